"""The chance to break a limit, and proposals that keep to a small one."""

import pickle
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution
from optuna.trial import create_trial

from storage.inputs.config import Table
from storage.specification import read_specification
from study import FeatureKernelSampler, FeatureTable
from study.sampler import risk
from study.sampler.risk import Prior, RiskError
from study.sampler.worlds import limits_in_worlds
from tests.storage import plants
from tests.study.conftest import refused
from tests.study.sampler import risky
from tests.study.sampler.campaigns import machine_of
from tests.study.sampler.studies import told

LINE = np.linspace(0.0, 1.0, 41)
SPACE = {"x": FloatDistribution(0.0, 1.0)}
# Twelve worlds; each falls beyond its own place, and costs least just before it.
PLACES = np.linspace(0.55, 0.85, 12)
COSTS = np.abs(LINE[:, None] - PLACES) + 0.2
FELL = LINE[:, None] > PLACES


def table_of(fell=FELL, costs=COSTS, features=None):
    limits = {} if fell is None else {"fall": fell}
    return FeatureTable.from_arrays(
        {"x": LINE}, features, outcomes=costs, limits=limits, space=SPACE
    )


def study_on(table, trials=(), **options):
    """A study over the line, after trials: where, and whether the machine fell."""
    sampler = FeatureKernelSampler(table, seed=1, **options)
    study = optuna.create_study(sampler=sampler)
    for x, fell in trials:
        told(study, SPACE, {"x": x}, 6.0 if fell else 0.5, fall=1.0 if fell else -1.0)
    return study


def risks(trials=(), fell=FELL):
    study = study_on(table_of(fell), trials)
    return study.sampler.predict(study).risks["fall"]


# Before any trial.
def test_before_a_trial_the_risk_is_the_share_of_worlds_with_a_prior():
    found, count = risks(), FELL.sum(axis=1)
    prior = Prior.of(limits_in_worlds({"fall": FELL}, len(LINE))["fall"])
    assert_allclose(found, (count + prior.broken) / (12.0 + prior.worlds))
    assert 0.01 < found[0] < 0.05 and found[-1] > 0.9
    assert (np.diff(found) >= 0.0).all()


def test_the_prior_is_worth_less_where_worlds_agree_and_never_more_than_laplaces():
    agree = np.tile(LINE[:, None] > 0.5, 12)
    rng = np.random.default_rng(1)
    apart = rng.random((41, 12)) < 0.3
    known = {"agree": agree, "apart": apart, "one": agree[:, :1], "none": agree & False}
    found = {
        name: Prior.of(worlds)
        for name, worlds in limits_in_worlds(known, len(LINE)).items()
    }
    assert found["agree"].worlds < 1.0
    for name in ("apart", "one", "none"):
        assert found[name].worlds == pytest.approx(2.0)
    # Of one world that falls in half of the rows, Laplace's rule.
    assert found["one"].broken == pytest.approx(1.0, abs=0.05)


def test_the_risk_of_rows_that_no_other_world_breaks_is_that_of_left_out_worlds():
    """Of 60 made-up machines: said of rows that fell in no world, and how many fell."""
    said, fell = list[float](), list[bool]()
    for seed in range(60):
        machine = machine_of("worlds", is_like=True, seed=seed)
        table = risky.knowing_falls(machine)
        study = optuna.create_study()
        found = FeatureKernelSampler(table, seed=0).predict(study).risks["fall"]
        safe = table.rows.limits["fall"].costs.sum(axis=1) == 0.0
        said += found[safe].tolist()
        fell += [risky.falls(machine, row[None]) for row in table.rows.parameters[safe]]
    assert np.mean(fell) <= np.mean(said) <= np.mean(fell) + 0.05


def test_families_count_alike_and_a_row_with_a_gap_is_unknown():
    families = {"few": FELL[:, :1], "many": np.repeat(FELL[:, -1:], 11, axis=1)}
    found = risks(fell=families)
    between = np.isclose(LINE, 0.7)
    assert_allclose(found[between], 0.5, atol=0.05)
    gap = np.where(LINE[:, None] == 0.5, np.nan, FELL)
    unknown = risks(fell=gap)
    assert np.isnan(unknown[20]) and np.isfinite(np.delete(unknown, 20)).all()


# After trials.
def test_trials_move_the_risk_towards_the_worlds_that_the_machine_is_like():
    before = risks()
    kept, fell = risks([(0.8, False)] * 4), risks([(0.6, True)] * 4)
    middle = np.flatnonzero(np.isclose(LINE, 0.7))
    assert kept[middle] < before[middle] < fell[middle]


def test_a_trial_counts_near_it_where_no_world_agrees_with_it():
    fell = risks([(0.1, True)])
    near, far = fell[np.isclose(LINE, 0.1)], fell[np.isclose(LINE, 0.4)]
    assert near > 2.0 * far > 2.0 * risks()[0]


def test_falls_that_nobody_expected_raise_all_risks_and_their_lack_does_not_lower_them():
    places = (0.05, 0.15, 0.25)
    base, more = risks(), risks([(x, True) for x in places])
    assert (more > base).all()
    far = np.isclose(LINE, 0.45)
    assert more[far] > 2.0 * base[far]
    assert_allclose(risks([(x, False) for x in places])[far], base[far], rtol=0.2)


def test_without_worlds_the_risk_is_that_of_the_trials():
    study = study_on(table_of(None), [(0.1, False), (0.2, False)])
    assert np.isnan(study.sampler.predict(study).risks["fall"]).all()
    told(study, SPACE, {"x": 0.3}, 0.5, fall=-1.0)
    found = study.sampler.predict(study)
    assert_allclose(found.risks["fall"], 0.2)
    assert_allclose(found.kept, 0.8)


# Proposals.
def proposals(study, count=12):
    """Trials of a machine that falls beyond 0.62, which a certificate has to find out."""
    for _ in range(count):
        trial = study.ask(SPACE)
        x = trial.params["x"]
        trial.set_constraint("fall", 1.0 if x > 0.62 else -1.0)
        study.tell(trial, 6.0 if x > 0.62 else abs(x - 0.62) + 0.2)
    return np.array([trial.params["x"] for trial in study.trials])


@pytest.mark.parametrize("allowed", [0.05, 0.2, 0.5])
def test_proposals_keep_to_the_risk_that_is_allowed(allowed):
    table = table_of()
    study = study_on(table, allowed_risk=allowed, success=0.25)
    for _ in range(10):
        said = study.sampler.predict(study)
        (x,) = proposals(study, 1)[-1:]
        # Off the table the rows near it tell.
        near = np.abs(LINE - x) <= 0.05
        assert said.risks["fall"][near].min() <= allowed
    free = proposals(study_on(table, success=0.25))
    careful = proposals(study_on(table, allowed_risk={"fall": 0.05}, success=0.25))
    assert (careful > 0.62).sum() < (free > 0.62).sum()


def test_a_risk_that_all_candidates_keep_to_changes_no_proposal():
    table = table_of(np.zeros_like(FELL))
    same = {"success": 0.25}
    free = proposals(study_on(table, **same))
    assert_allclose(free, proposals(study_on(table, allowed_risk=0.999, **same)))


def test_a_point_off_the_table_has_the_risk_of_rows_near_it():
    study = study_on(table_of())
    found = study.sampler.predict(study, [{"x": 0.012}, {"x": 0.99}])
    assert found.rows.tolist() == [-1, -1]
    assert_allclose(found.risks["fall"], risks()[[0, -1]], rtol=1e-3)


# Refusals.
@pytest.mark.parametrize("risk", [0, 1, 0.0, 1.0, -0.1, True, "0.1", np.nan])
def test_a_risk_is_above_0_and_below_1(risk):
    with refused("allowed_risk: .* a chance above 0 and below 1"):
        FeatureKernelSampler(table_of(), allowed_risk=risk)
    with refused(r"allowed_risk\.fall: .* a chance above 0 and below 1"):
        FeatureKernelSampler(table_of(), allowed_risk={"fall": risk})


def test_a_risk_needs_a_table_that_is_fitted_strictly():
    with refused("allowed_risk: 0.1 .* none without a table"):
        FeatureKernelSampler(allowed_risk=0.1)
    with refused("allowed_risk: 0.1 .* none without strict"):
        FeatureKernelSampler(table_of(), strict=False, allowed_risk=0.1)


@pytest.mark.parametrize("wanted", [0.1, {"fall": 0.1}])
def test_where_all_worlds_fall_the_least_risk_is_said(wanted):
    study = study_on(table_of(FELL | True), allowed_risk=wanted)
    with refused(r"allowed_risk\.fall: 0\.1 .* from 0\.99 on, the least risk") as error:
        study.ask(SPACE)
    assert 0.9 < error.value.least < 1.0


@pytest.mark.parametrize("wanted", [0.1, {"fall": 0.1}])
def test_where_nothing_tells_it_says_so_and_three_trials_may_change_that(wanted):
    table = table_of(None, features=np.column_stack([LINE, LINE**2]), costs=None)
    study = study_on(table, [(LINE[4], False), (LINE[8], False)], allowed_risk=wanted)
    with refused("allowed_risk.fall: 0.1 .* neither worlds nor 3 trials tell of it"):
        study.ask(SPACE)
    for x in LINE[9:11]:
        told(study, SPACE, {"x": x}, 0.5, fall=-1.0)
    with refused(r"allowed_risk\.fall: 0\.1 .* from 0\.17 on, the least risk"):
        study.ask(SPACE)
    for x in LINE[11:15]:
        told(study, SPACE, {"x": x}, 0.5, fall=-1.0)
    assert study.ask(SPACE).params


def test_a_number_for_all_limits_needs_one_limit():
    table = table_of(None, features=np.column_stack([LINE, LINE**2]), costs=None)
    with refused("allowed_risk: 0.1 .* neither worlds nor 3 trials tell of a limit"):
        study_on(table, allowed_risk=0.1).ask(SPACE)


def test_several_limits_each_have_their_own_risk():
    limits = {"fall": FELL, "torque": LINE[:, None] < 1.0 - PLACES}
    table = FeatureTable.from_arrays(
        {"x": LINE}, outcomes=COSTS, limits=limits, space=SPACE
    )
    study = study_on(table, allowed_risk={"fall": 0.5, "torque": 0.05})
    found = study.sampler.predict(study)
    within = (found.risks["fall"] <= 0.5) & (found.risks["torque"] <= 0.05)
    assert_allclose(found.kept, (1 - found.risks["fall"]) * (1 - found.risks["torque"]))
    x = study.ask(SPACE).params["x"]
    assert within[np.isclose(LINE, x)].all()
    tight = study_on(table, allowed_risk={"fall": 0.5, "torque": 0.001})
    with refused(r"allowed_risk\.torque: 0\.001"):
        tight.ask(SPACE)


def test_the_error_passes_between_processes():
    error = pickle.loads(pickle.dumps(RiskError("fall", 0.1, 0.2)))
    assert (error.limit, error.least, str(error)) == (
        "fall",
        0.2,
        str(RiskError("fall", 0.1, 0.2)),
    )


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"fall": FELL[:5]}, r"table\.limits\.fall\.shape: \(5, 12\)"),
        ({"fall": [["x"]] * 41}, r"table\.limits\.fall.* numbers"),
        ({"fall": {}}, r"table\.limits\.fall: 'none'"),
        ({"fall": np.full((41, 2), np.nan)}, r"table\.limits\.fall: 'gaps"),
        ({1: FELL}, r"table\.limits"),
        (FELL, r"table\.limits"),
    ],
)
def test_limits_that_cannot_be_used(limits, said):
    with refused(said):
        FeatureTable.from_arrays({"x": LINE}, outcomes=COSTS, limits=limits)


# The harness.
@pytest.mark.slow
def test_the_harness_counts_falls():
    robots = risky.made_up(4, 3, is_like=True)
    lines = list(risky.table("like", robots))
    assert len(lines) == 4
    assert "like at any: " in lines[0] and " at 5 %: " in lines[1]
    shares = [float(line.split("fell")[1].split("%")[0]) for line in lines]
    assert shares[1] <= 7.0 and min(shares) >= 0.0


def test_a_world_that_is_left_out_is_a_robot_that_nobody_knows():
    rows = risky.knowing_falls(machine_of("worlds", is_like=True, seed=1)).rows
    fall = replace(rows.limits["fall"], names=rows.worlds.names)  # as a store has them
    rows = replace(rows, limits={"fall": fall})
    robot = risky.left_out(rows, 5, None, lambda params: (1.0, False))
    for known in (robot.table.rows.worlds, robot.table.rows.limits["fall"]):
        assert known.names == rows.worlds.names[:5] + rows.worlds.names[6:]


def test_a_world_of_a_store_runs_any_point_as_it_has_run_the_rows():
    hot = {"settings": 3, "world": {"heat_k": [300.0, 320.0]}}
    table = {
        "samples": 8,
        "simulation": {"duration_s": 5400.0},
        "families": {"hot": hot},
    }
    made = read_specification(Table(table), simulator=plants.Battery)
    (family,), params = made.families, {"pulses": 3, "current_a": 3.0}
    point = np.array([[3.0, 3.0]])
    rows, _ = made.simulator.run(point, family.worlds, family.horizon_s, float)
    goal = SimpleNamespace(in_worlds=lambda given, _: given["loss_j"])
    found = [risky.ran(made, f"hot {world}", goal, params) for world in range(3)]
    assert len(set(found)) == 3 and [c for c, _ in found] == rows["loss_j"][0].tolist()
    assert [fell for _, fell in found] == (rows["survived_fraction"][0] < 1.0).tolist()


def test_an_oven_is_one_more_of_those_that_its_candidates_know():
    (oven,) = risky.ovens(1, 3)
    rows = oven.table.rows
    gains = dict(zip(rows.names, np.median(rows.parameters, axis=0), strict=True))
    cost, is_too_hot = oven.tried(gains)
    assert rows.worlds.costs.min() < cost < rows.worlds.costs.max()
    assert is_too_hot in (True, False)
    assert 0.05 < rows.limits["fall"].costs.mean() < 0.95


def tried(**limits):
    return create_trial(value=1.0, constraints=limits)


def test_to_keep_all_limits_is_one_event():
    """After a trial that broke two limits the chance was said to be 1 in 9."""
    risks = {"a": np.array([2 / 3]), "b": np.array([2 / 3])}
    all_kept = partial(risk.all_kept, errors=np.full((1, 4), np.nan))
    broke, kept = tried(a=1.0, b=1.0), tried(a=-1.0, b=-1.0)
    assert_allclose(all_kept(risks, (), [broke]), 1 / 3)
    assert_allclose(all_kept(risks, (), [broke, kept]), 1 / 2)
    assert_allclose(all_kept(risks, (), [tried(a=1.0, b=-1.0)]), 1 / 3)
    # Of what worlds tell, and of one limit, nothing changes.
    assert_allclose(all_kept(risks, ("a", "b"), [broke]), 1 / 9)
    assert_allclose(all_kept({"a": risks["a"]}, (), [broke]), 1 / 3)
    three = risks | {"c": np.array([0.1])}
    assert_allclose(all_kept(three, ("c",), [broke]), 0.3)
    # Trials that tell of one limit alone are not of all, and many leave it to the model.
    assert_allclose(all_kept(risks, (), [tried(a=1.0), tried(b=1.0)]), 1 / 9)
    many = partial(risk.all_kept, risks, (), 200 * [broke])
    apart, same = np.ones((40, 3)), np.ones((40, 3))
    apart[::2, 2] = -1.0
    for errors, chance in ((same[:0], 2 / 9), (apart, 0.12), (same, 0.323)):
        assert_allclose(many(errors), chance, rtol=0.02)
    unknown = risks | {"a": np.array([np.nan])}
    assert np.isnan(all_kept(unknown, (), [broke])).all()

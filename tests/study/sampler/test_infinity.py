"""A number that stands for infinity never changes side: limits, values, worlds, features, goals."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from study import FeatureKernelSampler, FeatureTable
from study.sampler.history import next_trial
from study.sampler.worlds import Worlds
from tests.study.sampler.studies import params_of, study_of, told

INF, NAN = np.inf, np.nan
LINE = np.linspace(0.0, 1.0, 200)
TABLE = FeatureTable.from_arrays({"x": LINE}, np.column_stack([LINE, LINE**2]))
SPACE = TABLE.rows.space.as_dict()
SIGNS = {"minimize": 1.0, "maximize": -1.0}


# Limits.
def crashing(broken, kept):
    """Best at 0.9, and crashes above 0.5."""

    def objective(trial):
        x = trial.suggest_float("x", 0, 1)
        trial.set_constraint("crash", broken if x > 0.5 else kept)
        return (x - 0.9) ** 2

    return objective


@pytest.mark.parametrize(
    ("broken", "kept"),
    [
        (INF, -1.0),
        (INF, -INF),
        (1.0, -INF),
        (1e300, -1.0),
        (1.0, 0.0),
        (INF, 0.0),
        (1e-13, -1e-13),
    ],
)
def test_a_limit_that_is_broken_by_infinity_is_broken(broken, kept):
    usual = study_of(TABLE, crashing(1.0, -1.0), 20)
    study = study_of(TABLE, crashing(broken, kept), 20)
    assert params_of(study) == params_of(usual)
    sampler = study.sampler
    assert sampler.best(study).params["x"] == LINE[99]  # 0.497
    found = sampler.predict(study)
    assert found.kept[182] < 0.05 and (found.kept[:5] > 0.6).all()
    assert_allclose(found.kept, usual.sampler.predict(usual).kept)


# Values of a study.
STORAGES = {
    "memory": lambda path: None,
    "sqlite": lambda path: f"sqlite:///{path}",
    "journal": lambda path: JournalStorage(JournalFileBackend(str(path))),
}


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("direction", SIGNS)
def test_infinite_values_are_the_worst_and_the_best_in_any_database(
    direction, storage, tmp_path
):
    sign, sampler = SIGNS[direction], FeatureKernelSampler(TABLE, seed=1)
    kept_in = {"storage": STORAGES[storage](tmp_path / "study")}
    study = optuna.create_study(direction=direction, sampler=sampler, **kept_in)

    def tell(row, value, limit=-1.0):
        told(study, SPACE, {"x": LINE[row]}, sign * value, limit=limit)

    for row in (20, 60):
        tell(row, INF)
    worst = sampler.best(study)
    assert worst.value == sign * INF and np.isnan([worst.low, worst.high]).all()
    assert np.isnan(sampler.predict(study).value).all()  # no number is known
    tell(100, 5.0)
    best = sampler.best(study)
    assert best.number == 2 and best.low < best.value < best.high
    assert sign * best.value < 7.0
    tell(140, -INF, INF)
    assert sampler.best(study).number == 2  # the other broke its limit
    tell(160, -INF, -INF)
    best, shown = sampler.best(study), f"{-sign * INF:g} (interval unknown), by 1 trial"
    assert best.number == 4 and best.value == -sign * INF
    wanted = f"Trial 4, row 160: read {-sign * INF:g}; expected {shown}"
    assert str(best).startswith(wanted)
    value = sign * sampler.predict(study).value
    assert value[160] < value[100] < min(value[[20, 60]])
    assert sampler.worth(study).trials == 5


def history_of(study):
    """What the sampler reads before its next trial."""
    return study.sampler._policy._history(study, next_trial(study))


@pytest.mark.parametrize("direction", SIGNS)
@pytest.mark.parametrize("values", [[INF], [INF, INF, 0.9], [-INF], [-INF, 0.9]])
def test_infinity_is_on_its_own_side_of_a_success(values, direction):
    """The first trial is infinite; a success is at most 0.5."""
    sign, costs = SIGNS[direction], np.column_stack([0.1 + LINE, 0.4 + LINE])
    table = FeatureTable.from_arrays({"x": LINE}, outcomes=sign * costs)
    study = study_of(table, direction=direction, success=sign * 0.5)
    for x, value in zip(LINE, values, strict=False):
        told(study, SPACE, {"x": x}, sign * value)
    first = history_of(study).cost[0]
    if values[0] < 0:
        assert first < costs.min() and first <= 0.5
    else:  # worse than in any world
        assert first > costs.max() and first > 0.5


def test_several_goals_have_infinities_on_their_own_sides():
    sampler = FeatureKernelSampler(TABLE, seed=1)
    study = optuna.create_study(directions=["minimize", "maximize"], sampler=sampler)
    for row, values in ((3, (INF, 2)), (9, (1, -INF)), (30, (2, 3)), (60, (-INF, INF))):
        told(study, SPACE, {"x": LINE[row]}, values)
    first, second = history_of(study).costs.T  # lower is better
    assert np.argsort(first).tolist() == [3, 1, 2, 0]
    assert np.argsort(second).tolist() == [3, 2, 0, 1]
    assert np.isfinite(history_of(study).cost).all() and study.ask(SPACE).params


# Worlds.
@pytest.mark.parametrize(
    ("outcomes", "order"),
    [
        ([[INF], [1.0], [2.0]], [1, 2, 0]),
        ([[INF], [1.0]], [1, 0]),
        ([[-INF], [1.0]], [0, 1]),
        ({"easy": [[1.0], [2.0]], "hard": [[INF], [INF]]}, [0, 1]),
        ({"easy": [[1.0], [2.0]], "hard": [[INF], [-INF]]}, [1, 0]),
        ([[INF, 5.0], [9.0, 5.0]], [1, 0]),
    ],
)
def test_what_is_infinite_in_a_world_is_worse_than_any_number(outcomes, order):
    families = outcomes if isinstance(outcomes, dict) else {"world": outcomes}
    for better, sign in (("lower", 1.0), ("higher", -1.0), (None, 1.0)):
        given = {name: sign * np.array(part) for name, part in families.items()}
        table = FeatureTable.from_arrays(
            {"x": LINE[: len(order)]}, outcomes=given, better=better
        )
        mean = table.rows.ensemble(np.ones(1)).mean
        assert np.argsort(mean, kind="stable").tolist() == order
        assert np.isfinite(mean).all()


def test_a_world_in_which_all_is_infinite_is_no_free_one():
    worlds = Worlds.of({"easy": [[1.0], [2.0]], "hard": [[INF], [INF]]})
    assert worlds.costs.min() == 1.0 and (worlds.costs[:, 1] > 2.0).all()
    goals = Worlds.of(np.array([[[1.0, -5.0]], [[INF, -INF]], [[3.0, -9.0]]]))
    assert goals.costs[1].tolist() == [[5.0, -13.0]]  # each goal on its own


@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_a_table_with_infinite_outcomes_has_the_digest_that_version_0_3_0_gave_it():
    """A bench that was begun with it opens."""
    outcomes = {"a": [[INF, 2.0], [1.0, 3.0], [NAN, 1.0]], "b": [[4.0], [-INF], [0.5]]}
    table = FeatureTable.from_arrays({"x": [0.0, 0.5, 1.0]}, outcomes=outcomes)
    assert (
        table.digest
        == "2bd01532a5c0997279d76d56d8ec54b9e24c7803a0c3b607ba35b5d45679c828"
    )


# Features.
def test_an_infinite_score_is_extreme_to_the_papers_sampler():
    """Rows that failed in the simulator are not taken for middling ones."""
    score = np.where(LINE > 0.7, -INF, LINE)  # high ones are good
    table = FeatureTable.from_arrays({"x": LINE}, score)
    standard = table.rows.standard.standard(table.rows.features)[:, 0]
    assert standard[LINE > 0.7].max() < standard[LINE <= 0.7].min()
    study = study_of(table, seed=1, direction="maximize", kernel="rbf")

    def objective(trial):
        x = trial.suggest_float("x", 0, 1)
        return x if x <= 0.7 else -x

    study.optimize(objective, n_trials=15)
    assert study.best_value > 0.68

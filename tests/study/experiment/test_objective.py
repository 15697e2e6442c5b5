"""What a trial costs: weighted terms beside the paper's two costs, of rows and of worlds."""

import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from storage.inputs.config import Table
from storage.store import open_store
from study.bench.plan import Goal
from study.experiment.arms import ARMS
from study.experiment.experiment import candidates
from study.experiment.objective import Objective, Term, read_objective
from study.experiment.walker import PAID, as_written, experiment_of
from taichi_nmm.result import RESULT_DTYPE
from tests.cases import cases, refused
from tests.study import fake_walker

TERMS = {
    "cost_of_transport_jpkgpm": 2.0,
    "mean_speed_mps": {"weight": 100.0, "target": 0.8, "tolerance": 0.05},
}
TABLE = {"cost": "weighted", "fell_cost": 50.0, "terms": TERMS}
AT_08 = read_objective(Table(TABLE, "objective"), PAID)


@pytest.mark.parametrize(
    ("cost", "walker", "faller"),
    [
        ("smooth", 1 / 101 + 0.3 / 121 + 0.001, 1 / 11 + 0.3 / 13 + 0.001),
        ("walking", 15.0, 288.0),
    ],
)
def test_costs_in_worlds_are_those_of_a_trial(cost, walker, faller):
    names = ("survived_fraction", "mean_speed_mps", "cost_of_transport_jpkgpm")
    values = np.array([[1.0, 0.5, np.nan], [1.2, 1.2, np.nan], [5.0, 9.0, np.nan]])
    given = dict(zip(names, values[:, None], strict=True))
    # who lasts 20 s is taken to last 100 s
    found = Objective(cost).in_worlds(given, 20.0)
    assert_allclose(found, [[walker, faller, np.nan]])


def test_a_walk_pays_for_each_term_and_a_fall_for_how_early_it_was():
    rows = np.zeros(5, RESULT_DTYPE)
    rows["survived_fraction"] = 1.0, 1.0, 1.0, 0.75, 0.0
    rows["mean_speed_mps"] = 0.84, 0.7, 2.0, 0.8, 0.8
    rows["cost_of_transport_jpkgpm"] = 4.0
    rows["duration_s"] = 5.0
    # the third costs 123: no more
    expected = [8.0, 8.0 + 100.0 * 0.05, 50.0, 50.0 * 1.25, 100.0]
    assert_allclose(AT_08.costs(rows), expected)
    given = {name: rows[name][:, None] for name in rows.dtype.names or ()}
    assert_allclose(AT_08.in_worlds(given, 5.0)[:, 0], expected)
    assert AT_08.success(100.0) == 50.0
    assert [*AT_08.metrics, *Objective("walking").metrics] == [
        "weighted_cost",
        "walking_cost",
    ]


def test_what_was_not_measured_costs_as_much_as_a_fall_at_the_end_and_never_0():
    """Who stands still uses no energy a metre that is known, and no step is like people's."""
    objective = read_objective(Table(TABLE | {"terms": {"human_deviation": 1.0}}), PAID)
    rows = np.zeros(2, RESULT_DTYPE)
    rows["survived_fraction"], rows["duration_s"], rows["step_count"] = (
        1.0,
        100.0,
        (0, 150),
    )
    rows["human_deviation"] = 0.0, 3.0
    assert objective.costs(rows).tolist() == [50.0, 3.0]
    still = read_objective(
        Table(TABLE | {"terms": {"cost_of_transport_jpkgpm": 2.0}}), PAID
    )
    rows["mean_speed_mps"], rows["cost_of_transport_jpkgpm"] = (0.0, 0.8), (0.0, 4.0)
    assert still.costs(rows).tolist() == [50.0, 8.0]
    given = {name: rows[name][:, None] for name in ("survived_fraction", *TERMS)}
    assert still.in_worlds(given, 5.0)[:, 0].tolist() == [50.0, 8.0]


def test_it_is_read_back_from_what_it_writes(tmp_path, fake_simulator):
    assert AT_08.document() == TABLE and AT_08.terms[0] == Term(
        "cost_of_transport_jpkgpm", 2.0
    )
    experiment = replace(fake_walker.experiment(tmp_path), objective=AT_08)
    written = as_written(experiment)
    again = experiment_of(Table(written), "")
    assert again.objective == AT_08 and as_written(again) == written
    column = read_objective(
        Table({"cost": "effort", "fell_cost": 9.0}), ("effort",), "lasted"
    )
    assert column == Objective("effort", (Term("effort", 1.0),), 9.0, "lasted")
    assert column.document() == {"cost": "effort", "fell_cost": 9.0}


OWN = """def slow(columns): return 2.0 - columns["mean_speed_mps"]
def no(columns): return columns["effort"]
def none(columns): return columns["mean_speed_mps"] * float("nan")
def one(columns): return columns["mean_speed_mps"][:2]
number = 3
"""


@pytest.mark.parametrize(
    ("function", "found"),
    [
        ("slow", [0.5, 1.5, 13.5]),
        ("no", "objective: .* not ValueError: no field of name effort$"),
        ("none", "objective: .* not ValueError: NaN or"),
        ("two", "objective.*attribute 'two'"),
        ("one", "objective: .* not ValueError: operands"),
        ("number", "function: 'int' .* a function "),
    ],
)
def test_a_function_stands_for_a_column_or_is_the_cost(
    function, found, tmp_path, monkeypatch
):
    monkeypatch.setattr("sys.path", [*sys.path])
    file, name = tmp_path / f"own_{function}.py", f"own_{function}.py:{function}"
    file.write_text(OWN)
    rows, cost = np.zeros(3, RESULT_DTYPE), {"cost": name, "fell_cost": 9.0}
    rows["survived_fraction"], rows["mean_speed_mps"] = (1.0, 1.0, 0.5), (1.5, 0.5, 0.0)
    if isinstance(found, str):
        with refused(f"^{found}"):
            read_objective(Table(cost, "objective", tmp_path), PAID).costs(rows)
        return
    for table in (cost, TABLE | {"fell_cost": 9.0, "terms": {name: 1.0}}):
        objective = pickle.loads(
            pickle.dumps(read_objective(Table(table, "o", tmp_path), PAID))
        )
        assert_allclose(objective.costs(rows), found)
    assert_allclose(
        Goal("", False, None, None, 1.0).in_worlds(objective.terms[0])(rows, 1.0),
        [0.5, 1.5, 2.0],
    )
    document = objective.document()
    assert read_objective(Table(document, "objective", tmp_path), PAID) == objective
    file.write_text(f"{OWN}# another version")
    with refused(r"^objective\.code: "):
        read_objective(Table(document, "objective", tmp_path), PAID)


@cases("bad-objectives.toml", "changed", "message")
def test_bad_objectives_are_refused(changed, message):
    table = Table(TABLE | changed, "objective")
    with refused(message):
        read_objective(table, PAID)
        table.done()


def test_worlds_count_in_the_units_of_the_objective(fake_simulator, tmp_path):
    experiment, feature = fake_walker.experiment(tmp_path), ARMS["worlds"].feature
    objectives = {"smooth": Objective(), "walking": Objective("walking"), "at": AT_08}
    costs, rows = {}, None
    for name, objective in objectives.items():
        one = replace(experiment, objective=objective)
        rows = candidates(one, "worlds", feature).rows
        costs[name] = rows.worlds.costs
    assert (
        np.nanmax(costs["smooth"]) < 2.0 < 200.0 < np.nanmax(costs["walking"]) <= 300.0
    )
    assert 50.0 < np.nanmax(costs["at"]) <= 100.0


def test_worlds_keep_the_columns_that_a_store_names(fake_simulator, tmp_path):
    """No cost is of the base setting's level ground, whose column the store may have."""
    experiment = fake_walker.experiment(tmp_path)
    for name in ("activation_sol_mean", "activation_cubed_mean"):
        lacking = replace(
            experiment, objective=Objective("weighted", (Term(name, 1.0),), 30.0)
        )
        with refused(
            f"^cost: '{name}' .* survived_fraction, mean_.*kept = ..{name}"
        ) as error:
            candidates(lacking, "worlds", ARMS["worlds"].feature)
        assert len(str(error.value)) < 500
    effort = Objective("weighted", (Term("activation_cubed_mean", 1.0),), 30.0)
    experiment = replace(experiment, objective=effort)
    fake_walker.write_store(tmp_path / "kept", kept=["activation_cubed_mean"])
    kept = replace(experiment, stores={"worlds": tmp_path / "kept"})
    rows = candidates(kept, "worlds", ARMS["worlds"].feature).rows
    store = open_store(tmp_path / "kept")
    given, lasted = (
        store.outcomes("rough", name)
        for name in ("activation_cubed_mean", "survived_fraction")
    )
    ran = store.table()["rough_evaluated"].to_numpy() & (lasted[:, 0] >= 1.0)
    place = rows.worlds.names.index("rough 0")
    assert ran.any() and np.ptp(given[ran, 0]) > 0.1
    assert_allclose(rows.worlds.costs[ran, place], given[ran, 0])

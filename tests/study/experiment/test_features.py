"""What a store knows of its rows, as candidates of studies."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from storage.store import open_store
from study.experiment import features
from study.experiment.arms import ARMS, check_arms
from study.experiment.experiment import candidates
from tests.study import fake_walker
from tests.study.conftest import refused


@pytest.mark.filterwarnings("error:FeatureTable")
def test_rows_that_no_family_ran_are_left_out_and_do_not_count(comparisons):
    strict = {"settings": 1, "min_survival_s": 2.8}  # a third of the fake's points falls sooner
    families = dict.fromkeys(("rough", "up"), strict)
    fake_walker.write_store(comparisons.folder / "strict", robust=strict, families=families)
    store = open_store(comparisons.folder / "strict")
    ran = store.table()["rough_evaluated"].to_numpy()
    count = int(ran.sum())
    assert 30 < count < len(store) - 30
    experiment = replace(comparisons.experiment, stores={"worlds": store.path})
    for arm in ("worlds", "ranking"):
        table = candidates(experiment, "worlds", ARMS[arm].feature)
        assert_array_equal(table.rows.offered, ran)
        comparisons.run(arm, experiment=experiment, arms=(arm,), runs=2, trials=20)
        rows = comparisons.table(arm)["row"].to_numpy()
        assert ran[rows[rows >= 0]].all()  # others are between rows
        with refused(f"trials: {count + 1} .* at most {count}, the rows that {arm} may"):
            check_arms(experiment, (arm,), count + 1)


@pytest.mark.parametrize(("cost", "walker", "faller"), [
    ("smooth", 1 / 101 + 0.3 / 121 + 0.001, 1 / 11 + 0.3 / 13 + 0.001), ("walking", 15.0, 288.0),
])  # fmt: skip
def test_costs_in_worlds_are_those_of_a_trial(cost, walker, faller):
    names = ("survived_fraction", "mean_speed_mps", "cost_of_transport_jpkgpm")
    values = np.array([[1.0, 0.5, np.nan], [1.2, 1.2, np.nan], [5.0, 9.0, np.nan]])
    given = dict(zip(names, values[:, None], strict=True))
    found = features.COSTS[cost](given, 20.0)  # who lasts 20 s is taken to last 100 s
    assert_allclose(found, [[walker, faller, np.nan]])


def test_worlds_count_in_the_units_of_the_experiments_cost(fake_simulator, tmp_path):
    experiment = fake_walker.experiment(tmp_path)
    tables = {
        cost: candidates(replace(experiment, cost=cost), "worlds", ARMS["worlds"].feature)
        for cost in ("smooth", "walking")
    }
    costs = {cost: table.rows.worlds.costs for cost, table in tables.items()}
    assert np.nanmax(costs["smooth"]) < 2.0 < 200.0 < np.nanmax(costs["walking"])

"""What a store knows of its rows, as candidates of studies."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from storage.store import open_store
from study.experiment.arms import ARMS, check_arms
from study.experiment.experiment import candidates
from study.experiment.features import world_table
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


def test_what_no_world_has_kept_is_that_of_level_ground_for_rows_that_ran(fake_simulator, tmp_path):
    strict = {"settings": 1, "min_survival_s": 2.8}  # a third of the fake's points falls sooner
    fake_walker.write_store(tmp_path / "strict", robust=strict, families={"rough": strict})
    store = open_store(tmp_path / "strict")
    known = world_table(store.path, lambda given, horizon_s: given["phi_printed"]).rows
    ran, own = world_table(store.path).rows.offered, store.numpy(["phi_printed"])["phi_printed"]
    assert 0 < ran.sum() < len(store)
    assert_array_equal(known.offered, ran)
    for costs in known.worlds.costs[ran].T:
        assert_array_equal(costs, own[ran])
    score = lambda given, horizon_s: given["phi_printed"]  # noqa: E731
    both = world_table(store.path, lambda given, horizon_s: -given["phi_printed"], score)
    assert both.rows.worlds.goals == 2
    for costs, sign in zip(np.moveaxis(both.rows.worlds.costs, -1, 0), (-1.0, 1.0), strict=True):
        assert_array_equal(costs, sign * known.worlds.costs)

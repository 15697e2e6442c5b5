"""The loop: what arms share, and that nothing is lost or computed twice."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from study.comparison import lockstep
from study.comparison.results import RESULT_SCHEMA
from study.comparison.summary import summaries
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, lower_bounds, upper_bounds
from tests.study.comparison import fake
from tests.study.comparison.conftest import Comparisons


def test_a_round_is_one_batch_and_all_arms_share_bodies_and_grounds(
    comparisons: Comparisons,
) -> None:
    fake.calls.clear()
    comparisons.run("out")
    assert len(fake.calls) == 8  # rounds, not 8 trials x 9 studies
    for call in fake.calls:
        assert call["gains"].shape == (9, 16)
        index = call["terrain_index"]
        assert sorted(index.tolist()) == [0, 0, 0, 1, 1, 1, 2, 2, 2]
        assert len(call["terrains"]) == 3
        for run in range(3):
            masses = call["bodies"].mass_kg[index == run]
            assert (masses == masses[0]).all()  # three arms, one body
    heights = [[t.height_m.tobytes() for t in call["terrains"]] for call in fake.calls]
    assert len({tuple(h) for h in heights}) == 1  # the same in every round
    assert len(set(heights[0])) == 3  # another in every run


def test_the_table_has_every_trial_once_and_no_gaps(comparisons: Comparisons) -> None:
    outcome = comparisons.run("out")
    table = comparisons.table("out")
    assert outcome.computed == len(table) == 3 * 3 * 8
    assert table.schema.remove_metadata().equals(RESULT_SCHEMA)
    frame = table.to_pandas()
    assert not frame.isna().any().any()
    keys = frame[["arm", "run", "trial"]]
    assert not keys.duplicated().any()
    assert keys.equals(keys.sort_values(["arm", "run", "trial"], ignore_index=True))
    gains = frame[list(GAIN_NAMES)].to_numpy()
    assert ((gains >= lower_bounds()) & (gains <= upper_bounds())).all()
    best = frame.groupby(["arm", "run"]).cost.cummin()
    np.testing.assert_array_equal(frame.best_cost, best)
    times = pq.read_table(comparisons.folder / "out" / "proposal_times.parquet").to_pandas()
    assert times[["arm", "run", "trial"]].equals(keys)
    assert (times.proposal_s > 0).all()


def test_rows_of_the_store_are_named_and_are_those_rows(comparisons: Comparisons) -> None:
    comparisons.run("out")
    frame = comparisons.table("out").to_pandas()
    store = pq.read_table(comparisons.folder / "store" / "part-00000.parquet").to_pandas()
    assert (frame.row[frame.arm == "random"] == -1).all()
    proposed = frame[frame.arm != "random"]
    names = list(GAIN_NAMES)
    np.testing.assert_array_equal(proposed[names], store.loc[proposed.row, names])


def test_the_footer_is_the_experiment(comparisons: Comparisons) -> None:
    comparisons.run("out")
    written = json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    footer = json.loads(comparisons.table("out").schema.metadata[b"taichi_nmm"])
    assert footer == written
    assert written["name"] == "toy"
    assert set(written["stores"]) == {"flat", "robust"}
    assert set(written["arms"]) == {"random", "dog", "score-first"}
    assert written["arms"]["dog"]["options"]["acquisition"] == "ei"
    assert "optuna" in written["versions"]


def test_growing_an_experiment_is_the_same_as_all_at_once(comparisons: Comparisons) -> None:
    comparisons.run("grown", arms=("random",), runs=1, trials=3)
    comparisons.run("grown", arms=("random", "cmaes-cold"), runs=2, trials=5)
    grown = comparisons.run("grown", arms=("random", "cmaes-cold", "dog"))
    whole = comparisons.run("whole", arms=("dog", "cmaes-cold", "random"))
    assert comparisons.content("grown") == comparisons.content("whole")
    assert grown.computed < whole.computed == 72


def test_a_smaller_request_keeps_what_is_there(comparisons: Comparisons) -> None:
    comparisons.run("out")
    before = comparisons.content("out")
    outcome = comparisons.run("out", arms=("dog",), runs=1, trials=2)
    assert outcome.computed == 0
    assert comparisons.content("out") == before


def test_an_interrupted_experiment_goes_on(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = iter(range(100))

    def interrupted(*arguments: object, **options: object) -> object:
        if next(rounds) == 3:
            raise KeyboardInterrupt
        return simulate(*arguments, **options)  # type: ignore[arg-type]

    simulate = lockstep.simulate_trials
    monkeypatch.setattr(lockstep, "simulate_trials", interrupted)
    with pytest.raises(KeyboardInterrupt):
        comparisons.run("out")
    assert not (comparisons.folder / "out" / "trials.parquet").exists()
    outcome = comparisons.run("out")
    assert outcome.computed == 72 - 3 * 9  # three rounds were kept
    comparisons.run("whole")
    assert comparisons.content("out") == comparisons.content("whole")


def test_checkpoints_are_written_on_the_way(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lockstep, "CHECKPOINT_S", 0.0)
    seen = []

    def watch(progress: lockstep.Progress) -> None:
        file = comparisons.folder / "out" / "arms" / "dog.parquet"
        seen.append(pq.read_metadata(file).num_rows if file.exists() else 0)

    studies = [("dog", 0), ("dog", 1)]
    from study.comparison.folder import ExperimentFolder

    with ExperimentFolder.claim(comparisons.folder / "out", {"arms": {}, "stores": {}}) as folder:
        lockstep.Lockstep(comparisons.experiment, studies, folder).run(4, 1, watch)
    assert seen == [0, 0, 2, 4, 6]  # reported before the checkpoint of its round


def test_a_broken_sampler_stops_the_experiment_and_keeps_the_rest(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    from study.comparison.group import OneStudy

    ask = OneStudy.ask

    def breaks(self: OneStudy) -> object:
        if self.trials == 2:
            raise InputError("sampler", "tired", "rest")
        return ask(self)

    monkeypatch.setattr(OneStudy, "ask", breaks)
    with pytest.raises(InputError, match="tired"):
        comparisons.run("out", arms=("random",))
    assert pq.read_metadata(comparisons.folder / "out/arms/random.parquet").num_rows == 6


def test_the_seventeenth_parameter_is_searched_simulated_and_written(
    fake_walker: None, comparisons: Comparisons
) -> None:
    folder = comparisons.folder / "torso"
    folder.mkdir()
    experiment = fake.experiment(folder, 'searched = ["theta_ref"]')
    fake.calls.clear()
    arms = ("random", "dog", "cmaes-warm", "cmaes-cold", "bo-euclidean", "score-first")
    comparisons.run("torso/out", experiment=experiment, arms=arms, trials=5)
    frame = comparisons.table("torso/out").to_pandas()
    assert frame.theta_ref.nunique() > 50
    assert frame.theta_ref.between(np.deg2rad(-10), np.deg2rad(30)).all()
    simulated = np.concatenate([call["low_level_gains"][:, 7] for call in fake.calls])
    assert sorted(simulated) == sorted(frame.theta_ref)
    store = pq.read_table(folder / "store" / "part-00000.parquet").to_pandas()
    ranked = frame[frame.arm == "score-first"]
    np.testing.assert_array_equal(ranked.theta_ref, store.theta_ref[ranked.row])


def test_without_it_the_column_holds_its_default(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    np.testing.assert_allclose(comparisons.table("out")["theta_ref"], np.deg2rad(6.0))


def test_the_summary_counts_first_walkers(comparisons: Comparisons) -> None:
    outcome = comparisons.run("out", trials=12)
    frame = comparisons.table("out").to_pandas()
    for one in outcome.arms:
        mine = frame[frame.arm == one.arm]
        walkers = mine[mine.walked].groupby("run").trial.min() + 1
        assert one.walkers == len(walkers)
        assert (one.runs, one.trials) == (3, 36)
        assert one.best_cost == mine.groupby("run").cost.min().median()
        first = walkers.reindex(range(3), fill_value=np.inf).median()
        assert one.first_walker == (first if np.isfinite(first) else None)
    times = pq.read_table(comparisons.folder / "out" / "proposal_times.parquet")
    assert summaries(comparisons.table("out"), times, comparisons.experiment.stores) == outcome.arms

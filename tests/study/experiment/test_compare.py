"""Comparisons: what arms share, and that nothing is lost or computed twice, however work is cut."""

import json
from contextlib import nullcontext

import numpy as np
import pyarrow.parquet as pq
import pytest

from storage.pool import InProcess, Pool
from study.experiment import compare as comparing
from study.experiment.compare import Request, compare, cut
from study.experiment.folder import results_of
from study.experiment.one_study import OneStudy
from taichi_nmm.parameters import GAIN_NAMES, LOW_LEVEL_GAINS
from taichi_nmm.settings import Settings
from tests.storage.fake import stopping
from tests.study import fake_walker
from tests.study.experiment.fake_results import STATE_SCHEMA, experiment

pytestmark = pytest.mark.slow

# one of each way to keep a state
STATEFUL = ("random", "dog", "cmaes-cold", "cmaes-warm")


@pytest.fixture
def cut_into(monkeypatch):
    """Sets the sizes of units of work: studies of a block, trials of a stretch."""

    def into(studies, trials):
        monkeypatch.setattr(comparing, "BLOCK_STUDIES", studies)
        monkeypatch.setattr(comparing, "STRETCH_TRIALS", trials)

    return into


def test_a_round_is_one_batch_and_arms_share_bodies_and_grounds(comparisons):
    fake_walker.calls.clear()
    comparisons.run("out", arms=("random", "dog", "cmaes-cold"))  # which share no gains
    assert len(fake_walker.calls) == 8  # rounds, not 8 trials x 9 studies
    for call in fake_walker.calls:
        assert call["gains"].shape == (9, 16)
        index = call["terrain_index"]
        assert sorted(index.tolist()) == [0, 0, 0, 1, 1, 1, 2, 2, 2]
        assert len(call["terrains"]) == 3
        for run in range(3):
            masses = call["bodies"].mass_kg[index == run]
            assert (masses == masses[0]).all()  # three arms, one body
    heights = [
        [t.height_m.tobytes() for t in call["terrains"]] for call in fake_walker.calls
    ]
    assert len({tuple(h) for h in heights}) == 1  # the same in every round
    assert len(set(heights[0])) == 3  # another in every run


def test_the_table_has_every_trial_once_and_no_gaps(comparisons):
    outcome, table = comparisons.run("out"), comparisons.table("out")
    assert outcome.computed == len(table) == 3 * 3 * 8
    assert table.schema.remove_metadata().equals(
        results_of(STATE_SCHEMA.empty_table()).schema
    )
    frame = table.to_pandas()
    assert not frame.isna().any().any()
    keys = frame[["arm", "run", "trial"]]
    assert not keys.duplicated().any()
    assert keys.equals(keys.sort_values(["arm", "run", "trial"], ignore_index=True))
    # not searched: its default
    np.testing.assert_allclose(frame.theta_ref, np.deg2rad(6.0))
    best = frame.groupby(["arm", "run"]).cost.cummin()
    np.testing.assert_array_equal(frame.best_cost, best)
    store = pq.read_table(
        comparisons.folder / "store" / "part-00000.parquet"
    ).to_pandas()
    assert (frame.row[frame.arm == "random"] == -1).all()
    rows = frame[frame.arm != "random"]  # of the store, each named by its number
    np.testing.assert_array_equal(
        rows[list(GAIN_NAMES)], store.loc[rows.row, list(GAIN_NAMES)]
    )
    times = pq.read_table(
        comparisons.folder / "out" / "proposal_times.parquet"
    ).to_pandas()
    assert times[["arm", "run", "trial"]].equals(keys) and (times.proposal_s > 0).all()
    written = json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    assert json.loads(table.schema.metadata[b"taichi_nmm"]) == written
    assert written["name"] == "toy" and set(written["stores"]) == {"flat", "worlds"}
    assert set(written["arms"]) == {"random", "dog", "ranking"}
    assert written["arms"]["dog"]["options"] == {"kernel": "rbf"}


def test_growing_an_experiment_is_the_same_as_all_at_once(comparisons):
    comparisons.run("grown", arms=("random",), runs=1, trials=3)
    comparisons.run("grown", arms=("random", "cmaes-cold"), runs=2, trials=5)
    grown = comparisons.run("grown", arms=("random", "cmaes-cold", "dog"))
    whole = comparisons.run("whole", arms=("dog", "cmaes-cold", "random"))
    assert grown.computed < whole.computed == 72
    # a smaller one
    assert comparisons.run("grown", arms=("dog",), runs=1, trials=2).computed == 0
    assert comparisons.content("grown") == comparisons.content("whole")


def test_results_depend_on_no_cut_slot_or_stop(comparisons, cut_into, monkeypatch):
    comparisons.run("whole", arms=STATEFUL)
    for slots in (2, 5, 100):
        with monkeypatch.context() as patch:
            pool = nullcontext(Pool(InProcess(), slots))
            patch.setattr(comparing, "open_pool", lambda *_, pool=pool: pool)
            comparisons.run(f"{slots}", arms=STATEFUL)
        assert comparisons.content(f"{slots}") == comparisons.content("whole")
        assert all(call["settings"].threads == 1 for call in fake_walker.calls[-12:])
    cut_into(2, 3)
    assert comparisons.stop_and_run("stopped", 8, arms=STATEFUL) > 3
    assert comparisons.content("stopped") == comparisons.content("whole")
    comparisons.run("five", arms=STATEFUL, trials=5)
    for block, stretch in ((1, 1), (1, 1000), (1000, 1), (2, 2)):
        cut_into(block, stretch)
        comparisons.run(f"cut-{block}-{stretch}", arms=STATEFUL, trials=5)
        assert comparisons.content(f"cut-{block}-{stretch}") == comparisons.content(
            "five"
        )


@pytest.mark.parametrize(
    "engine", ["taichi", pytest.param("mujoco", marks=pytest.mark.campaign)]
)
def test_results_do_not_depend_on_processes_and_stops(engine, tmp_path):
    """The real simulator, in one process; and begun there, in two that are spawned."""
    settings = Settings(arch="cpu", engine=engine)
    tiny = experiment(duration_s=1.0, arms=("random", "cmaes-cold"), settings=settings)
    one, two = (tmp_path / name / "trials.parquet" for name in ("one", "two"))
    stopped, whole = {"runs": 1, "trials": 2}, {"runs": 2, "trials": 3}
    calls = (one, 1, whole, 12), (two, 1, stopped, 4), (two, 2, whole, 8)
    for table, workers, asked, computed in calls:
        request = Request(table.parent, workers=workers, **asked)
        assert compare(tiny, request, lambda progress: None).computed == computed
    assert one.read_bytes() == two.read_bytes()
    frame = pq.read_table(one).to_pandas()
    assert frame.cost.nunique() > 6 and frame.duration_s.between(0.1, 1.0).all()


def test_studies_are_cut_into_blocks_for_all_slots():
    studies = [(arm, run) for run in range(7) for arm in ("a", "b", "c")]
    for slots in (1, 2, 5, 21, 50):
        blocks = cut(studies, slots)
        assert [key for block in blocks for key in block] == studies
        assert len(blocks) >= min(slots, 11)
        assert max(map(len, blocks)) <= -(-len(studies) // slots)
    many = [("a", run) for run in range(1000)]
    sizes = [len(block) for block in cut(many, 2)]
    assert max(sizes) <= comparing.BLOCK_STUDIES and len(sizes) % 2 == 0
    assert max(sizes) - min(sizes) < len(sizes)
    assert cut([], 2) == []


def test_checkpoints_and_the_database_are_written_on_the_way(
    comparisons, cut_into, monkeypatch
):
    exports = []

    def export(of, trials, *_, final):
        assert trials.schema.remove_metadata().equals(
            results_of(STATE_SCHEMA.empty_table()).schema
        )
        exports.append((len(trials), final))

    monkeypatch.setattr(comparing, "export", export)
    monkeypatch.setattr(comparing, "CHECKPOINT_S", 0.0)
    monkeypatch.setattr(comparing, "EXPORT_S", 0.0)
    cut_into(2, 1)
    seen, told = [], []

    def watch(progress):
        file = comparisons.folder / "out" / "arms" / "dog.parquet"
        seen.append(pq.read_metadata(file).num_rows if file.exists() else 0)
        assert not (comparisons.folder / "out" / "trials.parquet").exists()
        told.append((progress.trials, progress.total, progress.studies))

    request = Request(comparisons.folder / "out", arms=("dog",), runs=2, trials=4)
    compare(comparisons.experiment, request, watch)
    assert seen == [0, 0, 2, 4, 6]  # reported before the checkpoint of its stretch
    assert told == [(done, 8, 2) for done in (0, 2, 4, 6, 8)]
    assert exports == [(2, False), (4, False), (6, False), (8, False), (8, True)]
    comparisons.run("out", arms=("tpe",), runs=1, trials=2)
    assert exports[-1] == (10, True)  # all arms of the folder


def test_sessions_say_what_they_did(comparisons):
    for trials in (3, 8, 8):  # the last: nothing to do, nothing to say
        comparisons.run("out", trials=trials)
    sessions = json.loads((comparisons.folder / "out" / "run.json").read_text())[
        "sessions"
    ]
    assert [session["trials"] for session in sessions] == [27, 45]
    assert sessions[0]["stores"]["flat"] == str(comparisons.folder / "store")


def test_a_broken_sampler_stops_the_experiment_and_keeps_the_rest(
    comparisons, cut_into, monkeypatch
):
    cut_into(3, 1)
    monkeypatch.setattr(OneStudy, "ask", stopping(6, OneStudy.ask, ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):
        comparisons.run("out", arms=("random",))
    assert (
        pq.read_metadata(comparisons.folder / "out/arms/random.parquet").num_rows == 6
    )


def test_a_seventeenth_parameter_is_searched_and_written(comparisons):
    folder = comparisons.folder / "torso"
    folder.mkdir()
    experiment = fake_walker.experiment(folder, 'searched = ["theta_ref"]')
    fake_walker.calls.clear()
    arms = ("random", "dog", "cmaes-warm", "cmaes-cold", "bo-euclidean", "ranking")
    comparisons.run("torso/out", experiment=experiment, arms=arms, trials=5)
    frame = comparisons.table("torso/out").to_pandas()
    assert frame.theta_ref.nunique() > 50
    assert frame.theta_ref.between(np.deg2rad(-10), np.deg2rad(30)).all()
    simulated = np.concatenate([call["low_level_gains"] for call in fake_walker.calls])
    # of two arms, once
    walks = frame.drop_duplicates(["run", *GAIN_NAMES, "theta_ref"])
    assert sorted(simulated[:, 7]) == sorted(walks.theta_ref)
    assert (simulated[:, :7] == [gain.default for gain in LOW_LEVEL_GAINS[:7]]).all()
    store = pq.read_table(folder / "store" / "part-00000.parquet").to_pandas()
    ranked = frame[frame.arm == "ranking"]
    np.testing.assert_array_equal(ranked.theta_ref, store.theta_ref[ranked.row])

"""Reading a comparison's folder: arrays, checkpoints, what is unfinished, what is refused."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from study.report.runs import Results, read_results, runs_of
from taichi_nmm.errors import InputError
from tests.study.report import synthetic

TWO = {"dog": (0.02, 0.002), "random": (0.01, 0.0)}


def small(folder: Path, **options: str) -> Path:
    return synthetic.write(folder, TWO, runs=4, trials=6, **options)


def rewrite(folder: Path, table: pa.Table) -> None:
    pq.write_table(table, folder / "trials.parquet")


def test_arrays_are_those_of_the_table(comparison: Path, results: Results) -> None:
    table = pq.read_table(comparison / "trials.parquet")
    assert list(results.arms) == sorted(synthetic.ARMS)
    dog = table.filter(pc.equal(table["arm"], "dog"))
    seventh = dog.filter(pc.equal(dog["run"], 7))
    arm = results.arms["dog"]
    assert arm.best.shape == arm.walks.shape == (50, 100)
    np.testing.assert_array_equal(arm.best[7], seventh["best_cost"].to_numpy())
    walked = np.flatnonzero(seventh["walked"].to_numpy())
    assert arm.first_walker[7] == (walked[0] + 1 if len(walked) else np.inf)
    assert results.complete and results.found == results.planned == 70_000
    assert (results.name, results.cost) == ("made-up", "smooth")


def test_the_order_of_the_rows_does_not_matter(tmp_path: Path) -> None:
    folder = small(tmp_path)
    before = read_results(folder).arms["dog"]
    table = pq.read_table(folder / "trials.parquet")
    rewrite(folder, table.take(np.random.default_rng(0).permutation(len(table))))
    np.testing.assert_array_equal(read_results(folder).arms["dog"].best, before.best)


def test_a_checkpoint_with_more_trials_counts(tmp_path: Path) -> None:
    folder = small(tmp_path)
    table = pq.read_table(folder / "trials.parquet")
    (folder / "arms").mkdir()
    pq.write_table(table.filter(pc.equal(table["arm"], "dog")), folder / "arms" / "dog.parquet")
    (folder / "arms" / ".random.parquet.1.tmp").write_bytes(b"half")
    rewrite(folder, table.filter(pc.less(table["trial"], 2)))
    results = read_results(folder)
    assert results.arms["dog"].trials == 6
    assert results.arms["random"].trials == 2
    assert (results.complete, results.found, results.planned) == (False, 24 + 8, 48)
    (folder / "trials.parquet").unlink()
    assert list(read_results(folder).arms) == ["dog"]


def test_runs_count_as_far_as_all_have_come(tmp_path: Path) -> None:
    folder = small(tmp_path)
    table = pq.read_table(folder / "trials.parquet")
    late = pc.and_(pc.equal(table["run"], 3), pc.greater_equal(table["trial"], 4))
    rewrite(folder, table.filter(pc.invert(late)))
    results = read_results(folder)
    assert results.arms["dog"].best.shape == (4, 4)
    assert not results.complete


@pytest.mark.parametrize("cost", ["smooth", "walking"])
def test_the_cost_is_known_by_its_size_where_nothing_says_it(tmp_path: Path, cost: str) -> None:
    folder = small(tmp_path, cost=cost)
    assert read_results(folder).cost == cost
    (folder / "experiment.json").unlink()
    assert read_results(folder).cost == cost


def test_a_folder_without_trials_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"folder: .*trials\.parquet"):
        read_results(tmp_path)
    with pytest.raises(InputError, match=r"folder: .*nowhere"):
        read_results(tmp_path / "nowhere")


def test_a_damaged_table_is_refused(tmp_path: Path) -> None:
    folder = small(tmp_path)
    (folder / "trials.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match=r"trials\.parquet: .*readable"):
        read_results(folder)


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    folder = small(tmp_path)
    rewrite(folder, pq.read_table(folder / "trials.parquet").drop_columns(["best_cost"]))
    with pytest.raises(InputError, match="column: 'best_cost'"):
        read_results(folder)


def test_a_trial_that_is_missing_or_doubled_is_refused(tmp_path: Path) -> None:
    folder = small(tmp_path)
    table = pq.read_table(folder / "trials.parquet")
    for broken in (table.slice(1), pa.concat_tables([table, table.slice(3, 1)])):
        rewrite(folder, broken)
        with pytest.raises(InputError, match="arm dog"):
            read_results(folder)


def test_unreadable_json_is_refused(tmp_path: Path) -> None:
    folder = small(tmp_path)
    (folder / "experiment.json").write_text("{")
    with pytest.raises(InputError, match=re.escape("experiment.json")):
        read_results(folder)


def test_facts_of_the_run_are_kept(tmp_path: Path) -> None:
    folder = small(tmp_path)
    (folder / "run.json").write_text(json.dumps({"machine": "two cores"}))
    facts = read_results(folder).facts
    assert facts["machine"] == "two cores" and facts["seed"] == 1


def test_proposal_times_are_medians_of_each_arm(tmp_path: Path) -> None:
    folder = small(tmp_path)
    assert read_results(folder).arms["dog"].proposal_ms is None
    times = {"arm": ["dog", "dog", "dog", "random"], "proposal_s": [0.01, 0.02, 0.9, 0.001]}
    pq.write_table(pa.table(times), folder / "proposal_times.parquet")
    arms = read_results(folder).arms
    assert (arms["dog"].proposal_ms, arms["random"].proposal_ms) == (20.0, 1.0)


def test_a_table_in_memory_gives_the_same_runs(tmp_path: Path) -> None:
    folder = small(tmp_path)
    table = pq.read_table(folder / "trials.parquet")
    found = runs_of(table.take(np.random.default_rng(0).permutation(len(table))))
    known = read_results(folder).arms
    assert list(found) == list(known)
    for arm, theirs in known.items():
        np.testing.assert_array_equal(found[arm].best, theirs.best)
        assert (found[arm].walkers, found[arm].found) == (theirs.walkers, theirs.found)
    with pytest.raises(InputError, match="trials: 'arm dog'"):
        runs_of(table.slice(1))

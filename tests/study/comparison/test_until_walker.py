"""Experiments whose studies end with their first walker: nothing more is tried, nothing is lost."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from study.comparison import compare as comparing
from study.comparison.block import Block, advance
from study.comparison.compare import Progress, Request, compare
from study.comparison.folder import STATE_SCHEMA
from study.experiment.experiment import Experiment
from study.report.runs import read_results
from tests.study import fake_walker
from tests.study.conftest import Comparisons

pytestmark = pytest.mark.slow

ARMS = ("random", "dog", "cmaes-cold", "cmaes-warm")
TRIALS = 12


@pytest.fixture
def until(toy: Experiment) -> Experiment:
    return replace(toy, until_walker=True)


def frame(table: pa.Table) -> Any:
    return table.to_pandas().sort_values(["arm", "run", "trial"], ignore_index=True)


def up_to_first_walker(table: pa.Table) -> Any:
    """Of studies with all their trials: those up to the first walker."""
    rows = frame(table)
    earlier = rows.groupby(["arm", "run"]).walked.transform(lambda walked: walked.cumsum() - walked)
    return rows[earlier == 0].reset_index(drop=True)


def assert_equal(found: Any, expected: Any) -> None:
    columns = ["arm", "run", "trial", "cost", "best_cost", "walked", "row", "duration_s"]
    assert len(found) == len(expected)
    assert found[columns].equals(expected[columns])


# A block.


def test_a_study_ends_right_at_its_first_walker(toy: Experiment, until: Experiment) -> None:
    studies = tuple((arm, run) for arm in ARMS for run in range(3))
    nothing = STATE_SCHEMA.empty_table()
    all_trials = advance(Block(toy, studies, nothing, TRIALS)).table
    expected = up_to_first_walker(all_trials)
    fake_walker.calls.clear()
    found = advance(Block(until, studies, nothing, TRIALS)).table
    assert_equal(frame(found), expected)
    assert sum(len(call["gains"]) for call in fake_walker.calls) == len(expected)
    # Both happen: some never find one, some find one early, and of those each has one.
    last = frame(found).groupby(["arm", "run"]).walked.agg(["sum", "last", "size"])
    assert 0 < last["last"].sum() < len(studies)
    assert (last["sum"] == last["last"]).all() and (last["size"][~last["last"]] == TRIALS).all()


def test_a_block_that_is_known_in_part_goes_on(until: Experiment) -> None:
    studies, nothing = tuple((arm, 0) for arm in ARMS), STATE_SCHEMA.empty_table()
    whole = advance(Block(until, studies, nothing, TRIALS)).table
    for first in (1, 3, 7):
        known = advance(Block(until, studies, nothing, first)).table
        rest = advance(Block(until, studies, known, TRIALS)).table
        assert_equal(frame(pa.concat_tables([known, rest])), frame(whole))
    assert len(advance(Block(until, studies, whole, TRIALS)).table) == 0


# A comparison.


def test_a_comparison_in_pieces_is_the_same(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted any number of times, in blocks of any size, grown trial by trial."""
    comparisons.run("all", arms=ARMS, trials=TRIALS)
    comparisons.experiment = replace(comparisons.experiment, until_walker=True)
    comparisons.run("whole", arms=ARMS, trials=TRIALS)
    assert_equal(frame(comparisons.table("whole")), up_to_first_walker(comparisons.table("all")))
    monkeypatch.setattr(comparing, "BLOCK_STUDIES", 3)
    monkeypatch.setattr(comparing, "STRETCH_TRIALS", 2)
    stops = 0
    while True:
        monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.stopped_in_call(7))
        try:
            comparisons.run("pieces", arms=ARMS, trials=TRIALS)
            break
        except KeyboardInterrupt:
            stops += 1
    assert stops > 2
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    for trials in (1, 4, TRIALS):
        comparisons.run("grown", arms=ARMS, trials=trials)
    fake_walker.calls.clear()  # a finished folder runs nothing
    assert (
        comparisons.run("grown", arms=ARMS, trials=TRIALS).computed == len(fake_walker.calls) == 0
    )
    for name in ("pieces", "grown"):
        assert comparisons.content(name) == comparisons.content("whole")


def test_progress_counts_what_there_is_to_do(comparisons: Comparisons) -> None:
    """A study that has ended has no trials before it; at the end all is done."""
    told: list[Progress] = []
    until = replace(comparisons.experiment, until_walker=True)
    request = Request(comparisons.folder / "out", arms=ARMS, trials=TRIALS, artifacts=False)
    compare(until, request, told.append)
    assert told[0] == Progress(0, 3 * len(ARMS) * TRIALS, 3 * len(ARMS), 0)
    done = len(comparisons.table("out"))
    walkers = int(frame(comparisons.table("out")).walked.sum())
    assert told[-1] == Progress(done, done, 3 * len(ARMS), walkers)
    assert all(one.total >= two.total for one, two in pairwise(told))


def test_the_report_reads_ragged_runs(comparisons: Comparisons) -> None:
    comparisons.experiment = replace(comparisons.experiment, until_walker=True)
    comparisons.run("out", arms=ARMS, trials=TRIALS)
    results = read_results(comparisons.folder / "out")
    assert results.complete and results.trials == TRIALS and results.runs == 3
    rows = frame(comparisons.table("out"))
    assert results.found == results.planned == len(rows) < 3 * TRIALS * len(ARMS)
    for name, arm in results.arms.items():
        assert arm.found == (rows.arm == name).sum()
        assert arm.best.shape == (3, TRIALS)
        for run in range(3):
            mine = rows[(rows.arm == name) & (rows.run == run)]
            first = len(mine) if mine.walked.any() else np.inf
            assert arm.first_walker[run] == first
            np.testing.assert_array_equal(arm.best[run, : len(mine)], mine.best_cost)
            assert (arm.best[run, len(mine) - 1 :] == mine.best_cost.iloc[-1]).all()
            assert arm.has_walker[run, -1] == mine.walked.any()


def test_an_unfinished_folder_is_not_complete(comparisons: Comparisons) -> None:
    comparisons.experiment = replace(comparisons.experiment, until_walker=True)
    comparisons.run("out", arms=("dog",), trials=TRIALS)
    comparisons.run("out", arms=("random",), trials=2)
    file: Path = comparisons.folder / "out" / "trials.parquet"
    assert not pq.read_table(file).to_pandas().query("arm == 'random'").walked.any()
    results = read_results(comparisons.folder / "out")
    assert not results.complete
    assert results.arms["random"].trials == 2

"""Experiments whose studies end with their first walker: nothing more is tried, nothing is lost."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from study.experiment import compare as comparing
from study.experiment.compare import Progress, Request, compare
from study.report.runs import read_results
from tests.study import fake_walker

pytestmark = pytest.mark.slow

ARMS = ("random", "dog", "cmaes-cold", "cmaes-warm")
TRIALS = 12


def frame(table):
    return table.to_pandas().sort_values(["arm", "run", "trial"], ignore_index=True)


@pytest.fixture
def until(comparisons):
    """Of the toy experiment, but a study ends with its first walker."""
    comparisons.experiment = replace(comparisons.experiment, until_walker=True)
    return comparisons


def test_studies_end_with_first_walker(until, monkeypatch):
    """Interrupted any number of times, in blocks of any size, grown trial by trial."""
    request = {"arms": ARMS, "trials": TRIALS}
    until.run(
        "all", experiment=replace(until.experiment, until_walker=False), **request
    )
    rows = frame(until.table("all"))
    earlier = rows.groupby(["arm", "run"]).walked.transform(
        lambda walked: walked.cumsum() - walked
    )
    # of each study, up to its first walker
    expected = rows[earlier == 0].reset_index(drop=True)
    fake_walker.calls.clear()
    until.run("whole", **request)
    whole = frame(until.table("whole"))
    columns = [
        "arm",
        "run",
        "trial",
        "cost",
        "best_cost",
        "walked",
        "row",
        "duration_s",
    ]
    assert len(whole) == len(expected) and whole[columns].equals(expected[columns])
    assert sum(len(call["gains"]) for call in fake_walker.calls) == len(expected)
    # Both happen: some never find one, some find one early, and of those each has one.
    last = whole.groupby(["arm", "run"]).walked.agg(["sum", "last", "size"])
    assert 0 < last["last"].sum() < len(last) == 3 * len(ARMS)
    assert (last["sum"] == last["last"]).all() and (
        last["size"][~last["last"]] == TRIALS
    ).all()
    monkeypatch.setattr(comparing, "BLOCK_STUDIES", 3)
    monkeypatch.setattr(comparing, "STRETCH_TRIALS", 2)
    assert until.stop_and_run("pieces", 7, **request) > 2
    for trials in (1, 3, 4, 7, TRIALS):
        until.run("grown", arms=ARMS, trials=trials)
    fake_walker.calls.clear()  # a finished folder runs nothing
    assert until.run("grown", **request).computed == len(fake_walker.calls) == 0
    for name in ("pieces", "grown"):
        assert until.content(name) == until.content("whole")


def test_progress_counts_what_there_is_to_do_and_the_report_reads(until):
    """A study that has ended has no trials before it; at the end all is done."""
    told = []
    request = Request(until.folder / "out", arms=ARMS, trials=TRIALS)
    compare(until.experiment, request, told.append)
    assert told[0] == Progress(0, 3 * len(ARMS) * TRIALS, 3 * len(ARMS), 0)
    done, walkers = len(until.table("out")), int(frame(until.table("out")).walked.sum())
    assert told[-1] == Progress(done, done, 3 * len(ARMS), walkers)
    assert all(one.total >= two.total for one, two in pairwise(told))
    compare(
        until.experiment, replace(request, arms=ARMS[:2], runs=1, trials=1), told.append
    )
    # of a smaller request
    assert told[-1].trials == told[-1].total > told[-1].studies == 2
    results = read_results(until.folder / "out")
    assert results.complete and results.trials == TRIALS and results.runs == 3
    rows = frame(until.table("out"))
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


def test_an_unfinished_folder_is_not_complete(until):
    until.run("out", arms=("dog",), trials=TRIALS)
    until.run("out", arms=("random",), trials=2)
    assert not until.table("out").to_pandas().query("arm == 'random'").walked.any()
    results = read_results(until.folder / "out")
    assert not results.complete and results.arms["random"].trials == 2

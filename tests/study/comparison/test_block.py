"""Worker processes: what they compute does not depend on how many there are."""

import os
import pickle
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import taichi_nmm
from study.comparison import lockstep, pool
from study.comparison.pool import Pool, shares
from taichi_nmm.errors import InputError
from tests.study.comparison import fake
from tests.study.comparison.conftest import Comparisons


def test_shares_are_even_in_every_arm_and_hold_every_study() -> None:
    studies = [(arm, run) for run in range(7) for arm in ("a", "b", "c")]
    parts = shares(studies, 2)
    assert sorted(n for part in parts for n in part) == list(range(21))
    assert all(studies[n] == key for part in parts for n, key in part.items())
    for arm in "abc":
        counts = [sum(key[0] == arm for key in part.values()) for part in parts]
        assert abs(counts[0] - counts[1]) <= 1
    assert abs(len(parts[0]) - len(parts[1])) <= 1
    assert len(shares(studies[:3], 8)) == 3


def test_two_workers_then_one_give_the_same_table_as_none(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    arms = ("random", "dog", "cmaes-cold", "cmaes-warm")
    comparisons.run("none", arms=arms, trials=6)
    monkeypatch.setattr(lockstep, "Pool", Pool)
    comparisons.run("some", arms=arms, trials=5, workers=2)
    comparisons.run("some", arms=arms, trials=6, workers=1)
    assert comparisons.content("some") == comparisons.content("none")


def test_an_error_in_a_worker_is_one_line_here(comparisons: Comparisons) -> None:
    (comparisons.folder / "store" / "manifest.json").unlink()
    with (
        pytest.raises(InputError, match="a finished store"),
        Pool(comparisons.experiment, [("dog", 0)], 3, {}, 1) as made,
    ):
        made.propose()


def test_an_input_error_passes_between_processes_whole() -> None:
    error = InputError("trials", 0, "1 or more")
    copy = pickle.loads(pickle.dumps(error))
    assert (copy.field, copy.value, copy.allowed) == ("trials", 0, "1 or more")
    assert str(copy) == str(error)


def test_a_worker_that_is_killed_is_one_line_here(comparisons: Comparisons) -> None:
    with Pool(comparisons.experiment, [("random", 0)], 3, {}, 1) as made:
        assert len(made.propose().study) == 1
        (process,) = made._processes
        os.kill(process.pid or 0, signal.SIGKILL)
        process.join()
        with pytest.raises(InputError, match="workers: 'one was killed'"):
            made.tell(np.array([1.0]), fake.simulate(np.ones((1, 16))).rows)


def test_starting_processes_leaves_this_one_as_it_was() -> None:
    handler, environment = signal.getsignal(signal.SIGINT), dict(os.environ)
    with pool._quiet_children():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        assert os.environ["OMP_NUM_THREADS"] == "1"
    assert signal.getsignal(signal.SIGINT) is handler
    assert dict(os.environ) == environment


def test_the_real_simulator_gives_the_same_table_after_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lockstep, "Pool", fake.LocalPool)
    with monkeypatch.context() as faked:
        faked.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        comparisons = Comparisons(tmp_path)
    comparisons.experiment = replace(comparisons.experiment, duration_s=2.0)
    arms = ("random", "dog")
    comparisons.run("parts", arms=arms, runs=1, trials=2)
    comparisons.run("parts", arms=arms, runs=2, trials=4)
    comparisons.run("whole", arms=arms, runs=2, trials=4)
    assert comparisons.content("parts") == comparisons.content("whole")
    frame = comparisons.table("whole").to_pandas()
    assert frame.duration_s.between(0.1, 2.0).all()
    assert frame.cost.nunique() > 8

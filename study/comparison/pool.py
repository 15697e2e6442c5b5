"""The processes that hold the studies, as one object that proposes and is told."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from study.comparison.experiment import Experiment
from study.comparison.group import Key, Proposals
from study.comparison.worker import work
from taichi_nmm.errors import InputError

# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
JOIN_S = 3.0  # of a worker in the middle of a proposal


class Pool:
    """Worker processes, each with a fixed share of the studies; results do not depend on how many.

    Use it as a context manager; it ends its processes.

    Args:
        experiment: of all.
        studies: arm and run of each.
        trials: that each is to have.
        known: finished trials of earlier sessions, by arm.
        workers: how many.
    """

    def __init__(
        self,
        experiment: Experiment,
        studies: list[Key],
        trials: int,
        known: dict[str, pa.Table],
        workers: int,
    ) -> None:
        """Start the processes, and have them set up their studies."""
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes = []
        self._sizes: list[int] = []
        with _quiet_children():
            for share in shares(studies, workers):
                ours, theirs = context.Pipe()
                arguments = (theirs, experiment, share, trials, known)
                process = context.Process(target=work, args=arguments, daemon=True)
                process.start()
                theirs.close()  # or the worker's end would never be seen
                self._pipes.append(ours)
                self._processes.append(process)

    def __enter__(self) -> "Pool":
        """Wait until all are set up."""
        try:
            self._all("start", [()] * len(self._pipes))
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes."""
        self.close()

    def close(self) -> None:
        """End the processes: what they hold is in the main process's tables."""
        for pipe in self._pipes:
            pipe.close()  # a worker that hears of it ends in order
        for process in self._processes:
            process.join(JOIN_S)
            process.terminate()
            process.join()

    def propose(self) -> Proposals:
        """The next trial of every study that has not all its trials."""
        parts: list[Proposals] = self._all("propose", [()] * len(self._pipes))
        self._sizes = [len(part.study) for part in parts]
        return Proposals(
            np.concatenate([part.study for part in parts]),
            np.vstack([part.gains for part in parts]),
            [notes for part in parts for notes in part.notes],
            np.concatenate([part.seconds for part in parts]),
        )

    def tell(self, costs: NDArray[np.float64], outcomes: NDArray[np.void]) -> None:
        """What became of them, in the order of the proposals: costs [n], result rows [n]."""
        ends = np.cumsum(self._sizes)[:-1]
        self._all("tell", list(zip(np.split(costs, ends), np.split(outcomes, ends), strict=True)))

    def _all(self, what: str, arguments: list[Any]) -> list[Any]:
        """Ask all, then hear all."""
        for pipe, words in zip(self._pipes, arguments, strict=True):
            try:
                pipe.send((what, words))
            except (BrokenPipeError, ConnectionResetError):
                raise _lost() from None
        return [_answer(pipe) for pipe in self._pipes]


def shares(studies: list[Key], workers: int) -> list[dict[int, Key]]:
    """The studies of each worker by number: every worker gets as much of each arm as can be."""
    count = max(1, min(workers, len(studies)))
    arms = list(dict.fromkeys(arm for arm, _ in studies))
    parts: list[dict[int, Key]] = [{} for _ in range(count)]
    turns = {arm: place for place, arm in enumerate(arms)}
    for number, (arm, run) in enumerate(studies):
        parts[turns[arm] % count][number] = (arm, run)
        turns[arm] += 1
    return [part for part in parts if part]


def _answer(pipe: Connection) -> Any:
    try:
        kind, result = pipe.recv()
    except (EOFError, ConnectionResetError):
        raise _lost() from None
    if kind == "input":
        raise result
    if kind == "failed":
        raise RuntimeError(f"in a worker process:\n{result}")
    return result


def _lost() -> InputError:
    allowed = "memory for all of them; the same command goes on from the last checkpoint"
    return InputError("workers", "one was killed", allowed)


@contextmanager
def _quiet_children() -> Iterator[None]:
    """Have the processes that are started now use one thread each and leave Ctrl-C to this one."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # a new process inherits "ignored"
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

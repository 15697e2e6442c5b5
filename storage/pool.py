"""Work spread over an executor: in this process, over processes of this machine, or any other.

A unit of work is a function of an importable module and its arguments, and depends on nothing else;
what comes of it is the same wherever it is run, and the order in which units end decides nothing.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from taichi_nmm.errors import InputError

Unit = TypeVar("Unit")
Result = TypeVar("Result")

# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class InProcess(Executor):
    """Runs a unit at once, in this thread: for debuggers, tests, and machines with a GPU."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The future of a call that is over; Ctrl-C is not kept in it."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@dataclass(frozen=True)
class Pool:
    """An executor, and how many units it is given at a time.

    Attributes:
        executor: any.
        slots: units under way at once; no more are lost when work is stopped.
    """

    executor: Executor
    slots: int

    @property
    def shares_machine(self) -> bool:
        """Whether units run side by side, each of which then keeps to one core."""
        return self.slots > 1

    def results(
        self, function: Callable[[Unit], Result], units: deque[Unit]
    ) -> Iterator[tuple[Unit, Result]]:
        """Units and what came of them, in the order in which they end.

        The caller may append further units while it goes on, such as the next stretch of one.

        Raises:
            InputError: what a unit raised, or a process was killed.
            Exception: whatever else a unit raised.
        """
        running: dict[Future[Result], Unit] = {}
        while units or running:
            while units and len(running) < self.slots:
                unit = units.popleft()
                running[self.executor.submit(function, unit)] = unit
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                unit = running.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    allowed = "memory for all of them; the same command goes on where it stopped"
                    raise InputError("workers", "one was killed", allowed) from None
                yield unit, result


IN_PROCESS = Pool(InProcess(), 1)


@contextmanager
def local_pool(workers: int) -> Iterator[Pool]:
    """A pool of this machine: so many spawned processes, or, for one, this process itself.

    The processes leave Ctrl-C to this one, use one thread for linear algebra, and end when the
    context does or when this process is gone, in the middle of a unit if need be.

    Raises:
        InputError: not a number of processes.
    """
    if workers < 1:
        raise InputError("workers", workers, "1 or more")
    if workers == 1:
        yield IN_PROCESS
        return
    context = multiprocessing.get_context("spawn")  # a fork does not survive Taichi's threads
    lifeline, ours = context.Pipe(duplex=False)
    executor = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_live_on, initargs=(lifeline,)
    )
    try:
        with _quiet_children():
            wait([executor.submit(os.getpid) for _ in range(workers)])
        yield Pool(executor, workers)
    finally:
        ours.close()
        lifeline.close()
        executor.shutdown(cancel_futures=True)


def cores() -> int:
    """Cores of this machine that this process may use."""
    return len(os.sched_getaffinity(0))


def _live_on(lifeline: Connection) -> None:
    """In a worker: leave Ctrl-C to the parent, and end when its end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        lifeline.poll(None)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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

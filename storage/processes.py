"""Spawned processes as an executor: a killed one is noticed, and none outlives this process.

Why not `concurrent.futures.ProcessPoolExecutor`? Its processes share two queues, so a
process that is killed in the middle of a result blocks all for ever (before Python
3.11.5, also one killed while the next call is being written; CPython issue 94777). And
before Python 3.14 it cannot end a process in the middle of a call, while Taichi
compiles for half a minute without listening. Here every process has a pipe of its own.
"""

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any

# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)

END = b""  # told to a process: to end
END_S = 10.0  # that an idle one may take


class Processes(Executor):
    """Processes of this machine, each started when a call finds no other idle.

    They leave Ctrl-C to this process, use one thread for linear algebra, and end when
    this process is gone, even in the middle of a call. `most` of them run at a time.
    """

    def __init__(self, most: int) -> None:
        """None is started yet."""
        self._threads = ThreadPoolExecutor(most)  # one waits for each process
        self._idle: deque[Connection] = deque()
        self._started: dict[Connection, BaseProcess] = {}
        self._lock = threading.Lock()  # of starting and ending
        self._over = False
        resource_tracker.ensure_running()  # it would unblock SIGINT within `_quiet_child`

    def submit(
        self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any
    ) -> Future[Any]:
        """Call a function of an importable module elsewhere.

        The future's error is the call's, or `BrokenExecutor` where its process was
        killed.
        """
        return self._threads.submit(self._call, (fn, args, kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Kill the busy processes, and let the idle ones end by themselves.

        A process that ends by itself keeps the kernels that Taichi has compiled.
        """
        with self._lock:
            self._over = True
            idle = set(self._idle)
        for pipe, process in self._started.items():
            if pipe in idle:
                with suppress(OSError):
                    pipe.send_bytes(END)
            else:
                process.kill()
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process in self._started.values():
            process.join(END_S)
            process.kill()
            process.join()

    def _call(self, call: tuple[Any, ...]) -> Any:
        words = pickle.dumps(call)
        try:
            pipe = self._idle.pop() if self._idle else self._start()
            pipe.send_bytes(words)
            result, error = pickle.loads(pipe.recv_bytes())
        except (EOFError, OSError):
            raise BrokenExecutor("a process was killed") from None
        self._idle.append(pipe)
        if error is not None:
            raise error
        return result

    def _start(self) -> Connection:
        # a fork does not survive Taichi's threads
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        with self._lock, _quiet_child():
            if self._over:
                raise BrokenExecutor("the processes have been ended")
            process = context.Process(target=_serve, args=(theirs,), daemon=True)
            process.start()
            self._started[ours] = process
        theirs.close()  # or the end of the process would never be seen
        return ours


def _serve(pipe: Connection) -> None:
    """In a process: answer calls in the main thread, until told to end or the other is gone."""
    calls: SimpleQueue[bytes] = SimpleQueue()

    def listen() -> None:
        try:
            while call := pipe.recv_bytes():
                calls.put(call)
            calls.put(END)
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    with suppress(OSError):
        while call := calls.get():
            pipe.send_bytes(_answer(call))
    # A parent that ends first, as a worker of a cluster does, terminates its processes;
    # but Taichi writes compiled kernels at the very end of this one.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _answer(words: bytes) -> bytes:
    """Result and error of a call, one of them None."""
    try:
        function, args, kwargs = pickle.loads(words)
        return pickle.dumps((function(*args, **kwargs), None), protocol=5)
    except Exception as error:
        error.add_note(f"In a worker: {traceback.format_exc()}")
        return pickle.dumps((None, error))


@contextmanager
def _quiet_child() -> Iterator[None]:
    """Have the process that is started now use one thread, and Ctrl-C not reach it.

    It takes over our paths, and finds this package first: a worker of Dask has a folder
    `storage` among its paths, which would be taken for an editable install's.
    """
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    paths = sys.path[:]
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    # which a process inherits
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        sys.path[:] = paths
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

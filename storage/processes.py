"""Spawned processes as an executor: a killed one is noticed, and none outlives this process.

Why not `concurrent.futures.ProcessPoolExecutor`? Its processes share two queues, so a process that
is killed in the middle of a result blocks all for ever (before Python 3.11.5, also one killed while
the next call is being written; CPython issue 94777). And before Python 3.14 it cannot end a process
in the middle of a call, while Taichi compiles for half a minute without listening. Here every
process has a pair of sockets of its own. A pipe of `multiprocessing` would read a table in dozens
of small pieces, wait for the lock of Python after each, and copy them.
"""

import multiprocessing
import os
import pickle
import signal
import socket
import struct
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any

# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

LENGTH = struct.Struct("!Q")
END_S = 10.0  # that an idle one may take


class Processes(Executor):
    """Processes of this machine, each started when a call finds no other idle.

    They leave Ctrl-C to this process, use one thread for linear algebra, and end when this process
    is gone, even in the middle of a call. `most` of them run at a time.
    """

    def __init__(self, most: int) -> None:
        """None is started yet."""
        self._threads = ThreadPoolExecutor(most)  # one waits for each process
        self._idle: deque[socket.socket] = deque()
        self._started: dict[socket.socket, BaseProcess] = {}
        self._lock = threading.Lock()  # of starting and ending
        self._over = False
        resource_tracker.ensure_running()  # it would unblock SIGINT within `_quiet_child`

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function of an importable module elsewhere.

        The future's error is the call's, or `BrokenExecutor` where its process was killed.
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
                    _send(pipe)
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
            _send(pipe, words)
            answer, *buffers = _receive(pipe)
            result, error = pickle.loads(answer, buffers=buffers)
        except (EOFError, OSError):
            raise BrokenExecutor("a process was killed") from None
        self._idle.append(pipe)
        if error is not None:
            raise error
        return result

    def _start(self) -> socket.socket:
        context = multiprocessing.get_context("spawn")  # a fork does not survive Taichi's threads
        ours, theirs = socket.socketpair()
        with self._lock, _quiet_child():
            if self._over:
                raise BrokenExecutor("the processes have been ended")
            process = context.Process(target=_serve, args=(theirs,), daemon=True)
            process.start()
            self._started[ours] = process
        theirs.close()  # or the end of the process would never be seen
        return ours


def _serve(pipe: socket.socket) -> None:
    """In a process: answer calls in the main thread, until told to end or the other is gone."""
    calls: SimpleQueue[list[memoryview]] = SimpleQueue()

    def listen() -> None:
        try:
            while call := _receive(pipe):
                calls.put(call)
            calls.put([])
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    with suppress(OSError):
        while call := calls.get():
            _send(pipe, *_answer(call[0]))
    # A parent that ends first, as a worker of a cluster does, terminates its processes; but Taichi
    # writes compiled kernels at the very end of this one.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _answer(words: memoryview) -> list[bytes | memoryview]:
    """Result and error of a call, one of them None; the data of arrays and tables is not copied."""
    held: list[pickle.PickleBuffer] = []
    try:
        function, args, kwargs = pickle.loads(words)
        outcome = (function(*args, **kwargs), None)
        answer = pickle.dumps(outcome, protocol=5, buffer_callback=held.append)
    except Exception as error:
        error.add_note(f"In a worker: {traceback.format_exc()}")
        return [pickle.dumps((None, error))]
    return [answer, *(buffer.raw() for buffer in held)]


def _send(pipe: socket.socket, *parts: bytes | memoryview) -> None:
    """Send a message; one of no parts tells a process to end."""
    lengths = [len(parts), *map(len, parts)]
    for part in (b"".join(map(LENGTH.pack, lengths)), *parts):
        pipe.sendall(part)


def _receive(pipe: socket.socket) -> list[memoryview]:
    """The parts of a message, which lie in memory of their own.

    Raises:
        EOFError: the other side is gone.
    """
    (count,) = LENGTH.unpack(_filled(pipe, LENGTH.size))
    lengths = [length for (length,) in LENGTH.iter_unpack(_filled(pipe, count * LENGTH.size))]
    return [_filled(pipe, length) for length in lengths]


def _filled(pipe: socket.socket, size: int) -> memoryview:
    whole = memoryview(bytearray(size))
    left = whole
    while left:
        received = pipe.recv_into(left, 0, socket.MSG_WAITALL)
        if not received:
            raise EOFError
        left = left[received:]
    return whole


@contextmanager
def _quiet_child() -> Iterator[None]:
    """Have the process that is started now use one thread, and Ctrl-C not reach it."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which a process inherits
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

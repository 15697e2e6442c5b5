"""Calls that are made on a cluster's workers, as an executor."""

import asyncio
import pickle
import time
import uuid
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from typing import Any

from distributed import Client, KilledWorker
from distributed import Future as Remote
from distributed.comm import CommClosedError

from storage.cluster.gate import Gate
from storage.cluster.plugin import answer
from taichi_nmm.errors import InputError, one_line, shortened

WORKERLESS_S = 300.0  # after which a cluster without a worker is given up
WATCH_S = 2.0
ANSWER_S = 30.0  # that a scheduler may take: of one that stalls, connections stay open
GOES_ON = "the same command goes on where it stopped"


class ClusterExecutor(Executor):
    """Makes calls where the gate has let workers in.

    A call whose worker is killed is made again elsewhere, by Dask. What fails is an `InputError`.

    Args:
        client: of the scheduler.
        session: whose plugin and places are used.
        gate: of the session.
        address: what the user calls the cluster.
    """

    def __init__(self, client: Client, session: str, gate: Gate, address: str) -> None:
        self._client = client
        self._session = session
        self._gate = gate
        self._address = address
        self._pending: dict[Future[Any], Remote] = {}
        client.loop.add_callback(self._watch)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function of an importable module on some worker; arguments by place alone."""
        if kwargs:
            raise TypeError("arguments by name")
        remote = self._client.submit(
            answer,
            self._session,
            pickle.dumps((fn, args)),
            key=f"{fn.__name__}-{uuid.uuid4().hex}",
            resources={self._session: 1},
        )
        future: Future[Any] = Future()
        self._pending[future] = remote
        self._client.loop.add_callback(self._follow, remote, future)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Drop what is not over."""
        pending, self._pending = list(self._pending.values()), {}
        if pending and self._client.status == "running":
            self._client.cancel(pending, force=True)

    async def _follow(self, remote: Remote, future: Future[Any]) -> None:
        try:
            outcome, error = pickle.loads(await remote), None
        except InputError as refused:
            outcome, error = None, refused
        except (asyncio.CancelledError, CancelledError, CommClosedError):
            outcome, error = None, self._given_up("a scheduler that stays")
        except KilledWorker as killed:
            said = f"workers that live: a call took {killed.allowed_failures + 1} with it"
            outcome, error = None, self._given_up(said)
        except Exception as failed:
            said = one_line(shortened(f"{type(failed).__name__}: {failed}"))
            outcome, error = None, self._given_up(f"calls that do not fail there ({said})")
        self._settle(future, outcome, error)

    async def _watch(self) -> None:
        """Give up when there has been no worker for long, or no answer."""
        seen_s = time.monotonic()
        while self._client.status not in ("closed", "closing"):
            await asyncio.sleep(WATCH_S)
            try:
                await asyncio.wait_for(self._gate.look(), ANSWER_S)
            except TimeoutError:
                self._give_up(f"a scheduler that answers within {ANSWER_S:.0f} s")
            except OSError:
                pass  # Dask connects again, or cancels what is under way
            if self._gate.places() or not self._pending:
                seen_s = time.monotonic()
            elif time.monotonic() - seen_s > WORKERLESS_S:
                self._give_up(f"a cluster that is not without a worker for {WORKERLESS_S:.0f} s")

    def _give_up(self, allowed: str) -> None:
        for future in list(self._pending):
            self._settle(future, None, self._given_up(allowed))

    def _given_up(self, allowed: str) -> InputError:
        return InputError("cluster", self._address, f"{allowed}; {GOES_ON}")

    def _settle(self, future: Future[Any], outcome: Any, error: InputError | None) -> None:
        """Once; the remote result is let go."""
        if self._pending.pop(future, None) is None:
            return
        if error is None:
            future.set_result(outcome)
        else:
            future.set_exception(error)

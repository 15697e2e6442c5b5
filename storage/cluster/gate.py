"""Who gets work: workers that compute the bits of the folder, however late they join."""

import threading
import time
from collections.abc import Callable
from typing import Any

from distributed import Client

from storage.cluster.plugin import let_in
from storage.pool import Kind, differences
from taichi_nmm.errors import InputError

START_S = 300.0  # for the first worker: its processes may have to compile the walker
POLL_S = 0.2


class Gate:
    """Meets the workers of a session one by one.

    Args:
        client: of the scheduler.
        session: its name.
        reference: the folder's kind; None: that of the first worker.
        mixed: whether workers of other kinds are let in.
        tell: called with a line on each worker that is not.
    """

    def __init__(
        self,
        client: Client,
        session: str,
        reference: Kind | None,
        mixed: bool,
        tell: Callable[[str], None],
    ) -> None:
        self._client = client
        self._session = session
        self._mixed = mixed
        self._tell = tell
        self._inside: dict[str, Kind] = {}
        self._there: dict[str, int] = {}  # threads of each worker that the scheduler knows
        self._refused: dict[str, str] = {}
        self._told: set[str] = set()
        self._met = threading.Event()
        self.kind = reference
        self.kinds: list[Kind] = []  # of all that were ever let in, in this order

    async def meet(self, event: tuple[float, dict[str, Any]]) -> None:
        """Let a worker in that has said what it computes with, or say why not."""
        _, said = event
        address, kind = str(said["worker"]), said.get("kind")
        reason = str(said.get("error", ""))
        if kind is not None and self.kind is None:
            self.kind = kind
        if kind is not None and self.kind is not None and not self._mixed:
            reason = differences(kind, self.kind)
        if reason or kind is None:
            self._refused[address] = reason
            if reason not in self._told:  # a line for a hundred workers alike
                self._told.add(reason)
                self._tell(f"worker {address} gets no work: {reason}")
        else:
            if kind not in self.kinds:
                self.kinds.append(kind)
            await self._client.run(let_in, self._session, workers=[address])
            self._inside[address] = kind
            await self.look()
        self._met.set()

    async def look(self) -> None:
        """Ask the scheduler which workers there are."""
        self._there = dict(await self._client.scheduler.ncores())

    def wait_for_one(self, address: str) -> None:
        """Return when a worker is in.

        Raises:
            InputError: all workers were refused, or there is none in time.
        """
        began_s = time.monotonic()
        while not self.places():
            self._client.sync(self.look)
            if self._there and self._there.keys() <= self._refused.keys():
                reason = next(iter(self._refused.values()))
                allowed = f"workers like the folder's ({reason}); or --mixed; or another --out"
                raise InputError("cluster", address, allowed)
            if time.monotonic() - began_s > START_S:
                allowed = f"a scheduler that has a worker within {START_S:.0f} s"
                raise InputError("cluster", address, allowed)
            self._met.wait(POLL_S)
            self._met.clear()

    def places(self) -> int:
        """Calls that can be under way at once: threads of the workers that are in and alive.

        As of the last look: asking each time would cost a call as much as all else of Dask.
        """
        return sum(self._there.get(address, 0) for address in self._inside)

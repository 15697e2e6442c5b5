"""Work spread over an executor: in this process, over processes of this machine, or any other.

A unit of work is a function of an importable module and its arguments, and depends on
nothing else. Its result is the same on every machine of one *kind*, and the order in
which units end decides nothing. Bits are the same at any number of threads, but not on
any processor. Machines of one kind may fill a folder together; two kinds would mix two
simulators.
"""

import hashlib
import os
import platform
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from storage.inputs.errors import InputError, shortened
from storage.processes import Processes
from storage.simulator import WALKER, Simulator

Kind = dict[str, str]
"""By name: "canary", "processor", and the versions of the simulator and of packages."""

MOST_LOCAL = 256  # processes of this machine
FORMS = f"local:N with N from 1 to {MOST_LOCAL}, or a scheduler's HOST:PORT, tcp:// or tls://"
_LOCAL = re.compile(r"local:([1-9]\d{0,2})")
_SCHEDULER = re.compile(
    r"(?!local:)((tcp|tls)://)?(\[[0-9a-fA-F:.%]+\]|[\w.-]+):\d{1,5}", re.ASCII
)

DIGEST_LENGTH = 64  # of SHA-256 in hexadecimal digits
KIND_NAME = "kind.json"  # in a folder: the kind of the workers that fill it

Unit = TypeVar("Unit")
Result = TypeVar("Result")


class InProcess(Executor):
    """Runs a unit at once, in this thread: for debuggers, tests, and machines with a GPU."""

    def submit(
        self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any
    ) -> Future[Any]:
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
        executor: that runs the units.
        slots: units under way at once, to begin with; no more are lost when work is
            stopped.
        mixed: whether machines may differ in the bits that they compute.
    """

    executor: Executor
    slots: int
    mixed: bool = False

    def room(self) -> int:
        """Units that may be under way at this moment."""
        return self.slots

    def there(self, store: Path) -> Path:
        """The path at which units find a store of this machine."""
        return store

    def agree(self, folder: Path) -> None:
        """Check that units are computed with the bits of a folder, which is held.

        Raises:
            InputError: the folder is of another kind of machine.
        """

    @property
    def kinds(self) -> list[Kind]:
        """Kinds of the machines that compute, where they are others than this one."""
        return []

    @property
    def in_process(self) -> bool:
        """Whether units run in this process, and so may call back."""
        return isinstance(self.executor, InProcess)

    @property
    def shares_machine(self) -> bool:
        """Whether units run side by side, each of which then keeps to one core."""
        return self.slots > 1

    def results(
        self, function: Callable[[Unit], Result], units: deque[Unit]
    ) -> Iterator[tuple[Unit, Result]]:
        """Units and their results, in the order in which they end.

        The caller may append further units meanwhile.

        Raises:
            InputError: a process was killed.
            Exception: raised by a unit.
        """
        running: dict[Future[Result], Unit] = {}
        try:
            while units or running:
                while units and len(running) < self.room():
                    unit = units.popleft()
                    running[self.executor.submit(function, unit)] = unit
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    yield running.pop(future), future.result()
        except BrokenExecutor:
            allowed = (
                "memory for all of them; the same command goes on where it stopped"
            )
            raise InputError("workers", "one was killed", allowed) from None


IN_PROCESS = Pool(InProcess(), 1)


@contextmanager
def local_pool(workers: int) -> Iterator[Pool]:
    """A pool of this machine: up to so many spawned processes, or, for one, this process itself.

    They are started as units need them, and end when the context does, even in the
    middle of a unit; see `Processes`.

    Raises:
        InputError: not a number of processes.
    """
    if workers < 1:
        raise InputError("workers", workers, "1 or more")
    if workers == 1:
        yield IN_PROCESS
        return
    with Processes(workers) as executor:
        yield Pool(executor, workers)


@dataclass(frozen=True)
class Cluster:
    """A cluster that a user names.

    Attributes:
        address: of a scheduler, or "local:N", N processes of this machine.
        mixed: whether workers may differ in the bits that they compute.

    Raises:
        InputError: neither form of an address, or the package distributed is not there.
    """

    address: str
    mixed: bool = False

    def __post_init__(self) -> None:
        scheduler = _SCHEDULER.fullmatch(self.address)
        if not scheduler and not 0 < self.local_processes <= MOST_LOCAL:
            # An "@" may end a password.
            said = shortened(self.address) if "@" not in self.address else "..."
            raise InputError("cluster", said, FORMS)
        if find_spec("distributed") is None:
            allowed = (
                "an environment with distributed: pip install 'taichi-nmm[cluster]'"
            )
            raise InputError("cluster", self.address, allowed)

    @staticmethod
    def asked(
        address: str | None, mixed: bool, workers: int | None = None
    ) -> "Cluster | None":
        """The cluster of `--cluster` and `--mixed`; None where no address is given.

        Raises:
            InputError: no address, no Dask, --mixed without a cluster, or `--workers`
                with one.
        """
        if address is None and mixed:
            raise InputError("mixed", True, "only beside --cluster")
        if address is None:
            return None
        found = Cluster(address, mixed)
        if workers is not None:
            raise InputError(
                "workers", workers, "none beside --cluster, which has its own"
            )
        return found

    @property
    def local_processes(self) -> int:
        """Processes of this machine to start; 0: the cluster is there already."""
        local = _LOCAL.fullmatch(self.address)
        return int(local[1]) if local else 0


def cores() -> int:
    """Cores of this machine that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not everywhere
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def own_kind(simulator: Simulator, packages: Sequence[str] = ()) -> Kind:
    """The kind of this machine: the digest of a small batch of a simulator, processor, versions.

    The versions are those of the simulator's packages, and of others that decide
    results.
    """
    rows = simulator.canary()
    digest = hashlib.sha256()
    for name in rows.dtype.names or ():
        digest.update(rows[name].tobytes())
    names = dict.fromkeys([*simulator.packages, *packages])
    return {
        "canary": digest.hexdigest(),
        "processor": processor(),
        "taichi-nmm"
        if simulator.name == WALKER
        else simulator.name: simulator.code_version,
        **{name: version(name) for name in names},
    }


def processor(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """The name of the processor; where it is not known, its architecture."""
    try:
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (
        line.partition(":")[2].strip()
        for line in lines
        if line.startswith("model name")
    )
    return next(named, "") or platform.processor() or platform.machine()


def differences(kind: Kind, reference: Kind) -> str:
    """All differences of a kind from another, in a line; empty: none."""

    def shown(value: str) -> str:
        # a digest by its beginning
        return value[:12] if len(value) == DIGEST_LENGTH else value

    pairs = [
        (name, kind.get(name, "none"), reference.get(name, "none"))
        for name in dict.fromkeys([*reference, *kind])
    ]
    return ", ".join(
        f"{name} {shown(a)}, not {shown(b)}" for name, a, b in pairs if a != b
    )

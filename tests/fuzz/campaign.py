"""Many cases in processes of their own: one that is aborted or hangs takes nothing with it.

Each process has an executor to itself, so that a broken one tells which case broke it. It ends by
itself where a case takes too long: nobody has to kill it.
"""

import faulthandler
import json
import multiprocessing
import os
import resource
import shlex
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.cases import make_case
from tests.fuzz.judge import (
    ACCEPTED,
    REFUSED,
    Verdict,
    doors,
    files_for_output,
    judge,
)
from tests.fuzz.world import Words

LIMIT_S = 60.0  # of a case; the longest takes two seconds of a processor
CHUNK = 50  # cases of a call
MOST_BYTES = 4 << 30  # of memory: what asks for more than that is wrong, and says so itself
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
BEGUN, TRACE = "begun", "trace"  # files of a process: the case that it is at, what ended it

DOORS = ExitStack()  # of this process, for good: it does nothing else

Judge = Callable[[Words, Path], Verdict]


@dataclass(frozen=True)
class Outcome:
    """What came of a case.

    Attributes:
        number: of the case.
        name: of its format.
        words: of its command.
        verdict: on it.
        took_s: seconds.
    """

    number: int
    name: str
    words: Words
    verdict: Verdict
    took_s: float


@dataclass(frozen=True)
class Plan:
    """What all processes know.

    Attributes:
        seed: of the cases; None: of `every_option`.
        world: folder of sound files.
        scratch: folder for the processes' own.
        limit_s: of a case.
        judge: on a case.
    """

    seed: int | None
    world: Path
    scratch: Path
    limit_s: float = LIMIT_S
    judge: Judge = judge


def run_cases(plan: Plan, numbers: Iterable[int], workers: int) -> Iterator[Outcome]:
    """The outcomes of cases, as they come."""
    chunks = cut(list(numbers), CHUNK)
    processes = [Process(plan, place) for place in range(workers)]
    running: dict[Future[list[Outcome]], tuple[Process, list[int]]] = {}
    try:
        while chunks or running:
            for process in processes:
                if chunks and process not in (owner for owner, _ in running.values()):
                    chunk = chunks.pop()
                    running[process.submit(chunk)] = process, chunk
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                process, chunk = running.pop(future)
                try:
                    yield from future.result()
                except BrokenProcessPool:
                    ended = process.ended_at()
                    yield ended
                    rest = [number for number in chunk if number > ended.number]
                    before = [number for number in chunk if number < ended.number]
                    chunks += [part for part in (rest, before) if part]
    finally:
        for process in processes:
            process.close()


def cut(numbers: list[int], size: int) -> list[list[int]]:
    """Parts of a list; the first come last."""
    return [numbers[first : first + size] for first in range(0, len(numbers), size)][::-1]


class Process:
    """One process that judges, and the next one where it has ended."""

    def __init__(self, plan: Plan, place: int) -> None:
        """It is started with the first cases."""
        self._plan = plan
        self._place = plan.scratch / f"process-{place}"
        self._place.mkdir()
        self._executor: ProcessPoolExecutor | None = None

    def submit(self, numbers: list[int]) -> Future[list[Outcome]]:
        """Judge some cases."""
        if self._executor is None:
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(
                1, context, initializer=begin, initargs=(self._place,)
            )
        return self._executor.submit(judge_cases, self._plan, self._place, numbers)

    def ended_at(self) -> Outcome:
        """The case that ended the process: by an abort, or by taking too long."""
        self.close()
        number = int((self._place / BEGUN).read_text())
        trace = (self._place / TRACE).read_text(errors="replace")
        what = f"longer than {self._plan.limit_s:g} s" if "Timeout" in trace else "abort"
        case = make_case(self._plan.seed, number, self._plan.world, self._place / "again")
        verdict = Verdict(None, what, trace[-3000:])
        return Outcome(number, case.name, case.words, verdict, self._plan.limit_s)

    def close(self) -> None:
        """End it."""
        if self._executor is not None:
            self._executor.shutdown()
        self._executor = None


def begin(place: Path) -> None:
    """In a new process: no output of it is shown, and it cannot take all memory."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears Ctrl-C
    os.environ |= ONE_THREAD
    (place / "cache").mkdir(exist_ok=True)
    os.environ["TI_OFFLINE_CACHE_FILE_PATH"] = str(place / "cache")
    files_for_output(place)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, most))
    DOORS.enter_context(doors())


def judge_cases(plan: Plan, place: Path, numbers: list[int]) -> list[Outcome]:
    """In a process: the outcomes of some cases."""
    found = []
    with (place / TRACE).open("w") as trace:
        faulthandler.enable(trace)
        for number in numbers:
            (place / BEGUN).write_text(str(number))
            case = make_case(plan.seed, number, plan.world, place / "case")
            began_s = time.perf_counter()
            faulthandler.dump_traceback_later(plan.limit_s, exit=True, file=trace)
            verdict = plan.judge(case.words, case.folder)
            faulthandler.cancel_dump_traceback_later()
            took_s = time.perf_counter() - began_s
            found.append(Outcome(number, case.name, case.words, verdict, took_s))
        faulthandler.disable()
    return found


def keep(plan: Plan, outcome: Outcome, folder: Path) -> None:
    """Make a failed case's files once more, to be looked at, with what it did."""
    make_case(plan.seed, outcome.number, plan.world, folder)
    document = {
        "wrong": outcome.verdict.wrong,
        "repeat": f"cd here && taichi-nmm {shlex.join(outcome.words)}",
        "words": outcome.words,
        "code": outcome.verdict.code,
        "said": outcome.verdict.said,
    }
    (folder / "case.json").write_text(json.dumps(document, indent=2) + "\n")


def table(outcomes: Iterable[Outcome]) -> str:
    """Markdown: a line a format, and one of all."""
    by_name: dict[str, list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda each: each.number):
        by_name.setdefault(outcome.name, []).append(outcome)
    lines = [line(name, own) for name, own in sorted(by_name.items())]
    everything = [outcome for own in by_name.values() for outcome in own]
    head = "| format | cases | refused | accepted | failures | slowest |"
    return "\n".join([head, "|---|--:|--:|--:|--:|--:|", *lines, line("all", everything)])


def line(name: str, outcomes: list[Outcome]) -> str:
    """Of a format."""
    codes = [outcome.verdict.code for outcome in outcomes if not outcome.verdict.wrong]
    slowest = max((outcome.took_s for outcome in outcomes), default=0.0)
    return (
        f"| {name} | {len(outcomes):,} | {codes.count(REFUSED):,} | {codes.count(ACCEPTED):,}"
        f" | {len(outcomes) - len(codes):,} | {slowest:.1f} s |"
    )

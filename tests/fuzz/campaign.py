"""Damaged input for every command: it ends with 0, or with 2, one line, and its folder as it was.

    python -m tests.fuzz.campaign --cases 50000 --seed 1

Case n of a seed is the same everywhere. Failed cases lie below --out, with the words that repeat
them. The simulator is replaced by a door:
a command that gets there has passed all checks of its input, and counts as accepted. Cases run in
processes of their own: an abort, or a case that takes too long, ends one process and tells which
case it was. Exit codes: 0, 1 something failed, 2 bad input, 130 interrupted.
"""

import faulthandler
import hashlib
import json
import multiprocessing
import os
import re
import resource
import shlex
import signal
import sys
import tempfile
import time
import traceback
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from tqdm import tqdm

from storage.commit import require_folder
from storage.pool import cores
from study.cli import EXIT_BAD_INPUT, main, run_command
from study.options import LARGEST_SEED, Options
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_folder
from tests.fuzz.cases import make_case
from tests.fuzz.world import Words, make_world

ACCEPTED, REFUSED = 0, EXIT_BAD_INPUT
LINE = re.compile(r"error: \S.*: .*\S", re.DOTALL)
OF_ARGPARSE = re.compile(r"error: (unrecognized arguments|the following arguments are required): ")
# Of optimum and compare, of which the end of the work looks at what the beginning could not.
PROGRESS = re.compile(r"^(dog: \d+ of \d+ trials|(\r[^\r\n]*trial/s[^\r\n]*)+)\n")
LONGEST_LINE = 2000  # characters; a path may have hundreds
PICTURES = {"png": b"\x89PNG IEND\xaeB`\x82", "svg": b"<svg></svg>"}

Content = dict[str, str]
"""What a file or a folder is, by its path."""


class Reached(BaseException):
    """The command got where the work begins."""


class Idle(Executor):
    """Does nothing of what it is asked for."""

    def __init__(self, _: int) -> None:
        pass

    def submit(self, *_: Any, **__: Any) -> Future[Any]:
        return Future()


@dataclass(frozen=True)
class Verdict:
    """What came of a command.

    Attributes:
        code: that it ended with; None where it did not say.
        wrong: what it must not have done; "": nothing.
        said: on standard error.
    """

    code: int | None
    wrong: str
    said: str


def judge(words: tuple[str, ...], folder: Path) -> Verdict:
    """Run `taichi-nmm` with these words from within the folder.

    Standard output and error of this process have to be files (see `files_for_output`).
    """
    before = content(folder)
    code, error = run(words, folder)
    said = take_output()
    if error:
        return Verdict(None, error, said)
    return Verdict(code, wrong(code, said, before, folder), said)


def run(words: tuple[str, ...], folder: Path) -> tuple[int | None, str]:
    """Exit code of a command; or what it raised, and where."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with mock.patch.object(sys, "argv", []), warnings.catch_warnings():
            main(words)
    except SystemExit as end:
        return (end.code, "") if isinstance(end.code, int) else (int(bool(end.code)), "")
    except Reached:
        pass
    except BaseException as error:  # what the guard lets pass is what is looked for
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return None, f"{type(error).__name__} in {where}: {error}"[:300]
    finally:
        os.chdir(before)
    return ACCEPTED, ""


def wrong(code: int | None, said: str, before: Content, folder: Path) -> str:
    """What is wrong with an exit code, what was said, and what is left in the folder."""
    if "Traceback" in said:
        return "a traceback"
    if code == ACCEPTED:
        return ""
    if code != REFUSED:
        return f"exit code {code}"
    line = PROGRESS.sub("", said).removesuffix("\n")
    if "\n" in line or not line.isprintable():
        return f"{len(said.splitlines())} lines, or one that is not printable"
    if not (LINE.fullmatch(line) or OF_ARGPARSE.match(line)) or len(line) > LONGEST_LINE:
        return f"a line that names nothing, or of {len(line)} characters"
    after = content(folder)
    changed = sorted(path for path in before.keys() | after if before.get(path) != after.get(path))
    return f"changed: {', '.join(changed)}" if changed else ""


def content(folder: Path) -> Content:
    """SHA-256 of every file below a folder; folders too."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        data = path.read_bytes() if path.is_file() and not path.is_symlink() else None
        found[name] = "no file" if data is None else hashlib.sha256(data).hexdigest()
    return found


@contextmanager
def doors() -> Iterator[None]:
    """Where the work would begin, `Reached` is raised; and what no input decides takes no time."""
    from alembic.script import ScriptDirectory
    from bokeh.document import Document
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    import taichi_nmm.simulator
    from storage import pool
    from study.commands import dashboard, explore

    def reached(*_: object, **__: object) -> None:
        raise Reached

    def fill(page: Callable[[Document], None], _: int) -> None:
        page(Document())
        raise Reached

    def savefig(_: object, path: Path, format: str, **__: object) -> None:
        Path(path).write_bytes(PICTURES[format])

    ask, known = ScriptDirectory.get_current_head, []

    def head(script: ScriptDirectory) -> str | None:
        if not known:
            known.append(ask(script))
        return known[0]

    for_nothing = [
        (Figure, "savefig", savefig),
        (Figure, "tight_layout", lambda _: None),
        (FigureCanvasAgg, "draw", lambda _: None),
        (os, "fsync", lambda _: None),
        # Optuna asks anew for the version of its own schema, from ten files, at every opening.
        (ScriptDirectory, "get_current_head", head),
    ]
    with ExitStack() as stack:
        for owner, name, instead in (
            (taichi_nmm.simulator, "_start", reached),
            (pool, "Processes", reached),
            (dashboard.Server, "serve_forever", reached),
            (explore, "Processes", Idle),
            (explore, "serve", fill),
            *for_nothing,
        ):
            stack.enter_context(mock.patch.object(owner, name, instead))
        yield


def files_for_output(folder: Path) -> None:
    """From now on standard output and error are files: C++ writes there too, past Python."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        file = os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)


def take_output() -> str:
    """What stands on standard error; both are emptied."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    said = os.pread(2, 1 << 20, 0).decode(errors="replace")
    for number in (1, 2):
        os.ftruncate(number, 0)
    return said


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
        seed: of the cases.
        world: folder of sound files.
        scratch: folder for the processes' own.
        limit_s: of a case.
        judge: on a case.
    """

    seed: int
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


MOST_CASES = 10_000_000


def fuzz() -> None:
    """Run cases, keep those that failed, and print a table."""
    options = parse()
    require_folder(options.out)
    if is_folder(options.out) and any(options.out.iterdir()):
        raise InputError("out", str(options.out), "a new folder, or an empty one")
    began_s, outcomes, failed = time.monotonic(), [], 0
    with tempfile.TemporaryDirectory() as scratch, tqdm(total=options.cases, unit="case") as bar:
        plan = Plan(options.seed, Path(scratch) / "world", Path(scratch))
        make_world(plan.world)
        for outcome in run_cases(plan, range(options.cases), options.workers or cores()):
            outcomes.append(outcome)
            bar.update()
            if outcome.verdict.wrong:
                failed += 1
                bar.set_postfix_str(f"{failed} failed")
                keep(plan, outcome, options.out / f"{options.seed}-{outcome.number}")
    print(table(outcomes))
    print(f"\n{time.monotonic() - began_s:.0f} s")
    if failed:
        sys.exit(f"{failed} failed: {options.out}")


def parse() -> Namespace:
    """The options of this process."""
    parser = Options(__file__)
    parser.whole("--cases", 1, MOST_CASES, default=2000, help="(%(default)s)")
    parser.whole("--seed", 0, LARGEST_SEED, default=1, help="of the cases (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="(%(default)s)")
    parser.workers()
    return parser.parse_args()


if __name__ == "__main__":
    run_command(fuzz)

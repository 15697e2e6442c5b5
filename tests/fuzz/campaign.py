"""Damaged input for every command: it ends with 0, or with 2 and its folder as it was.

Of each mistake there is one line.

    python -m tests.fuzz.campaign --cases 50000 --seed 1

Case n of a seed is the same everywhere. Failed cases lie below --out, with the words
that repeat them. The simulator is replaced by an exception: a command that raises it
has passed all checks of its input, and counts as accepted. Cases run in other
processes: an abort, or a case that takes too long, ends one process and is a failure of
that case. Exit codes: 0, 1 something failed, 2 bad input, 130 interrupted.
"""

import faulthandler
import hashlib
import json
import os
import re
import resource
import shlex
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, as_completed
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from unittest import mock

from tqdm import tqdm

from storage.commit import require_folder
from storage.inputs.config import MOST_MISTAKES
from storage.inputs.errors import InputError
from storage.inputs.reading import is_folder
from storage.pool import cores
from storage.processes import Processes
from study.cli import EXIT_BAD_INPUT, main, run_command
from study.options import LARGEST_SEED, Options
from taichi_nmm.kernel_cache import CACHE_VARIABLE
from tests.fuzz.cases import Case, make_case
from tests.fuzz.world import make_world
from tests.processes import read_schema_once

ACCEPTED, REFUSED = 0, EXIT_BAD_INPUT
LINE = re.compile(r"error: \S.*: .*\S", re.DOTALL)
OF_ARGPARSE = re.compile(
    r"error: (unrecognized arguments|the following arguments are required): "
)
# The progress of compare, whose work has checks of input at its end too.
PROGRESS = re.compile(r"^(\r[^\r\n]*trial/s[^\r\n]*)+\n")
LIMIT_S = 60.0  # of a case; the longest takes two seconds of a processor
LONGEST_LINE = 2000  # characters; a path may have hundreds
PICTURE = b"\x89PNG IEND\xaeB`\x82"

Content = dict[str, str]  # of a folder: SHA-256 of each file, by path


class Reached(BaseException):
    """The command has come to its work."""


@dataclass(frozen=True)
class Verdict:
    """How a command ended."""

    code: int | None  # None where it raised something instead
    wrong: str  # the rule that it broke; "" for none
    said: str  # on standard error


def judge(case):
    """Run `taichi-nmm` with the case's words from within its folder; see `files_for_output`."""
    before = content(case.folder)
    code, error = run(case.words, case.folder)
    said = take_output()
    return Verdict(code, error or wrong(code, said, before, case.folder), said)


def run(words, folder):
    """Exit code of a command; or what it raised, and where."""
    try:
        with (
            chdir(folder),
            mock.patch.object(sys, "argv", []),
            warnings.catch_warnings(),
        ):
            main(words)
    except SystemExit as end:
        return (
            (end.code, "") if isinstance(end.code, int) else (int(bool(end.code)), "")
        )
    except Reached:
        pass
    except BaseException as error:  # one that the guard let pass
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return None, f"{type(error).__name__} in {where}: {error}"[:300]
    return ACCEPTED, ""


def wrong(code, said, before, folder):
    """The rule that an exit code, a message or the folder's new content breaks."""
    if "Traceback" in said:
        return "a traceback"
    if code == ACCEPTED:
        return ""
    if code != REFUSED:
        return f"exit code {code}"
    lines = PROGRESS.sub("", said).removesuffix("\n").split("\n")
    if len(lines) > MOST_MISTAKES or not all(map(str.isprintable, lines)):
        return f"{len(lines)} lines, or one that is not printable"
    for line in lines:
        if (
            not (LINE.fullmatch(line) or OF_ARGPARSE.match(line))
            or len(line) > LONGEST_LINE
        ):
            return f"a line that names nothing, or of {len(line)} characters"
    after = content(folder)
    changed = sorted(
        path for path in before.keys() | after if before.get(path) != after.get(path)
    )
    return f"changed: {', '.join(changed)}" if changed else ""


def content(folder):
    """SHA-256 of every file below a folder; folders too."""

    def digest(path):
        sound = path.is_file() and not path.is_symlink()
        return hashlib.sha256(path.read_bytes()).hexdigest() if sound else "no file"

    return {
        str(path.relative_to(folder)): digest(path)
        for path in sorted(folder.rglob("*"))
    }


@contextmanager
def doors():
    """Where the work would begin, `Reached` is raised; and what no input decides takes no time."""
    from bokeh.document import Document
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    import taichi_nmm.simulator
    from storage import pool, processes
    from study import loopback
    from study.explore import server

    def reached(*_, **__):
        raise Reached

    def fill(page, _):
        page(Document())
        raise Reached

    def savefig(_, path, **__):
        Path(path).write_bytes(PICTURE)

    with ExitStack() as stack:
        for owner, name, instead in (
            (taichi_nmm.simulator, "_takes_queue", reached),
            (pool, "Processes", reached),
            (loopback.Server, "serve_forever", reached),
            (processes, "Processes", mock.MagicMock()),
            (server, "serve", fill),
            (Figure, "savefig", savefig),
            (Figure, "tight_layout", lambda _: None),
            (FigureCanvasAgg, "draw", lambda _: None),
            (os, "fsync", lambda _: None),
        ):
            stack.enter_context(mock.patch.object(owner, name, instead))
        yield


def files_for_output(folder):
    """From now on standard output and error are files: C++ writes there too, past Python."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        file = os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)


def take_output():
    """The content of standard error; both outputs are emptied."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    said = os.pread(2, 1 << 20, 0).decode(errors="replace")
    for number in (1, 2):
        os.ftruncate(number, 0)
    return said


# of memory: a command that takes more is wrong, and fails by itself
MOST_BYTES = 4 << 30
MOST_CASES = 10_000_000

DOORS = ExitStack()  # of a process of cases, for good: it does nothing else


@dataclass(frozen=True)
class Outcome:
    """A case, its verdict, and the seconds that it took."""

    case: Case
    verdict: Verdict
    took_s: float


@dataclass(frozen=True)
class Plan:
    """All that processes need: the cases' seed, sound files, a folder of theirs, how to judge."""

    seed: int
    world: Path
    scratch: Path
    limit_s: float = LIMIT_S
    judge: Callable[[Case], Verdict] = judge

    def trace(self, number):
        """The file that says what ended the process of a case."""
        return self.scratch / f"trace-{number}"


def run_cases(plan, numbers, workers, note=id):
    """The outcomes of cases; `note` is called with each as it comes."""
    outcomes = []
    with Processes(workers) as pool:
        futures = {pool.submit(judge_case, plan, number): number for number in numbers}
        for future in as_completed(futures):
            try:
                outcomes.append(future.result())
            except BrokenExecutor:
                outcomes.append(ended(plan, futures[future]))
            note(outcomes[-1])
    return outcomes


def ended(plan, number):
    """Of a case that ended its process: by an abort, or by taking too long."""
    trace = plan.trace(number).read_text(errors="replace")
    what = f"longer than {plan.limit_s:g} s" if "Timeout" in trace else "abort"
    case = make_case(plan.seed, number, plan.world, plan.scratch / f"again-{number}")
    return Outcome(case, Verdict(None, what, trace[-3000:]), plan.limit_s)


@cache
def begin(scratch):
    """Once in a process, its folder: no output is shown, and it cannot take all memory."""
    place = scratch / f"process-{os.getpid()}"
    (place / "cache").mkdir(parents=True)
    os.environ[CACHE_VARIABLE] = str(place / "cache")
    files_for_output(place)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, most))
    DOORS.enter_context(doors())
    read_schema_once()
    return place


def judge_case(plan, number):
    """In a process: the outcome of one case."""
    place = begin(plan.scratch)
    with plan.trace(number).open("w") as trace:
        faulthandler.enable(trace)
        case = make_case(plan.seed, number, plan.world, place / "case")
        began_s = time.perf_counter()
        faulthandler.dump_traceback_later(plan.limit_s, exit=True, file=trace)
        verdict = plan.judge(case)
        faulthandler.cancel_dump_traceback_later()
        took_s = time.perf_counter() - began_s
        faulthandler.disable()
    plan.trace(number).unlink()
    return Outcome(case, verdict, took_s)


def keep(plan, outcome, folder):
    """Make a failed case's files once more, to be looked at, with its verdict."""
    make_case(plan.seed, outcome.case.number, plan.world, folder)
    words = outcome.case.words
    repeat = {"repeat": f"cd here && taichi-nmm {shlex.join(words)}", "words": words}
    document = asdict(outcome.verdict) | repeat
    (folder / "case.json").write_text(json.dumps(document, indent=2) + "\n")


def table(outcomes):
    """Markdown: a line a format, and one of all."""
    lines = [
        "| format | cases | refused | accepted | failures | slowest |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for name in [*sorted({each.case.name for each in outcomes}), "all"]:
        own = [each for each in outcomes if name in (each.case.name, "all")]
        codes = [each.verdict.code for each in own if not each.verdict.wrong]
        slowest_s = max((each.took_s for each in own), default=0.0)
        lines.append(
            f"| {name} | {len(own):,} | {codes.count(REFUSED):,} | {codes.count(ACCEPTED):,}"
            f" | {len(own) - len(codes):,} | {slowest_s:.1f} s |"
        )
    return "\n".join(lines)


def fuzz():
    """Run cases, keep those that failed, and print a table."""
    parser = Options(__file__)
    parser.whole("--cases", 1, MOST_CASES, default=2000, help="(%(default)s)")
    parser.whole(
        "--seed", 0, LARGEST_SEED, default=1, help="of the cases (%(default)s)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/fuzz"), help="(%(default)s)"
    )
    parser.declare({"like": "workers"})
    options = parser.parse_args()
    require_folder(options.out)
    if is_folder(options.out) and any(options.out.iterdir()):
        raise InputError("out", str(options.out), "a new folder, or an empty one")
    began_s, failed = time.monotonic(), []
    with (
        tempfile.TemporaryDirectory() as scratch,
        tqdm(total=options.cases, unit="case") as bar,
    ):
        plan = Plan(options.seed, Path(scratch) / "world", Path(scratch))
        make_world(plan.world)

        def note(outcome):
            if outcome.verdict.wrong:
                failed.append(outcome)
                bar.set_postfix_str(f"{len(failed)} failed")
                keep(
                    plan, outcome, options.out / f"{options.seed}-{outcome.case.number}"
                )
            bar.update()

        outcomes = run_cases(
            plan, range(options.cases), options.workers or cores(), note
        )
    print(table(outcomes))
    print(f"\n{time.monotonic() - began_s:.0f} s")
    if failed:
        sys.exit(f"{len(failed)} failed: {options.out}")


if __name__ == "__main__":
    run_command(fuzz)

"""Commands killed at commits and at random moments: what they leave is compared with a whole run.

    python -m tests.tools.kills --kills 100 --seed 1

In every folder a command is killed at a commit, just before it or just after, and then,
resumed, at any moment. Resumed once more it ends, and its folder must hold the same
bits as that of a run that was not killed. The simulator is replaced by a formula. Exit
code 1 where a folder differs.

A commit is a file that gets its name, or a transaction of a database. Python's audit
events and SQLAlchemy's report them: the commands know nothing of this. Processes are
forked from one that has imported the commands and has done nothing else, since an
import takes longer than a command.
"""

import atexit
import hashlib
import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from importlib import import_module
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import optuna
import pyarrow.parquet as pq
from optuna.trial import TrialState
from sqlalchemy import Engine, Pool, event

import taichi_nmm
from storage.databases.plain import COMMIT
from storage.databases.urls import file_url
from study.cli import main as command_line
from study.cli import run_command
from study.experiment import compare
from study.experiment.folder import PROPOSAL_TIME, RUN_NAME, TIMES_NAME
from study.options import COMMANDS, LARGEST_SEED, Options
from tests.cases import ASSETS
from tests.study import fake_walker

FORK = multiprocessing.get_context("fork")
NAMING = ("os.rename", "os.link")  # the audit events of os.replace and its like
DATABASE = "a transaction"  # in place of a file's name

REPERTOIRE = "repertoire = {evaluations = 300, settings = 1, candidates = 6}"
ONE = "--workers 1"
COMPARE = f"compare --config {{base}}/rough.toml {ONE} --out"
# The commands that write, run in a folder of their own; {base} is the folder of what
# they need.
SCENES = {
    "precompute": f"precompute --config {{base}}/bred.toml --out out {ONE}",
    "study": "study --config {base}/rough.toml --arm dog --storage sqlite:///out/s.db --out out",
    "compare": f"{COMPARE} out",
    "report": "report compared",
    "sweep": f"sweep --config {{base}}/rough.toml --over body.disturbance=0.1,0.2 {ONE} --out out",
}
PREPARATIONS = (
    f"precompute --config {{base}}/store.toml --out store {ONE}",
    f"{COMPARE} compared",
)


class Death(NamedTuple):
    """When a process is killed; by default never."""

    commit: str = ""  # name of the file, or `DATABASE`, whose commit it dies at
    number: int = 1  # of that commit among those of its name
    after: bool = False  # die at whatever comes after the commit, not just before it
    delay_s: float | None = None  # or die so long after the beginning


NEVER = Death()


class Ended(NamedTuple):
    """How a process ended: its exit code, its commits in their order, its duration."""

    code: int
    commits: list[str]
    wall_s: float


class Watch:
    """Counts the commits of this process, reports each to a file descriptor, and kills at one."""

    def __init__(self, death, report):
        self._death, self._report = death, report
        self._count = 0
        # kind of event, and thread, that dies next
        self._dying: tuple[str, int] | None = None

    def begin(self):
        """Watch from here on."""
        os.write(self._report, b"\n")
        sys.addaudithook(self._on_audit)
        event.listen(Engine, "commit", lambda _: self._on_commit(DATABASE, "checkin"))
        event.listen(Pool, "checkin", lambda *_: self._on_next("checkin"))

    def _on_audit(self, name, arguments):
        if name in NAMING:
            self._on_commit(Path(arguments[1]).name, "audit")
        elif name == COMMIT:  # of a database that Optuna does not write
            self._on_commit(DATABASE, "audit")
        elif self._dying is not None:
            self._on_next("audit")

    def _on_commit(self, name, next_kind):
        os.write(self._report, f"{name}\n".encode())
        self._count += name == self._death.commit
        if name != self._death.commit or self._count != self._death.number:
            return
        if not self._death.after:
            os.kill(os.getpid(), signal.SIGKILL)
        self._dying = next_kind, threading.get_ident()

    def _on_next(self, kind):
        if self._dying == (kind, threading.get_ident()):
            self._dying = None  # os.kill is an audit event, too
            os.kill(os.getpid(), signal.SIGKILL)


def in_process(work, folder, log, death=NEVER):
    """Do some work in a fork of this process, in a folder; what it prints goes to the log."""
    ours, theirs = os.pipe()  # which holds all names of commits
    process = FORK.Process(target=be, args=(work, folder, log, Watch(death, theirs)))
    process.start()
    os.close(theirs)
    with os.fdopen(ours) as pipe:
        pipe.readline()  # the work begins
        begun_s = time.monotonic()
        process.join(death.delay_s)
        process.kill()  # if it runs still
        process.join()
        wall_s = time.monotonic() - begun_s
        commits = pipe.read().splitlines()
    assert process.exitcode is not None
    return Ended(process.exitcode, commits, wall_s)


def be(work, folder, log, watch):
    """The forked process, which runs none of its parent's code."""
    code = 1
    try:
        printed = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        os.chdir(folder)
        watch.begin()
        work()
        code = 0
    except SystemExit as leaving:
        code = leaving.code or 0
    finally:
        sys.stdout.flush()
        atexit._run_exitfuncs()
        os._exit(code)


class Theatre:
    """A folder in which commands are run, beside a base with what all of them need."""

    def __init__(self, folder):
        self._folder, self._base = folder, folder / "base"
        self._log, self._stage = folder / "log.txt", folder / "stage"
        self._base.mkdir(parents=True)
        files = ASSETS / "kills"
        store, rough = (
            (files / f"{name}.toml").read_text() for name in ("store", "rough")
        )
        texts = {"store": store, "bred": store + REPERTOIRE, "rough": rough}
        for name, text in texts.items():
            (self._base / f"{name}.toml").write_text(
                text.replace("BASE", str(self._base))
            )
        for line in PREPARATIONS:
            self._play(line, self._base, NEVER)

    def run(self, command, *deaths):
        """A command in a new folder, killed so often and then whole; the folder's digest."""
        shutil.rmtree(self._stage, ignore_errors=True)
        self._stage.mkdir()
        if command == "report":
            shutil.copytree(self._base / "compared", self._stage / "compared")
        ended = [
            self._play(SCENES[command], self._stage, each) for each in (*deaths, NEVER)
        ]
        return ended, self._digest()

    def _play(self, line, folder, death):
        self._log.write_text("")
        words = line.format(base=self._base).split()
        ended = in_process(lambda: command_line(words), folder, self._log, death)
        if ended.code not in (0, -signal.SIGKILL):
            raise RuntimeError(
                f"{line} ended with {ended.code}: {self._log.read_text()}"
            )
        return ended

    def _digest(self):
        """In a process of its own: this one opens no database, and so forks none that is open."""
        file, stage = self._folder / "digest.json", self._stage
        in_process(
            lambda: file.write_text(json.dumps(digest(stage))), self._folder, self._log
        )
        found = json.loads(file.read_text())
        file.unlink()
        return found


OF_THE_DATABASE = (".db-wal", ".db-shm")  # read with it
# of a trial that was cut short
OF_REPEATS = {"failed_trial", "retry_history", "fixed_params"}
VERSION = re.compile("note_ver")  # counts how often a note was written
# by the trial's identity, in the order of writing
TRIAL_NOTE = re.compile(r"dashboard:(\d+):")
# of study and trial, in the order of writing
IDENTITIES = re.compile(r"/artifacts/\d+/\d+/")


def digest(folder):
    """SHA-256 of each file, also of what a killed process left, less times and interruptions."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    kept = [file for file in files if not file.name.endswith(OF_THE_DATABASE)]
    return {
        str(f.relative_to(folder)): hashlib.sha256(content(f)).hexdigest() for f in kept
    }


def content(file):
    """The content of a file that two runs agree upon."""
    if file.name == RUN_NAME:
        return b""
    if file.name == TIMES_NAME or file.parent.name == "arms":
        return repr(
            pq.read_table(file).drop_columns(PROPOSAL_TIME).to_pylist()
        ).encode()
    if file.suffix == ".db":
        storage = optuna.storages.RDBStorage(file_url(file))
        names = optuna.get_all_study_names(storage)
        found = {
            n: of_study(optuna.load_study(study_name=n, storage=storage)) for n in names
        }
        storage.engine.dispose()
        return json.dumps(found, sort_keys=True).encode()
    return file.read_bytes()


def of_study(study):
    """Attributes and finished trials of a study, less numbers that count trials cut short."""
    finished = study.get_trials(states=(TrialState.COMPLETE,))
    places = {trial._trial_id: place for place, trial in enumerate(finished)}

    def renamed(key):
        return TRIAL_NOTE.sub(lambda found: f"trial {places.get(int(found[1]))}:", key)

    system = study._storage.get_study_system_attrs(study._study_id)
    kept = {
        renamed(key): text for key, text in system.items() if not VERSION.search(key)
    }
    trials = [
        {
            "params": trial.params,
            "values": trial.values,
            "user": trial.user_attrs,
            "system": {
                k: v for k, v in trial.system_attrs.items() if k not in OF_REPEATS
            },
        }
        for trial in finished
    ]
    text = json.dumps({"user": study.user_attrs, "system": kept})
    return json.loads(IDENTITIES.sub("/artifacts/", text)) | {"trials": trials}


def kill(theatre, commands, kills, seed):
    """Of each command: kills, those at a commit, folders, and folders that are bit-equal."""
    dice = random.Random(seed)
    wholes = {command: theatre.run(command) for command in commands}
    counts = {command: [0, 0, 0, 0] for command in commands}
    for command in cycle(commands):
        if sum(count[0] for count in counts.values()) >= kills:
            break
        (whole,), expected = wholes[command]
        name = dice.choice(sorted(set(whole.commits)))
        number = dice.randint(1, whole.commits.count(name))
        at_commit = Death(name, number, after=dice.random() < 0.5)
        deaths = (at_commit, Death(delay_s=dice.uniform(0.0, whole.wall_s)))
        ended, found = theatre.run(command, *deaths)
        names = sorted({name for name, _ in expected.items() ^ found.items()})
        killed = [each.code == -signal.SIGKILL for each in ended]
        this = (sum(killed), killed[0], 1, not names)
        counts[command] = [a + b for a, b in zip(counts[command], this, strict=True)]
        print(f"{command}: {', '.join(names) or 'equal'}, {deaths}", file=sys.stderr)
    return counts


def main():
    """Kill, and print a table."""
    parser = Options(__file__)
    parser.whole("--kills", 1, 100_000, default=100, help="in total (%(default)s)")
    parser.whole(
        "--seed", 0, LARGEST_SEED, default=1, help="of the moments (%(default)s)"
    )
    parser.add_argument(
        "--commands", metavar="A,B,C", default=",".join(SCENES), help="%(default)s"
    )
    args = parser.parse_args()
    vars(taichi_nmm)["simulate"] = fake_walker.simulate
    compare.CHECKPOINT_S = compare.EXPORT_S = 0.0  # often, not every 20 s
    compare.STRETCH_TRIALS = 2
    for name in COMMANDS:  # so that no process has to
        import_module(f"study.commands.{name.replace('-', '_')}")
    for late in ("ribs.archives", "optuna_dashboard"):
        import_module(late)
    # TemporaryDirectory's would go with the first process
    folder = Path(tempfile.mkdtemp())
    try:
        counts = kill(Theatre(folder), args.commands.split(","), args.kills, args.seed)
    finally:
        shutil.rmtree(folder)
    print(
        "| command | kills | at a commit | folders | bit-equal |\n|---|--:|--:|--:|--:|"
    )
    for command, count in counts.items():
        print(f"| {command} | {' | '.join(map(str, count))} |")
    if any(folders != equal for _, _, folders, equal in counts.values()):
        sys.exit(1)


if __name__ == "__main__":
    run_command(main)

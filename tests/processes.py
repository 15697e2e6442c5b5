"""Processes of Python, their children, waiting for what they do; and Optuna in haste."""

import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WAIT_S = 120.0


def python(*words, **options):
    """Run it on these words, in the root unless `cwd` is given, and keep what it prints."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(
        command, **{"cwd": ROOT, "capture_output": True, "text": True} | options
    )


def printed(*words, **options):
    """What `python` prints on these words, which must end well."""
    done = python(*words, **options)
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


@contextmanager
def serving(*words, **options):
    """Python on these words as a server: what it prints; Ctrl-C ends it, and must end it well."""
    command = [sys.executable, *map(str, words)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, **options
    ) as process:
        assert process.stdout is not None
        try:
            yield process.stdout
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0


def until(true, wait_s=WAIT_S):
    """Wait for something to be true, which must be so in time."""
    deadline_s = time.monotonic() + wait_s
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def children(pid):
    """Processes that a process has spawned, in any generation."""
    found = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, file.read_text().split()):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                found += [child, *children(child)]
    return found


def read_schema_once():
    """Have Optuna read the version of its schema from ten files once, not whenever a
    database is opened: that takes half the time, and there are hundreds."""
    from alembic.script import ScriptDirectory  # slow to load

    read = ScriptDirectory.get_current_head
    known = cache(lambda folder: read(ScriptDirectory(folder)))
    ScriptDirectory.get_current_head = lambda script: known(script.dir)

"""The command: within this process, and in processes that are killed and interrupted for real."""

import json
import os
import signal
import time
from pathlib import Path
from subprocess import Popen

import pytest

from storage import open_store
from tests.tools.conftest import Command, Simulator, Tool
from tests.tools.running import ROOT, WAIT_S, Done, finish, start

pytestmark = pytest.mark.slow

CONFIG = """
samples = 96
shard_rows = 8
seed = 7
searched = ["theta_ref"]
families.up = {settings = 2, terrain = {kind = "ramp"}}
"""
SHARDS = 12
INTERRUPTED = "interrupted: finished work is kept; the same command resumes"


def run(command: Command, *more: str, **accidents: object) -> Done:
    """The command in a process of its own; the accidents are those of fake_command.py."""
    return finish(start(*command.words(), *more, **accidents))


def shards(out: Path) -> int:
    return len(list(out.glob("part-*.parquet")))


def content(out: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in out.iterdir()}


@pytest.fixture
def command(simulator: Simulator, tool: Tool, tmp_path: Path) -> Command:
    config = tmp_path / "store.toml"
    config.write_text(CONFIG)
    return Command(tool, tmp_path, "precompute", workers=1, config=config)


@pytest.fixture
def uninterrupted(command: Command) -> dict[str, bytes]:
    assert command.run(out=command.folder / "whole") == 0
    return content(command.folder / "whole")


def test_json_is_one_object(command: Command) -> None:
    summary = command.json(samples=20)
    assert (summary["points"], summary["points_computed"], summary["shards"]) == (20, 20, 3)
    assert summary["path"] == str(command.out)
    assert summary["walkers_per_s"] > 0
    ends = open_store(command.out, verify=True).numpy(["end_reason"])["end_reason"]
    assert summary["alive_at_horizon"] == (ends == "completed").sum()
    command.refuses("samples: 96 cannot be used; allowed: 20, as ")
    assert command.tool.json(*command.words(), "--fresh")["points_computed"] == 96


def test_text_says_what_was_done_where(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    (command.folder / "store.toml").write_text(
        CONFIG + "[robust]\nsettings = 2\n[robust.body]\ndisturbance = 0.1\n"
    )
    monkeypatch.chdir(command.folder)
    assert command.run(out="") == 0
    assert "96 in 12 shards (96 computed now)" in command.tool.out
    assert "points on its disturbed settings" in command.tool.out
    assert str(Path("out", "store")) in command.tool.out  # named after the configuration
    assert "walker/s" in command.tool.err and "96/96" in command.tool.err
    assert (command.folder / "out" / "store" / "manifest.json").is_file()


def test_kill_9_before_a_file_is_named(command: Command, uninterrupted: dict[str, bytes]) -> None:
    # Files get their names in this order: the specification, twelve shards, the manifest.
    for rename, expected in ((1, 0), (3, 1), (12, SHARDS)):
        done = run(command, death=rename)
        assert (done.code, shards(command.out)) == (-signal.SIGKILL, expected)
        assert len(list(command.out.glob(".*.tmp"))) == 1
    assert command.run() == 0
    assert content(command.out) == uninterrupted


def test_interrupt_exits_130_and_resumes(command: Command, uninterrupted: dict[str, bytes]) -> None:
    done = run(command, signal="5:SIGINT")  # a shard takes two, for its family
    assert (done.code, done.last) == (130, INTERRUPTED) and shards(command.out) == 2
    assert json.loads(run(command, "--json").out)["points_computed"] == 8 * (SHARDS - 2)
    assert content(command.out) == uninterrupted


def test_a_full_disk_is_one_line(command: Command, uninterrupted: dict[str, bytes]) -> None:
    done = run(command, largest_b=8000)
    assert done.code == 2 and done.last.startswith("error: out: ") and "File too large" in done.last
    assert sorted(content(command.out)) == [".lock", "specification.json"]
    assert command.run() == 0
    assert content(command.out) == uninterrupted


REAL = """
samples = 400
shard_rows = 8
simulation = {duration_s = 1.0, arch = "cpu"}
"""
REAL_SHARDS = 50


def start_real(tmp_path: Path, name: str, workers: int) -> "Popen[str]":
    """The command with the real simulator, which other processes have too."""
    config = tmp_path / "real.toml"
    config.write_text(REAL)
    options = ["--config", config, "--out", tmp_path / name, "--workers", workers]
    return start(*options, program=[ROOT / "tools" / "precompute.py"])


def workers_of(process: "Popen[str]") -> list[int]:
    """Processes that a process has spawned."""
    tasks = Path(f"/proc/{process.pid}/task")
    pids = [pid for file in tasks.glob("*/children") for pid in file.read_text().split()]
    return [int(pid) for pid in pids if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


@pytest.fixture(scope="module")
def real_store(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("real")
    done = finish(start_real(folder, "store", workers=1))
    assert done.code == 0, done.error
    return content(folder / "store")


# Whom which signal ends, and the exit code and the line that the command ends with.
ENDS = (
    ("worker", signal.SIGKILL, 2, "error: workers: 'one was killed' cannot be used; allowed: "),
    ("it", signal.SIGINT, 130, INTERRUPTED),
    ("it", signal.SIGKILL, -signal.SIGKILL, ""),
)


@pytest.mark.campaign
def test_several_ended_processes_resume_equal(tmp_path: Path, real_store: dict[str, bytes]) -> None:
    for victim, number, code, line in ENDS:
        kept = shards(tmp_path / "store")
        process = start_real(tmp_path, "store", workers=2)
        deadline = time.monotonic() + WAIT_S
        while shards(tmp_path / "store") < kept + 3 and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        workers = workers_of(process)
        assert len(workers) == 2
        os.kill(workers[0] if victim == "worker" else process.pid, number)
        done = finish(process)
        assert done.code == code and done.last.startswith(line)
        assert kept + 3 <= shards(tmp_path / "store") < REAL_SHARDS
        while any(Path(f"/proc/{pid}").exists() for pid in workers):
            assert time.monotonic() < deadline
            time.sleep(0.01)
    done = finish(start_real(tmp_path, "store", workers=2))
    assert done.code == 0, done.error
    assert content(tmp_path / "store") == real_store

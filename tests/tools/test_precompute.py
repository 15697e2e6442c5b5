"""The command: within this process, and in processes that are killed and interrupted for real."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import taichi_nmm
from storage import open_store
from taichi_nmm.errors import InputError
from taichi_nmm.settings import Settings
from tests.study import fake_walker
from tests.tools.running import ROOT, run_tool

pytestmark = pytest.mark.slow

CONFIG = """
samples = 96
shard_rows = 8
seed = 7
searched = ["theta_ref"]
[families.up]
settings = 2
[families.up.terrain]
kind = "ramp"
"""
SHARDS = 12
WAIT_S = 300.0  # the real simulator may compile first


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "store.toml"
    path.write_text(CONFIG)
    return path


def start(config: Path, out: Path, *options: str, **accidents: object) -> subprocess.Popen[str]:
    """The command in a process of its own; the accidents are those of fake_command.py."""
    program = [sys.executable, str(ROOT / "tests" / "tools" / "fake_command.py"), "precompute"]
    words = ("--workers", "1", "--config", str(config), "--out", str(out), *options)
    environment = {f"FAKE_{name.upper()}": str(value) for name, value in accidents.items()}
    return subprocess.Popen(
        [*program, *words],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, standard output, and the last line of standard error."""
    out, err = process.communicate(timeout=WAIT_S)
    return process.returncode, out, (err.strip().splitlines() or [""])[-1]


def run(config: Path, out: Path, *options: str, **accidents: object) -> tuple[int, str, str]:
    return finish(start(config, out, *options, **accidents))


def shards(out: Path) -> int:
    return len(list(out.glob("part-*.parquet")))


def wait_for_shards(process: subprocess.Popen[str], out: Path, count: int) -> None:
    deadline = time.monotonic() + WAIT_S
    while shards(out) < count and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.002)


def content(out: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in out.iterdir()}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("uninterrupted")
    (folder / "store.toml").write_text(CONFIG)
    code, _, error = run(folder / "store.toml", folder / "store")
    assert code == 0, error
    return content(folder / "store")


Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """The command within this process: exit code, standard output, standard error."""
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)

    def call(*arguments: object) -> tuple[int, str, str]:
        code = run_tool(monkeypatch, "precompute", "--workers", 1, *arguments)
        return code, *capsys.readouterr()

    return call


def test_json_is_one_object(config: Path, tmp_path: Path, command: Command) -> None:
    store = tmp_path / "store"
    code, out, _ = command("--config", config, "--out", store, "--json", "--samples", 20)
    summary = json.loads(out)
    assert code == 0
    assert (summary["points"], summary["points_computed"], summary["shards"]) == (20, 20, 3)
    assert summary["path"] == str(store)
    assert summary["walkers_per_s"] > 0
    ends = open_store(store, verify=True).numpy(["end_reason"])["end_reason"]
    assert summary["alive_at_horizon"] == (ends == "completed").sum()


def test_text_says_what_was_done_and_where(
    config: Path, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    config.write_text(CONFIG + "[robust]\nsettings = 2\n[robust.body]\ndisturbance = 0.1\n")
    monkeypatch.chdir(tmp_path)
    code, out, progress = command("--config", config)
    assert code == 0
    assert "96 in 12 shards (96 computed now)" in out
    assert "points on its disturbed settings" in out
    assert str(Path("out", "store")) in out  # named after the configuration
    assert "walker/s" in progress and "96/96" in progress
    assert (tmp_path / "out" / "store" / "manifest.json").is_file()


def test_another_specification_is_refused_and_fresh_starts_over(
    config: Path, tmp_path: Path, command: Command, uninterrupted: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    assert command("--config", config, "--out", out, "--samples", 20)[0] == 0
    before = content(out)
    code, _, error = command("--config", config, "--out", out)
    assert code == 2 and error.startswith("error: samples: 96 cannot be used; allowed: 20, as ")
    assert content(out) == before
    assert command("--config", config, "--out", out, "--fresh")[0] == 0
    assert content(out) == uninterrupted


def test_a_missing_gpu_is_refused_before_anything_is_written(
    config: Path, tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(settings: Settings) -> None:
        raise InputError("simulation.arch", settings.arch, "an architecture of this machine")

    backend = SimpleNamespace(start=refuse)
    monkeypatch.setattr("taichi_nmm.kernel.backend", backend, raising=False)
    code, _, error = command("--config", config, "--out", tmp_path / "store", "--arch", "cuda")
    assert code == 2 and error.startswith("error: simulation.arch: 'cuda'")
    assert not (tmp_path / "store").exists()


def test_kill_9_again_and_again_then_equal(
    config: Path, tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    out, dice, codes = tmp_path / "store", random.Random(1), []
    while shards(out) < SHARDS - 4:
        process = start(config, out, trial_s=0.05)
        wait_for_shards(process, out, shards(out) + 3)
        time.sleep(dice.uniform(0.0, 0.08))  # while simulating, while writing, in between
        process.kill()
        process.communicate()
        codes.append(process.returncode)
    assert -signal.SIGKILL in codes
    code, _, error = run(config, out)
    assert code == 0, error
    assert content(out) == uninterrupted


def test_kill_9_between_writing_and_naming_a_file(
    config: Path, tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    # Files get their names in this order: the specification, twelve shards, the manifest.
    out = tmp_path / "store"
    for rename, expected in ((1, 0), (3, 1), (12, SHARDS)):
        code, _, _ = run(config, out, death=rename)
        assert (code, shards(out)) == (-signal.SIGKILL, expected)
        assert len(list(out.glob(".*.tmp"))) == 1
    assert run(config, out)[0] == 0
    assert content(out) == uninterrupted


def test_interrupt_exits_130_and_resumes(
    config: Path, tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    code, _, error = run(config, out, signal="5:SIGINT")  # a shard takes two, for its family
    assert (code, error) == (130, "interrupted: finished work is kept; the same command resumes")
    kept = shards(out)
    assert kept == 2
    code, text, _ = run(config, out, "--json")
    assert json.loads(text)["points_computed"] == 8 * (SHARDS - kept)
    assert content(out) == uninterrupted


def test_two_launchers_on_one_folder(
    config: Path, tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    first = start(config, out, trial_s=0.15)
    wait_for_shards(first, out, 1)
    code, _, error = run(config, out)
    assert code == 2 and error.startswith("error: out: ") and "no other process" in error
    assert first.poll() is None
    assert finish(first)[0] == 0
    assert content(out) == uninterrupted


def test_a_full_disk_is_one_line(
    config: Path, tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    out = tmp_path / "store"
    code, _, error = run(config, out, largest_b=8000)
    assert code == 2 and error.startswith("error: out: ") and "File too large" in error
    assert sorted(content(out)) == [".lock", "specification.json"]
    assert run(config, out)[0] == 0
    assert content(out) == uninterrupted


REAL = """
samples = 400
shard_rows = 8
[simulation]
duration_s = 1.0
arch = "cpu"
"""
REAL_SHARDS = 50


def start_real(tmp_path: Path, name: str, workers: int) -> subprocess.Popen[str]:
    """The command with the real simulator, which other processes have too."""
    config = tmp_path / "real.toml"
    config.write_text(REAL)
    options = ["--config", config, "--out", tmp_path / name, "--workers", workers]
    return subprocess.Popen(
        [sys.executable, str(ROOT / "tools" / "precompute.py"), *map(str, options)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Processes that a process has spawned."""
    tasks = Path(f"/proc/{process.pid}/task")
    pids = [pid for file in tasks.glob("*/children") for pid in file.read_text().split()]
    return [int(pid) for pid in pids if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def wait_until_gone(pids: list[int]) -> None:
    deadline = time.monotonic() + WAIT_S
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(scope="module")
def real_store(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("real")
    code, _, error = finish(start_real(folder, "store", workers=1))
    assert code == 0, error
    return content(folder / "store")


def end_by_killing_a_worker(process: subprocess.Popen[str]) -> tuple[int, str]:
    os.kill(workers_of(process)[0], signal.SIGKILL)
    code, _, error = finish(process)
    return code, error


def end_by_interrupt(process: subprocess.Popen[str]) -> tuple[int, str]:
    process.send_signal(signal.SIGINT)
    code, _, error = finish(process)
    return code, error


def end_by_killing_it(process: subprocess.Popen[str]) -> tuple[int, str]:
    process.kill()
    return process.wait(), ""


ENDS = (
    (end_by_killing_a_worker, 2, "error: workers: 'one was killed' cannot be used; allowed: "),
    (end_by_interrupt, 130, "interrupted: finished work is kept; the same command resumes"),
    (end_by_killing_it, -signal.SIGKILL, ""),
)


@pytest.mark.campaign
def test_several_processes_ended_in_the_middle_again_and_again_resume_bit_equal(
    tmp_path: Path, real_store: dict[str, bytes]
) -> None:
    for end, code, line in ENDS:
        kept = shards(tmp_path / "store") if (tmp_path / "store").is_dir() else 0
        process = start_real(tmp_path, "store", workers=2)
        wait_for_shards(process, tmp_path / "store", kept + 3)
        workers = workers_of(process)
        assert len(workers) == 2
        ended, error = end(process)
        assert ended == code and error.startswith(line)
        assert kept + 3 <= shards(tmp_path / "store") < REAL_SHARDS
        wait_until_gone(workers)
    code, _, error = finish(start_real(tmp_path, "store", workers=2))
    assert code == 0, error
    assert content(tmp_path / "store") == real_store


BRED = """
samples = 64
shard_rows = 32
seed = 7
[families.up]
settings = 2
terrain = {kind = "ramp"}
[repertoire]
evaluations = 800
settings = 2
candidates = 10
"""
RENAMES_OF_THE_GRID = 3  # the specification and two shards


@pytest.mark.campaign
def test_a_killed_search_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    pytest.importorskip("ribs")
    config = tmp_path / "store.toml"
    config.write_text(BRED)
    code, text, _ = run(config, tmp_path / "whole", "--json")
    walks = json.loads(text)["walks_searched"]
    assert code == 0 and len(open_store(tmp_path / "whole", verify=True)) == 74
    last = RENAMES_OF_THE_GRID + 3
    killed, *_ = run(config, tmp_path / "killed", "--json", death=last)
    assert killed == -signal.SIGKILL
    assert len(list((tmp_path / "killed").glob("search-up-*.parquet"))) == 2
    code, text, _ = run(config, tmp_path / "killed", "--json")
    assert code == 0 and 0 < json.loads(text)["walks_searched"] < walks
    assert content(tmp_path / "killed") == content(tmp_path / "whole")

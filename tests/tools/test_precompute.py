"""The command: in this process, and in a process that is interrupted for real."""

import json
from pathlib import Path

import pytest

from storage import open_store
from tests.cases import ASSETS
from tests.storage.fake import content
from tests.tools.conftest import Command
from tests.tools.running import INTERRUPTED, finish, start

pytestmark = pytest.mark.slow

CONFIG = (ASSETS / "interrupted-store.toml").read_text()
SHARDS = 12


def run(command, *more, **accidents):
    """The command in a process of its own; the accidents are those of fake_command.py."""
    return finish(start(*command.words(), *more, **accidents))


def shards(out):
    return len(list(out.glob("part-*.parquet")))


@pytest.fixture
def command(simulator, tool, tmp_path):
    config = tmp_path / "store.toml"
    config.write_text(CONFIG)
    return Command(tool, tmp_path, "precompute", workers=1, config=config)


@pytest.fixture
def uninterrupted(command):
    assert command.run(out=command.folder / "whole") == 0
    return content(command.folder / "whole")


def test_json_is_one_object(command):
    summary = command.json(samples=20)
    assert (summary["points"], summary["points_computed"], summary["shards"]) == (
        20,
        20,
        3,
    )
    assert summary["path"] == str(command.out)
    assert summary["walkers_per_s"] > 0
    ends = open_store(command.out, verify=True).numpy(["end_reason"])["end_reason"]
    assert summary["alive_at_horizon"] == (ends == "completed").sum()
    assert summary["alive_fraction"] == summary["alive_at_horizon"] / 20
    command.refuses("samples: 96 cannot be used; allowed: 20, as ")
    assert command.tool.json(*command.words(), "--fresh")["points_computed"] == 96
    again = command.json()
    assert (again["points_computed"], again["walkers_per_s"]) == (0, 0.0)


def test_text_says_what_was_done_where(command, monkeypatch):
    robust = "[robust]\nsettings = 2\nbody.disturbance = 0.1\n"
    (command.folder / "store.toml").write_text(CONFIG + robust)
    monkeypatch.chdir(command.folder)
    assert command.run(out="") == 0
    assert "96 in 12 shards (96 computed now)" in command.tool.out
    assert "points in its worlds" in command.tool.out and "runs/s" in command.tool.out
    # named after the configuration
    assert str(Path("out", "store")) in command.tool.out
    assert "run/s" in command.tool.err and "96/96" in command.tool.err
    assert (command.folder / "out" / "store" / "manifest.json").is_file()


def test_a_forecast_is_said_where_worlds_tell_of_walkers(command):
    found = command.tool.json(*command.words(), "--forecast")["forecast"]
    assert found.startswith("Of 2 robots like your worlds ")
    (command.folder / "store.toml").write_text(CONFIG.partition("families")[0])
    message = "forecast: 'walker' cannot be used; allowed: a store of the walker with"
    command.tool.refuses(message, *command.words(), "--forecast")


def test_interrupt_exits_130_and_resumes(command, uninterrupted):
    done = run(command, signal="5:SIGINT")  # a shard takes two, for its family
    assert (done.code, done.last) == (130, INTERRUPTED) and shards(command.out) == 2
    assert json.loads(run(command, "--json").out)["points_computed"] == 8 * (SHARDS - 2)
    assert content(command.out) == uninterrupted

"""The command with candidates beyond the grid, killed for real in the middle of the search."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from storage import open_store

pytest.importorskip("ribs")
pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).parents[2]
CONFIG = """
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


def run(config: Path, out: Path, **accidents: int) -> tuple[int, str]:
    launcher = [sys.executable, "-m", "tests.tools.launch_precompute", json.dumps(accidents)]
    done = subprocess.run(
        [*launcher, "--config", config, "--out", out, "--workers", "1", "--json"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout


def content(out: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in out.iterdir()}


@pytest.mark.campaign
def test_a_killed_search_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    config = tmp_path / "store.toml"
    config.write_text(CONFIG)
    code, text = run(config, tmp_path / "whole")
    walks = json.loads(text)["walks_searched"]
    assert code == 0 and len(open_store(tmp_path / "whole", verify=True)) == 74
    killed, _ = run(config, tmp_path / "killed", kill_at_rename=RENAMES_OF_THE_GRID + 3)
    assert killed == -signal.SIGKILL
    assert len(list((tmp_path / "killed").glob("search-up-*.parquet"))) == 2
    code, text = run(config, tmp_path / "killed")
    assert code == 0 and 0 < json.loads(text)["walks_searched"] < walks
    assert content(tmp_path / "killed") == content(tmp_path / "whole")

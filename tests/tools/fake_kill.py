"""tools/kill_commands.py with the simulator replaced, and nothing drawn of walks."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.cli import run_command
from tests.study import fake_walker
from tools import kill_commands

if __name__ == "__main__":
    vars(taichi_nmm)["simulate"] = fake_walker.simulate
    run_command(lambda: kill_commands.main(pictures=False))

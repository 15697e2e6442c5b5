"""tools/compare.py with the simulator replaced, and a checkpoint a round: for processes to kill."""

import os
import runpy
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.comparison import command, lockstep
from tests.study.comparison import fake

if __name__ == "__main__":
    vars(taichi_nmm)["simulate"] = fake.simulate
    lockstep.CHECKPOINT_S = 0.0
    command.EXPORT_S = 1e9
    if os.environ.get("FAKE_POOL"):
        vars(lockstep)["Pool"] = fake.LocalPool
    root = Path(__file__).resolve().parents[2]
    runpy.run_path(str(root / "tools" / "compare.py"), run_name="__main__")

"""tools/study.py with the simulator replaced: for tests that need a process of their own."""

import runpy
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from tests.study import fake_walker

if __name__ == "__main__":
    vars(taichi_nmm)["simulate"] = fake_walker.simulate
    root = Path(__file__).resolve().parents[2]
    runpy.run_path(str(root / "tools" / "study.py"), run_name="__main__")

"""tools/compare.py with the simulator replaced, and a checkpoint a stretch: for processes to kill.

Spawned processes import this file, which stays the main module, and have the same simulator.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.cli import main
from study.comparison import compare
from tests.study import fake_walker

vars(taichi_nmm)["simulate"] = fake_walker.simulate
compare.CHECKPOINT_S = 0.0
compare.EXPORT_S = 1e9
compare.STRETCH_TRIALS = 2

if __name__ == "__main__":
    main(["compare", *sys.argv[1:]])

"""`taichi-nmm` with the simulator replaced: for tests that need a process of their own."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.cli import main
from tests.study import fake_walker

if __name__ == "__main__":
    vars(taichi_nmm)["simulate"] = fake_walker.simulate
    main()

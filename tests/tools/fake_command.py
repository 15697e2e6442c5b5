"""`taichi-nmm` with the simulator replaced, and with accidents: for tests that need a process.

    FAKE_SIGNAL=5:SIGINT python tests/tools/fake_command.py precompute --config FILE --out DIR

The environment asks for accidents. FAKE_TRIAL_S: seconds that a simulation takes.
FAKE_SIGNAL: a signal in the n-th simulation. FAKE_STRETCH: trials between two
checkpoints of a comparison. Spawned processes import this file, which stays the main
module, and so have the same simulator.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.cli import main
from study.experiment import compare
from tests.study import fake_walker

vars(taichi_nmm)["simulate"] = fake_walker.simulate

if stretch := os.environ.get("FAKE_STRETCH"):
    compare.CHECKPOINT_S = 0.0
    compare.EXPORT_S = 1e9
    compare.STRETCH_TRIALS = int(stretch)

if __name__ == "__main__":
    main()

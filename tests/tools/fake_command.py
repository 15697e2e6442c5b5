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
from types import ModuleType
from unittest.mock import Mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import taichi_nmm
from study.cli import main
from study.experiment import compare
from tests.study import fake_walker

vars(taichi_nmm)["simulate"] = fake_walker.simulate

# Pictures and notes have tests of their own. What they need takes longer to load than
# all else in a command.
for name, functions in {
    "study.experiment.artifacts": ("draw_best",),
    "optuna_dashboard": ("get_note", "save_note"),
}.items():
    sys.modules[name] = ModuleType(name)
    vars(sys.modules[name]).update(dict.fromkeys(functions, Mock(return_value="")))

if stretch := os.environ.get("FAKE_STRETCH"):
    compare.CHECKPOINT_S = 0.0
    compare.EXPORT_S = 1e9
    compare.STRETCH_TRIALS = int(stretch)

if __name__ == "__main__":
    main()

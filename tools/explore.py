"""The command `taichi-nmm explore` from a checkout, where nothing has to be installed."""

import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.guard import run

if __name__ == "__main__":
    run("explore")

"""The commands: `taichi-nmm`, or `python -m taichi_nmm`.

The only module of this package that imports `study`.
"""

import gc
import runpy
import sys
from pathlib import Path

# By its path: the name `study` may be a user's.
NEIGHBOURS = Path(__file__).resolve().parents[1] / "study" / "neighbours.py"


def main() -> None:
    """Run the command that the process was called with, and leave with its exit code."""
    gc.disable()  # until all is imported, which stays
    try:
        runpy.run_path(str(NEIGHBOURS))["require_neighbours"]("study", "storage")
    except ImportError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    from study.cli import main as run  # after the check that it is ours

    run()


if __name__ == "__main__":
    main()

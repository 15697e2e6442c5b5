"""The commands: `taichi-nmm`, or `python -m taichi_nmm`.

The only module of this package that imports `study`.
"""

import sys

from taichi_nmm.neighbours import require_neighbours


def main() -> None:
    """Run the command that the process was called with, and leave with its exit code."""
    try:
        require_neighbours("study", "storage")
    except ImportError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    from study.cli import main as run  # after the check that it is ours

    run()


if __name__ == "__main__":
    main()

"""The commands, a file each: what `taichi-nmm NAME` and the thin files in tools/ run."""

import sys
from collections.abc import Sequence
from pathlib import Path

from study.guard import EXIT_BAD_INPUT, guarded_imports, run
from taichi_nmm.errors import InputError

PROGRAM = "taichi-nmm"


def run_named(words: Sequence[str]) -> None:
    """Run the command that the first word names on the others; leave with its exit code."""
    with guarded_imports():
        from study.command_options import summary
    files = {
        path.stem.replace("_", "-"): path for path in sorted(Path(__file__).parent.glob("[!_]*.py"))
    }
    if not words or words[0] in ("-h", "--help"):
        width = max(map(len, files))
        print(f"usage: {PROGRAM} COMMAND [OPTION ...]   ({PROGRAM} COMMAND --help)\n")
        print(*(f"  {name:<{width}}  {summary(file)}" for name, file in files.items()), sep="\n")
        return
    if words[0] not in files:
        print(f"error: {InputError('command', words[0], ', '.join(files))}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    sys.argv = [f"{PROGRAM} {words[0]}", *words[1:]]
    run(files[words[0]].stem)

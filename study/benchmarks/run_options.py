"""The options that commands have in common which compare samplers on problems."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from study.benchmarks.run_cache import ROOT, chosen
from taichi_nmm.errors import InputError

LEAST = {"seeds": 1, "trials": 2, "processes": 1}


def run_parser(
    doc: str | None, arms: Sequence[str], trials: int, cache: str
) -> argparse.ArgumentParser:
    """A parser of the common options, to which a command adds its own.

    Args:
        doc: of the command, whose first line tells what it does.
        arms: that it knows, all of them by default.
        trials: of a run, by default.
        cache: folder of finished runs within `out`.
    """
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30, help="of each arm; %(default)s")
    parser.add_argument("--trials", type=int, default=trials, help="of a run; %(default)s")
    parser.add_argument("--arms", default=",".join(arms), help="%(default)s")
    parser.add_argument("--processes", type=int, default=2, help="runs at a time; %(default)s")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / cache, help="of the runs")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    return parser


def parsed(parser: argparse.ArgumentParser, arms: Sequence[str]) -> argparse.Namespace:
    """The options of this process, the arms as a list in the order of `arms`.

    Raises:
        InputError: an arm that is not known, or too few seeds, trials or processes.
    """
    options = parser.parse_args()
    options.arms = chosen("arms", options.arms, arms)
    for name, least in LEAST.items():
        if getattr(options, name) < least:
            raise InputError(name, getattr(options, name), f"{least} or more")
    return options


def command() -> str:
    """What this process was called as, for the documents that it writes."""
    return " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])

"""The options that commands have in common which compare samplers on problems."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from storage.commit import require_folder
from study.benchmarks.run_cache import ROOT, chosen
from study.options import MOST_WORKERS, Options

MOST_SEEDS, MOST_TRIALS = 10_000, 100_000


def run_parser(file: str, arms: Sequence[str], trials: int, cache: str) -> Options:
    """A parser of the common options, to which a command adds its own.

    Args:
        file: of the command.
        arms: that it knows, all of them by default.
        trials: of a run, by default.
        cache: folder of finished runs within `out`.
    """
    parser = Options(file)
    parser.whole("--seeds", 1, MOST_SEEDS, default=30, help="of each arm; %(default)s")
    parser.whole("--trials", 2, MOST_TRIALS, default=trials, help="of a run; %(default)s")
    parser.add_argument("--arms", default=",".join(arms), help="%(default)s")
    parser.whole("--processes", 1, MOST_WORKERS, default=2, help="runs at a time; %(default)s")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / cache, help="of the runs")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    return parser


def parsed(parser: Options, arms: Sequence[str]) -> Namespace:
    """The options of this process, the arms as a list in the order of `arms`.

    Raises:
        InputError: an arm that is not known, a number out of range, or no place to write.
    """
    options = parser.parse_args()
    require_folder(options.out)
    require_folder(options.cache, "cache")
    options.arms = chosen("arms", options.arms, arms)
    return options


def command() -> str:
    """What this process was called as, for the documents that it writes."""
    return " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])

"""Figures and tables of one or several comparisons.

    python tools/report.py out/compare/rough8-smooth
    python tools/report.py out/compare/* --out out/overview --optimum out/optimum/optimum.json

Each folder gets a folder `report`; of several, the overview goes to --out. An unfinished comparison
is reported as far as it is, and says so. Two walks are simulated again to be drawn, where the
experiment's configuration is found (--configs). Exit codes: 0, 2 bad input, 130 interrupted.
"""

import argparse
import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.command import run_command
from study.comparison.experiment import Experiment
from study.report.before_after import before_and_after, find_experiment, known_stores
from study.report.optimum import find_optimum
from study.report.results import Results, read_results
from study.report.writing import REPORT_NAME, write_overview, write_report
from taichi_nmm.errors import InputError

CONFIGS = Path("configs")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="of tools/compare.py")
    parser.add_argument("--out", type=Path, help="for the overview of several folders")
    parser.add_argument(
        "--optimum", type=Path, action="append", default=[],
        help="optimum.json of tools/optimum.py, drawn as a line; may be repeated, a cost each",
    )  # fmt: skip
    parser.add_argument(
        "--configs", type=Path, metavar="FOLDER",
        help="with the experiments' configurations, NAME.toml (configs)",
    )  # fmt: skip
    parser.add_argument("--no-strips", action="store_true", help="simulate and draw no walks")
    return parser.parse_args()


def experiment_of(results: Results, configs: Path | None, strips: bool) -> Experiment | None:
    """Its configuration; where nobody said which, one that is another's only costs the strips."""
    try:
        return find_experiment(results, configs or CONFIGS)
    except InputError as error:
        if configs is not None:
            raise
        if strips:
            print(f"{results.name}: no strips ({error})", file=sys.stderr)
        return None


def main() -> None:
    args = parse()
    if args.out is not None and len(args.folders) == 1:
        raise InputError(
            "out", str(args.out), f"two folders or more; of one, it is DIR/{REPORT_NAME}"
        )
    everything = [read_results(folder) for folder in args.folders]
    optima = [find_optimum(results, args.optimum) for results in everything]
    strips = not args.no_strips
    experiments = [experiment_of(results, args.configs, strips) for results in everything]
    found = []
    for results, optimum, experiment in zip(everything, optima, experiments, strict=True):
        pair = before_and_after(results, experiment) if experiment and strips else None
        stores = known_stores(results, experiment) if experiment else {}
        found.append(write_report(results, optimum, pair, stores=stores))
        state = "" if results.complete else f" ({results.found:,} of {results.planned:,} trials)"
        print(f"{results.folder / REPORT_NAME}: {results.name}{state}", flush=True)
    if args.out is not None:
        write_overview(args.out, found)
        print(f"{args.out}: overview of {len(found)} experiments")


if __name__ == "__main__":
    run_command(main)

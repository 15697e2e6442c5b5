"""Compute the file of a problem from outside: features and cost of every candidate of its pool.

    python tools/make_outside.py --problem digits-network   # minutes on one core

The files are in the repository, so nobody has to. A file made again has the same numbers on the
same machine and versions; elsewhere they agree to rounding, which iterations may enlarge.
"""

import argparse
import os
import sys
from collections.abc import Iterable
from pathlib import Path

# Before NumPy is imported: one thread adds in one order.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from tqdm import tqdm

    from study.benchmarks.outside import catalogue
    from study.benchmarks.outside.candidate_pool import POOL_BITS
    from study.benchmarks.outside.definition import Settings
    from study.benchmarks.outside.making import make
    from study.benchmarks.outside.outside_problem import file_of
    from study.options import Options
    from taichi_nmm.errors import InputError


def main() -> None:
    options = parse()
    definition = catalogue.definition(options.problem)
    path = options.out or file_of(options.problem)
    make(definition, path, bar, options.rows)
    print(path)


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.add_argument("--problem", required=True, help=f"one of {', '.join(catalogue.PROBLEMS)}")
    parser.whole("--rows", 1, 2**POOL_BITS, help="the first so many candidates only, with --out")
    parser.add_argument("--out", type=Path, help="file; by default the one in the repository")
    options = parser.parse_args()
    if options.rows is not None and options.out is None:
        raise InputError("rows", options.rows, "--out as well: the repository has whole files")
    return options


def bar(rows: Iterable[Settings]) -> Iterable[Settings]:
    return tqdm(list(rows), unit="row")


if __name__ == "__main__":
    run_command(main)

"""Give damaged input to every command, of every format, and see that it ends in one line.

    python tools/fuzz.py --cases 50000 --seed 1
    python tools/fuzz.py --every-option

Case n of a seed is the same everywhere; or every option of every command gets every hostile word.
What failed lies below --out, with the words that repeat it. The simulator is replaced: whoever gets
there has passed the checks, and counts as accepted.
Exit codes: 0, 1 something failed, 2 bad input, 130 interrupted.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from tqdm import tqdm

    from storage.commit import require_folder
    from storage.pool import cores
    from study.options import LARGEST_SEED, Options
    from taichi_nmm.errors import InputError
    from taichi_nmm.reading import is_folder
    from tests.fuzz.campaign import Plan, keep, run_cases, table
    from tests.fuzz.cases import every_option
    from tests.fuzz.world import make_world

MOST_CASES = 10_000_000


def main() -> None:
    options = parse()
    require_folder(options.out)
    if is_folder(options.out) and any(options.out.iterdir()):
        raise InputError("out", str(options.out), "a new folder, or an empty one")
    count = len(every_option()) if options.every_option else options.cases
    began_s, outcomes, failed = time.monotonic(), [], 0
    with tempfile.TemporaryDirectory() as scratch, tqdm(total=count, unit="case") as bar:
        seed = None if options.every_option else options.seed
        plan = Plan(seed, Path(scratch) / "world", Path(scratch))
        make_world(plan.world)
        for outcome in run_cases(plan, range(count), options.workers or cores()):
            outcomes.append(outcome)
            bar.update()
            if outcome.verdict.wrong:
                failed += 1
                bar.set_postfix_str(f"{failed} failed")
                keep(plan, outcome, options.out / f"{seed}-{outcome.number}")
    print(table(outcomes))
    print(f"\n{time.monotonic() - began_s:.0f} s")
    if failed:
        sys.exit(f"{failed} failed: {options.out}")


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--cases", 1, MOST_CASES, default=2000, help="(%(default)s)")
    parser.whole("--seed", 0, LARGEST_SEED, default=1, help="of the cases (%(default)s)")
    parser.add_argument("--every-option", action="store_true", help="in place of cases of a seed")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="(%(default)s)")
    parser.workers()
    return parser.parse_args()


if __name__ == "__main__":
    run_command(main)

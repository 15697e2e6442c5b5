"""Compare our samplers with Optuna's on tuning problems from outside, and write a table and a plot.

    python tools/compare_outside.py                    # the problems for tuning
    python tools/compare_outside.py --problems all     # those that are only reported as well
    python tools/compare_outside.py --seeds 3 --arms ours,tpe --problems transport-solver

Finished runs are kept in the cache's folder: the same command goes on where it was stopped, and a
run is repeated only where the code or the numbers that made it have changed. GPSampler needs
PyTorch, which this project does not install: without it that arm is left out.
"""

import argparse
import json
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    import numpy as np

    from study.benchmarks.outside import catalogue, outside_arms, outside_document
    from study.benchmarks.outside.outside_problem import digest, outside_problem
    from study.benchmarks.outside.outside_report import OutsideReport
    from study.benchmarks.run_cache import (
        ONE_THREAD,
        OUR_PACKAGES,
        OUR_SOURCES,
        PEER_PACKAGES,
        ROOT,
        chosen,
        collect,
        execute,
        fingerprint,
        runnable,
    )
    from study.benchmarks.run_options import command, parsed, run_parser

DEFAULT_ARMS = tuple(outside_arms.ARMS)
GROUPS = {
    "tuning": catalogue.TUNING,
    "reported": catalogue.REPORTED,
    "all": catalogue.PROBLEMS,
}
# What decides a run beside the problem's numbers and the sampler.
SOURCES = ("definition", "nearest", "outside_problem", "outside_arms")


@dataclass(frozen=True)
class Run:
    """One study: a problem, an arm, the sampler's seed and a number of trials."""

    problem: str
    arm: str
    seed: int
    trials: int

    def file(self, cache: Path) -> Path:
        """Where its result is kept."""
        name = f"{self.trials}-trials-seed-{self.seed:03d}.json"
        return cache / self.problem / self.arm / name

    def code(self) -> str:
        """Fingerprint of what decides it: numbers, reader and sampler."""
        return code_of(self.arm, self.problem)

    def costs(self) -> np.ndarray:
        """Costs of its trials, [trials]."""
        problem = outside_problem(self.problem).drawn(self.seed)
        return outside_arms.run(self.arm, problem, self.seed, self.trials)


def main() -> None:
    options = parse()
    os.environ.update(ONE_THREAD)
    arms = runnable(options.arms)
    runs = [
        Run(problem, arm, seed, options.trials)
        for problem in options.problems
        for arm in arms
        for seed in range(options.seeds)
    ]
    execute(runs, options.cache, options.processes)
    report = OutsideReport.of(collect(runs, options.cache))
    if options.json:
        print(json.dumps(report.as_dict()))
        return
    text = outside_document.markdown(report, command())
    outside_document.write(options.out, report, text)
    print(text)


def parse() -> argparse.Namespace:
    parser = run_parser(__file__, DEFAULT_ARMS, trials=40, cache="outside")
    names = ",".join(catalogue.PROBLEMS)
    parser.add_argument(
        "--problems", default="tuning", help=f"{', '.join(GROUPS)}, or some of {names}; %(default)s"
    )
    options = parsed(parser, DEFAULT_ARMS)
    group = GROUPS.get(options.problems)
    options.problems = group or chosen("problems", options.problems, catalogue.PROBLEMS)
    return options


@cache
def code_of(arm: str, problem: str) -> str:
    sources = [ROOT / "study" / "benchmarks" / "outside" / f"{name}.py" for name in SOURCES]
    if outside_arms.ARMS[arm].kind == "ours":
        ours = [*sources, ROOT / "study" / "features" / "feature_table.py", *OUR_SOURCES]
        return fingerprint(ours, OUR_PACKAGES, digest(problem))
    return fingerprint(sources, PEER_PACKAGES, digest(problem))


if __name__ == "__main__":
    run_command(main)

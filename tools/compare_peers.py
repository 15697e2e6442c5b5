"""Compare our samplers with Optuna's on synthetic problems, and write a table and a plot.

    python tools/compare_peers.py                  # everything; a quarter of an hour or more
    python tools/compare_peers.py --seeds 3 --arms random,tpe,ours

Finished runs are kept in the cache's folder: the same command goes on where it was stopped, and a
run is repeated only where the code that made it has changed. GPSampler needs PyTorch, which this
project does not install: without it that arm is left out.
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

    from study.benchmarks import comparison_report, peers, synthetic
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

DEFAULT_ARMS = tuple(peers.PEERS)


@dataclass(frozen=True)
class Run:
    """One study: a problem, an arm, a seed and a number of trials."""

    problem: str
    arm: str
    seed: int
    trials: int

    def file(self, cache: Path) -> Path:
        """Where its result is kept; problems of one cost share the runs that see no feature."""
        landscape = synthetic.problem(self.problem, self.seed).landscape
        folder = self.problem if peers.PEERS[self.arm].uses_feature else landscape
        return cache / folder / self.arm / f"{self.trials}-trials-seed-{self.seed:03d}.json"

    def code(self) -> str:
        """Fingerprint of what decides it: the problems, and the sampler."""
        return code_of(self.arm)

    def costs(self) -> np.ndarray:
        """Costs of its trials, [trials]."""
        return peers.run(self.arm, synthetic.problem(self.problem, self.seed), self.trials)


def main() -> None:
    options = parse()
    os.environ.update(ONE_THREAD)
    arms = runnable(options.arms)
    runs = [
        Run(problem, arm, seed, options.trials)
        for seed in range(options.seeds)
        for problem in options.problems
        for arm in arms
    ]
    execute(runs, options.cache, options.processes)
    report = comparison_report.Report.of(collect(runs, options.cache))
    if options.json:
        print(json.dumps(report.as_dict()))
        return
    text = report.markdown(command())
    comparison_report.write(options.out, report, text)
    print(text)


def parse() -> argparse.Namespace:
    parser = run_parser(__file__, DEFAULT_ARMS, trials=60, cache="peers")
    parser.add_argument("--problems", default=",".join(synthetic.PROBLEMS), help="%(default)s")
    options = parsed(parser, DEFAULT_ARMS)
    options.problems = chosen("problems", options.problems, synthetic.PROBLEMS)
    return options


@cache
def code_of(arm: str) -> str:
    sources = [ROOT / "study" / "benchmarks" / "synthetic.py"]
    if peers.PEERS[arm].kind == "ours":
        return fingerprint([*sources, *OUR_SOURCES], OUR_PACKAGES)
    return fingerprint(sources, PEER_PACKAGES)


if __name__ == "__main__":
    run_command(main)

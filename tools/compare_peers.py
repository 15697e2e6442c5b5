"""Compare our samplers with Optuna's on synthetic problems, and write a table and a plot.

    python tools/compare_peers.py                  # everything; a quarter of an hour or more
    python tools/compare_peers.py --seeds 3 --arms random,tpe,feature

Finished runs are kept in the cache's folder: the same command goes on where it was stopped, and a
run is repeated only where the code that made it has changed. GPSampler needs PyTorch, which this
project does not install: without it that arm is left out.
"""

import argparse
import ast
import hashlib
import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import optuna
from tqdm import tqdm

from storage.commit import commit_json
from study.benchmarks import comparison_report, peers, synthetic
from study.command import run_command
from taichi_nmm.errors import InputError

ROOT = Path(__file__).resolve().parents[1]

# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
DEFAULT_ARMS = tuple(peers.PEERS)
Costs = dict[tuple[str, str], np.ndarray]  # of a problem and an arm, [seeds, trials]


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
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30, help="instances, each with its own seed")
    parser.add_argument("--trials", type=int, default=60, help="of a run; %(default)s")
    parser.add_argument("--arms", default=",".join(DEFAULT_ARMS), help="%(default)s")
    parser.add_argument("--problems", default=",".join(synthetic.PROBLEMS), help="%(default)s")
    parser.add_argument("--processes", type=int, default=2, help="runs at a time; %(default)s")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "peers", help="of the runs")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    options = parser.parse_args()
    options.arms = chosen("arms", options.arms, DEFAULT_ARMS)
    options.problems = chosen("problems", options.problems, synthetic.PROBLEMS)
    for name, least in (("seeds", 1), ("trials", 2), ("processes", 1)):
        if getattr(options, name) < least:
            raise InputError(name, getattr(options, name), f"{least} or more")
    return options


def chosen(field: str, listed: str, known: tuple[str, ...]) -> list[str]:
    """The comma-separated names, each once, in the order of `known`."""
    names = set(listed.split(","))
    for name in sorted(names - set(known)):
        raise InputError(field, name, f"some of {','.join(known)}")
    return [name for name in known if name in names]


def runnable(arms: list[str]) -> list[str]:
    """The arms without GPSampler where there is no PyTorch."""
    if "gp" not in arms or peers.torch_is_installed():
        return arms
    print("GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr)
    if arms == ["gp"]:
        raise InputError("arms", "gp", "PyTorch installed, or another arm")
    return [arm for arm in arms if arm != "gp"]


def execute(runs: list[Run], cache: Path, processes: int) -> None:
    """Run what the cache has not got, each study in one process."""
    missing = {run.file(cache): run for run in runs if not is_current(run, cache)}
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(processes, mp_context=context) as pool,
        tqdm(total=len(missing), unit="run", disable=not missing) as bar,
    ):
        futures = [pool.submit(execute_one, run, file) for file, run in missing.items()]
        try:
            for future in as_completed(futures):
                future.result()
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def execute_one(run: Run, file: Path) -> None:
    """Run one study and keep its costs."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    began = time.perf_counter()
    costs = peers.run(run.arm, synthetic.problem(run.problem, run.seed), run.trials)
    result = {
        "code": code_of(run.arm),
        "run": asdict(run),
        "seconds": time.perf_counter() - began,
        "costs": costs.tolist(),
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    commit_json(file, result)


def is_current(run: Run, cache: Path) -> bool:
    """Whether the cache has this run, made by the present code."""
    file = run.file(cache)
    try:
        return bool(read(file)["code"] == code_of(run.arm))
    except (OSError, ValueError, KeyError):
        return False


def read(file: Path) -> dict[str, Any]:
    parsed: dict[str, Any] = json.loads(file.read_text())
    return parsed


@cache
def code_of(arm: str) -> str:
    """Fingerprint of what decides an arm's runs: the problems, and the sampler."""
    sources = [ROOT / "study" / "benchmarks" / "synthetic.py"]
    if peers.PEERS[arm].kind == "ours":
        sources += [ROOT / "study" / "draws.py", *sorted((ROOT / "study" / "sampler").glob("*.py"))]
        packages = ["numpy", "scipy", "optuna", "scikit-learn"]
    else:
        packages = ["numpy", "scipy", "optuna", "cmaes", "torch"]
    digest = hashlib.sha256()
    for file in sources:
        # Not the text: neither layout nor comments decide a run.
        digest.update(ast.dump(ast.parse(file.read_text(encoding="utf-8"))).encode())
    for package in packages:
        digest.update(f"{package} {installed(package)}\n".encode())
    return digest.hexdigest()[:16]


def installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def collect(runs: list[Run], cache: Path) -> Costs:
    """Costs of every problem and arm, the seeds in their order."""
    found: dict[tuple[str, str], list[list[float]]] = {}
    for run in runs:
        found.setdefault((run.problem, run.arm), []).append(read(run.file(cache))["costs"])
    return {key: np.array(costs) for key, costs in found.items()}


def command() -> str:
    return " ".join(["python", "tools/compare_peers.py", *sys.argv[1:]])


if __name__ == "__main__":
    run_command(main)

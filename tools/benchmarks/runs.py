"""Runs of a benchmark's arms on its problems: the options of a comparison, and a cache of results.

A run is one arm on one problem with one seed. The cache keeps a file of each finished run; a run
that is missing there, or was made by other code, is run again.

A benchmark is a module of this package with `PROBLEMS`, `ARMS`, and three functions:
`problem(name, seed)`; `shared(name)`, the folder of runs without features; and `digest(name)`, a
fingerprint of a problem's numbers.
"""

import ast
import hashlib
import importlib.util
import json
import multiprocessing
import os
import sys
import time
import warnings
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from tqdm import tqdm

from storage.commit import commit_json, require_folder
from study.options import MOST_WORKERS, Options
from taichi_nmm.errors import InputError
from tools.benchmarks import arms
from tools.benchmarks.arms import Floats
from tools.benchmarks.documents import ROOT, installed

Costs = dict[tuple[str, str], Floats]  # of a problem and an arm, [seeds, trials]

# The sources that decide our arms, beside a benchmark's own.
OUR_SOURCES = sorted((ROOT / "study" / "sampler").glob("*.py"))
OUR_PACKAGES = ("numpy", "scipy", "optuna", "scikit-learn")
PEER_PACKAGES = ("numpy", "scipy", "optuna", "cmaes", "torch")
# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MOST_SEEDS, MOST_TRIALS = 10_000, 100_000


def benchmark(name: str) -> ModuleType:
    """A module of this package by its name."""
    return import_module(f"{__package__}.{name}")


@dataclass(frozen=True)
class Run:
    """One study: a benchmark's name, a problem, an arm, a seed and a number of trials."""

    benchmark: str
    problem: str
    arm: str
    seed: int
    trials: int

    def file(self, cache: Path) -> Path:
        """The file of its result; problems of one cost share the runs of arms without features."""
        module = benchmark(self.benchmark)
        told = module.ARMS[self.arm].features
        folder = self.problem if told else module.shared(self.problem)
        return cache / folder / self.arm / f"{self.trials}-trials-seed-{self.seed:03d}.json"

    def is_current(self, cache: Path) -> bool:
        """Whether the cache has this run, made by the present code."""
        try:
            known = json.loads(self.file(cache).read_text())["code"]
        except (OSError, ValueError, KeyError):
            return False
        return bool(known == code(self.benchmark, self.problem, self.arm))

    def execute(self, cache: Path) -> None:
        """Run it, and keep its costs."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", ExperimentalWarning)
        module = benchmark(self.benchmark)
        began = time.perf_counter()
        problem = module.problem(self.problem, self.seed)
        costs = module.ARMS[self.arm].costs(problem, self.seed, self.trials)
        result = {
            "code": code(self.benchmark, self.problem, self.arm),
            "run": asdict(self),
            "seconds": time.perf_counter() - began,
            "costs": costs.tolist(),
        }
        file = self.file(cache)
        file.parent.mkdir(parents=True, exist_ok=True)
        commit_json(file, result)


@cache
def code(name: str, problem: str, arm: str) -> str:
    """Fingerprint of all that decides an arm's costs: sources, packages and the problem's data."""
    module = benchmark(name)
    ours = module.ARMS[arm].kind == "ours"
    digest = hashlib.sha256(module.digest(problem).encode())
    for file in (module.__file__, arms.__file__, *(OUR_SOURCES if ours else ())):
        # The syntax tree leaves out layout and comments, which do not decide a run.
        digest.update(ast.dump(ast.parse(Path(str(file)).read_text(encoding="utf-8"))).encode())
    for package in OUR_PACKAGES if ours else PEER_PACKAGES:
        digest.update(f"{package} {installed(package) or 'none'}\n".encode())
    return digest.hexdigest()[:16]


def execute(runs: Iterable[Run], cache: Path, processes: int) -> Costs:
    """Run the studies that the cache lacks, one a process; costs of all, seeds in order."""
    os.environ.update(ONE_THREAD)
    runs = list(runs)
    missing = {run.file(cache): run for run in runs if not run.is_current(cache)}
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(processes, mp_context=context) as pool,
        tqdm(total=len(missing), unit="run", disable=not missing) as bar,
    ):
        futures = [pool.submit(run.execute, cache) for run in missing.values()]
        try:
            for future in as_completed(futures):
                future.result()
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    found: dict[tuple[str, str], list[list[float]]] = {}
    for run in runs:
        costs = json.loads(run.file(cache).read_text())["costs"]
        found.setdefault((run.problem, run.arm), []).append(costs)
    return {key: np.array(costs) for key, costs in found.items()}


def parse(
    file: str, name: str, trials: int, cache: str, groups: Mapping[str, Sequence[str]]
) -> Namespace:
    """The options of a comparison, with lists of problems and arms.

    Args:
        file: of the command.
        name: of its benchmark.
        trials: of a run, by default.
        cache: folder of finished runs within `out`, by default.
        groups: of problems, by the names that `--problems` takes; the first is the default.

    Raises:
        InputError: an unknown problem or arm, a number out of range, or no place to write.
    """
    module = benchmark(name)
    known, problems = ",".join(module.ARMS), ",".join(module.PROBLEMS)
    parser = Options(file)
    parser.whole("--seeds", 1, MOST_SEEDS, default=30, help="of each arm; %(default)s")
    parser.whole("--trials", 2, MOST_TRIALS, default=trials, help="of a run; %(default)s")
    parser.add_argument("--arms", default=known, help="%(default)s")
    parser.whole("--processes", 1, MOST_WORKERS, default=2, help="runs at a time; %(default)s")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / cache, help="of the runs")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    parser.add_argument(
        "--problems", default=next(iter(groups)),
        help=f"{', '.join(groups)}, or some of {problems}; %(default)s",
    )  # fmt: skip
    found = parser.parse_args()
    require_folder(found.out)
    require_folder(found.cache, "cache")
    listed = groups.get(found.problems)
    found.problems = listed or chosen("problems", found.problems, module.PROBLEMS)
    found.arms = runnable(chosen("arms", found.arms, tuple(module.ARMS)))
    return found


def compared(name: str, options: Namespace) -> Costs:
    """Costs of the problems, arms and seeds of the options."""
    wanted = (
        Run(name, problem, arm, seed, options.trials)
        for seed in range(options.seeds)
        for problem in options.problems
        for arm in options.arms
    )
    return execute(wanted, options.cache, options.processes)


def chosen(field: str, listed: str, known: Sequence[str]) -> list[str]:
    """The comma-separated names, each once, in the order of `known`.

    Raises:
        InputError: a name that is not known.
    """
    names = set(listed.split(","))
    for name in sorted(names - set(known)):
        raise InputError(field, name, f"some of {','.join(known)}")
    return [name for name in known if name in names]


def torch_is_installed() -> bool:
    """Whether GPSampler can run: it needs PyTorch, which this project does not install.

    Prints a line where it cannot.
    """
    found = importlib.util.find_spec("torch") is not None
    if not found:
        print("GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr)
    return found


def runnable(names: list[str]) -> list[str]:
    """The arms, without GPSampler where there is no PyTorch.

    Raises:
        InputError: nothing is left.
    """
    if "gp" not in names or torch_is_installed():
        return names
    if names == ["gp"]:
        raise InputError("arms", "gp", "PyTorch installed, or another arm")
    return [name for name in names if name != "gp"]

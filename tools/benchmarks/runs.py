"""Runs of samplers on a benchmark's problems: the arms, a cache of finished runs, the options.

A run is a study of one arm on one problem with one seed. Finished runs are kept in a file each;
those that are missing, or were made by other code, are run again.
"""

import ast
import hashlib
import importlib.util
import json
import multiprocessing
import os
import platform
import sys
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, RandomSampler, TPESampler
from tqdm import tqdm

from storage.commit import commit_json, commit_text, require_folder, writable
from study import draws
from study.options import MOST_WORKERS, Options
from taichi_nmm.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Costs = dict[tuple[str, str], Floats]  # of a problem and an arm, [seeds, trials]

ROOT = Path(__file__).resolve().parents[2]
# The sources that decide our arms, beside a benchmark's own file.
OUR_SOURCES = (Path(draws.__file__), *sorted((ROOT / "study" / "sampler").glob("*.py")))
OUR_PACKAGES = ("numpy", "scipy", "optuna", "scikit-learn")
PEER_PACKAGES = ("numpy", "scipy", "optuna", "cmaes", "torch")
PACKAGES = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes", "torch", "greenlet")
# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MOST_SEEDS, MOST_TRIALS = 10_000, 100_000

OURS, PEER, CONTROL = "ours", "peer", "control"

# Samplers of Optuna by the name of their arm. CMA-ES draws choices at random, as always in Optuna.
PEERS: dict[str, tuple[str, Callable[[int], BaseSampler]]] = {
    "random": ("RandomSampler", lambda seed: RandomSampler(seed=seed)),
    "tpe": ("TPESampler", lambda seed: TPESampler(seed=seed)),
    "gp": ("GPSampler", lambda seed: GPSampler(seed=seed)),
    "cmaes": ("CmaEsSampler", lambda s: CmaEsSampler(seed=s, warn_independent_sampling=False)),
}


@dataclass(frozen=True)
class Arm:
    """A way of choosing trials that is compared with others.

    Attributes:
        label: for tables and plots.
        sees: the points it may choose from, or its information beside the costs.
        kind: `OURS`, `PEER` or `CONTROL`.
        sampler: for a problem and a seed; None for the controls, which need no study.
        features: whether it is told features.
        enqueued: number of rows, the best-ranked, that are tried first.
    """

    label: str
    sees: str
    kind: str
    sampler: Callable[[Any, int], BaseSampler] | None = None
    features: bool = False
    enqueued: int = 0


def peer(name: str, sees: str) -> Arm:
    """The arm of a sampler of Optuna's with its defaults."""
    label, make = PEERS[name]
    return Arm(label, sees, PEER, lambda _, seed: make(seed))


def costs_of(
    make: Callable[[], BaseSampler],
    objective: Callable[[optuna.Trial], float],
    trials: int,
    first: Iterable[Mapping[str, Any]] = (),
) -> Floats:
    """Costs of the trials of a study in their order, [trials]; settings `first` are tried first."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        study = optuna.create_study(sampler=make())
    for settings in first:
        study.enqueue_trial(dict(settings))
    study.optimize(objective, n_trials=trials)
    return np.array([trial.values[0] for trial in study.get_trials(deepcopy=False)])


@dataclass(frozen=True)
class Run:
    """One study: a module of this package, and a problem, an arm, a seed and a number of trials.

    The module has `folder(problem, arm, seed)`, `costs(problem, arm, seed, trials)`, and
    `code(problem, arm)`: a fingerprint of all that decides the costs.
    """

    benchmark: str
    problem: str
    arm: str
    seed: int
    trials: int

    @property
    def module(self) -> Any:
        """The benchmark."""
        return importlib.import_module(f"{__package__}.{self.benchmark}")

    def file(self, cache: Path) -> Path:
        """Where its result is kept."""
        folder: Path = cache / self.module.folder(self.problem, self.arm, self.seed)
        return folder / f"{self.trials}-trials-seed-{self.seed:03d}.json"

    def code(self) -> str:
        """Fingerprint of all that decides its costs."""
        return str(self.module.code(self.problem, self.arm))

    def is_current(self, cache: Path) -> bool:
        """Whether the cache has this run, made by the present code."""
        try:
            return bool(self.read(cache)["code"] == self.code())
        except (OSError, ValueError, KeyError):
            return False

    def read(self, cache: Path) -> dict[str, Any]:
        """Its result, as `execute` has kept it."""
        parsed: dict[str, Any] = json.loads(self.file(cache).read_text())
        return parsed

    def execute(self, cache: Path) -> None:
        """Run it, and keep its costs."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        began = time.perf_counter()
        costs = self.module.costs(self.problem, self.arm, self.seed, self.trials)
        result = {
            "code": self.code(),
            "run": asdict(self),
            "seconds": time.perf_counter() - began,
            "costs": costs.tolist(),
        }
        file = self.file(cache)
        file.parent.mkdir(parents=True, exist_ok=True)
        commit_json(file, result)


def execute(runs: Sequence[Run], cache: Path, processes: int) -> Costs:
    """Run the studies that the cache lacks, one a process; costs of all, seeds in order."""
    os.environ.update(ONE_THREAD)
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
        found.setdefault((run.problem, run.arm), []).append(run.read(cache)["costs"])
    return {key: np.array(costs) for key, costs in found.items()}


def fingerprint(sources: Iterable[Path], packages: Iterable[str], *others: str) -> str:
    """Of source files, versions of packages, and anything else that decides a run."""
    digest = hashlib.sha256()
    for file in sources:
        # Of the syntax tree: neither layout nor comments decide a run.
        digest.update(ast.dump(ast.parse(file.read_text(encoding="utf-8"))).encode())
    for package in packages:
        digest.update(f"{package} {_installed(package) or 'none'}\n".encode())
    for other in others:
        digest.update(f"{other}\n".encode())
    return digest.hexdigest()[:16]


def options(file: str, arms: Sequence[str], trials: int, cache: str) -> Options:
    """The parser of the options that both comparisons have.

    Args:
        file: of the command.
        arms: all of them, which are the default.
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
    found = parser.parse_args()
    require_folder(found.out)
    require_folder(found.cache, "cache")
    found.arms = chosen("arms", found.arms, arms)
    return found


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
    """Whether GPSampler can run: it needs PyTorch, which this project does not.

    Prints a line where it cannot.
    """
    found = importlib.util.find_spec("torch") is not None
    if not found:
        print("GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr)
    return found


def runnable(arms: list[str]) -> list[str]:
    """The arms, without GPSampler where there is no PyTorch.

    Raises:
        InputError: nothing is left.
    """
    if "gp" not in arms or torch_is_installed():
        return arms
    if arms == ["gp"]:
        raise InputError("arms", "gp", "PyTorch installed, or another arm")
    return [arm for arm in arms if arm != "gp"]


def made_by() -> str:
    """The line of a document: command, day, machine and versions that made it."""
    command = " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return f"Written by `{command}` on {time.strftime('%Y-%m-%d')}: {machine()}; {versions()}."


def machine() -> str:
    """The machine, in words."""
    return f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Python and the packages that decide the figures."""
    found = [
        f"{name} {_installed(name)}" if _installed(name) else f"no {name}" for name in PACKAGES
    ]
    return ", ".join([f"Python {platform.python_version()}", *found])


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


@dataclass(frozen=True)
class Bar:
    """A figure that must be reached, the measured value, and whether it is enough."""

    what: str
    measured: str
    holds: bool

    @staticmethod
    def table(bars: Sequence["Bar"], measured: str) -> list[str]:
        """A heading and the bars as rows of Markdown; nothing where there are none."""
        rows = [
            f"| {bar.what} | {bar.measured} | {'yes' if bar.holds else '**no**'} |" for bar in bars
        ]
        head = ["", "## Bars", "", f"| what | {measured} | holds |", "|---|---|---|"]
        return [*head, *rows] if rows else []


def write(folder: Path, name: str, text: str, draw: Callable[[Path], None]) -> None:
    """Write `NAME.md` and draw `NAME.png` into a folder.

    Raises:
        InputError: the folder cannot be written.
    """
    path = folder / f"{name}.md"
    with writable(path):
        folder.mkdir(parents=True, exist_ok=True)
    draw(folder / f"{name}.png")
    commit_text(path, text)


def save_panels(figure: "Figure", path: Path, legend_in: float) -> None:
    """Give a figure the legend of its first panel, at the right, and save it."""
    from study.pictures import style

    handles, labels = figure.axes[0].get_legend_handles_labels()
    right = 1.0 - legend_in / figure.get_figwidth()
    figure.legend(
        handles, labels, loc="center left", bbox_to_anchor=(right, 0.5),
        fontsize=style.SMALL_PT, frameon=False,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, right, 1))
    style.save_png(figure, path)

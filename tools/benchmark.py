"""What the tools that measure the sampler share: arms, their runs, the options, and the document.

An *arm* is a function from a problem, a seed and a number of trials to the costs of these trials. A
problem has a `space`, as Optuna has it, and `cost_at(settings)`. `study_costs` makes an arm of a
sampler of Optuna; another optimizer needs a function of its own.

A *benchmark* is a module of this folder with `PROBLEMS`, `GROUPS` of them by the names that the
option `--problems` takes, of which the first is the default, `ARMS`, and two functions:
`problem(name, seed)`, and `digest(name)`, a fingerprint of a problem's numbers.

A *run* is one arm on one problem with one seed. The cache keeps a file of each finished run; a run
that is missing there, or was made by other code, is run again.
"""

import ast
import hashlib
import importlib.util
import json
import os
import platform
import sys
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from itertools import product, repeat
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, Protocol

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, RandomSampler, TPESampler
from tqdm import tqdm

from storage.commit import commit_json, commit_text, require_folder, writable
from storage.processes import Processes
from study.options import MOST_WORKERS, Options
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Costs = dict[tuple[str, str], Floats]  # of a problem and an arm, [seeds, trials]

ROOT = Path(__file__).resolve().parents[1]
# The sources that decide our arms, beside a benchmark's own and this one.
OUR_SOURCES = sorted((ROOT / "study" / "sampler").glob("*.py"))
OUR_PACKAGES = ("numpy", "scipy", "optuna", "scikit-learn")
PEER_PACKAGES = ("numpy", "scipy", "optuna", "cmaes", "torch")
NAMED_PACKAGES = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes", "torch", "greenlet")
MOST_SEEDS, MOST_TRIALS = 10_000, 100_000

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

    Its costs are of a problem, a seed and a number of trials: in the order of trials, [trials].
    """

    label: str  # for tables and plots
    sees: str  # the points it may choose from, or its information beside the costs
    kind: Literal["ours", "peer", "control"]
    costs: Callable[[Any, int, int], Floats]
    features: bool = False  # whether it is told features


def peer(name: str, sees: str) -> Arm:
    """The arm of a sampler of Optuna with its defaults."""
    label, make = PEERS[name]
    return Arm(label, sees, "peer", lambda problem, seed, trials: study_costs(
        problem, make(seed), trials))  # fmt: skip


def ours(
    label: str, sees: str, make: Callable[[Any, int], BaseSampler], features: bool = False
) -> Arm:
    """An arm of our sampler, which `make` makes for a problem and a seed."""
    return Arm(label, sees, "ours", lambda problem, seed, trials: study_costs(
        problem, make(problem, seed), trials), features)  # fmt: skip


def study_costs(
    problem: Any, sampler: BaseSampler, trials: int, first: Iterable[Mapping[str, Any]] = ()
) -> Floats:
    """Costs of the trials of a study in their order, [trials]; settings `first` are tried first."""
    study, costs = optuna.create_study(sampler=sampler), []
    for settings in first:
        study.enqueue_trial(dict(settings))
    for _ in range(trials):
        trial = study.ask(problem.space)
        costs.append(problem.cost_at(trial.params))
        study.tell(trial, costs[-1])
    return np.array(costs)


def benchmark(name: str) -> ModuleType:
    """A module of this folder by its name."""
    return import_module(f"tools.{name}")


@dataclass(frozen=True)
class Run:
    """One study: a benchmark's name, a problem, an arm, a seed and a number of trials."""

    benchmark: str
    problem: str
    arm: str
    seed: int
    trials: int

    def file(self, cache: Path) -> Path:
        """The file of its result."""
        name = f"{self.trials}-trials-seed-{self.seed:03d}.json"
        return cache / self.problem / self.arm / name

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
    for file in (module.__file__, __file__, *(OUR_SOURCES if ours else ())):
        # The syntax tree leaves out layout and comments, which do not decide a run.
        digest.update(ast.dump(ast.parse(Path(str(file)).read_text(encoding="utf-8"))).encode())
    for package in OUR_PACKAGES if ours else PEER_PACKAGES:
        digest.update(f"{package} {installed(package) or 'none'}\n".encode())
    return digest.hexdigest()[:16]


def compared(name: str, options: Namespace) -> Costs:
    """Costs of the problems, arms and seeds of the options; runs that the cache lacks are made."""
    keys = list(product(options.problems, options.arms))
    runs = [Run(name, *key, seed, options.trials) for seed in range(options.seeds) for key in keys]
    missing = {run.file(options.cache): run for run in runs if not run.is_current(options.cache)}
    with Processes(options.processes) as pool:
        done = pool.map(Run.execute, missing.values(), repeat(options.cache))
        list(tqdm(done, total=len(missing), unit="run", disable=not missing))
    found: dict[tuple[str, str], list[list[float]]] = {key: [] for key in keys}
    for run in runs:
        costs = json.loads(run.file(options.cache).read_text())["costs"]
        found[run.problem, run.arm].append(costs)
    return {key: np.array(costs) for key, costs in found.items()}


def parse(file: str, name: str, trials: int, cache: str) -> Namespace:
    """The options of a comparison, with lists of problems and arms.

    By default a run has so many `trials`, and the cache is a folder of this name within `out`.

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
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / cache, help="of the runs")
    parser.add_argument(
        "--problems", default=next(iter(module.GROUPS)),
        help=f"{', '.join(module.GROUPS)}, or some of {problems}; %(default)s",
    )  # fmt: skip
    found = parsed(parser)
    require_folder(found.cache, "cache")
    listed = module.GROUPS.get(found.problems)
    found.problems = listed or chosen("problems", found.problems, module.PROBLEMS)
    found.arms = runnable(chosen("arms", found.arms, tuple(module.ARMS)))
    return found


def parsed(parser: Options) -> Namespace:
    """The options of a tool that writes a document: those of `publish` as well."""
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    found = parser.parse_args()
    require_folder(found.out)
    return found


def chosen(field: str, listed: str, known: Sequence[str]) -> list[str]:
    """The comma-separated names, each once, in the order of `known`.

    Raises:
        InputError: a name that is not known.
    """
    names = set(listed.split(","))
    for name in sorted(names.difference(known)):
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


class Report(Protocol):
    """Everything that a command measured."""

    @property
    def bars(self) -> Sequence[Bar]:
        """As far as they can be checked."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values but the bars, for programs."""

    def markdown(self) -> str:
        """The document."""

    def plot(self, path: Path) -> None:
        """The document's picture."""


def publish(options: Namespace, name: str, report: Report) -> None:
    """Print the report; unless it is printed as JSON, also write `NAME.md` and `NAME.png`.

    Raises:
        InputError: the folder `--out` cannot be written.
    """
    if options.json:
        made = {"machine": machine(), "versions": versions()}
        print(json.dumps(made | report.as_dict() | {"bars": [asdict(bar) for bar in report.bars]}))
        return
    path, text = options.out / f"{name}.md", report.markdown()
    with writable(path):
        options.out.mkdir(parents=True, exist_ok=True)
    report.plot(path.with_suffix(".png"))
    commit_text(path, text)
    print(text)


def made_by() -> str:
    """The line of a document: command, day, machine and versions that made it."""
    command = " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    return f"Written by `{command}` on {time.strftime('%Y-%m-%d')}: {machine()}; {versions()}."


def machine() -> str:
    """The machine, in words."""
    return f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Python and the packages that decide the figures."""
    known = ((name, installed(name)) for name in NAMED_PACKAGES)
    found = [f"{name} {number}" if number else f"no {name}" for name, number in known]
    return ", ".join([f"Python {platform.python_version()}", *found])


def installed(package: str) -> str:
    """The version of an installed package; "" where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def draw_panels(
    path: Path,
    arms: Mapping[str, Arm],
    curves: Costs,
    ylabel: str,
    across: int,
    panel_in: tuple[float, float],
    legend_in: float,
    log: bool = False,
) -> None:
    """Draw a panel for each problem, with a curve for each arm that has one.

    Curves are values after so many trials, [trials] for each (problem, arm). A row has at most
    `across` panels, of a width and height in inches; the legend stands at the right.
    """
    from study.pictures import style  # not in the processes that are measured

    problems = list(dict.fromkeys(problem for problem, _ in curves))
    across = min(len(problems), across)
    down = -(-len(problems) // across)
    figure = style.new_figure(panel_in[0] * across + legend_in, panel_in[1] * down)
    looks = _looks(arms)
    for place, problem in enumerate(problems):
        axes = figure.add_subplot(down, across, place + 1)
        style.tidy(axes)
        for name, arm in arms.items():
            if (values := curves.get((problem, name))) is not None:
                axes.plot(np.arange(1, len(values) + 1), values, label=arm.label, **looks[name])
        axes.set_yscale("log" if log else "linear")
        axes.set_title(problem, fontsize=style.TITLE_PT, loc="left")
        axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        axes.set_ylabel(ylabel, fontsize=style.TEXT_PT)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    right = 1.0 - legend_in / figure.get_figwidth()
    figure.legend(
        handles, labels, loc="center left", bbox_to_anchor=(right, 0.5),
        fontsize=style.SMALL_PT, frameon=False,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, right, 1))
    style.save_png(figure, path)


def _looks(arms: Mapping[str, Arm]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and width of each arm's curve, by its kind and its place among its kind.

    Our arms are in colour and unbroken, peers dashed, controls grey and dotted.
    """
    from study.pictures import style

    colours = {
        "ours": style.SERIES,
        "peer": (style.FAINT, style.SKY_BLUE, style.BROWN, style.VIOLET, style.ORANGE),
        "control": (style.FAINT,),
    }
    members = dict.fromkeys(colours, 0)
    found: dict[str, dict[str, Any]] = {}
    for name, arm in arms.items():
        place, own = members[arm.kind], colours[arm.kind]
        members[arm.kind] += 1
        dashes = {"ours": "-", "peer": "--", "control": (0, (1, 1 + 2 * place))}[arm.kind]
        width = 1.8 if arm.kind == "ours" else 1.3
        found[name] = {"color": own[place % len(own)], "linestyle": dashes, "linewidth": width}
    return found

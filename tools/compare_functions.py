"""Compare the plain process with others' on standard functions, and write a page.

    python tools/compare_functions.py                       # 12 functions, with and without noise
    python tools/compare_functions.py --seeds 2 --trials 30 --arms plain,gp

Every arm has the same first three trials. A seed draws them, the noise, and how far the
function is moved. GPSampler needs PyTorch and BoTorch is a package apart; this project
installs neither: without them these arms are left out. The cache keeps finished runs.
"""

from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Self

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna
    from optuna.distributions import BaseDistribution, FloatDistribution
    from optuna.samplers import BaseSampler, GPSampler

    from storage.inputs.errors import InputError
    from study.sampler.sampler import FeatureKernelSampler
    from tools import peers
    from tools.page import write_page
    from tools.runs import (
        Arm,
        Batches,
        Floats,
        Pool,
        Run,
        RunOptions,
        Settings,
        Versus,
        chosen,
        execute,
        runnable,
    )

TITLE = "The plain process on standard functions"
CHECKPOINTS = (10, 20, 30, 40, 60)  # trials
FIRST = 3  # random trials, the same for every arm
MOVED = 0.1  # of the range: so far at most is a function moved, each way
NOISE = 0.05  # of the spread of the function over its box
SPREAD_POINTS = 2000  # that tell this spread
NOISES = {"exact": 0.0, "noisy": NOISE}

A3 = np.array([[3.0, 10, 30], [0.1, 10, 35], [3.0, 10, 30], [0.1, 10, 35]])
P3 = np.array(
    [[3689, 1170, 2673], [4699, 4387, 7470], [1091, 8732, 5547], [381, 5743, 8828]]
)
A6 = np.array(
    [
        [10, 3, 17, 3.5, 1.7, 8],
        [0.05, 10, 17, 0.1, 8, 14],
        [3, 3.5, 1.7, 10, 17, 8],
        [17, 8, 0.05, 10, 0.1, 14],
    ]
)
P6 = np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)
ALPHA = np.array([1.0, 1.2, 3.0, 3.2])


def hartmann(a: Floats, p: Floats) -> Callable[[Floats], float]:
    """Hartmann's function of three or six parameters."""

    def cost(x: Floats) -> float:
        return float(-ALPHA @ np.exp(-(a * (x - 1e-4 * p) ** 2).sum(axis=1)))

    return cost


def branin(x: Floats) -> float:
    curve = x[1] - 5.1 / (4 * np.pi**2) * x[0] ** 2 + 5 / np.pi * x[0] - 6
    return float(curve**2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(x[0]) + 10)


def camel(x: Floats) -> float:
    a, b = x
    return float(
        (4 - 2.1 * a**2 + a**4 / 3) * a**2 + a * b + (4 * b**2 - 4) * b**2,
    )


def goldstein(x: Floats) -> float:
    a, b = x
    left = 19 - 14 * a + 3 * a**2 - 14 * b + 6 * a * b + 3 * b**2
    right = 18 - 32 * a + 12 * a**2 + 48 * b - 36 * a * b + 27 * b**2
    return float((1 + (a + b + 1) ** 2 * left) * (30 + (2 * a - 3 * b) ** 2 * right))


def rosenbrock(x: Floats) -> float:
    return float((100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2).sum())


def michalewicz(x: Floats) -> float:
    turns = np.arange(1, len(x) + 1) * x**2 / np.pi
    return float(-(np.sin(x) * np.sin(turns) ** 20).sum())


def ackley(x: Floats) -> float:
    near = -20 * np.exp(-0.2 * np.sqrt((x**2).mean()))
    return float(near - np.exp(np.cos(2 * np.pi * x).mean()) + 20 + np.e)


def levy(x: Floats) -> float:
    w = 1 + (x - 1) / 4
    inner = (w[:-1] - 1) ** 2 * (1 + 10 * np.sin(np.pi * w[:-1] + 1) ** 2)
    last = (w[-1] - 1) ** 2 * (1 + np.sin(2 * np.pi * w[-1]) ** 2)
    return float(np.sin(np.pi * w[0]) ** 2 + inner.sum() + last)


def styblinski(x: Floats) -> float:
    return float((x**4 - 16 * x**2 + 5 * x).sum() / 2)


def dixon(x: Floats) -> float:
    pairs = np.arange(2, len(x) + 1) * (2 * x[1:] ** 2 - x[:-1]) ** 2
    return float((x[0] - 1) ** 2 + pairs.sum())


def ellipsoid(x: Floats) -> float:
    return float((np.arange(1, len(x) + 1) * x**2).sum())


# Of each, the number of its parameters and their range.
FUNCTIONS: Mapping[str, tuple[Callable[[Floats], float], int, float, float]] = {
    "branin": (lambda x: branin(x + np.array([0.0, 5.0])), 2, -5.0, 10.0),
    "camel": (camel, 2, -2.0, 2.0),
    "goldstein": (goldstein, 2, -2.0, 2.0),
    "hartmann3": (hartmann(A3, P3), 3, 0.0, 1.0),
    "rosenbrock": (rosenbrock, 4, -2.0, 2.0),
    "michalewicz": (michalewicz, 5, 0.0, np.pi),
    "hartmann6": (hartmann(A6, P6), 6, 0.0, 1.0),
    "ackley": (ackley, 8, -5.0, 5.0),
    "styblinski": (styblinski, 8, -5.0, 5.0),
    "levy": (levy, 10, -5.0, 5.0),
    "dixon": (dixon, 15, -2.0, 2.0),
    "ellipsoid": (ellipsoid, 20, -5.0, 5.0),
}


@dataclass(frozen=True, eq=False)
class Function(Pool):
    """A function on a box, moved as a seed draws it; it has no candidates.

    Attributes:
        move: added to every point, [d].
        noise: deviation of what a trial is told.
    """

    move: Floats
    noise: float

    @classmethod
    def of(cls, name: str) -> "Function":
        """Of a name such as "levy-noisy"."""
        function, level = name.split("-")
        cost, count, low, high = FUNCTIONS[function]
        space: dict[str, BaseDistribution] = {
            f"x{place}": FloatDistribution(low, high) for place in range(count)
        }
        points = np.random.default_rng(1).uniform(low, high, (SPREAD_POINTS, count))
        spread = float(np.std([cost(point) for point in points]))
        return cls(
            name=name,
            space=space,
            columns={},
            cost=np.empty(0),
            move=np.zeros(count),
            noise=NOISES[level] * spread,
        )

    @property
    def box(self) -> tuple[float, float]:
        """Of every parameter."""
        _, _, low, high = FUNCTIONS[self.name.split("-")[0]]
        return low, high

    def drawn(self, seed: int) -> Self:
        """The function, moved."""
        low, high = self.box
        most = MOVED * (high - low)
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        return replace(self, move=rng.uniform(-most, most, len(self.move)))

    def cost_at(self, settings: Settings) -> float:
        """Without noise."""
        cost = FUNCTIONS[self.name.split("-")[0]][0]
        point = np.array([settings[name] for name in self.space], dtype=np.float64)
        return cost(point + self.move)

    def draws(self, seed: int, trials: int) -> tuple[Floats, Floats]:
        """The first points [FIRST, d], and the noise of each trial, [trials]."""
        rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
        first = rng.uniform(*self.box, (FIRST, len(self.move)))
        return first, self.noise * rng.standard_normal(trials)


def of_sampler(
    made: Callable[[Function, int], BaseSampler],
) -> Callable[[Function, int, Batches], Floats]:
    """Costs of a study's trials, without noise; the sampler is told them with it."""

    def costs(function: Function, seed: int, batches: Batches) -> Floats:
        first, noise = function.draws(seed, batches.trials)
        study, found = optuna.create_study(sampler=made(function, seed)), []
        for point in first.tolist():
            study.enqueue_trial(dict(zip(function.space, point, strict=True)))
        for size in batches:
            for trial in [study.ask(function.space) for _ in range(size)]:
                found.append(function.cost_at(trial.params))
                study.tell(trial, found[-1] + noise[len(found) - 1])
        return np.array(found)

    return costs


def plain(function: Function, seed: int) -> BaseSampler:
    return FeatureKernelSampler(
        None, seed=seed, kernel="euclidean", space=function.space
    )


def gp_sampler(function: Function, seed: int) -> BaseSampler:
    peers.torch_of(seed)
    return GPSampler(seed=seed, n_startup_trials=FIRST)


def botorch(function: Function, seed: int, batches: Batches) -> Floats:
    """BoTorch as its front page has it: SingleTaskGP, LogExpectedImprovement."""
    torch = peers.torch_of(seed)
    from botorch import fit_gpytorch_mll
    from botorch.acquisition import LogExpectedImprovement
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Normalize, Standardize
    from botorch.optim import optimize_acqf
    from gpytorch.mlls import ExactMarginalLogLikelihood

    first, noise = function.draws(seed, batches.trials)
    d = len(function.space)
    bounds = torch.tensor([[end] * d for end in function.box], dtype=torch.double)
    points, told, found = first, list[float](), list[float]()
    for trial in range(batches.trials):
        if trial >= FIRST:
            x, y = (
                torch.tensor(points),
                -torch.tensor(told, dtype=torch.double)[:, None],
            )
            model = SingleTaskGP(
                x, y, input_transform=Normalize(d), outcome_transform=Standardize(m=1)
            )
            fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            acquisition = LogExpectedImprovement(model, best_f=y.max())
            proposed, _ = optimize_acqf(
                acquisition, bounds=bounds, q=1, num_restarts=5, raw_samples=20
            )
            points = np.vstack([points, proposed.numpy()])
        settings = dict(zip(function.space, points[trial].tolist(), strict=True))
        found.append(function.cost_at(settings))
        told.append(found[-1] + noise[trial])
    return np.array(found)


ARMS = {
    "plain": Arm("ours", of_sampler(plain), ours=True),
    "gp": Arm("GPSampler", of_sampler(gp_sampler), needs="torch"),
    "botorch": Arm("BoTorch", botorch, needs="botorch"),
}


class FunctionRun(Run):
    """One study on a function."""

    SOURCES = (Path(__file__),)

    @property
    def pool(self) -> Function:
        """The function of that name."""
        return Function.of(self.problem)

    @property
    def way(self) -> Arm[Any]:
        """The arm of that name."""
        return ARMS[self.arm]

    @property
    def data(self) -> tuple[Path, ...]:
        """It is read from no file."""
        return ()


def main() -> None:
    options = parse()
    problems = ["-".join(each) for each in product(options.functions, NOISES)]
    keys = list(product(range(options.seeds), problems, options.arms))
    runs = [
        FunctionRun(problem, arm, seed, options.batches) for seed, problem, arm in keys
    ]
    costs, seconds = execute(runs, options.cache, options.processes)
    shape = (options.seeds, len(problems), len(options.arms))
    best = np.minimum.accumulate(costs, axis=1).reshape(*shape, options.trials)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = Figures(options, problems, best, seconds.reshape(shape)).lines()
    write_page(options.out / "sampler-functions.md", TITLE, figures)


def parse() -> Namespace:
    """The options, with lists of functions and of arms that this machine can run."""
    parser = RunOptions(__file__, seeds=20, trials=60, cache="functions")
    parser.add_argument("--functions", help=f"some of {','.join(FUNCTIONS)}; all")
    parser.add_argument("--arms", help=f"some of {','.join(ARMS)}; all")
    found = parser.parse_args()
    if found.batch > 1:
        raise InputError("batch", found.batch, "1: BoTorch's page proposes one")
    names = found.functions or ",".join(FUNCTIONS)
    found.functions = chosen("functions", names, [*FUNCTIONS])
    found.arms = runnable(chosen("arms", found.arms or ",".join(ARMS), [*ARMS]), ARMS)
    return found


class Figures:
    """Tables of all runs.

    Attributes:
        options: of the command.
        problems: functions with their noise, [p].
        best: lowest cost so far without noise, [seeds, p, arms, trials].
        seconds: of a run, [seeds, p, arms].
    """

    def __init__(
        self, options: Namespace, problems: list[str], best: Floats, seconds: Floats
    ) -> None:
        self.options, self.problems, self.best = options, problems, best
        self.seconds = seconds
        last = options.trials
        self.checkpoints = [*(at for at in CHECKPOINTS if at < last), last]

    def versus(self, other: int, trial: int, level: str, name: str = "") -> Versus:
        """The first arm against another: of all seeds on all functions, or on one."""
        places = [
            place
            for place, problem in enumerate(self.problems)
            if problem.endswith(level) and problem.startswith(name)
        ]
        ours, theirs = (self.best[:, places, arm, trial - 1] for arm in (0, other))
        return Versus.of(np.sign(theirs - ours).ravel().tolist())

    def lines(self) -> list[str]:
        """Won and lost over all functions, and by function after the last trial."""
        arms = [ARMS[name].label for name in self.options.arms]
        head = "".join(f" after {at} | p |" for at in self.checkpoints)
        lines = [
            "## Won and lost, by seed and function",
            "",
            f"| {arms[0]} against | noise |{head} s a run |",
            "|---|---|" + "---:|" * (2 * len(self.checkpoints) + 1),
        ]
        for other, level in product(range(1, len(arms)), ["", *NOISES]):
            cells = " | ".join(
                self.versus(other, at, level).cells() for at in self.checkpoints
            )
            lines.append(
                f"| {arms[other]} | {level or 'both'} | {cells} |"
                f" {np.median(self.seconds[..., other]):.3g} |"
            )
        lines += [
            "",
            f"A run of {arms[0]} took {np.median(self.seconds[..., 0]):.3g} s.",
            "",
            f"| after {self.options.trials}, won:lost with p |"
            + "".join(f" {label} | p |" for label in arms[1:]),
            "|---|" + "---:|" * 2 * (len(arms) - 1),
        ]
        for problem in self.problems:
            name, level = problem.split("-")
            cells = " | ".join(
                self.versus(other, self.options.trials, level, f"{name}-").cells()
                for other in range(1, len(arms))
            )
            lines.append(f"| {name}, {level} | {cells} |")
        return lines


if __name__ == "__main__":
    run_command(main)

"""Measure the walker against the figures that it must show, as a Markdown table."""

import json
import platform
from argparse import Namespace
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import taichi_nmm
from storage.points import sobol_points
from study.experiment.walker import walked
from study.options import require_used
from taichi_nmm import GAINS, Bodies, Settings, terrain
from taichi_nmm.result import COMPLETED
from taichi_nmm.settings import OWN_ENGINE
from taichi_nmm.walker_simulator import require_engine

SHORT_S, LONG_S = 5.0, 100.0
TOP_FRACTION = 0.05
AGREEMENT_POINTS = 4096
MUJOCO_BATCH = 250  # points at once
OF_MUJOCO = ("--engine", "--samples", "--seed", "--json")  # options that it uses


@dataclass(frozen=True)
class Figure:
    """A measured number beside its bar.

    Attributes:
        what: name of the quantity.
        value: as measured.
        low: the least that is allowed; None: no lower bound.
        high: the most; with both None, the number is only reported.
        unit: of the number and its bar; "" where it has none.
    """

    what: str
    value: float
    low: float | None = None
    high: float | None = None
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether the number lies within its bar."""
        enough = self.low is None or self.value >= self.low
        return bool(enough and (self.high is None or self.value <= self.high))

    def row(self) -> str:
        """A row of a Markdown table."""
        value = f"| {self.what} | {self.value:.4g} {self.unit} "
        if self.low is None and self.high is None:
            return f"{value}| | |"
        low = "" if self.low is None else f"{self.low:g}"
        high = "" if self.high is None else f" to {self.high:g}"
        return f"{value}| {low}{high} | {'yes' if self.holds else '**no**'} |"


def show(measured: Iterable[Figure], how: str, as_json: bool) -> None:
    """Print the figures once all are measured: as Markdown after a line on `how`, or as JSON."""
    figures = []
    with tqdm(unit="figure") as bar:
        for figure in measured:
            figures.append(figure)
            bar.set_postfix_str(figure.what)
            bar.update()
    if as_json:
        print(
            json.dumps(
                [{**asdict(figure), "holds": figure.holds} for figure in figures]
            )
        )
        return
    machine = (
        f"{date.today()}, {platform.machine()}, Python {platform.python_version()}"
    )
    print(f"{how}; {machine}.", "", "| what | measured | bar | holds |", sep="\n")
    print("|---|---|---|---|", *(figure.row() for figure in figures), sep="\n")


def main(args: Namespace) -> None:
    """Measure and print."""
    if args.engine != OWN_ENGINE:
        require_used(args, OF_MUJOCO, f"--engine {args.engine}")
    require_engine(Settings(engine=args.engine))
    if args.engine == OWN_ENGINE:
        how = f"{args.samples} Sobol points, float32, 1 ms unless stated otherwise"
        measured = of_our_engine(args.samples, args.draws, args.seed)
    else:
        how = f"{args.samples} Sobol points, MuJoCo's default contact, 1 ms"
        measured = of_mujoco(args.samples, args.seed)
    show(measured, how, args.json)


def of_our_engine(samples: int, draws: int, seed: int) -> Iterator[Figure]:
    """All figures, as they are measured."""
    from sklearn.metrics import roc_auc_score  # a second

    yield from known_gait("published", (1.365, 1.425), (0.99, 1.01), Settings())
    gains = sobol_points(seed, 0, samples, GAINS)
    short = taichi_nmm.simulate(gains, duration_s=SHORT_S).rows
    alive = short["end_reason"] == COMPLETED
    walks = np.zeros(samples, dtype=bool)
    long = taichi_nmm.simulate(gains[alive], duration_s=LONG_S).rows
    walks[np.flatnonzero(alive)] = long["end_reason"] == COMPLETED
    yield Figure("alive at 5 s, flat", 100 * alive.mean(), 8.5, 11.5, "%")
    yield Figure("walk 100 s, flat", 100 * walks.mean(), 4.7, 7.1, "%")
    for score in ("phi_printed", "phi_corrected"):
        area = roc_auc_score(walks, short[score])
        yield Figure(
            f"area under the ROC curve of {score} for walks 100 s", area, 0.95, 1.0
        )
    yield from rough_ground(gains, short["phi_printed"], draws, seed)
    yield from agreement(gains[:AGREEMENT_POINTS])


def known_gait(
    name: str,
    speed_mps: tuple[float, float],
    load_bw: tuple[float, float],
    settings: Settings,
) -> Iterator[Figure]:
    """A gait that ships, on flat ground; its speed and its mean load have bars."""
    gains = taichi_nmm.load_gains(name)
    row = taichi_nmm.simulate(gains, duration_s=LONG_S, settings=settings).rows[0]
    yield Figure(f"{name} gains, flat: walked", row["duration_s"], LONG_S, LONG_S, "s")
    yield Figure(
        f"{name} gains, flat: mean speed", row["mean_speed_mps"], *speed_mps, "m/s"
    )
    force = row["grf_vertical_mean_bw"]
    yield Figure(f"{name} gains: mean vertical ground reaction", force, *load_bw, "BW")


def rough_ground(
    gains: NDArray[np.float64], score: NDArray[np.float64], draws: int, seed: int
) -> Iterator[Figure]:
    """Walkers among all points and among the best by score, over several draws."""
    best = np.argsort(-score, kind="stable")[: round(TOP_FRACTION * len(gains))]
    everyone, top = [], []
    for draw in range(draws):
        body, ground = np.random.SeedSequence(seed, spawn_key=(draw,)).spawn(2)
        bodies, rough = Bodies.disturbed([body]), terrain.rough(ground)
        rows = taichi_nmm.simulate(
            gains, duration_s=LONG_S, bodies=bodies, terrains=rough
        ).rows
        walks = rows["end_reason"] == COMPLETED
        everyone.append(100 * walks.mean())
        top.append(100 * walks[best].mean())
    what = f"walk 100 s, rough +-8 cm, disturbed body, mean of {draws} draws"
    yield Figure(what, float(np.mean(everyone)), 0.4, 1.6, "%")
    yield Figure(
        "the same among the top 5 % by phi_printed", float(np.mean(top)), 7.0, 15.0, "%"
    )


def agreement(gains: NDArray[np.float64]) -> Iterator[Figure]:
    """Share of points with the same verdict 'alive at 5 s' under another step or precision."""

    def verdicts(settings: Settings) -> NDArray[np.bool_]:
        rows = taichi_nmm.simulate(gains, duration_s=SHORT_S, settings=settings).rows
        return np.asarray(rows["end_reason"] == COMPLETED)

    base = verdicts(Settings())
    fine = verdicts(Settings(physics_step_s=0.25e-3))
    double = verdicts(Settings(precision="float64"))
    yield Figure(
        "same verdict at 1 ms and 0.25 ms",
        100 * (base == fine).mean(),
        94.0,
        100.0,
        "%",
    )
    yield Figure(
        "same verdict in float32 and float64",
        100 * (base == double).mean(),
        97,
        100,
        "%",
    )


def of_mujoco(samples: int, seed: int) -> Iterator[Figure]:
    """Known gaits, and agreement with our engine and of MuJoCo with itself at half the step."""
    mujoco, load_bw = Settings(engine="mujoco"), (0.998, 1.002)
    yield from known_gait("published", (1.37, 1.43), load_bw, mujoco)
    yield from known_gait("reference", (1.23, 1.31), load_bw, mujoco)
    points = sobol_points(seed, 0, samples, GAINS)
    finer = Settings(engine="mujoco", physics_step_s=0.5e-3)
    ours, theirs, half = (lasting(points, each) for each in (Settings(), mujoco, finer))
    yield Figure("alive at 5 s", 100 * theirs[0].mean(), unit="%")
    yield Figure("walk 100 s", 100 * theirs[1].mean(), unit="%")
    same = 100 * (theirs[1] == ours[1]).mean()
    yield Figure("same verdict 'walks 100 s' as our engine", same, 93, 100, "%")
    for name, one, other in zip(
        ("alive at 5 s", "walks 100 s"), theirs, half, strict=True
    ):
        same = 100 * (one == other).mean()
        yield Figure(f"same verdict '{name}' at 1 and 0.5 ms", same, unit="%")


def lasting(
    points: NDArray[np.float64], settings: Settings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each point is alive at 5 s, and whether it walks 100 s."""
    rows = np.concatenate(
        [
            taichi_nmm.simulate(batch, duration_s=LONG_S, settings=settings).rows
            for batch in np.split(
                points, range(MUJOCO_BATCH, len(points), MUJOCO_BATCH)
            )
        ]
    )
    return rows["duration_s"] >= SHORT_S, walked(rows)

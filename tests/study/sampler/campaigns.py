"""Campaigns on made-up machines: what was said before each trial, and what then happened.

    python -m tests.study.sampler.campaigns --campaigns 40 --seed 1

Each kind of campaign knows something else before its first trial: costs in twelve
worlds of three families, in one world, features, or the parameters alone. Half of the
machines are drawn as the worlds are. The others are structurally unlike all worlds:
another optimum, and a smooth misfit that no world has. Every reading has noise.

Prints how often the 95 % interval held the next reading, what was said of success and
of limits beside what happened, how often the recommended trial was truly better, or
worse, than the one of the best reading, and how often the machine was called unlike all
worlds after three trials (`--trials 4` are enough for that).
"""

import argparse
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import optuna
from optuna.distributions import FloatDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.trial import create_trial

from study import FeatureKernelSampler, FeatureTable

KINDS = ("worlds", "one world", "features", "knobs")
ROWS, FAMILIES, WORLDS_EACH, TRIALS = 300, 3, 4, 30
SHOWN_TRIALS = (1, 4, 8, 16, 30)
RECOMMENDED_AFTER = (12, 25)
LIMITS = ("torque", "heat")
FALL, FALLEN = 3.0, 6.0  # cost of a fall at the end, and at once


@dataclass(frozen=True)
class Physics:
    """What all machines of one problem share; they differ by d + 2 numbers.

    Attributes:
        weights: how much each parameter counts, [d].
        pairs: which parameters act together, [d, d].
        waves: directions of a ripple that all machines have, [3, d].
        fall: direction along which a machine falls, [d].
    """

    weights: np.ndarray
    pairs: np.ndarray
    waves: np.ndarray
    fall: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Physics":
        d = int(rng.choice([2, 3, 5, 8]))
        return cls(
            weights=rng.uniform(0.3, 1.5, d),
            pairs=0.5 * rng.normal(size=(d, d)) / d,
            waves=rng.normal(size=(3, d)) * 4.0,
            fall=rng.normal(size=d) / np.sqrt(d),
        )

    def cost(self, u: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Costs of points [n, d] on the machine with these numbers, [n]."""
        d = len(self.weights)
        away = u - numbers[:d]
        bowl = away**2 @ self.weights + np.einsum("ni,ij,nj->n", away, self.pairs, away)
        ripple = 0.05 * np.sin(u @ self.waves.T + numbers[d]).sum(axis=1)
        walked = 0.4 + np.abs(bowl) + ripple
        unstable = (u - 0.5) @ self.fall - numbers[d + 1]
        fell = FALL + (FALLEN - FALL) * np.clip(unstable, 0.0, 1.0)
        return np.where(unstable > 0.0, fell, walked)

    def numbers(self, family: int, rng: np.random.Generator) -> np.ndarray:
        """Those of a machine of a family."""
        d = len(self.weights)
        spread = np.full(d, 0.06)
        spread[family % d] = 0.2  # each family doubts another parameter
        centre = 0.5 + 0.1 * np.cos(np.arange(d) + 2.0 * family)
        return np.append(
            centre + spread * rng.normal(size=d), rng.uniform(0, 3, 2) * (1, 0.15)
        )


@dataclass(frozen=True)
class Machine:
    """A machine, its candidates, and what is known of it before.

    Attributes:
        table: of the candidates.
        space: of the parameters.
        truth: what it does.
        success: the cost from which on a trial has succeeded.
        noise: standard deviation of a reading.
        is_like: whether it was drawn as the worlds were.
    """

    table: FeatureTable
    space: dict[str, FloatDistribution]
    truth: "Truth"
    success: float
    noise: float
    is_like: bool


@dataclass(frozen=True)
class Truth:
    """What a machine does at points [n, d].

    Attributes:
        physics: of the problem.
        numbers: of the machine.
        misfit: amplitudes, directions and phases of smooth waves that no world has, of
            the logarithm of the cost.
        slopes: of the limits, [2, d]; `levels` are where they break, [2].
        levels: see slopes.
    """

    physics: Physics
    numbers: np.ndarray
    misfit: tuple[np.ndarray, np.ndarray, np.ndarray]
    slopes: np.ndarray
    levels: np.ndarray

    @classmethod
    def drawn(
        cls, physics: Physics, rng: np.random.Generator, *, is_like: bool
    ) -> "Truth":
        """Another machine of a problem, whose limits break beyond 0."""
        d = len(physics.weights)
        numbers = physics.numbers(int(rng.integers(FAMILIES)), rng)
        size = 0.0
        if not is_like:
            numbers[:d] += rng.choice([-1, 1], d) * rng.uniform(0.1, 0.35, d)
            size = rng.choice([0.15, 0.3, 0.6])
        return cls(
            physics=physics,
            numbers=numbers,
            misfit=(
                size * rng.normal(size=12) / np.sqrt(6.0),
                rng.normal(size=(12, d)) * 3.0 / np.sqrt(d),
                rng.uniform(0, 2 * np.pi, 12),
            ),
            slopes=rng.normal(size=(2, d)) / np.sqrt(d),
            levels=np.zeros(2),
        )

    def costs(self, u: np.ndarray) -> np.ndarray:
        amplitudes, directions, phases = self.misfit
        waves = np.cos(u @ directions.T + phases) @ amplitudes
        return self.physics.cost(u, self.numbers) * np.exp(waves)

    def limits(self, u: np.ndarray) -> np.ndarray:
        """Above 0 where broken, [n, 2]."""
        return (u - 0.5) @ self.slopes.T + 0.2 * np.sin(5.0 * u[:, :1]) - self.levels


def machine_of(kind: str, *, is_like: bool, seed: int) -> Machine:
    """A machine of a new problem, with what a campaign of this kind knows of it."""
    rng = np.random.default_rng([seed, KINDS.index(kind), is_like])
    physics = Physics.drawn(rng)
    d = len(physics.weights)
    u = rng.uniform(size=(ROWS, d))
    families = {
        f"family {family}": np.column_stack(
            [physics.cost(u, physics.numbers(family, rng)) for _ in range(WORLDS_EACH)]
        )
        for family in range(FAMILIES)
    }
    known = np.mean([costs.mean(axis=1) for costs in families.values()], axis=0)
    truth = Truth.drawn(physics, rng, is_like=is_like)
    truth = replace(truth, levels=np.quantile(truth.limits(u), 0.65, axis=0))
    names = [f"x{column}" for column in range(d)]
    space = {name: FloatDistribution(0.0, 1.0) for name in names}
    columns = dict(zip(names, u.T, strict=True))
    features = [families["family 0"][:, 0], u[:, 0] * u[:, -1]]
    told = {
        "worlds": {"outcomes": families},
        "one world": {"outcomes": families["family 0"][:, :1]},
        "features": {},
        "knobs": {},
    }[kind]
    shown = np.column_stack(features) if kind == "features" else None
    shown = u if kind == "knobs" else shown
    best = np.sort(truth.costs(u))
    return Machine(
        table=FeatureTable.from_arrays(columns, shown, space=space, **told),
        space=space,
        truth=truth,
        success=float(np.quantile(known, 0.1)),
        noise=float(rng.choice([0.02, 0.1]) * (best[ROWS // 4] - best[0])),
        is_like=is_like,
    )


@dataclass(frozen=True)
class Said:
    """What was said before a trial, and what happened.

    Attributes:
        kind: of the campaign.
        is_like: whether the machine was drawn as the worlds were.
        trial: from 1.
        low: end of the interval.
        high: its other end.
        success: the chance that was said.
        kept: likewise, of all limits.
        value: the reading.
        succeeded: whether it was a success.
        has_kept: whether all limits were kept.
        recommended: what the recommended trial truly costs less what the one of the
            best reading does; NaN where nobody asked.
        unlike: whether the machine was called unlike all worlds.
    """

    kind: str
    is_like: bool
    trial: int
    low: float
    high: float
    success: float
    kept: float
    value: float
    succeeded: bool
    has_kept: bool
    recommended: float
    unlike: bool


def campaign(
    kind: str, *, is_like: bool, seed: int, trials: int = TRIALS
) -> Iterator[Said]:
    """Thirty trials on a machine."""
    machine = machine_of(kind, is_like=is_like, seed=seed)
    rng = np.random.default_rng([seed, 7])
    sampler = FeatureKernelSampler(machine.table, seed=seed, success=machine.success)
    asked, told = optuna.create_study(sampler=sampler), optuna.create_study()
    for number in range(1, trials + 1):
        trial = asked.ask(dict(machine.space))
        found = sampler.predict(told, [trial.params])
        u = np.array([list(trial.params.values())])
        value = float(machine.truth.costs(u)[0] + machine.noise * rng.normal())
        limits = dict(zip(LIMITS, machine.truth.limits(u)[0].tolist(), strict=True))
        for name, limit in limits.items():
            trial.set_constraint(name, limit)
        asked.tell(trial, value)
        told.add_trial(
            create_trial(
                value=value,
                params=trial.params,
                distributions=machine.space,
                user_attrs=dict(asked.trials[-1].user_attrs),
                constraints=limits,
            )
        )
        recommended = np.nan
        if number in RECOMMENDED_AFTER:
            recommended = better_than_reading(sampler, told, machine.truth)
        yield Said(
            kind=kind,
            is_like=is_like,
            trial=number,
            low=float(found.low[0]),
            high=float(found.high[0]),
            success=float(found.success[0]),
            kept=float(found.kept[0]),
            value=value,
            succeeded=value <= machine.success,
            has_kept=max(limits.values()) <= 0.0,
            recommended=recommended,
            unlike=bool(found.unlike),
        )


def better_than_reading(
    sampler: FeatureKernelSampler, study: optuna.Study, truth: Truth
) -> float:
    """What the recommended trial truly costs, less what the one of the best reading does."""
    trials = study.trials
    kept = [trial for trial in trials if max(trial.constraints.values()) <= 0.0]
    read = min(kept or trials, key=lambda trial: trial.values[0])
    chosen = trials[sampler.best(study).number]
    u = np.array([list(trial.params.values()) for trial in (chosen, read)])
    costs = truth.costs(u)
    return float(costs[0] - costs[1])


def share(flags: list[bool]) -> str:
    return f"{100 * np.mean(flags):4.0f} %" if flags else "     -"


def tables(said: list[Said]) -> Iterator[str]:
    """The tables, a line each."""
    yield "The 95 % interval held the next reading (known of how many), at trial"
    yield "kind            " + "".join(f"{trial:>14}" for trial in SHOWN_TRIALS)
    for kind in KINDS:
        for is_like in (True, False):
            cells = []
            for trial in SHOWN_TRIALS:
                some = [
                    each
                    for each in said
                    if (each.kind, each.is_like) == (kind, is_like)
                    and abs(each.trial - trial) <= min(trial // 8, 2)
                ]
                known = [each for each in some if np.isfinite(each.low)]
                held = share([each.low <= each.value <= each.high for each in known])
                cells.append(f"{held} ({len(known)}/{len(some)})")
            yield f"{kind:<10}{'like' if is_like else 'unlike':<8}" + "".join(
                f"{cell:>16}" for cell in cells
            )
    yield from said_and_happened("Success", said, "success", "succeeded")
    yield from said_and_happened("Limits kept", said, "kept", "has_kept")
    first = [each for each in said if each.trial == 1]
    unknown = np.mean([np.isnan(each.kept) for each in first])
    yield f"Limits, first trial: unknown in {100 * unknown:.0f} %"
    for number in RECOMMENDED_AFTER:
        for kind in KINDS:
            gaps = np.array(
                [e.recommended for e in said if (e.trial, e.kind) == (number, kind)]
            )
            yield (
                f"recommend after {number}, {kind}: better {int((gaps < 0).sum())}, "
                f"worse {int((gaps > 0).sum())}"
            )
    for is_like in (True, False):
        fourth = [
            each.unlike
            for each in said
            if (each.trial, each.is_like, each.kind) == (4, is_like, "worlds")
        ]
        name = "like" if is_like else "unlike"
        yield f"called unlike all worlds after 3 trials, {name}: {share(fourth)}"


def said_and_happened(
    title: str, said: list[Said], chance: str, happened: str
) -> Iterator[str]:
    """Chances in tenths, and how often it happened."""
    yield f"{title}: said (how often), happened"
    known = [each for each in said if np.isfinite(getattr(each, chance))]
    for tenth in range(10):
        some = [e for e in known if min(int(10 * getattr(e, chance)), 9) == tenth]
        if some:
            mean = 100 * np.mean([getattr(each, chance) for each in some])
            so = 100 * np.mean([getattr(each, happened) for each in some])
            yield f"  {mean:4.0f} % ({len(some):>5}){so:7.0f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=40, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--trials", type=int, default=TRIALS)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore", ExperimentalWarning)
    said, start_s = list[Said](), time.perf_counter()
    for kind in args.kinds.split(","):
        for place in range(args.campaigns):
            seed = 1000 * args.seed + place // 2
            is_like = place % 2 == 0
            said += campaign(kind, is_like=is_like, seed=seed, trials=args.trials)
        print(kind, f"{time.perf_counter() - start_s:.0f} s", file=sys.stderr)
    print("\n".join(tables(said)))


if __name__ == "__main__":
    main()

"""Campaigns that may risk little: falls, and what it costs to have fewer.

    python -m tests.study.sampler.risky --robots 200 like oven
    python -m tests.study.sampler.risky walker2d-robots rough8-smooth:rough,rough_long

Kinds of robots: machines drawn as their worlds are (`like`) and others (`unlike`), of
`campaigns`; ovens, whose costs are smooth and whose fall is to overheat; and the worlds
of the store of a configuration of `compare`, each of which is a robot that the sampler
is not told of: the store's simulator runs each trial in it, on the table or off it.
Each robot has 30 trials for each allowed risk of a fall, and 30 of the sampler that is
told of no risk.

Prints how many trials fell, how many robots were refused a trial (they end there), and
how many their first one; and what the best trial after 30 truly costs, as a share of the
cost that the sampler without the limit has found: the mean, and its 95 % interval.
"""

import argparse
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.exceptions import ExperimentalWarning

from storage.inputs.config import read_toml, read_whole
from storage.points import FAMILY_WORLD, seed_sequence
from storage.simulator import SURVIVED
from storage.specification import Specification, read_specification
from storage.store import open_store
from study import FeatureKernelSampler, FeatureTable
from study.experiment.experiment import candidates, store_path
from study.experiment.features import told_of
from study.experiment.objective import Objective
from study.experiment.robots import read_any
from study.options import config_path
from study.sampler.forecast import family_of, some_worlds
from study.sampler.risk import RiskError
from study.sampler.rows import Rows
from study.sampler.worlds import limits_in_worlds
from tests.study.sampler.campaigns import FALL, TRIALS, Machine, machine_of

ALLOWED = (0.05, 0.1, 0.2)
GAINS = {
    "kp": FloatDistribution(0.1, 100, log=True),
    "ki": FloatDistribution(0.0001, 1, log=True),
    "kd": FloatDistribution(1, 1000, log=True),
}
OVENS, OVEN_ROWS, OVEN_S = 12, 1000, 400
HOTTEST = 1.02  # that an oven may become on its way from 0 to 1


Tried = Callable[[Mapping[str, Any]], tuple[float, bool]]
"""What parameters truly cost, and whether the robot falls."""


@dataclass(frozen=True)
class Robot:
    """A robot, its candidates, and what is known of it before.

    Attributes:
        table: of the candidates; it knows which fall in worlds.
        space: of the parameters.
        success: the cost from which on a trial has succeeded.
        noise: standard deviation of a reading.
        tried: what it does.
    """

    table: FeatureTable
    space: Mapping[str, BaseDistribution]
    success: float | None
    noise: float
    tried: Tried


@dataclass(frozen=True)
class Campaign:
    """What came of the trials on a robot.

    Attributes:
        fell: whether each trial fell, [t]; t < `TRIALS` where no candidate was within.
        best: what the best trial that did not fall truly costs; NaN without one.
    """

    fell: np.ndarray
    best: float


def knowing_falls(machine: Machine) -> FeatureTable:
    """The candidates, with the falls of each in the worlds."""
    rows = machine.table.rows
    assert rows.worlds is not None
    fell = {"fall": rows.worlds.costs >= FALL}
    return FeatureTable(replace(rows, limits=limits_in_worlds(fell, len(rows))))


def falls(machine: Machine, u: np.ndarray) -> bool:
    """Whether the machine falls at a point [1, d]."""
    physics, numbers = machine.truth.physics, machine.truth.numbers
    return bool((u - 0.5) @ physics.fall > numbers[-1])


def made_up(robots: int, seed: int, *, is_like: bool) -> Iterator[Robot]:
    """Machines of `campaigns`."""
    for place in range(robots):
        machine = machine_of("worlds", is_like=is_like, seed=1000 * seed + place)

        def tried(
            params: Mapping[str, Any], machine: Machine = machine
        ) -> tuple[float, bool]:
            u = np.array([list(params.values())])
            return float(machine.truth.costs(u)[0]), falls(machine, u)

        yield Robot(
            table=knowing_falls(machine),
            space=machine.space,
            success=machine.success,
            noise=machine.noise,
            tried=tried,
        )


def heated(
    gains: tuple[np.ndarray, ...], oven: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What gains cost on ovens, and how hot these become; all of one shape.

    Args:
        gains: kp, ki and kd.
        oven: its strength, the lag of its element in s, and what it loses in 1 / s.
    """
    kp, ki, kd = gains
    strength, lag_s, loss = oven
    air = element = integral = total = np.zeros(np.broadcast(kp, strength).shape)
    peak = air
    for _ in range(OVEN_S):
        error, change = 1.0 - air, element - loss * air
        integral = integral + error
        power = np.clip(kp * error + ki * integral - kd * change, 0.0, 1.0)
        element = element + (strength * power - element) / lag_s
        air = air + element - loss * air
        peak, total = np.maximum(peak, air), total + np.abs(1.0 - air)
    return total / OVEN_S, peak


def ovens(robots: int, seed: int) -> Iterator[Robot]:
    """Ovens of which nobody knows how strong, how slow, how leaky they are."""
    for place in range(robots):
        rng = np.random.default_rng([seed, place, 11])
        low, high = np.log([(d.low, d.high) for d in GAINS.values()]).T[:, :, None]
        rows = np.exp(rng.uniform(low, high, (len(GAINS), OVEN_ROWS)))
        least, most = (0.014, 3.0, 0.006), (0.03, 30.0, 0.013)
        worlds, own = rng.uniform(least, most, (OVENS, 3)), rng.uniform(least, most)
        costs, peaks = heated(tuple(rows[:, :, None]), worlds.T[:, None])

        def tried(
            params: Mapping[str, Any], own: np.ndarray = own
        ) -> tuple[float, bool]:
            gains = tuple(np.array(params[name]) for name in GAINS)
            cost, peak = heated(gains, own)
            return float(cost), bool(peak > HOTTEST)

        columns = dict(zip(GAINS, rows, strict=True))
        limits = {"fall": peaks - HOTTEST}
        yield Robot(
            table=FeatureTable.from_arrays(
                columns, outcomes=costs, limits=limits, space=GAINS
            ),
            space=GAINS,
            success=None,
            noise=0.02 * float(costs.min()),
            tried=tried,
        )


def of_store(robots: int, kind: str) -> Iterator[Robot]:
    """Worlds of the store of a configuration, each left out; at most so many."""
    name, _, families = kind.partition(":")
    experiment = read_any(config_path(name), None, None)
    rows, path = (
        candidates(experiment, "worlds", "worlds").rows,
        store_path(experiment, "worlds"),
    )
    made = read_whole(read_toml(config_path(path.name)), read_specification)
    lasted = told_of(open_store(path), SURVIVED, "falls")
    # What a family did not run has the mean of another one's worlds, and is no trial.
    fell = {"fall": {family: 1.0 - each for family, each in lasted.items()}}
    rows = replace(rows, limits=limits_in_worlds(fell, len(rows)))
    success = experiment.objective.success(experiment.trial_s)
    assert rows.worlds is not None
    names = rows.worlds.names
    known = families.split(",") if families else lasted
    rows = without(rows, [name for name in names if family_of(name) not in known])
    assert rows.worlds is not None
    for world in some_worlds(rows.worlds.names, robots):
        tried = partial(ran, made, rows.worlds.names[world], experiment.objective)
        yield left_out(rows, world, success, tried)


def without(rows: Rows, names: Collection[str]) -> Rows:
    """The rows, while nobody knows of the worlds of these names."""
    worlds, fall = rows.worlds, rows.limits["fall"]
    assert worlds is not None
    known = {"fall": fall.without(names)}
    return replace(rows, worlds=worlds.without(names), limits=known)


def ran(
    made: Specification, name: str, objective: Objective, params: Mapping[str, Any]
) -> tuple[float, bool]:
    """What parameters cost in a world of the store that was made so, and whether they fall."""
    family, _, number = name.rpartition(" ")
    (own,) = [each for each in made.families if each.name == family]
    world = own.rule.draw([seed_sequence(own.seed, FAMILY_WORLD, int(number))])
    point = [params[each.name] for each in made.simulator.parameters]
    rows, _ = made.simulator.run(np.array([point]), world, own.horizon_s, float)
    given = {column: rows[column] for column in rows.dtype.names}
    cost = objective.in_worlds(given, own.horizon_s)
    return float(cost[0, 0]), bool(rows[SURVIVED][0, 0] < 1.0)


def left_out(rows: Rows, world: int, success: float | None, tried: Tried) -> Robot:
    """A world that the sampler is not told of."""
    assert rows.worlds is not None
    return Robot(
        table=FeatureTable(without(rows, [rows.worlds.names[world]])),
        space=rows.space.as_dict(),
        success=success,
        noise=0.0,
        tried=tried,
    )


def campaign(robot: Robot, seed: int, allowed: float | None) -> Campaign:
    """Thirty trials, or as many as the risk allows."""
    rng = np.random.default_rng([seed, 9])
    sampler = FeatureKernelSampler(
        robot.table,
        seed=seed,
        success=robot.success,
        allowed_risk=None if allowed is None else {"fall": allowed},
    )
    study, fell, costs = optuna.create_study(sampler=sampler), list[bool](), [np.nan]
    for _ in range(TRIALS):
        try:
            trial = study.ask(dict(robot.space))
        except RiskError:
            break
        cost, has_fallen = robot.tried(trial.params)
        fell.append(has_fallen)
        if allowed is not None:
            trial.set_constraint("fall", 1.0 if has_fallen else -1.0)
        study.tell(trial, cost + robot.noise * rng.normal())
        costs.append(np.nan if has_fallen else cost)
    best = np.nan if np.isnan(costs).all() else float(np.nanmin(costs))
    return Campaign(np.array(fell, dtype=bool), best)


def table(name: str, robots: Iterator[Robot]) -> Iterator[str]:
    """What came of all of them, a line an allowed risk."""
    found = dict[float | None, list[Campaign]]()
    for place, robot in enumerate(robots):
        for allowed in (None, *ALLOWED):
            found.setdefault(allowed, []).append(campaign(robot, place, allowed))
    plain = found[None]
    for allowed, some in found.items():
        fell = np.concatenate([each.fell for each in some])
        refused = np.array([len(each.fell) < TRIALS for each in some])
        at_once = sum(not len(each.fell) for each in some)
        pairs = zip(some, plain, strict=True)
        ratios = np.array([each.best / other.best for each, other in pairs])
        known = ratios[np.isfinite(ratios)]
        said = "any" if allowed is None else f"{100 * allowed:.0f} %"
        said = f"{name} at {said}: "
        said += f"fell {percent(fell)} of {len(fell)}, "
        said += f"refused {refused.sum()} of {len(some)} ({at_once} at once)"
        if len(known):
            reach = 1.96 * known.std() / np.sqrt(len(known))
            said += (
                f", best cost of {len(known)} {percent(known)} (+- {100 * reach:.1f})"
            )
            said += f", median {100 * np.median(known):.1f} %"
        yield said


def percent(values: np.ndarray) -> str:
    """The mean, in words."""
    return f"{100 * values.mean():5.2f} %" if len(values) else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "kinds", nargs="+", help="like, unlike, oven, or a configuration"
    )
    parser.add_argument("--robots", type=int, default=100, help="of each kind")
    parser.add_argument("--seed", type=int, default=21)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore", ExperimentalWarning)
    warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
    drawn = {
        "like": partial(made_up, seed=args.seed, is_like=True),
        "unlike": partial(made_up, seed=args.seed, is_like=False),
        "oven": partial(ovens, seed=args.seed),
    }
    for name in args.kinds:
        robots = drawn.get(name, partial(of_store, kind=name))(args.robots)
        for line in table(name, robots):
            print(line, flush=True)


if __name__ == "__main__":
    main()

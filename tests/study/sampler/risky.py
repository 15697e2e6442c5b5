"""Campaigns that may risk little: falls, and what it costs to have fewer.

    python -m tests.study.sampler.risky --like 200 --unlike 50 --seed 21

On machines that are drawn as the worlds are, and on others (`campaigns`). Each has 30
trials for each allowed risk of a fall, and 30 of the sampler that is told of no risk.
Prints how many trials fell, how many campaigns were refused a trial (they end there),
and what the best trial after 30 truly costs, as a share of the cost that the sampler
without the limit has found: the mean, and the 95 % interval of it.
"""

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning

from study import FeatureKernelSampler, FeatureTable
from study.sampler.risk import RiskError
from study.sampler.worlds import limits_in_worlds
from tests.study.sampler.campaigns import FALL, TRIALS, Machine, machine_of

ALLOWED = (0.05, 0.1, 0.2)


@dataclass(frozen=True)
class Campaign:
    """What came of the trials on a machine.

    Attributes:
        fell: whether each trial fell, [t]; t < `TRIALS` where no candidate was within.
        best: what the best trial truly costs; NaN without one.
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


def campaign(machine: Machine, seed: int, allowed: float | None) -> Campaign:
    """Thirty trials, or as many as the risk allows."""
    rng = np.random.default_rng([seed, 9])
    risk = {} if allowed is None else {"allowed_risk": {"fall": allowed}}
    sampler = FeatureKernelSampler(
        knowing_falls(machine), seed=seed, success=machine.success, **risk
    )
    study, fell, costs = optuna.create_study(sampler=sampler), list[bool](), [np.nan]
    for _ in range(TRIALS):
        try:
            trial = study.ask(dict(machine.space))
        except RiskError:
            break
        u = np.array([list(trial.params.values())])
        cost = float(machine.truth.costs(u)[0])
        fell.append(falls(machine, u))
        if allowed is not None:
            trial.set_constraint("fall", 1.0 if fell[-1] else -1.0)
        study.tell(trial, cost + machine.noise * rng.normal())
        costs.append(cost)
    return Campaign(np.array(fell, dtype=bool), float(np.nanmin(costs)))


def table(machines: int, seed: int, *, is_like: bool) -> Iterator[str]:
    """What came of all of them, a line an allowed risk."""
    found = dict[float | None, list[Campaign]]()
    for place in range(machines):
        machine = machine_of("worlds", is_like=is_like, seed=1000 * seed + place)
        for allowed in (None, *ALLOWED):
            found.setdefault(allowed, []).append(campaign(machine, place, allowed))
    plain = found[None]
    for allowed, some in found.items():
        fell = np.concatenate([each.fell for each in some])
        ended = sum(len(each.fell) < TRIALS for each in some)
        pairs = zip(some, plain, strict=True)
        ratios = np.array([each.best / other.best for each, other in pairs])
        known = ratios[np.isfinite(ratios)]
        reach = 1.96 * known.std() / np.sqrt(max(len(known), 1))
        name = "any risk" if allowed is None else f"{100 * allowed:.0f} %"
        yield (
            f"{'like' if is_like else 'unlike':<8}{name:<10}"
            f"fell {100 * fell.mean():5.2f} % of {len(fell)}, "
            f"ended early {ended} of {len(some)}, "
            f"best cost {100 * known.mean():.1f} % (+- {100 * reach:.1f}), "
            f"median {100 * np.median(known):.1f} %"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--like", type=int, default=100, help="machines like the worlds"
    )
    parser.add_argument("--unlike", type=int, default=50, help="others")
    parser.add_argument("--seed", type=int, default=21)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore", ExperimentalWarning)
    for is_like, machines in ((True, args.like), (False, args.unlike)):
        for line in table(machines, args.seed, is_like=is_like):
            print(line, flush=True)


if __name__ == "__main__":
    main()

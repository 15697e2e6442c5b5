"""How well any test can tell by some readings that a machine is like no world.

    python -m tests.study.sampler.telling --machines 150 --seed 32

Machines of `campaigns`, as many like their worlds as unlike, have three trials each.
Beside the warning of the sampler, which knows twelve worlds, stands the likelihood ratio
of one who knows how machines of either kind are drawn (Neyman, Pearson 1933): no test
of readings that are off by `OFF` beside their noise finds more at as many false alarms.
Likelihoods are means over machines that are drawn for it.
"""

import argparse
import warnings

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from scipy.special import logsumexp

from study import FeatureKernelSampler
from tests.study.sampler.campaigns import Machine, Truth, machine_of

TRIALS, DRAWN, OFF = 3, 2000, 0.05
FALSE_ALARMS = 0.05


def tried(machine: Machine, seed: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Where the first trials were, [t, d], their readings, [t], and whether these warn."""
    rng = np.random.default_rng([seed, 7])
    sampler = FeatureKernelSampler(machine.table, seed=seed, success=machine.success)
    study = optuna.create_study(sampler=sampler)
    for _ in range(TRIALS):
        trial = study.ask(dict(machine.space))
        u = np.array([list(trial.params.values())])
        noise = machine.noise * rng.normal()
        study.tell(trial, float(machine.truth.costs(u)[0]) + noise)
    found = sampler.predict(study, [trial.params])
    places = np.array([list(each.params.values()) for each in study.trials])
    values = np.array([each.value for each in study.trials])
    return places, values, bool(found.unlike)


def likelihood(
    machine: Machine, u: np.ndarray, values: np.ndarray, *, is_like: bool
) -> float:
    """The logarithm of it, if the machine is one of its problem's that are drawn so."""
    rng = np.random.default_rng([is_like, 8])
    physics, off = machine.truth.physics, np.hypot(machine.noise, OFF)
    drawn = [Truth.drawn(physics, rng, is_like=is_like) for _ in range(DRAWN)]
    z = (np.array([truth.costs(u) for truth in drawn]) - values) / off
    return float(logsumexp(-0.5 * (z**2).sum(axis=1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=100, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore", ExperimentalWarning)
    warned, ratios = dict[bool, list[bool]](), dict[bool, list[float]]()
    for seed in range(1000 * args.seed, 1000 * args.seed + args.machines):
        for is_like in (True, False):
            machine = machine_of("worlds", is_like=is_like, seed=seed)
            u, values, is_warned = tried(machine, seed)
            unlike, like = (
                likelihood(machine, u, values, is_like=each) for each in (False, True)
            )
            warned.setdefault(is_like, []).append(is_warned)
            ratios.setdefault(is_like, []).append(unlike - like)
    most = np.quantile(ratios[True], 1.0 - FALSE_ALARMS)
    found = np.mean(np.array(ratios[False]) > most)
    print(
        f"After {TRIALS} trials, {args.machines} machines of each kind. The warning: "
        f"{np.mean(warned[False]):.0%} of the unlike, {np.mean(warned[True]):.0%} of "
        f"the others. Whoever knows both laws: {found:.0%} at {FALSE_ALARMS:.0%}."
    )


if __name__ == "__main__":
    main()

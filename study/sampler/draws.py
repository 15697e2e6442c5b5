"""Random numbers that depend on the seed, the purpose and the trial: on nothing else.

A study that is resumed, or continued by another process, therefore draws what it would
have drawn: also by the sampler here, whereas Optuna's own `RandomSampler` walks along
one stream.
"""

import secrets
import warnings
from enum import IntEnum
from typing import Any
from zlib import crc32

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import RandomSampler
from optuna.storages import RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial

from storage.inputs import checks


class Purpose(IntEnum):
    """The purpose of a draw: the first word of its spawn key. Numbers are never reused."""

    BODY = 0
    TERRAIN = 1
    STARTUP_ROW = 2
    GP_RESTARTS = 3
    TIE_BREAK = 4
    INDEPENDENT = 5
    CMAES = 6
    CMAES_MEAN = 7
    CANDIDATES = 8
    OFF_GRID = 9
    OFF_GRID_UTILITY = 10
    STARTUP_POINT = 11
    SAMPLER = 12
    WORLD = 13
    COST_NOISE = 14
    GOALS = 15
    HILL = 16


def stream(seed: int, purpose: Purpose, *key: int) -> np.random.SeedSequence:
    """The seed of one draw.

    Args:
        seed: of a study, or of the sampler.
        purpose: of the draw.
        *key: numbers that tell draws of one purpose apart, such as the run or the turn.
    """
    return np.random.SeedSequence(seed, spawn_key=(int(purpose), *key))


def generator(seed: int, purpose: Purpose, *key: int) -> np.random.Generator:
    """A fresh NumPy generator for one draw."""
    return np.random.default_rng(stream(seed, purpose, *key))


def seed_32bit(seed: int, purpose: Purpose, *key: int) -> int:
    """The seed of one draw for libraries that take 32 bits."""
    return int(stream(seed, purpose, *key).generate_state(1)[0])


def seed_64bit(seed: int, purpose: Purpose, *key: int) -> int:
    """The seed of one draw as a number of 64 bits, from which other draws follow."""
    return int(stream(seed, purpose, *key).generate_state(1, np.uint64)[0])


def name_key(name: str) -> int:
    """A parameter's name as a word of a spawn key, the same in every process."""
    return crc32(name.encode())


def turn(study: optuna.Study, trial: FrozenTrial) -> int:
    """The trial's number in a study in which nothing had ever been killed.

    A killed trial is run again under a new number (Optuna's retry callback does it).
    The repetition takes the turn of the original, and the trials after it are counted
    as if it were not there.
    """
    originals = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        for other in study.get_trials(deepcopy=False):
            if other.system_attrs:  # most have none, and the call takes time
                original = RetryHeartbeatStaleTrialCallback.retried_trial_number(other)
                if original is not None:
                    originals[other.number] = original
    number = originals.get(trial.number, trial.number)
    return number - sum(repetition < number for repetition in originals)


class ReproducibleRandomSampler(RandomSampler):
    """Optuna's `RandomSampler`, seeded anew for each parameter of each trial.

    Args:
        seed: of all draws; None takes one from the machine's entropy.
    """

    @checks.checked(seed=checks.optional(checks.whole(0, checks.LARGEST_SEED)))
    def __init__(self, *, seed: int | None = None) -> None:
        super().__init__()  # whose stream is never begun
        self._seed = secrets.randbits(64) if seed is None else seed

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """One uniform draw, seeded by the trial and the parameter's name."""
        key = (turn(study, trial), name_key(param_name))
        sampler = RandomSampler(seed=seed_32bit(self._seed, Purpose.INDEPENDENT, *key))
        return sampler.sample_independent(study, trial, param_name, param_distribution)

"""Uniform random search whose draws depend on the seed, the trial and the parameter's name only.

Optuna's own `RandomSampler` walks along one stream, so a resumed study would start it again.
"""

from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler, RandomSampler
from optuna.trial import FrozenTrial

from study.sampler.draws import Purpose, name_key, seed_32bit, turn
from taichi_nmm import checks


class ReproducibleRandomSampler(BaseSampler):
    """Optuna's `RandomSampler`, seeded anew for each parameter of each trial.

    Args:
        seed: of all draws; None takes one from the machine's entropy.
    """

    @checks.checked(seed=checks.optional(checks.whole(0, checks.LARGEST_SEED)))
    def __init__(self, *, seed: int | None = None) -> None:
        """Remember the seed; no stream is begun."""
        self._seed = new_seed() if seed is None else seed

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """Nothing: every parameter is drawn alone."""
        return {}

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Nothing: every parameter is drawn alone."""
        return {}

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

    def reseed_rng(self) -> None:
        """Nothing to do: threads differ by the trials that they run."""


def new_seed() -> int:
    """A seed from the machine's entropy, for those who do not name one."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0])

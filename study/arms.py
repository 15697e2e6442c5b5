"""The samplers that a study can be run with, by name."""

import warnings

import optuna
from optuna.distributions import FloatDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler
from optuna.trial import FrozenTrial

from study.config import StudyConfig
from study.draws import Purpose, generator, seed_32bit
from study.feature_table import FeatureTable
from study.sampler.dog_sampler import DoGSampler
from study.sampler.random_sampler import ReproducibleRandomSampler
from study.survival import SurvivalSampler, survival_table
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS, lower_bounds, upper_bounds

ARMS = ("dog", "best", "random", "cmaes")

SOURCE_TRIALS = 10  # Optuna's warm start takes the best tenth of them


def new_sampler(
    arm: str, config: StudyConfig, table: FeatureTable | None, turn: int
) -> BaseSampler:
    """The sampler of one trial, the `turn`-th; all arms but CMA-ES have the same for every trial.

    `table` is what `read_table` gives.

    CMA-ES keeps its state in the trials; a new object with a seed of its own for each trial makes
    it draw alike after a restart.
    """
    if arm in ("dog", "best"):
        if table is None:
            raise InputError("store", None, f"a store of scores, for the sampler {arm}")
        if arm == "best":
            return SurvivalSampler(table, seed=config.seed)
        return DoGSampler(table, seed=config.seed, n_startup_trials=config.startup_trials)
    if arm == "random":
        return ReproducibleRandomSampler(seed=config.seed)
    return _cmaes(config.seed, turn)


def read_table(arm: str, config: StudyConfig, store: str | None = None) -> FeatureTable | None:
    """The candidates of an arm: rows of `store`, or of the configuration's; None if it has none.

    Raises:
        InputError: no such store, or one without what the arm compares rows by.
    """
    if arm == "dog":
        path = store or config.store
        table = FeatureTable.from_parquet(path, features=[config.score])
    elif arm == "best":
        path = store or config.survival_store
        table = survival_table(path)
    else:
        return None
    others = [name for name in table.rows.space.as_dict() if name not in GAIN_NAMES]
    if others:
        raise InputError("store", str(path), f"a store of the 16 gains alone, without {others[0]}")
    return table


def _cmaes(seed: int, turn: int) -> BaseSampler:
    """CMA-ES from a random mean with a tenth of each range as its spread; trial 0 is random."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)  # source_trials
        return CmaEsSampler(
            source_trials=[_start(seed)] * SOURCE_TRIALS,
            independent_sampler=ReproducibleRandomSampler(seed=seed),
            warn_independent_sampling=False,
            seed=seed_32bit(seed, Purpose.CMAES, turn),
        )


def _start(seed: int) -> FrozenTrial:
    """The random mean, in the only form that Optuna takes without deprecation: a finished trial."""
    mean = generator(seed, Purpose.CMAES_MEAN).uniform(lower_bounds(), upper_bounds())
    return optuna.create_trial(
        params=dict(zip(GAIN_NAMES, mean.tolist(), strict=True)),
        distributions={gain.name: FloatDistribution(gain.low, gain.high) for gain in GAINS},
        value=0.0,
    )

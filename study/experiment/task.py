"""What an arm's sampler is made for."""

from dataclasses import dataclass

from study.experiment.experiment import Experiment
from study.experiment.stores import candidates
from study.features.feature_table import FeatureTable
from study.features.store_features import Feature, name_of


@dataclass(frozen=True)
class Task:
    """One study of an experiment, and, of samplers that are new every trial, one trial.

    Attributes:
        experiment: of the study.
        seed: of the sampler.
        turn: number of the trial.
        store: key of the arm's store; "" for none.
        features: of the arm.
    """

    experiment: Experiment
    seed: int
    turn: int
    store: str
    features: tuple[Feature, ...]

    @property
    def table(self) -> FeatureTable:
        """The arm's candidates and features."""
        return candidates(self.experiment, self.store, self.features)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(name_of(feature) for feature in self.features)

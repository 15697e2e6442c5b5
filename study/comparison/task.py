"""What a sampler of an experiment is made for."""

from dataclasses import dataclass

from study.comparison.experiment import Experiment
from study.comparison.stores import Tables
from study.feature_table import FeatureTable
from study.features import Feature, name_of


@dataclass(frozen=True, eq=False)
class Task:
    """One study of an experiment, and, of samplers that are new every trial, one trial.

    Attributes:
        experiment: of the study.
        seed: of the sampler.
        turn: number of the trial.
        tables: of the process.
        store: key of the arm's store; "" for none.
        features: of the arm.
    """

    experiment: Experiment
    seed: int
    turn: int
    tables: Tables
    store: str
    features: tuple[Feature, ...]

    @property
    def table(self) -> FeatureTable:
        """The arm's candidates and features."""
        return self.tables.get(self.store, self.features)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(name_of(feature) for feature in self.features)

"""A study in a database, which others may write to as well.

Optuna's CMA-ES keeps its state in the trials, pickled, and whatever is unpickled may run anything.
So a sampler of such a library never sees a study of a database: it is asked in a twin, a study in
memory that this process has made and told the same trials, and what it proposes there is suggested
here.
"""

import math
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler, RandomSampler
from optuna.trial import FrozenTrial

from study.experiment.arms import Arm
from study.experiment.experiment import Experiment
from study.experiment.one_study import OneStudy


class LiveStudy(OneStudy):
    """An arm in a run, over a study of a database.

    Args:
        experiment: of the study.
        arm: that proposes its trials.
        run: whose body and ground it is about.
        study: where its trials are kept.

    Raises:
        InputError: trials of an arm that is replayed are not those that it proposes.
    """

    def __init__(self, experiment: Experiment, arm: Arm, run: int, study: optuna.Study) -> None:
        """The study as it stands; a twin is told its trials."""
        super().__init__(experiment, arm, run, study)
        self._names = experiment.names
        self._given: BaseSampler | None = None
        self._twin = OneStudy(experiment, arm, run) if arm.replayed else None
        if self._twin is not None:
            for trial in self.finished():
                gains = [trial.params.get(name, math.nan) for name in self._names]
                self._twin.restore(gains, trial.values[0], {})

    def ask(self) -> list[float]:
        """As of any study.

        Raises:
            InputError: the trial was queued by somebody else, who fixed other gains.
        """
        if self._twin is None:
            return super().ask()
        proposed = self._twin.ask()
        self._given = GivenSampler(dict(zip(self._names, proposed, strict=True)))
        asked = super().ask()
        self.require_proposed(asked, proposed)
        return asked

    def _sampler_of_turn(self) -> BaseSampler:
        return self._given or super()._sampler_of_turn()

    def _tell(self, cost: float, attributes: dict[str, Any]) -> FrozenTrial:
        if self._twin is not None:
            self._twin._tell(cost, {})
        return super()._tell(cost, attributes)


class GivenSampler(RandomSampler):
    """Proposes what it is given.

    Args:
        values: by name.
    """

    def __init__(self, values: dict[str, float]) -> None:
        """Nothing is drawn."""
        super().__init__(seed=0)
        self._values = values

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """The value of that name."""
        return self._values[param_name]

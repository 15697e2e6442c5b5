"""A study: an arm in a run of an experiment. It proposes its next trial, and is told of it.

The study is in memory, one of many, or in a database, alone and live (`LiveStudy`): the
same arm, run and experiment give the same trials in both.
"""

import math
import warnings
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, PartialFixedSampler, RandomSampler
from optuna.trial import FrozenTrial, TrialState, create_trial

from storage.inputs.errors import InputError
from study.experiment.arms import Arm
from study.experiment.experiment import Experiment, Floats
from study.experiment.samplers import Task
from study.sampler.diagnostics import TITLE, WORLDS_TITLE, Likeness, Worth
from study.sampler.policy import one_thread
from study.sampler.sampler import FeatureKernelSampler

FELL_ATTRIBUTE = "fell"  # of a trial: whether it did not last
COST_ATTRIBUTE = "cost"  # of a trial that was told with noise: its cost without
SHOWN_ATTRIBUTE = "shown"  # of a trial: the features that it showed itself


class OneStudy:
    """An arm in a run, over a study of this project's making; None: a new one in memory."""

    def __init__(
        self,
        experiment: Experiment,
        arm: Arm,
        run: int,
        study: optuna.Study | None = None,
    ) -> None:
        self.arm = arm
        self.run = run
        costs = len(experiment.objective.each)
        self.study = study or optuna.create_study(directions=["minimize"] * costs)
        self.trials = len(self.finished())
        self.experiment = experiment
        # A sampler that keeps a state in itself is handed on with its study.
        self._sampler = study.sampler if study and keeps_state(arm) else None
        self.asked: optuna.Trial  # the last one, once there is one

    def finished(self) -> list[FrozenTrial]:
        """The finished trials, in the order of their numbers."""
        return finished_trials(self.study)

    def ask(self) -> list[float]:
        """The next trial's parameters, as the simulator's numbers in their order."""
        space = self.experiment.space
        with one_thread():
            self.study.sampler = self._sampler_of_turn()
            self.asked = self.study.ask(space)
            params = self.asked.params
            return [of.to_internal_repr(params[name]) for name, of in space.items()]

    def noted(self) -> dict[str, Any]:
        """The attributes that the sampler gave the trial that was asked for."""
        # Not the trial's own: it does not hold what samplers write into the storage.
        return dict(self.study.get_trials(deepcopy=False)[self.asked.number].user_attrs)

    def tell(self, values: list[float], attributes: dict[str, Any]) -> FrozenTrial:
        """Finish the trial that was asked for.

        Args:
            values: its costs as the sampler is told them, finite, [k].
            attributes: what is `shown` of it, and more for readers of the study.
        """
        for name, value in attributes.items():
            self.asked.set_user_attr(name, value)
        with one_thread():
            told = self.study.tell(self.asked, values)
        self.trials += 1
        return told

    def shown(self, row: np.void, costs: Floats) -> dict[str, Any]:
        """Attributes by which samplers learn from a trial; with noise, its cost without.

        Args:
            row: of the simulator.
            costs: without noise, [k].
        """
        rows, feature = np.array([row]), self.arm.feature
        found: dict[str, Any] = {FELL_ATTRIBUTE: bool(self.experiment.fell(rows)[0])}
        if feature in self.experiment.kept:
            found[SHOWN_ATTRIBUTE] = [float(row[feature])]
        if self.experiment.noise:
            found[COST_ATTRIBUTE] = float(costs[0])
        return found

    def hand_on(self) -> optuna.Study:
        """The study for another process, which makes its sampler anew: some do not pickle."""
        if not keeps_state(self.arm):
            self._sampler = None
            self.study.sampler = RandomSampler(seed=0)
        return self.study

    def restore(
        self, gains: list[float], values: list[float], noted: dict[str, Any]
    ) -> None:
        """Add a trial of an earlier session; where the library keeps a state, by asking again.

        It has searched parameters, costs [k], and all user attributes that it had.

        Raises:
            InputError: the sampler now proposes other gains.
        """
        if self.arm.replayed:
            self.require_proposed(gains, self.ask())
            own = self.noted()
            self.tell(
                values,
                {name: value for name, value in noted.items() if name not in own},
            )
            return
        self.study.add_trial(
            create_trial(
                params=params_of(self.experiment, gains),
                distributions=dict(self.experiment.space),
                values=values,
                user_attrs=noted,
            )
        )
        self.trials += 1

    def require_proposed(self, gains: list[float], proposed: list[float]) -> None:
        """Refuse gains of the next trial other than those proposed for it.

        Raises:
            InputError: naming the trial.
        """
        if gains != proposed:
            where = f"{self.arm.name}, run {self.run}, trial {self.trials}"
            allowed = "the gains that the sampler proposes there; use another --out or --storage"
            raise InputError(where, "other gains", allowed)

    def _sampler_of_turn(self) -> BaseSampler:
        if self._sampler is None or self.arm.fresh:
            self._sampler = new_sampler(
                self.experiment, self.arm, self.run, self.trials
            )
        return self._sampler


def new_sampler(
    experiment: Experiment, arm: Arm, run: int, turn: int = 0
) -> BaseSampler:
    """The sampler of an arm in a run, for its trial of this number."""
    seed = experiment.sampler_seed(arm.name, run)
    return arm.new_sampler(Task(experiment, seed, turn, arm.store, arm.feature))


def finished_trials(study: optuna.Study) -> list[FrozenTrial]:
    """The finished trials of a study, in the order of their numbers."""
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def best_cost(experiment: Experiment, study: optuna.Study) -> float:
    """What the finished trials have reached together, without noise: `Objective.best`."""
    if not experiment.objective.goals and not experiment.noise:
        return study.best_value
    costs = [
        [trial.user_attrs[COST_ATTRIBUTE]] if experiment.noise else trial.values
        for trial in finished_trials(study)
    ]
    return experiment.objective.best(np.array(costs))


def keeps_state(arm: Arm) -> bool:
    """Whether the arm's sampler keeps a state in itself, which no new one has."""
    return arm.replayed and not arm.fresh


def params_of(experiment: Experiment, point: list[float]) -> dict[str, Any]:
    """Parameters as a study has them, from the simulator's numbers."""
    return {
        name: of.to_external_repr(number)
        for (name, of), number in zip(experiment.space.items(), point, strict=True)
    }


def point_of(experiment: Experiment, trial: FrozenTrial) -> list[float]:
    """The parameters of a trial as the simulator's numbers; NaN for one that it lacks."""
    return [
        of.to_internal_repr(trial.params[name]) if name in trial.params else math.nan
        for name, of in experiment.space.items()
    ]


class LiveStudy(OneStudy):
    """An arm in a run, over a study of a database, to which others may write as well.

    Optuna's CMA-ES keeps its state in the trials, pickled, and unpickling may run any
    code. So a sampler of such a library never sees a study of a database. It proposes
    in a twin, a study in memory that this process has made and told the same trials,
    and its proposal is suggested here.

    Raises:
        InputError: trials of an arm that is replayed are not those that it proposes.
    """

    def __init__(
        self, experiment: Experiment, arm: Arm, run: int, study: optuna.Study
    ) -> None:
        super().__init__(experiment, arm, run, study)
        self._given: dict[str, Any] = {}
        self._twin = OneStudy(experiment, arm, run) if arm.replayed else None
        if self._twin is not None:
            for trial in self.finished():
                self._twin.restore(point_of(experiment, trial), trial.values, {})

    def ask(self) -> list[float]:
        """As of any study.

        Raises:
            InputError: the trial was queued by somebody else, who fixed other gains.
        """
        if self._twin is None:
            return super().ask()
        proposed = self._twin.ask()
        self._given = params_of(self.experiment, proposed)
        asked = super().ask()
        self.require_proposed(asked, proposed)
        return asked

    def _sampler_of_turn(self) -> BaseSampler:
        if self._twin is None:
            return super()._sampler_of_turn()
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            return PartialFixedSampler(self._given, RandomSampler(seed=0))

    def tell(self, values: list[float], attributes: dict[str, Any]) -> FrozenTrial:
        """As of any study."""
        if self._twin is not None:
            attributes = self._twin.noted() | attributes  # such as the row
            self._twin.tell(values, {})
        return super().tell(values, attributes)


def worth_of_study(
    experiment: Experiment, arm: Arm, run: int, study: optuna.Study
) -> Worth | Likeness | None:
    """The worth of the arm's feature or worlds in the trials of its study; None: it has none.

    Of several goals there is none: the dashboard draws their front by itself.
    """
    if experiment.objective.goals or arm.kind != "ours":
        return None
    sampler = new_sampler(experiment, arm, run) if arm.store else None
    if not isinstance(sampler, FeatureKernelSampler) or not sampler.has_features:
        return None
    return sampler.worth(study)


def note_worth(experiment: Experiment, arm: Arm, run: int, study: optuna.Study) -> None:
    """Show the worth with the study, in place of an earlier one; a note of the user's stays."""
    worth = worth_of_study(experiment, arm, run, study)
    if worth is None:
        return
    # a second, which other studies need not spend
    from optuna_dashboard import get_note, save_note

    known, note = get_note(study), worth.markdown()
    if note != known and (
        not known or known.startswith((f"## {TITLE}", f"## {WORLDS_TITLE}"))
    ):
        save_note(study, note)

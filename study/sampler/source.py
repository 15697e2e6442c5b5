"""Where proposals come from: what the two kinds of sources have in common."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState
from threadpoolctl import ThreadpoolController

from study.draws import Purpose, generator
from study.sampler.acquisition import Constants, Model
from study.sampler.diagnostics import Present
from study.sampler.evidence import Evidence, read_limits
from study.sampler.gp import NEARNESS, Kernel
from study.sampler.history import History
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.proposals import Proposals
from study.sampler.transforms import Guess, is_doubtful
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One proposal: a row of a table, or (row -1) a point off it, with its features."""

    row: int
    parameters: Floats
    features: Floats


class Source(ABC):
    """A maker of proposals for the trials of any study.

    Attributes:
        options: of the sampler.
        seed: of the sampler.
        independent: sampler for what is not proposed here.
        constants: learned in this process.
        proposals: for the trials that run in this process.
    """

    def __init__(self, options: Options, seed: int, independent: BaseSampler) -> None:
        self.options = options
        self.seed = seed
        self.independent = independent
        self.constants = Constants()
        self.proposals = Proposals()
        self._said: set[str] = set()

    @abstractmethod
    def search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """What `propose` will give values for: distributions by name."""

    @abstractmethod
    def propose(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Values of all parameters of the search space."""

    @abstractmethod
    def propose_one(
        self, study: optuna.Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """The value of one parameter that `propose` has not given."""

    @abstractmethod
    def present(self, study: optuna.Study) -> Present | None:
        """What is known of the features at present; None: nothing, there is no trial.

        Raises:
            InputError: of the feature function.
        """

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:  # noqa: B027
        """What is to be noted at a trial's start, before anything is asked for: nothing."""

    def after(self, study: optuna.Study, trial: FrozenTrial, state: TrialState) -> None:
        """Take back what was noted in the trial if something else was run."""
        proposal = self.proposals.take(trial)
        if proposal is not None and not proposal.was_run(trial.params):
            set_attributes(study, trial, dict.fromkeys(proposal.notes))

    def __getstate__(self) -> dict[str, Any]:
        """Without learned constants, which another process computes again."""
        return self.__dict__ | {"constants": Constants()}

    def model(
        self,
        guess: Guess | None,
        parameters: int,
        history: History,
        seen: Points,
        running: Points,
        own_turn: int,
    ) -> Model:
        """The model of one trial, after the trials of a history, at the points where they were."""
        evidence = Evidence(seen, history.cost, read_limits(history.trials), running)
        kernel: Kernel = self.options.model
        kept = history.cost[evidence.feasible]
        if self.options.learns_trust and is_doubtful(kept, own_turn, guess is not None):
            kernel, guess = NEARNESS, None
        return Model(kernel, guess, parameters, evidence, self.constants)

    def rng(self, purpose: Purpose, turn: int) -> np.random.Generator:
        """The generator of one draw of one trial."""
        return generator(self.seed, purpose, turn)

    def draw(
        self, study: optuna.Study, trial: FrozenTrial, space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """All parameters of a space from the independent sampler."""
        return {
            name: self.independent.sample_independent(study, trial, name, distribution)
            for name, distribution in space.items()
        }

    def misfit(self, error: InputError) -> None:
        """Refuse what does not fit, or, where that was asked for, say so once and go on."""
        if self.options.strict:
            raise error
        self.warn(f"{error}; the independent sampler takes over")

    def warn(self, message: str) -> None:
        """Once a sampler and kind of message."""
        kind = message.split(":")[0]
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(message, UserWarning, stacklevel=2)


def one_thread() -> AbstractContextManager[Any]:
    """BLAS on one thread: on these sizes more are slower, and workers are parallel already."""
    return _thread_pools().limit(limits=1, user_api="blas")  # type: ignore[no-any-return]


@cache
def _thread_pools() -> ThreadpoolController:
    """The libraries of this process, looked for once."""
    return ThreadpoolController()


def set_attributes(study: optuna.Study, trial: FrozenTrial, attributes: dict[str, Any]) -> None:
    """Leave notes in a running trial: samplers are given no public way, Optuna's own do this."""
    for key, value in attributes.items():
        study._storage.set_trial_user_attr(trial._trial_id, key, value)


def missing_in(
    names: Sequence[str], study: optuna.Study, before: FrozenTrial, ours: str | None
) -> InputError | None:
    """An error if the latest finished trial that was proposed here lacks a parameter.

    `ours` is the user attribute that tells proposals of this sampler; None takes any trial.
    """
    for trial in reversed(study.get_trials(deepcopy=False)):
        if trial.number == before.number or not trial.state.is_finished():
            continue
        if trial.values is None or (ours is not None and ours not in trial.user_attrs):
            continue
        for name in names:
            if name not in trial.params:
                allowed = f"an objective that suggests all of {', '.join(names)}"
                return InputError(name, f"not suggested in trial {trial.number}", allowed)
        return None
    return None

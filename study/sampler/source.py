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
from study.sampler.evidence import Evidence, read_limits
from study.sampler.history import History
from study.sampler.kernels import feature_only
from study.sampler.mismatch import Mismatch, read_shown
from study.sampler.model import Constants, Model
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.proposals import Proposals
from study.sampler.rows import Scale
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

    def kernel(self, turn: int) -> str:
        """The kernel of a trial: "alternate" is two of them."""
        if self.options.kernel != "alternate":
            return self.options.kernel
        return "rbf_ard" if turn % 2 == 0 else "euclidean"

    def needs_coordinates(self, kernel: str) -> bool:
        """Whether parameters are looked at, and not features alone."""
        return not feature_only(kernel) or self.options.mismatch is not None

    def model(
        self, kernel: str, parameters: int, history: History, seen: Points, running: Points
    ) -> Model:
        """The model after the trials of a history, at the points where they were seen."""
        limits = read_limits(history.trials, self.options.feasibility)
        if self.options.feasibility is not None and not np.isfinite(limits).any():
            self._warn_silent(history, "feasibility", self.options.feasibility)
        evidence = Evidence(seen, history.cost, limits, running)
        return Model(self.options, kernel, parameters, evidence, self.constants)

    def correction(
        self, history: History, simulated: Points, scale: Scale, parameters: int
    ) -> tuple[Mismatch | None, Points]:
        """The mismatch learned from finished trials, and these as they showed themselves."""
        if self.options.mismatch is None:
            return None, simulated
        width = simulated.features.shape[1]
        reported = read_shown(history.trials, self.options.mismatch, width)
        known = np.asarray(np.isfinite(reported).all(axis=1))
        if not known.any():
            self._warn_silent(history, "mismatch", f"{self.options.mismatch}, {width} numbers")
        shown = np.where(known[:, None], scale.standard(reported), np.nan)
        found = Mismatch.fit(simulated, shown, parameters, self.options.fast)
        if found is None:
            return None, simulated
        corrected = found.corrected(simulated).features
        features = np.where(known[:, None], shown, corrected)
        return found, Points(features, simulated.coordinates)

    def _warn_silent(self, history: History, option: str, wanted: str) -> None:
        """Once start-up is over: an option that no finished trial has given anything to."""
        if len(history.trials) >= self.options.n_startup_trials:
            self.warn(f"{option} is left out: no finished trial reports it ({wanted})")

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


def gumbel_choice(log_weight: Floats, rng: np.random.Generator) -> int:
    """One index, drawn with probability in proportion to exp(log_weight) (Gumbel 1954)."""
    return int(np.argmax(log_weight + rng.gumbel(size=len(log_weight))))


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

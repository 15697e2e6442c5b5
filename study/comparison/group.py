"""Some of an experiment's studies: each proposes its next trial, and is told what became of it."""

import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
import pyarrow as pa
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler

from study.comparison.arms import Arm, find_arm
from study.comparison.experiment import Experiment
from study.comparison.outcome import fell
from study.comparison.results import NOTES, gains_of
from study.comparison.stores import Tables
from study.comparison.task import Task
from study.draws import Purpose, name_key, seed_64bit
from study.sampler.history import OFF_TABLE, ROW_ATTRIBUTE
from study.sampler.source import one_thread
from taichi_nmm.errors import InputError
from taichi_nmm.result import COMPLETED, END_REASONS

Floats = NDArray[np.float64]
Key = tuple[str, int]  # arm, run

FELL_ATTRIBUTE = "fell"  # for samplers with feasibility="fell"
SHOWN_ATTRIBUTE = "shown"  # for samplers with mismatch="shown"


@dataclass(frozen=True, eq=False)
class Proposals:
    """The next trial of each of n studies.

    Attributes:
        study: its number in the experiment's list of studies, [n].
        gains: [n, 16 + k].
        notes: what the sampler noted in each trial, [n].
        seconds: what the sampler took for each, [n].
    """

    study: NDArray[np.int64]
    gains: Floats
    notes: list[dict[str, Any]]
    seconds: Floats

    @property
    def row(self) -> NDArray[np.int64]:
        """Of the arm's store, OFF_TABLE where it is none, [n]."""
        rows = [notes.get(ROW_ATTRIBUTE, OFF_TABLE) for notes in self.notes]
        return np.array(rows, dtype=np.int64)


def sampler_seed(experiment_seed: int, arm: str, run: int) -> int:
    """The seed of a study's sampler: it depends on experiment, arm and run, and nothing else."""
    return seed_64bit(experiment_seed, Purpose.SAMPLER, name_key(arm), run)


class OneStudy:
    """An arm in a run, as an Optuna study in memory."""

    def __init__(self, experiment: Experiment, key: Key, tables: Tables) -> None:
        """An empty study; its sampler is made with its first trial."""
        self.arm: Arm = find_arm(key[0])
        self.run = key[1]
        self._experiment = experiment
        self._tables = tables
        self._seed = sampler_seed(experiment.seed, *key)
        self._sampler: BaseSampler | None = None
        self._study = optuna.create_study(direction="minimize")
        self._asked: optuna.Trial | None = None
        self.trials = 0

    def ask(self) -> tuple[list[float], dict[str, Any]]:
        """The next trial's searched parameters, and what its sampler noted."""
        self._study.sampler = self._sampler_of_turn()
        trial = self._study.ask()
        gains = [
            trial.suggest_float(name, distribution.low, distribution.high)
            for name, distribution in self._experiment.space.items()
        ]
        self._asked = trial
        # Not the trial's own: it does not hear of what samplers write into the storage.
        noted = self._study.get_trials(deepcopy=False)[trial.number].user_attrs
        return gains, dict(noted)

    def tell(self, cost: float, shown: dict[str, Any]) -> None:
        """What became of the trial that was asked for."""
        assert self._asked is not None  # told only what was asked
        for name, value in shown.items():
            self._asked.set_user_attr(name, value)
        self._study.tell(self._asked, cost)
        self._asked = None
        self.trials += 1

    def restore(self, gains: list[float], cost: float, noted: dict[str, Any]) -> None:
        """Add a trial of an earlier session; where the library keeps a state, by asking again."""
        if not self.arm.replayed:
            space = self._experiment.space
            self._study.add_trial(
                optuna.create_trial(
                    params=dict(zip(space, gains, strict=True)),
                    distributions=dict(space),
                    value=cost,
                    user_attrs=noted,
                )
            )
            self.trials += 1
            return
        asked, own = self.ask()
        if asked != gains:
            where = f"{self.arm.name}, run {self.run}, trial {self.trials}"
            allowed = "the gains that the sampler proposes there; use another --out"
            raise InputError(where, "other gains", allowed)
        self.tell(cost, {name: value for name, value in noted.items() if name not in own})

    def _sampler_of_turn(self) -> BaseSampler:
        if self._sampler is None or self.arm.fresh:
            task = Task(
                self._experiment,
                self._seed,
                self.trials,
                self._tables,
                self.arm.store,
                self.arm.features,
            )
            self._sampler = self.arm.new_sampler(task)
        return self._sampler


class StudyGroup:
    """A share of the studies, by their numbers in the experiment's list.

    Args:
        experiment: of all.
        studies: arm and run of each, by number.
        trials: that each is to have.
    """

    def __init__(self, experiment: Experiment, studies: dict[int, Key], trials: int) -> None:
        """Empty studies."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", ExperimentalWarning)
        self._trials = trials
        self._experiment = experiment
        self._tables = Tables(experiment)
        self._studies = {n: OneStudy(experiment, key, self._tables) for n, key in studies.items()}
        self._asked: list[OneStudy] = []

    def restore(self, known: dict[str, pa.Table]) -> None:
        """Add the trials of earlier sessions, by arm."""
        by_key = {(study.arm.name, study.run): study for study in self._studies.values()}
        for arm, table in known.items():
            keys = [(arm, run) for run in table["run"].to_pylist()]
            ours = np.array([key in by_key for key in keys], dtype=bool)
            some = table.filter(pa.array(ours))
            gains = gains_of(self._experiment, some).tolist()
            shown = shown_of(find_arm(arm), some)
            keys = [key for key, wanted in zip(keys, ours, strict=True) if wanted]
            costs, notes = some["cost"].to_pylist(), some[NOTES].to_pylist()
            with one_thread():
                for place, key in enumerate(keys):
                    noted = json.loads(notes[place]) | shown[place]
                    by_key[key].restore(gains[place], costs[place], noted)

    def propose(self) -> Proposals:
        """The next trial of each study that has not all its trials."""
        open_studies = {n: s for n, s in self._studies.items() if s.trials < self._trials}
        self._asked = list(open_studies.values())
        gains, notes, seconds = [], [], []
        with one_thread():
            for study in self._asked:
                began_s = time.perf_counter()
                asked, noted = study.ask()
                seconds.append(time.perf_counter() - began_s)
                gains.append(asked)
                notes.append(noted)
        width = len(self._experiment.names)
        return Proposals(
            np.array(list(open_studies), dtype=np.int64),
            np.array(gains, dtype=np.float64).reshape(len(gains), width),
            notes,
            np.array(seconds, dtype=np.float64),
        )

    def tell(self, costs: Floats, outcomes: NDArray[np.void]) -> None:
        """What became of them, in their order: costs [n] and result rows [n]."""
        down = fell(outcomes)
        with one_thread():
            for place, study in enumerate(self._asked):
                shown: dict[str, Any] = {FELL_ATTRIBUTE: bool(down[place])}
                features = study.arm.columns
                if _are_shown(features, outcomes.dtype.names or ()):
                    row = outcomes[place]
                    shown[SHOWN_ATTRIBUTE] = [float(row[name]) for name in features]
                study.tell(float(costs[place]), shown)


def shown_of(arm: Arm, table: pa.Table) -> list[dict[str, Any]]:
    """What trials of an earlier session had shown, as `tell` notes it, [n]."""
    completed = END_REASONS[COMPLETED]
    shown: list[dict[str, Any]] = [
        {FELL_ATTRIBUTE: reason != completed} for reason in table["end_reason"].to_pylist()
    ]
    if _are_shown(arm.columns, table.column_names):
        columns = [table[name].to_numpy().astype(np.float64) for name in arm.columns]
        for place, values in enumerate(np.column_stack(columns).tolist()):
            shown[place][SHOWN_ATTRIBUTE] = values
    return shown


def _are_shown(features: Sequence[str], known: Sequence[str]) -> bool:
    """Whether a trial shows all features of an arm."""
    return bool(features) and all(name in known for name in features)

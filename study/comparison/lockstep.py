"""The experiment's loop: every study proposes, one batch is simulated, every study is told."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from study.comparison.experiment import Experiment
from study.comparison.folder import ExperimentFolder
from study.comparison.group import Key, Proposals
from study.comparison.outcome import costs, finite
from study.comparison.pool import Pool
from study.comparison.results import RESULT_SCHEMA, STATE_SCHEMA, in_order, state_table
from study.comparison.simulation import simulate_trials

CHECKPOINT_S = 20.0


@dataclass(frozen=True)
class Progress:
    """How far an experiment is.

    Attributes:
        trials: finished, those of earlier sessions included.
        total: that there are to be.
        studies: that there are.
        walkers: studies with a trial that walked.
        round: of this session.
    """

    trials: int
    total: int
    studies: int
    walkers: int
    round: int


@dataclass
class Lockstep:
    """All studies of an experiment, going forward together.

    Attributes:
        experiment: what is compared on what.
        studies: arm and run of each.
        folder: where finished trials go.
        checkpointed: called after each checkpoint on the way.
    """

    experiment: Experiment
    studies: list[Key]
    folder: ExperimentFolder
    checkpointed: Callable[[], None] = lambda: None
    _tables: dict[str, list[pa.Table]] = field(default_factory=dict)
    _new: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Read what is finished."""
        for arm in dict.fromkeys(arm for arm, _ in self.studies):
            self._tables[arm] = [self.folder.read_arm(arm)]
        self._done = np.zeros(len(self.studies), dtype=np.int64)
        self._best = np.full(len(self.studies), np.inf)
        self._walked = np.zeros(len(self.studies), dtype=bool)
        numbers = {key: number for number, key in enumerate(self.studies)}
        for arm, (table,) in self._tables.items():
            self._count(table, [numbers.get((arm, run)) for run in table["run"].to_pylist()])

    @property
    def finished(self) -> int:
        """Trials of all studies."""
        return int(self._done.sum())

    def results(self) -> pa.Table:
        """Finished trials of the session's arms, `RESULT_SCHEMA`."""
        tables = [table for tables in self._tables.values() for table in tables]
        return in_order([STATE_SCHEMA.empty_table(), *tables]).select(RESULT_SCHEMA.names)

    def run(self, trials: int, workers: int, report: Callable[[Progress], None]) -> None:
        """Go on until every study has `trials` trials; finished rounds are kept whatever happens.

        Raises:
            InputError: what a sampler or the simulator refuses, or a folder that is full.
            KeyboardInterrupt: between the simulator's chunks.
        """
        total = int(np.maximum(self._done, trials).sum())
        unfinished = np.flatnonzero(self._done < trials)
        number = 0
        report(self._progress(total, number))
        if not len(unfinished):
            return
        known = {arm: tables[0] for arm, tables in self._tables.items()}
        some = [self.studies[n] for n in unfinished]
        with Pool(self.experiment, some, trials, known, workers) as pool:
            written_s = time.monotonic()
            try:
                while len((asked := pool.propose()).study):
                    number += 1
                    self._round(pool, asked, unfinished[asked.study])
                    report(self._progress(total, number))
                    if time.monotonic() - written_s >= CHECKPOINT_S:
                        self.checkpoint()
                        self.checkpointed()
                        written_s = time.monotonic()
            finally:
                self.checkpoint()

    def checkpoint(self) -> None:
        """Commit the arms that have new trials."""
        for arm in sorted(self._new):
            table = in_order([STATE_SCHEMA.empty_table(), *self._tables[arm]])
            self._tables[arm] = [table]
            self.folder.write_arm(arm, table)
        self._new.clear()

    def _round(self, pool: Pool, asked: Proposals, number: np.ndarray) -> None:
        """Simulate one trial of each study, write it down, tell."""
        runs = np.array([self.studies[n][1] for n in number], dtype=np.int64)
        rows = finite(simulate_trials(self.experiment, runs, asked.gains).rows)
        cost = costs(rows, self.experiment.cost)
        columns = {
            "arm": np.array([self.studies[n][0] for n in number]),
            "run": runs,
            "trial": self._done[number],
            "row": asked.row,
            "cost": cost,
            "best_cost": np.minimum(self._best[number], cost),
            "proposal_s": asked.seconds,
            "notes": asked.notes,
            "rows": rows,
        }
        self._add(state_table(self.experiment, columns, asked.gains), number)
        pool.tell(cost, rows)

    def _add(self, table: pa.Table, number: np.ndarray) -> None:
        """Keep a finished round, all of it."""
        arms = table["arm"].to_numpy(zero_copy_only=False)
        parts = {arm: table.filter(pa.array(arms == arm)) for arm in set(arms)}
        for arm, part in parts.items():
            self._tables[arm].append(part)
            self._new.add(arm)
        self._count(table, number.tolist())

    def _count(self, table: pa.Table, numbers: list[int | None]) -> None:
        """Take finished trials into account, one study each; None is no study of this session."""
        known = np.array([n is not None for n in numbers], dtype=bool)
        number = np.array([n for n in numbers if n is not None], dtype=np.int64)
        np.add.at(self._done, number, 1)
        np.minimum.at(self._best, number, table["cost"].to_numpy()[known])
        walked = table["walked"].to_numpy(zero_copy_only=False)[known]
        self._walked[number[walked.astype(bool)]] = True

    def _progress(self, total: int, number: int) -> Progress:
        done = int(self._done.sum())
        return Progress(done, total, len(self.studies), int(self._walked.sum()), number)

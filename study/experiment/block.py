"""A block of an experiment's studies: all propose, one batch is simulated, all are told, and again.

A block is the unit of work of a comparison. It depends on nothing but its own fields,
so blocks go on side by side in any process, and no result depends on how studies are
cut into blocks.
"""

import json
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import optuna
import pyarrow as pa
from optuna.exceptions import ExperimentalWarning

from study.experiment.arms import find_arm
from study.experiment.experiment import WALKED, Experiment, Floats, Rows
from study.experiment.folder import (
    MEASURED,
    NOTES,
    PROPOSAL_TIME,
    Key,
    by_study,
    walkers,
)
from study.experiment.one_study import OneStudy, best_cost
from study.sampler.history import OFF_TABLE, ROW_ATTRIBUTE


class Walks:
    """Results of walks by run and point: a walk that several arms try in a run is simulated once.

    Arms that read one store often propose the same row. All arms have the same robot in
    a run, and a walk has the same bits in any batch, so one walk stands for all.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[int, bytes], tuple[np.void, Floats]] = {}

    def add(
        self, runs: Sequence[int], points: Floats, rows: Rows, costs: Floats
    ) -> None:
        """Keep n walks: runs [n], points [n, p], rows [n], costs [n, k]."""
        for run, tried, row, cost in zip(runs, points, rows, costs, strict=True):
            self._found.setdefault((run, tried.tobytes()), (row.copy(), cost))

    def walk(
        self, experiment: Experiment, runs: Sequence[int], points: Floats
    ) -> tuple[Rows, Floats]:
        """Of n trials rows, finite, [n], and costs [n, k]; new ones are simulated."""
        keys = [(run, tried.tobytes()) for run, tried in zip(runs, points, strict=True)]
        new = [
            k
            for k, key in enumerate(keys)
            if key not in self._found and key not in keys[:k]
        ]
        if new:
            tried = [runs[place] for place in new]
            rows = experiment.simulate(tried, points[new])
            self.add(tried, points[new], rows, experiment.objective.values(rows))
        found = [self._found[key] for key in keys]
        rows = np.array([row for row, _ in found])
        costs = np.array([cost for _, cost in found])
        return rows, costs


@dataclass(frozen=True)
class Block:
    """Some studies as they stand, and how many trials each is to have.

    Attributes:
        experiment: that the studies belong to.
        studies: by arm and run.
        known: their finished trials, `state_schema`; of studies that are handed on,
            none.
        trials: that each study is to have in total.
        handed_on: the studies of an earlier `Advanced`; empty: they are made of the
            known trials.
        walks: of that `Advanced`; they are not simulated again.
    """

    experiment: Experiment
    studies: tuple[Key, ...]
    known: pa.Table
    trials: int
    handed_on: tuple[optuna.Study, ...] = ()
    walks: Walks = field(default_factory=Walks)


@dataclass(frozen=True)
class Advanced:
    """The outcome of a block.

    With the studies the next stretch need not repeat the trials of libraries that keep
    a state, and with the walks it need not simulate them again.

    Attributes:
        table: the trials that its studies lacked, `state_schema`.
        studies: with all their trials, in the block's order.
        walks: all of the block so far.
    """

    table: pa.Table
    studies: tuple[optuna.Study, ...]
    walks: Walks


def advance(block: Block) -> Advanced:
    """Take the studies of a block on.

    Raises:
        InputError: what a sampler or the simulator refuses.
    """
    experiment, walks = block.experiment, block.walks
    with quiet():
        memories = block.handed_on or (None,) * len(block.studies)
        studies = {
            (arm, run): OneStudy(experiment, find_arm(arm), run, memory)
            for (arm, run), memory in zip(block.studies, memories, strict=True)
        }
        for arm, run, table in by_study(block.known):
            _restore(experiment, studies[arm, run], table, walks)
        ended = walkers(block.known) if experiment.until_walker else set()
        tables = [block.known.schema.empty_table()]
        while open_studies := [
            study
            for key, study in studies.items()
            if study.trials < block.trials and key not in ended
        ]:
            tables.append(_round(experiment, open_studies, walks, block.known.schema))
            if experiment.until_walker:
                ended |= walkers(tables[-1])
        handed_on = tuple(study.hand_on() for study in studies.values())
        return Advanced(pa.concat_tables(tables), handed_on, walks)


def _restore(
    experiment: Experiment, study: OneStudy, table: pa.Table, walks: Walks
) -> None:
    """Give a study its trials of earlier sessions."""
    points = np.column_stack([table[name].to_numpy() for name in experiment.names])
    costs = np.column_stack(
        [table[name].to_numpy() for name in experiment.objective.columns]
    )
    rows = experiment.rows_of(table)
    walks.add([study.run] * len(table), points, rows, costs)
    for place, notes in enumerate(table[NOTES].to_pylist()):
        told = experiment.told(costs[place], study.run, place)
        noted = json.loads(notes) | study.shown(rows[place], costs[place])
        study.restore(points[place].tolist(), told, noted)


def _round(
    experiment: Experiment, studies: list[OneStudy], walks: Walks, schema: pa.Schema
) -> pa.Table:
    """One trial of each study: proposed, simulated together, told, and written down."""
    asked, notes, seconds = [], [], []
    trials = [study.trials for study in studies]
    for study in studies:
        began_s = time.perf_counter()
        asked.append(study.ask())
        notes.append(study.noted())
        seconds.append(time.perf_counter() - began_s)
    runs = [study.run for study in studies]
    points = np.array(asked, dtype=np.float64)
    rows, costs = walks.walk(experiment, runs, points)
    measured = []
    for study, row, cost in zip(studies, rows, costs, strict=True):
        told = experiment.told(cost, study.run, study.trials)
        study.tell(told, study.shown(row, cost))
        measured.append(told[0])
    objective = experiment.objective
    columns = {
        "experiment": [experiment.name] * len(rows),
        "arm": [study.arm.name for study in studies],
        "run": runs,
        "trial": trials,
        **experiment.words(rows),
        **dict(zip(experiment.names, points.T, strict=True)),
        "row": [noted.get(ROW_ATTRIBUTE, OFF_TABLE) for noted in notes],
        **dict(zip(objective.columns, costs.T, strict=True)),
        "cost": [objective.best(cost) for cost in costs[:, None]],
        MEASURED: measured,
        "best_cost": [best_cost(experiment, study.study) for study in studies],
        WALKED: experiment.walked(rows),
        **{name: rows[name] for name in experiment.kept},
        PROPOSAL_TIME: seconds,
        NOTES: [json.dumps(noted) for noted in notes],
    }
    return pa.table({name: columns[name] for name in schema.names}, schema=schema)


@contextmanager
def quiet() -> Iterator[None]:
    """Without the lines that Optuna would print for each of thousands of trials."""
    verbosity = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            yield
    finally:
        optuna.logging.set_verbosity(verbosity)

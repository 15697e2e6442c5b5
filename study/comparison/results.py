"""The results' columns, and the tables of finished trials that are made of them.

The state of an arm has two columns more than the results: how long its sampler took, and what the
sampler noted in the trial, from which a stopped study is set up again.
"""

import json
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from study.experiment.experiment import Experiment
from study.experiment.trials import KEPT, OUTCOMES, walked
from taichi_nmm.parameters import GAIN_NAMES, LOW_LEVEL_GAINS
from taichi_nmm.result import END_REASONS, RESULT_DTYPE, SCORE_FIELDS

Floats = NDArray[np.float64]
Key = tuple[str, int]  # arm, run: a study of an experiment

THETA_REF = next(parameter for parameter in LOW_LEVEL_GAINS if parameter.name == "theta_ref")
PROPOSAL_TIME = "proposal_s"
NOTES = "notes"
ARROW_TYPES = {"f8": pa.float64(), "i4": pa.int32()}

_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("experiment", pa.string()),
    ("arm", pa.string()),
    ("run", pa.int32()),
    ("trial", pa.int32()),
    *((name, pa.float64()) for name in GAIN_NAMES),
    (THETA_REF.name, pa.float64()),
    ("row", pa.int64()),
    ("cost", pa.float64()),
    ("best_cost", pa.float64()),
    ("walked", pa.bool_()),
    *((name, pa.float64()) for name in OUTCOMES),
    ("end_reason", pa.string()),
    *((name, ARROW_TYPES[kind]) for name, kind in SCORE_FIELDS),
)


def _schema(columns: tuple[tuple[str, pa.DataType], ...]) -> pa.Schema:
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in columns])


RESULT_SCHEMA = _schema(_COLUMNS)
STATE_SCHEMA = _schema((*_COLUMNS, (PROPOSAL_TIME, pa.float64()), (NOTES, pa.string())))
TIME_COLUMNS = ("arm", "run", "trial", PROPOSAL_TIME)


def state_table(experiment: Experiment, columns: dict[str, Any], gains: Floats) -> pa.Table:
    """Finished trials as a table of `STATE_SCHEMA`.

    Args:
        experiment: of the trials.
        columns: arm, run, trial, row, cost, best_cost, proposal_s, notes (dictionaries), each [n],
            and rows: what the simulator returned, [n].
        gains: the searched parameters, [n, 16 + k].
    """
    rows: NDArray[np.void] = columns["rows"]
    arrays: dict[str, Any] = {name: values for name, values in columns.items() if name != "rows"}
    arrays["experiment"] = [experiment.name] * len(gains)
    arrays[THETA_REF.name] = np.full(len(gains), THETA_REF.default)
    arrays |= dict(zip(experiment.names, gains.T, strict=True))
    arrays |= {name: rows[name] for name in KEPT}
    arrays["end_reason"] = np.array(END_REASONS)[rows["end_reason"]]
    arrays["walked"] = walked(rows)
    arrays[NOTES] = [json.dumps(notes) for notes in columns[NOTES]]
    made = [pa.array(_contiguous(arrays[field.name]), field.type) for field in STATE_SCHEMA]
    return pa.Table.from_arrays(made, schema=STATE_SCHEMA)


def walkers(table: pa.Table) -> set[Key]:
    """The studies that have a trial which walked."""
    found = table.filter(table["walked"])
    return set(zip(found["arm"].to_pylist(), found["run"].to_pylist(), strict=True))


def as_if_gone_on(table: pa.Table) -> pa.Table:
    """Studies that ended with a walker, its trial again in place of those that others needed.

    Args:
        table: trials of an experiment with `until_walker`, of any columns with arm, run, trial and
            walked, without gaps; in any order.
    """
    ordered = table.sort_by([("arm", "ascending"), ("run", "ascending"), ("trial", "ascending")])
    arm, run, trial = (ordered[name].to_numpy() for name in ("arm", "run", "trial"))
    last = np.append((run[1:] != run[:-1]) | (arm[1:] != arm[:-1]), len(table) > 0)
    ended = np.flatnonzero(last & ordered["walked"].to_numpy(zero_copy_only=False))
    most = int(trial.max()) + 1 if len(trial) else 0
    repeats = np.ones(len(table), dtype=np.int64)
    repeats[ended] += most - 1 - trial[ended]
    index = np.repeat(np.arange(len(table)), repeats)
    first = np.repeat(np.cumsum(repeats) - repeats, repeats)
    longer = ordered.take(index)
    numbers = pa.array(
        trial[index] + np.arange(len(index)) - first, longer.schema.field("trial").type
    )
    return longer.set_column(longer.schema.get_field_index("trial"), "trial", numbers)


def _contiguous(values: Any) -> Any:
    return values if isinstance(values, list) else np.ascontiguousarray(values)


def in_order(tables: list[pa.Table], keys: tuple[str, ...] = ("arm", "run", "trial")) -> pa.Table:
    """Tables of one schema as one, sorted."""
    joined = pa.concat_tables(tables)
    order = joined.sort_by([(key, "ascending") for key in keys])
    return order.combine_chunks()


def gains_of(experiment: Experiment, table: pa.Table) -> Floats:
    """The searched parameters of a table's trials, [n, 16 + k]."""
    columns = [table[name].to_numpy() for name in experiment.names]
    return np.column_stack(columns).astype(np.float64)


def outcomes_of(table: pa.Table) -> NDArray[np.void]:
    """What a table says of the simulator's result rows, in their form, [n]; the rest is zero."""
    rows = np.zeros(len(table), RESULT_DTYPE)
    for name in KEPT:
        rows[name] = table[name].to_numpy()
    reasons = {reason: number for number, reason in enumerate(END_REASONS)}
    rows["end_reason"] = [reasons[reason] for reason in table["end_reason"].to_pylist()]
    return rows


def by_study(table: pa.Table) -> Iterator[tuple[str, int, pa.Table]]:
    """The trials of each study of a table, by arm and run: arm, run, its rows by trial.

    Where studies begin is looked up in the sorted rows: Arrow's `group_by` promises no order.
    """
    ordered = in_order([table])
    arms, runs = ordered["arm"].to_pylist(), ordered["run"].to_pylist()
    keys = list(zip(arms, runs, strict=True))
    starts = [n for n in range(len(keys)) if n == 0 or keys[n] != keys[n - 1]]
    for start, end in pairwise([*starts, len(keys)]):
        yield *keys[start], ordered.slice(start, end - start)

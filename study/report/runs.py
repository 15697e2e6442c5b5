"""A comparison's folder, finished or not: runs of arms as arrays, and facts of its documents.

Tables and documents are checked, whoever wrote them.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from storage.inputs.checks import (
    Check,
    anything,
    by_name,
    each,
    flag,
    number,
    text,
    that,
)
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import is_folder, json_document, reading
from storage.tables import read_any
from study.experiment.experiment import NAME_PATTERN, store_digest
from study.experiment.folder import (
    EXPERIMENT_NAME,
    RESULTS_NAME,
    ROBOTS_NAME,
    RUN_NAME,
    TIMES_NAME,
    as_if_gone_on,
    in_order,
    table_files,
    without_gaps,
)
from study.experiment.objective import FRONT, GOAL_COLUMN

COLUMNS = ("experiment", "arm", "run", "trial", "cost", "best_cost", "walked")


@dataclass(frozen=True, eq=False)
class ArmRuns:
    """The runs of one arm, as far as all of them have come: r runs of t trials.

    Attributes:
        arm: its name.
        runs: their numbers, ascending, [r].
        best: the best cost so far, `Objective.best`, [r, t].
        walks: whether a trial walked, [r, t].
        found: trials in the table.
        proposal_ms: median time of a proposal; None where it is not known.
        repeated: further trials in the arrays: the first walker of a run that ended
            with it.
        goals: what each trial costs by the one goal, and by the other, [r, t, 2]; None:
            there is one cost.
    """

    arm: str
    runs: NDArray[np.int64]
    best: NDArray[np.float64]
    walks: NDArray[np.bool_]
    found: int
    proposal_ms: float | None = None
    repeated: int = 0
    goals: NDArray[np.float64] | None = None

    @property
    def trials(self) -> int:
        """Trials that every run has, t."""
        return int(self.best.shape[1])

    @cached_property
    def first_walker(self) -> NDArray[np.float64]:
        """Trials to the first walker, its own among them; infinite where none walked, [r]."""
        any_walks = self.walks.any(axis=1)
        return np.where(any_walks, self.walks.argmax(axis=1) + 1.0, np.inf)

    @cached_property
    def has_walker(self) -> NDArray[np.bool_]:
        """Whether a run has a walker after so many trials, [r, t]."""
        return np.asarray(np.logical_or.accumulate(self.walks, axis=1))

    @property
    def walkers(self) -> int:
        """Runs with a walker."""
        return int(self.has_walker[:, -1].sum())


@dataclass(frozen=True, eq=False)
class Results:
    """One experiment.

    Attributes:
        folder: that was read.
        name: of the experiment.
        cost: `Objective.cost`.
        arms: by name, in the order of the table.
        facts: of experiment.json and run.json; empty where there are none.
    """

    folder: Path
    name: str
    cost: str
    arms: dict[str, ArmRuns]
    facts: dict[str, Any]

    @property
    def goals(self) -> dict[str, str]:
        """As `goals_of`."""
        return goals_of(self.facts.get("objective", {}))

    @property
    def runs(self) -> int:
        """The most runs that an arm has."""
        return max(len(arm.runs) for arm in self.arms.values())

    @property
    def trials(self) -> int:
        """The most trials that all runs of an arm have."""
        return max(arm.trials for arm in self.arms.values())

    @property
    def found(self) -> int:
        """Trials in the table."""
        return sum(arm.found for arm in self.arms.values())

    @property
    def planned(self) -> int:
        """Trials of the table if every arm had as many runs and trials as the longest.

        Runs that ended with their first walker are complete.
        """
        repeated = sum(arm.repeated for arm in self.arms.values())
        return len(self.arms) * self.runs * self.trials - repeated

    @property
    def complete(self) -> bool:
        """Whether no arm lags behind another."""
        return self.found == self.planned


def read_results(folder: str | Path) -> Results:
    """Read the folder of a comparison, finished or not.

    An arm is read from the table or from its checkpoint, whichever has more trials.

    Raises:
        InputError: no such folder, no trials in it, or a table or document that cannot
            be used.
    """
    folder = Path(folder)
    if (folder / ROBOTS_NAME).exists():
        allowed = "a comparison of version 0.5; this one's report is report.md there"
        raise InputError("folder", str(folder), allowed)
    if not is_folder(folder):
        raise InputError(
            "folder", str(folder), "the output folder of taichi-nmm compare"
        )
    arms: dict[str, pa.Table] = {}
    times, facts = _proposal_times(folder), read_facts(folder)
    objective = facts.get("objective", {})
    columns = (*COLUMNS, *map(GOAL_COLUMN.format, goals_of(objective)))
    for path in table_files(folder):
        for arm, rows in _by_arm(read_trials(path, columns)).items():
            if arm not in arms or len(arms[arm]) < len(rows):
                arms[arm] = rows
    if not arms:
        allowed = f"the output of taichi-nmm compare: {RESULTS_NAME}, with trials"
        raise InputError("folder", str(folder), allowed)
    found = {arm: len(rows) for arm, rows in arms.items()}
    if facts.get("until_walker"):
        arms = _by_arm(as_if_gone_on(pa.concat_tables(arms.values())))
    runs = {
        arm: _arm_runs(str(folder), arm, rows, times.get(arm), found[arm])
        for arm, rows in arms.items()
    }
    name = next(iter(arms.values()))["experiment"][0].as_py()
    return Results(folder, name, objective.get("cost", "smooth"), runs, facts)


def goals_of(objective: Mapping[str, Any]) -> dict[str, str]:
    """The two goals of a front by name, each with the columns that it pays for; empty: one cost."""
    goals: dict[str, Any] = objective.get("goals", {})
    if objective.get("cost") != FRONT or len(goals) != 2:
        return {}
    terms = {name: goal.get("terms") for name, goal in goals.items()}
    return {
        name: ", ".join(paid) if isinstance(paid, dict) else "a function"
        for name, paid in terms.items()
    }


def runs_of(trials: pa.Table) -> dict[str, ArmRuns]:
    """The runs of each arm of a table in memory (of `trials.parquet`), in the order of their names.

    Raises:
        InputError: a run lacks a trial between others, or has one twice.
    """
    arms = _by_arm(trials.select(COLUMNS))
    return {
        arm: _arm_runs("trials", arm, rows, None, len(rows))
        for arm, rows in arms.items()
    }


def _by_arm(table: pa.Table) -> dict[str, pa.Table]:
    """The rows of each arm, in the order of the arms' names, runs and trials."""
    ordered = in_order([table])
    arms = pc.unique(ordered["arm"]).to_pylist()
    return {arm: ordered.filter(pc.equal(ordered["arm"], arm)) for arm in arms}


def _arm_runs(
    source: str, arm: str, table: pa.Table, proposal_ms: float | None, found: int
) -> ArmRuns:
    """Arrays of one arm's table: `found` trials were made, the others are repeated."""
    if not without_gaps(table):
        raise InputError(
            source, f"arm {arm}", "trials 0, 1, 2, ... of each run, each once"
        )
    runs, counts = np.unique(table["run"].to_numpy(), return_counts=True)
    shared, shape = table["trial"].to_numpy() < counts.min(), (len(runs), -1)
    best, walks = (table[name].to_numpy()[shared] for name in ("best_cost", "walked"))
    best, walks = best.reshape(shape), walks.astype(bool).reshape(shape)
    goals = [
        table[name].to_numpy()[shared] for name in table.column_names[len(COLUMNS) :]
    ]
    return ArmRuns(
        arm=arm,
        runs=runs.astype(np.int64),
        best=best,
        walks=walks,
        found=found,
        proposal_ms=proposal_ms,
        repeated=len(table) - found,
        goals=np.stack(goals, axis=-1).reshape(*best.shape, 2) if goals else None,
    )


def _proposal_times(folder: Path) -> dict[str, float]:
    """Median milliseconds of each arm, where the folder has them."""
    path = folder / TIMES_NAME
    if not path.exists():
        return {}
    table = read_trials(path, ("arm", "proposal_s"))
    arm, seconds = table["arm"].to_numpy(), table["proposal_s"].to_numpy()
    return {
        str(name): 1e3 * float(np.median(seconds[arm == name]))
        for name in np.unique(arm)
    }


LARGEST_NUMBER = 1e15  # of seconds or trials
COST_NAME = re.compile(r"[\w./-]+(:\w+)?")

OBJECT = by_name(anything)
COST = that(
    lambda cost: isinstance(cost, str) and bool(COST_NAME.fullmatch(cost)),
    "smooth, walking, weighted, front, a column, or a function's path",
)
NUMBER = number(-LARGEST_NUMBER, LARGEST_NUMBER, f"a number up to {LARGEST_NUMBER:g}")
FORM: dict[str, dict[str, Check]] = {
    EXPERIMENT_NAME: {
        "simulation": OBJECT,
        "objective": OBJECT,
        "versions": OBJECT,
        "body": OBJECT,
        "terrain": OBJECT,
        "ground": OBJECT,
        "until_walker": flag,
        "searched": each(text),
        "stores": by_name(text),
        "objective.cost": COST,
        "simulator": text,
        "objective.noise": NUMBER,
        "objective.terms": OBJECT,
        "objective.goals": by_name(OBJECT),
        "simulation.duration_s": NUMBER,
    },
    RUN_NAME: {"sessions": each(OBJECT)},
}
SESSION: dict[str, Check] = {
    "machine": OBJECT,
    "stores": by_name(text),
    "wall_s": NUMBER,
    "trials": NUMBER,
}


def read_facts(folder: Path) -> dict[str, Any]:
    """Both documents of the folder as one; empty where there are none.

    Raises:
        InputError: one cannot be read, or a part of it is of another form; naming it.
    """
    facts: dict[str, Any] = {}
    if not is_folder(folder):
        return facts
    for name, form in FORM.items():
        if (folder / name).exists():
            document = json_document(name, folder / name, "a readable JSON object")
            _require_form(document, form, name)
            facts |= document
    for place, session in enumerate(facts.get("sessions", [])):
        _require_form(session, SESSION, f"{RUN_NAME}: sessions[{place}]")
    return facts


def _require_form(document: dict[str, Any], form: dict[str, Check], name: str) -> None:
    """Check the parts that are there; "a.b" is part b of part a."""
    for key, check in form.items():
        *parents, last = key.split(".")
        part: Any = document
        for step in parents:
            part = part.get(step, {})
        if last in part:
            check(f"{name}: {key}", part[last])


# whether a type is of the kind; allowed values
Kind = tuple[Callable[[pa.DataType], bool], str]

NAMES: Kind = pa.types.is_string, "letters, digits, '.', '_' and '-'"
COUNTS: Kind = pa.types.is_integer, "whole numbers from 0"
FLAGS: Kind = pa.types.is_boolean, "true or false"
NUMBERS: Kind = pa.types.is_floating, f"numbers up to {LARGEST_NUMBER:g}"
KINDS = {
    "experiment": NAMES,
    "arm": NAMES,
    "run": COUNTS,
    "trial": COUNTS,
    "walked": FLAGS,
}


def read_trials(path: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of a table of trials; all values are there, finite and of their column's kind.

    Raises:
        InputError: the table cannot be read, a column is missing, or a value is of
            another kind.
    """
    with reading(path.name, path, "a readable table of trials"):
        known = pq.read_schema(path).names
        for name in columns:
            if known.count(name) != 1:
                raise InputError(
                    f"{path.name}: column", name, f"one of {listed(known, name)}, once"
                )
        table = read_any(path, columns)
    for name in columns:
        _require_column(table[name], name, path)
    return table


def _require_column(column: pa.ChunkedArray, name: str, path: Path) -> None:
    """Refuse a column with values of another kind."""
    field, kind = f"{path.name}: {name}", KINDS.get(name, NUMBERS)
    is_kind, allowed = kind
    if not is_kind(column.type) or column.null_count:
        found = f"{column.type}, {column.null_count} of {len(column)} missing"
        raise InputError(field, found, f"{allowed}, none missing")
    if kind is NUMBERS and not (np.abs(column.to_numpy()) <= LARGEST_NUMBER).all():
        raise InputError(field, "NaN, infinite or larger", allowed)
    if kind is COUNTS and len(column) and pc.min(column).as_py() < 0:
        raise InputError(field, pc.min(column).as_py(), allowed)
    for value in pc.unique(column).to_pylist() if kind is NAMES else ():
        if not re.fullmatch(NAME_PATTERN, value):
            raise InputError(field, value, allowed)


def known_stores(results: Results) -> dict[str, Path]:
    """The stores that are unchanged since the results were made, by key.

    Their places are those of the latest session that names them; old folders have none.
    """
    digests: dict[str, str] = results.facts.get("stores", {})
    sessions = [
        each["stores"] for each in results.facts.get("sessions", []) if "stores" in each
    ]
    known = {}
    for key, path in (sessions[-1] if sessions else {}).items():
        with suppress(InputError, OSError):  # not there, or damaged
            if store_digest(Path(path)) == digests.get(key):
                known[key] = Path(path)
    return known

"""What a trial costs: one of the paper's two costs, a weighted sum, or two goals, each a cost.

[objective]
cost = "weighted"
fell_cost = 100.0       # of a run that falls at its end; twice that of one that falls at once

[objective.terms]       # by columns of the results, each with its weight
cost_of_transport_jpkgpm = 1.0
mean_speed_mps = {weight = 100.0, target = 0.8, tolerance = 0.02}    # the distance from a target

A function "module:function", or "file.py:function", of the columns may stand for a
column.

[objective]
cost = "front"          # a study of two goals: each is a table as above, by its name

[objective.goals.energy]
cost = "weighted"
...
"""

import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.function_simulator import code_of
from storage.inputs.config import REQUIRED, Table
from storage.inputs.errors import InputError, in_a_line, listed
from storage.simulator import SURVIVED, import_object
from taichi_nmm.conditions import TRIAL_S
from taichi_nmm.result import (
    COMPLETED,
    FELL,
    NEEDED,
    RESULT_DTYPE,
    smooth_cost,
    unmeasured,
    walking_cost,
)

Floats = NDArray[np.float64]

PRINTED = {"smooth": smooth_cost, "walking": walking_cost}  # the paper's two
WEIGHTED = "weighted"
FRONT = "front"  # that of two goals
GOAL_COLUMN = "goal_{}"  # of a table of trials: the cost by the goal of this name
GOAL_NAME = re.compile(r"[A-Za-z]\w{0,30}", re.ASCII)
FUNCTION = re.compile(r"[\w./-]+:\w+")
IMPORTED = "a function that can be imported: module:function, or file.py:function"
# people walk at 1.3; with 1.1, up a ramp, first walkers come later
SUCCESS_SPEED_MPS = 1.0
# walking_cost: who falls pays 300 less the distance, who lasts below 130
WALKING_SUCCESS = 150.0
MOST_WEIGHT = 1e9
# by the paper's costs
TRIAL_DTYPE = np.dtype([(name, RESULT_DTYPE[name]) for name in NEEDED])


@dataclass(frozen=True)
class Term:
    """What is paid for one column: weight times the number, or its distance from a target.

    Attributes:
        column: that is paid for, or a function's path.
        weight: of a number, in units of the cost over the column's unit; below 0, more
            is better.
        target: in the unit of the column; None: the number itself is paid for.
        tolerance: distance from the target that costs nothing, in this unit.
        function: of all columns by name, in place of a column; None: the column is paid
            for.
    """

    column: str
    weight: float
    target: float | None = None
    tolerance: float = 0.0
    function: Callable[[Any], Any] | None = None

    def values(self, given: Any, survived: str = SURVIVED) -> Floats:
        """The numbers of runs, [n] or [n, w], from their columns by name.

        Raises:
            InputError: a function that raises, or has no finite number for each run
                that lasted.
        """
        if self.function is None:
            return np.asarray(given[self.column], np.float64)
        lasted = np.asarray(given[survived], np.float64)
        try:
            found = np.array(
                np.broadcast_to(self.function(given), lasted.shape), np.float64
            )
            if not np.isfinite(found[lasted >= 1.0]).all():
                raise ValueError("NaN or infinity")
        except InputError:
            raise
        except Exception as error:  # the function is a user's: it may raise anything
            allowed = f"a function that gives each run a finite number, not {in_a_line(error)}"
            raise InputError("objective", self.column, allowed) from error
        return found

    def paid(self, values: Floats) -> Floats:
        """For numbers [...]."""
        if self.target is None:
            return np.asarray(self.weight * values)
        return self.weight * np.maximum(
            np.abs(values - self.target) - self.tolerance, 0.0
        )

    def document(self) -> Any:
        """As a configuration has it."""
        if self.target is None:
            return self.weight
        return {
            "weight": self.weight,
            "target": self.target,
            "tolerance": self.tolerance,
        }


@dataclass(frozen=True)
class Objective:
    """What a trial costs. It pickles and hashes.

    Attributes:
        cost: one of `PRINTED`, `WEIGHTED`, `FRONT` or, of any simulator, a column.
        terms: of a weighted sum; empty: the cost is one of the paper's, or a front.
        fell_cost: of a run that falls at its end; of one that falls at once it is twice
            this. Infinite without terms.
        survived: column with the share of the time that a run lasted, 0 to 1.
        goals: of a `FRONT`, two; empty: there is one cost.
        name: of a goal; "" of what is none.
    """

    cost: str = "smooth"
    terms: tuple[Term, ...] = ()
    fell_cost: float = math.inf
    survived: str = SURVIVED
    goals: tuple["Objective", ...] = ()
    name: str = ""

    @property
    def each(self) -> tuple["Objective", ...]:
        """The k costs that a study minimises: the goals, or this one."""
        return self.goals or (self,)

    @property
    def metrics(self) -> list[str]:
        """Names of the k costs in a study: of the paper's that of the function in `taichi_nmm`."""
        if self.goals:
            return [goal.name for goal in self.goals]
        name = self.cost.rpartition(":")[2]
        return [f"{name}_cost" if self.terms else PRINTED[name].__name__]

    @property
    def columns(self) -> list[str]:
        """Where a table of trials has these costs, k."""
        return [GOAL_COLUMN.format(goal.name) for goal in self.goals] or ["cost"]

    def values(self, rows: NDArray[np.void]) -> Floats:
        """What a study minimises, of a simulator's rows, [n, k]."""
        return np.stack([one.costs(rows) for one in self.each], axis=-1)

    def best(self, values: Floats) -> float:
        """What trials have reached together, from their values [n, k]: the least cost.

        Of two goals, the front cost: minus the area that the trials dominate, from the
        `fell_cost` of both on. It falls as the front grows.
        """
        if not self.goals:
            return float(values.min())
        farthest, reached = (goal.fell_cost for goal in self.goals)
        area = 0.0
        for first, second in sorted(values.tolist()):
            if first < farthest and second < reached:
                area += (farthest - first) * (reached - second)
                reached = second
        return 0.0 - area

    def costs(self, rows: NDArray[np.void]) -> Floats:
        """Costs of a simulator's rows, [n]; of a front, its goals have them."""
        return self._weighted(rows) if self.terms else PRINTED[self.cost](rows)

    def in_worlds(self, given: Mapping[str, Floats], horizon_s: float) -> Floats:
        """Costs [n, w] of a trial, from what runs in a store's worlds gave, by column [n, w].

        Who lasts to the horizon is taken to last the trial.
        """
        if self.terms:
            return self._weighted(given)
        lasted, speed = given[SURVIVED], given["mean_speed_mps"]
        seconds = np.where(lasted >= 1.0, TRIAL_S, lasted * horizon_s)
        rows = np.zeros(lasted.shape, TRIAL_DTYPE)
        rows["end_reason"] = np.where(lasted >= 1.0, COMPLETED, FELL)
        rows["duration_s"], rows["distance_m"] = seconds, speed * seconds
        rows["mean_speed_mps"] = speed
        if self.cost == "walking":
            rows["cost_of_transport_jpkgpm"] = given["cost_of_transport_jpkgpm"]
        return PRINTED[self.cost](rows)

    def success(self, duration_s: float) -> float | None:
        """The cost of a trial that has succeeded: of a run to the end; None: of a front.

        With the smooth cost of a fast one, since a slow one costs more than a late
        fall.
        """
        if self.goals:
            return None
        if self.terms:
            return self.fell_cost
        if self.cost == "walking":
            return WALKING_SUCCESS
        walk = np.zeros(1, RESULT_DTYPE)
        walk["duration_s"], walk["mean_speed_mps"] = duration_s, SUCCESS_SPEED_MPS
        walk["distance_m"] = SUCCESS_SPEED_MPS * duration_s
        return float(smooth_cost(walk)[0])

    def document(self) -> dict[str, Any]:
        """The table [objective]; `read_objective` reads it back."""
        if self.goals:
            return {
                "cost": FRONT,
                "goals": {goal.name: goal.document() for goal in self.goals},
            }
        if not self.terms:
            return {"cost": self.cost}
        document: dict[str, Any] = {"cost": self.cost, "fell_cost": self.fell_cost}
        if self.cost == WEIGHTED:
            document["terms"] = {term.column: term.document() for term in self.terms}
        return document | ({"code": self.code} if self.code else {})

    @property
    def code(self) -> str:
        """A digest of the code of its functions; trials of two versions never mix."""
        files = [code_of(term.function) for term in self.terms if term.function]
        return hashlib.sha256(b"".join(files)).hexdigest()[:16] if files else ""

    def _weighted(self, given: Any) -> Floats:
        """Who falls early pays twice `fell_cost`, who lasts at most that.

        So much pays also who lasted without what is paid for: no energy a metre is
        known of a walker that stands still, and it is not 0.
        """
        lasted = np.asarray(given[self.survived], np.float64)
        paid = sum(term.paid(term.values(given, self.survived)) for term in self.terms)
        lasting = np.minimum(paid, self.fell_cost)
        for term in self.terms:
            if term.function is None:
                lasting = np.where(
                    unmeasured(term.column, given), self.fell_cost, lasting
                )
        return np.asarray(
            np.where(lasted >= 1.0, lasting, self.fell_cost * (2.0 - lasted))
        )


def read_objective(
    table: Table, columns: Sequence[str], survived: str | None = None
) -> Objective:
    """The table [objective], whose keys `cost`, `fell_cost`, `terms` and `goals` are read.

    Args:
        table: with other keys perhaps, which are left.
        columns: numbers of a run that may be paid for.
        survived: of another simulator than the walker, the column with the share that
            lasted; a column may stand for a cost in place of the paper's.

    Raises:
        InputError: naming the key.
    """
    known = (*PRINTED, WEIGHTED, FRONT) if survived is None else (*columns, WEIGHTED)
    is_own = FUNCTION.fullmatch(str(table.unread.get("cost")))
    cost = table.text(
        "cost", REQUIRED if survived else "smooth", () if is_own else known
    )
    if survived is None and cost in PRINTED:
        return Objective(cost)
    if survived is None and cost == FRONT:
        return Objective(cost, goals=_read_goals(table.table("goals"), columns))
    survived, fell_cost = survived or SURVIVED, table.number("fell_cost", low=1e-9)
    own = Table({cost: 1.0}, table.path("cost"), table.folder)
    given = table.table("terms") if cost == WEIGHTED else own
    for name in given.unread:
        if name not in columns and not FUNCTION.fullmatch(name):
            raise InputError(
                given.path(name),
                "no number of a run",
                f"one of {listed(columns, name)}",
            )
    terms = tuple(_read_term(given, name) for name in list(given.unread))
    if not any(term.weight for term in terms) and not given.mistaken():
        raise InputError(
            table.path("terms"), "nothing to pay for", "a weight other than zero"
        )
    found = Objective(cost, terms, fell_cost, survived)
    if found.code:
        table.text("code", found.code, (found.code,))
    return found


def _read_goals(table: Table, columns: Sequence[str]) -> tuple[Objective, ...]:
    """Each in its table; in the order of their names, so that no digest depends on another one."""
    names, goals = sorted(table.unread), []
    if len(names) != 2 and not table.mistaken():
        raise InputError(
            "objective.goals", ", ".join(names) or "none", "two tables, a goal each"
        )
    for name in names:
        if not GOAL_NAME.fullmatch(name):
            allowed = "a name of up to 31 letters, digits and '_', first a letter"
            raise InputError(table.path(name), "a goal", allowed)
        goal = table.table(name)
        cost = goal.unread.get("cost", "missing")
        if cost in ("missing", FRONT, *PRINTED) and not goal.mistaken("cost"):
            allowed = "weighted, or a function: a front is measured from the fell_cost of its goals"
            raise InputError(goal.path("cost"), cost, allowed)
        goals.append(replace(read_objective(goal, columns), name=name))
        goal.done()
    return tuple(goals)


def _read_term(table: Table, column: str) -> Term:
    """The weight of a column, or a table with `weight`, `target` and `tolerance`."""
    function, ends = (
        named_function(table, column),
        {"low": -MOST_WEIGHT, "high": MOST_WEIGHT},
    )
    if not isinstance(table.unread[column], dict):
        return Term(column, table.number(column, **ends), function=function)
    term = table.table(column)
    tolerance = term.number("tolerance", 0.0, 0.0, MOST_WEIGHT)
    weight, target = term.number("weight", **ends), term.number("target", **ends)
    term.done()
    return Term(column, weight, target, tolerance, function)


def named_function(table: Table, column: str) -> Callable[[Any], Any] | None:
    """The function of that path, whose file may lie beside the configuration; None: a column."""
    if not FUNCTION.fullmatch(column):
        return None
    found: Callable[[Any], Any] = import_object(
        table.path(column), column, table.folder, IMPORTED
    )
    return found

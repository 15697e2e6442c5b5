"""What a trial costs: one of the paper's two costs, or a weighted sum of what a run gives.

[objective]
cost = "weighted"
fell_cost = 100.0       # of a run that falls at its end; twice that of one that falls at once

[objective.terms]       # by columns of the results, each with its weight
cost_of_transport_jpkgpm = 1.0
mean_speed_mps = {weight = 100.0, target = 0.8, tolerance = 0.02}    # the distance from a target
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.simulator import SURVIVED
from taichi_nmm.conditions import TRIAL_S
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.result import COMPLETED, FELL, NEEDED, RESULT_DTYPE, smooth_cost, walking_cost

Floats = NDArray[np.float64]

PRINTED = {"smooth": smooth_cost, "walking": walking_cost}  # the paper's two
WEIGHTED = "weighted"
SUCCESS_SPEED_MPS = 1.0  # people walk at 1.3; with 1.1, up a ramp, first walkers come later
WALKING_SUCCESS = 150.0  # walking_cost: who falls pays 300 less the distance, who lasts below 130
MOST_WEIGHT = 1e9
TRIAL_DTYPE = np.dtype([(name, RESULT_DTYPE[name]) for name in NEEDED])  # by the paper's costs


@dataclass(frozen=True)
class Term:
    """What is paid for one column: weight times the number, or its distance from a target."""

    column: str
    weight: float
    target: float | None = None
    tolerance: float = 0.0  # distance from the target that costs nothing

    def paid(self, values: Floats) -> Floats:
        """For numbers [...]."""
        if self.target is None:
            return np.asarray(self.weight * values)
        return self.weight * np.maximum(np.abs(values - self.target) - self.tolerance, 0.0)

    def document(self) -> Any:
        """As a configuration has it."""
        if self.target is None:
            return self.weight
        return {"weight": self.weight, "target": self.target, "tolerance": self.tolerance}


@dataclass(frozen=True)
class Objective:
    """What a trial costs. It pickles and hashes."""

    cost: str = "smooth"  # of `PRINTED`; `WEIGHTED`; or, of any simulator, a column
    terms: tuple[Term, ...] = ()  # none: one of the paper's
    fell_cost: float = math.inf
    survived: str = SURVIVED  # column with the share of the time that a run lasted

    @property
    def metric(self) -> str:
        """Its name in a study: of the paper's costs that of the function in `taichi_nmm`."""
        return f"{self.cost}_cost" if self.terms else PRINTED[self.cost].__name__

    def costs(self, rows: NDArray[np.void]) -> Floats:
        """Costs of a simulator's rows, [n]."""
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

    def success(self, duration_s: float) -> float:
        """The cost of a trial that has succeeded: of a run to the end.

        With the smooth cost of a fast one, since a slow one costs more than a late fall.
        """
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
        if not self.terms:
            return {"cost": self.cost}
        document: dict[str, Any] = {"cost": self.cost, "fell_cost": self.fell_cost}
        if self.cost == WEIGHTED:
            document["terms"] = {term.column: term.document() for term in self.terms}
        return document

    def _weighted(self, given: Any) -> Floats:
        """Who falls early pays twice `fell_cost`, who lasts at most that."""
        lasted = np.asarray(given[self.survived], np.float64)
        paid = sum(term.paid(np.asarray(given[term.column], np.float64)) for term in self.terms)
        lasting = np.minimum(paid, self.fell_cost)
        return np.asarray(np.where(lasted >= 1.0, lasting, self.fell_cost * (2.0 - lasted)))


def read_objective(table: Table, columns: Sequence[str], survived: str | None = None) -> Objective:
    """The table [objective], whose keys `cost`, `fell_cost` and `terms` are read.

    Args:
        table: with other keys perhaps, which are left.
        columns: numbers of a run that may be paid for.
        survived: of another simulator than the walker, the column with the share that lasted; a
            column may stand for a cost in place of the paper's.

    Raises:
        InputError: naming the key.
    """
    if survived is None:
        cost = table.text("cost", "smooth", (*PRINTED, WEIGHTED))
        if cost in PRINTED:
            return Objective(cost)
    else:
        cost = table.text("cost", choices=(*columns, WEIGHTED))
    survived, fell_cost = survived or SURVIVED, table.number("fell_cost", low=1e-9)
    if cost != WEIGHTED:
        return Objective(cost, (Term(cost, 1.0),), fell_cost, survived)
    given = table.table("terms")
    for name in given.unread:
        if name not in columns:
            raise InputError(given.path(name), "no number of a run", f"one of {', '.join(columns)}")
    terms = tuple(_read_term(given, name) for name in list(given.unread))
    if not any(term.weight for term in terms) and not given.mistaken():
        raise InputError("objective.terms", "nothing to pay for", "a column with a weight but zero")
    return Objective(cost, terms, fell_cost, survived)


def _read_term(table: Table, column: str) -> Term:
    """The weight of a column, or a table with `weight`, `target` and `tolerance`."""
    ends = {"low": -MOST_WEIGHT, "high": MOST_WEIGHT}
    if not isinstance(table.unread[column], dict):
        return Term(column, table.number(column, **ends))
    term = table.table(column)
    tolerance = term.number("tolerance", 0.0, 0.0, MOST_WEIGHT)
    found = Term(column, term.number("weight", **ends), term.number("target", **ends), tolerance)
    term.done()
    return found

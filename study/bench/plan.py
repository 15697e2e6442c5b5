"""The file of a bench, as docs/bench.md has it: its candidates, what a trial is, what is good."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial

from storage.databases.files import read_attributes, shown_url, studies_path
from storage.databases.urls import file_url, is_postgresql
from storage.inputs import checks
from storage.inputs.config import Table, read_whole
from storage.inputs.errors import InputError
from storage.inputs.reading import toml_document
from storage.simulator import SURVIVED
from study.bench.candidates import better_of, of_file
from study.bench.journal import LOG, Trial
from study.bench.limits import (
    FALL,
    ByFamily,
    Column,
    by_limit,
    in_worlds,
    read_allowed,
    read_column,
)
from study.sampler.sampler import MOST_OFF_GRID, FeatureKernelSampler
from study.sampler.table import FeatureTable
from study.sampler.worlds import Better, limits_in_worlds

if TYPE_CHECKING:
    from study.experiment.features import Cost
    from study.experiment.objective import Term

Floats = NDArray[np.float64]
Missing = TypeVar("Missing", None, float)

SMOOTH = "smooth"  # the cost of a store, if the file names none
# Parts of the file that may change under a running bench: none tells what a trial was.
FREE = ("about", "limit", "off_grid", "safety", "storage")
READABLE = "a readable TOML file of a bench"


@dataclass(frozen=True)
class Goal:
    """What a trial is tried for.

    Attributes:
        value: the number of a trial in words, with its unit.
        maximise: whether more is better.
        success: the value from which on a trial has succeeded; None: the file does not
            say.
        failed: value of a trial that fails at once, and at its end; None: the file does
            not say.
        duration_s: of a whole trial; infinite where it has no end.
    """

    value: str
    maximise: bool
    success: float | None
    failed: tuple[float, float] | None
    duration_s: float

    def of_failure(self, seconds: float) -> float:
        """The value of a trial that failed after so long: the later, the better.

        Raises:
            InputError: the file does not say what failures are worth, or no such time.
        """
        if self.failed is None:
            allowed = (
                "failed_at_once, failed_at_end and duration_s in [goal] of a new bench; "
                "or the value of the failed trial itself"
            )
            raise InputError("goal.failed_at_once", "missing", allowed)
        checks.number(0.0, self.duration_s)("seconds", seconds)
        first, last = self.failed
        return first + (last - first) * seconds / self.duration_s

    @property
    def failures(self) -> dict[str, float]:
        """What failures are worth, by the key of the file; none where it does not say."""
        if self.failed is None:
            return {}
        return dict(zip(("failed_at_once", "failed_at_end"), self.failed, strict=True))

    def is_better(self, value: float, other: float) -> bool:
        """Whether a value is better than another one."""
        return value > other if self.maximise else value < other

    def is_good(self, value: float) -> bool:
        """Whether it is as good as `success`; any value is where nothing says what success is."""
        return self.success is None or not self.is_better(self.success, value)

    def in_worlds(self, term: "Term") -> "Cost":
        """Values by a column of a store, or a function of them; runs that fell are failures.

        They count by how far they came. None that lasted is worse than a failure at the
        end. Without `failed` the numbers are taken as they are.
        """

        def values(given: Mapping[str, Floats], horizon_s: float) -> Floats:
            found = term.values(given)
            if self.failed is None:
                return found
            (first, last), lasted = self.failed, given[SURVIVED]
            paid = (np.maximum if self.maximise else np.minimum)(found, last)
            return np.asarray(
                np.where(lasted >= 1.0, paid, first + (last - first) * lasted)
            )

        return values


@dataclass(frozen=True)
class Safety:
    """Limits of what may be proposed.

    Attributes:
        most_step: from the nearest trial that succeeded, as a share of any parameter's
            range, 0 to 1.
        least_success: predicted chance to succeed, 0 to 1.
        least_kept: predicted chance that the limits of all columns are kept, 0 to 1.
    """

    most_step: float = 1.0
    least_success: float = 0.0
    least_kept: float = 0.0


@dataclass(frozen=True)
class Plan:
    """The content of a bench's file.

    Attributes:
        path: of the file.
        document: the file as it is written, without what may change.
        name: of the bench, and of its study.
        about: what it is for, in words.
        seed: of the sampler.
        candidates: the table [candidates], as it is written.
        goal: what a trial is tried for.
        columns: other numbers of a trial, by name.
        safety: limits of what may be proposed.
        allowed: what a proposal may risk, by the name of a column or "fall".
        off_grid: points near the best trials that are looked at; None: as many as the
            sampler has.
        url: of the study database.
    """

    path: Path
    document: Mapping[str, Any]
    name: str
    about: str
    seed: int
    candidates: Table
    goal: Goal
    columns: Mapping[str, Column]
    safety: Safety
    allowed: Mapping[str, float]
    off_grid: int | None
    url: str

    @property
    def limited(self) -> list[str]:
        """Names of the columns that have limits."""
        return [name for name, column in self.columns.items() if column.limits("", 0.0)]

    def limits(self, trial: Trial) -> dict[str, float]:
        """What is above zero where a trial broke a limit, by name; falls, if [limit] has them."""
        found = {FALL: 1.0 if trial.failed else -1.0} if FALL in self.allowed else {}
        for name, value in trial.columns.items():
            limits = self.columns[name].limits(name, value)
            found |= {limit: float(excess) for limit, excess in limits.items()}
        return found

    def broke(self, trial: Trial) -> bool:
        """Whether a trial broke a limit, as far as is known."""
        return any(excess > 0.0 for excess in self.limits(trial).values())

    def may_be_named(self, trial: Trial) -> bool:
        """Whether a finished trial neither failed nor, as far as is known, broke a limit."""
        return not trial.failed and not self.broke(trial)

    @property
    def store(self) -> Path | None:
        """The store that the candidates are the rows of; None: they are those of a file."""
        store = self.candidates.unread.get("store")
        return None if store is None else self.candidates.folder / store

    @property
    def priced_store(self) -> Path | None:
        """The store, if what its rows cost in its worlds is known, and not features of them."""
        return None if self.candidates.unread.get("features") else self.store

    @property
    def asked(self) -> Path | None:
        """The configuration of the store, whose simulator is asked; None: it is not."""
        asked = self.candidates.unread.get("asked")
        return None if asked is None else self.candidates.folder / str(asked)

    @property
    def _cost(self) -> str:
        """What a row of a store costs, by the name that the file has for it."""
        return str(self.candidates.unread.get("cost", SMOOTH))

    @property
    def least_of_a_walk(self) -> float | None:
        """What a walk of the whole duration costs at least, 1 / (1 + t) of the smooth cost."""
        if self.store is None or self._cost != SMOOTH:
            return None
        duration_s = self.goal.duration_s
        return 1.0 / (1.0 + duration_s) if math.isfinite(duration_s) else None

    @property
    def price_of_a_fall(self) -> float | None:
        """What a fall at once costs in a store whose cost prices falls itself; None: in others."""
        if self.priced_store is None:
            return None
        from study.experiment.objective import PRINTED, TRIAL_DTYPE
        from taichi_nmm.result import FELL

        if self._cost not in PRINTED:
            return None
        rows = np.zeros(1, TRIAL_DTYPE)
        rows["end_reason"] = FELL
        return float(PRINTED[self._cost](rows)[0])

    @property
    def direction(self) -> StudyDirection:
        """As Optuna has it."""
        return (
            StudyDirection.MAXIMIZE if self.goal.maximise else StudyDirection.MINIMIZE
        )

    def read_candidates(
        self, begun: Mapping[str, BaseDistribution] | None = None
    ) -> FeatureTable:
        """What may be tried, and what is known of it before.

        Args:
            begun: the parameters of a bench that was begun; None: it begins now.

        Raises:
            InputError: naming the key of the file, or the column and row.
        """
        table = Table(self.candidates.unread, "candidates", self.candidates.folder)
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            # They are of rows that are left out.
            if self.store is None:
                found = of_file(table, begun, self._limits_in_file)
            else:
                found = _of_store(table, self)
        table.done()
        return found

    def _limits_in_file(
        self, costs: ByFamily, told: Callable[[str, tuple[str, ...]], ByFamily]
    ) -> dict[str, ByFamily]:
        """Limits in the worlds of a file, above zero where broken: a row falls by its cost."""
        found = in_worlds(self.columns, told)
        if FALL in self.allowed and costs and self.goal.failed is not None:
            sign, at_end = -1.0 if self.goal.maximise else 1.0, self.goal.failed[1]
            found[FALL] = {
                family: np.where(sign * each >= sign * at_end, 1.0, 0.0)
                for family, each in costs.items()
            }
        return found

    def cautions(self) -> list[str]:
        """A line for each family of the store in which no row came to the end."""
        if self.priced_store is None:
            return []
        from storage.store import open_store
        from study.experiment.features import cautions_of

        return cautions_of(open_store(self.priced_store))

    def horizon_note(self) -> str:
        """A sentence on runs of the store that last longer or shorter than a trial; "": none."""
        if self.priced_store is None:
            return ""
        from storage.store import open_store

        store = open_store(self.priced_store)
        trial_s = self.goal.duration_s
        runs_s = {store.settings_of(name)["horizon_s"] for name in store.families}
        said = " and ".join(f"{run_s:g}" for run_s in sorted(runs_s - {trial_s}))
        if not said:
            return ""
        trial = f", a trial {trial_s:g} s" if math.isfinite(trial_s) else ""
        return f"Simulated runs last {said} s{trial}: what is simulated is the cost of such a run."

    def sampler(
        self,
        candidates: FeatureTable,
        allowed: NDArray[np.bool_] | None = None,
        limits_of: Sequence[FrozenTrial] = (),
        *,
        may_ask: bool = True,
    ) -> FeatureKernelSampler:
        """The sampler over candidates; trials off the table have what rows near them tell,
        or the simulator that is asked.

        Args:
            candidates: the rows.
            allowed: which of them may be proposed, [n]; None: all.
            limits_of: trials elsewhere, of which the limits alone are learned.
            may_ask: whether the candidates have the store's worlds alone, so that its
                simulator may be asked.
        """
        rows = candidates.rows
        options = dict[str, Any]()
        if rows.worlds is None and rows.alike is None:

            def features(points: Floats) -> Floats:
                places = rows.space.unit(points)
                return rows.between().at(rows.features[rows.numbers], places, places)

            options = {"feature_function": features}
        elif self.asked is not None and may_ask:
            options = {"feature_function": _simulator_of(self)}
        return FeatureKernelSampler(
            candidates,
            seed=self.seed,
            success=self.goal.success,
            off_grid=self.off_grid if allowed is None else 0,
            allowed=allowed,
            limits_of=limits_of,
            allowed_risk=by_limit(self.allowed, self.columns) or None,
            **options,
        )


def read_plan(path: Path) -> Plan:
    """The plan in a TOML file; the files that it names are not read yet.

    Raises:
        InputError: naming the key.
    """
    table = Table(toml_document("bench", path, READABLE), folder=path.parent)
    return read_whole(table, lambda table: _plan_of(table, path))


def _plan_of(table: Table, path: Path) -> Plan:
    document = {key: given for key, given in table.unread.items() if key not in FREE}
    name = table.text("name", path.stem)
    if not name.strip() or "/" in name:
        raise InputError("name", name, "a name without /")
    columns, goal = table.table("columns"), _goal(table.table("goal"))
    known = {key: read_column(columns.table(key)) for key in columns.unread}
    plan = Plan(
        path=path,
        document=document,
        name=name,
        about=table.text("about", ""),
        seed=table.integer("seed", 0),
        candidates=table.table("candidates"),
        goal=goal,
        columns=known,
        safety=_safety(table.table("safety")),
        allowed=read_allowed(
            table.table("limit"), known, knows_falls=goal.failed is not None
        ),
        off_grid=(
            table.integer("off_grid", low=0, high=MOST_OFF_GRID)
            if table.has("off_grid")
            else None
        ),
        url=_url(table.table("storage"), path, name),
    )
    for part in (
        table,
        *map(table.table, ("goal", "safety", "columns", "limit", "storage")),
    ):
        part.done()
    least_success = plan.safety.least_success
    if least_success > 0.0 and plan.goal.success is None:
        allowed = "0 without goal.success"
        raise InputError("safety.least_success", least_success, allowed)
    return plan


def _url(table: Table, path: Path, name: str) -> str:
    """The URL of the database of a bench of this file and name."""
    is_named = table.has("url")
    url = table.text("url", file_url(path.with_suffix(".db")))
    shown_url(url)  # refuses what is no study database
    return _beside(path, url, name) if is_named else url


def _beside(path: Path, url: str, name: str) -> str:
    """The URL of a database whose relative file lies beside the file of the bench.

    Until version 0.3.0 it lay in the working folder: a bench that was begun there is
    found there.
    """
    if is_postgresql(url):
        return url
    file = studies_path(url)
    beside = path.parent / file
    if file.is_absolute() or beside.exists() or not file.exists():
        return file_url(beside)
    begun = read_attributes(url, name + LOG)[0] is not None
    return url if begun else file_url(beside)


def _goal(table: Table) -> Goal:
    # All numbers are read before any is judged: then all that are wrong are named.
    success = _number(table, "success", None)
    duration_s = table.number("duration_s", 0.0, 0.0)
    at_once = _number(table, "failed_at_once", None)
    at_end = _number(table, "failed_at_end", None)
    value, maximise = table.text("value", "value"), table.boolean("maximise", False)
    table.done()
    failed = None
    # Beside a mistake nothing is missing: its value was taken out.
    if (at_once is not None or at_end is not None) and not table.mistaken():
        allowed = (
            "given, as all of failed_at_once, failed_at_end and duration_s (above 0)"
        )
        if at_once is None or at_end is None:
            key = "failed_at_once" if at_once is None else "failed_at_end"
            raise InputError(f"goal.{key}", "missing", allowed)
        if duration_s == 0.0:
            raise InputError("goal.duration_s", "missing or 0", allowed)
        failed = (at_once, at_end)
    return Goal(
        value=value,
        maximise=maximise,
        success=success,
        failed=failed,
        duration_s=duration_s or math.inf,
    )


def _safety(table: Table) -> Safety:
    def share(key: str) -> float:
        return table.number(key, getattr(Safety, key), 0.0, 1.0)

    return Safety(
        most_step=share("most_step"),
        least_success=share("least_success"),
        least_kept=share("least_kept"),
    )


def _number(table: Table, key: str, missing: Missing) -> float | Missing:
    """The number of a key that may be missing."""
    return table.number(key) if table.has(key) else missing


def require_failures(goal: Goal, simulated: Sequence[float] | None) -> None:
    """Refuse failures that are worth more than a success, or than all that was simulated.

    Args:
        goal: of a new bench.
        simulated: the least and the largest value in the worlds; None: in none of these
            units.
    """
    for key, value in goal.failures.items():
        if goal.success is not None and goal.is_better(value, goal.success):
            allowed = f"a value worse than goal.success, {goal.success:g}"
            raise InputError(f"goal.{key}", value, allowed)
        if simulated and all(goal.is_better(value, end) for end in simulated):
            least, most = simulated
            best = f"the best one simulated, of {least:.4g} to {most:.4g}"
            allowed = f"a value worse than {best}; or failed all runs of the worlds?"
            raise InputError(f"goal.{key}", value, allowed)
    if goal.failed is not None and goal.is_better(*goal.failed):
        at_once, at_end = goal.failed
        allowed = f"a value no worse than goal.failed_at_once, {at_once:g}"
        raise InputError("goal.failed_at_end", at_end, allowed)


def _of_store(table: Table, plan: Plan) -> FeatureTable:
    """The rows of a store: with features, or else in the worlds of its families."""
    # Of the walker: what has no store does without, as `status` does.
    from storage.store import open_store
    from study.experiment.features import told_of, world_table

    path, features = table.folder / table.text("store"), table.texts("features")
    better = better_of(table)
    asked = table.text("asked") if table.has("asked") else None
    if asked is not None and (features or not asked):
        allowed = "none beside features" if features else "a file"
        raise InputError("candidates.asked", asked, allowed)
    store = open_store(path)

    def told(field: str, names: tuple[str, ...]) -> ByFamily:
        if len(names) > 1:
            raise InputError(field, list(names), "one column that the worlds keep")
        return told_of(store, names[0], field)

    limits = in_worlds(plan.columns, told)
    if FALL in plan.allowed:
        lasted = told_of(store, SURVIVED, "limit.fall")
        limits[FALL] = {family: 1.0 - each for family, each in lasted.items()}
    if features:
        found = FeatureTable.from_parquet(path, features=features).rows
    else:
        if asked:
            _simulator_of(plan)  # refused before the first trial
        found = world_table(path, _cost_of(table, plan, better)).rows
        assert found.worlds is not None
        found = replace(found, worlds=replace(found.worlds, better=better))
    return FeatureTable(replace(found, limits=limits_in_worlds(limits, len(found))))


def _cost_of(table: Table, plan: Plan, better: Better | None) -> "Cost":
    """What a trial costs in a world of the store, as [candidates] says."""
    from study.experiment.objective import PRINTED, Objective, Term, named_function

    cost = table.text("cost", SMOOTH)
    goal = plan.goal if better is None else replace(plan.goal, failed=None)
    term = Term(cost, 1.0, function=named_function(table, cost))
    return Objective(cost).in_worlds if cost in PRINTED else goal.in_worlds(term)


def _simulator_of(plan: Plan) -> Callable[[Floats], Floats]:
    """The simulator of the store, to be asked what other points cost in its worlds."""
    from study.experiment.features import worlds_function

    table = Table(plan.candidates.unread, "candidates", plan.candidates.folder)
    assert plan.store is not None and plan.asked is not None
    cost = _cost_of(table, plan, better_of(table))
    try:
        return worlds_function(plan.store, plan.asked, cost)
    except InputError as error:
        if error.field != "config":
            raise
        given = str(plan.candidates.unread["asked"])
        raise InputError("candidates.asked", given, error.allowed) from None

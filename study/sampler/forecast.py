"""What to expect before the first trial: worlds that are left out take the machine's place.

Each world is a robot: the sampler proposes rows by the other worlds, and what a row
costs in the world that was left out is the reading. After so many trials the first
success comes, and so good is the best of ten. Then the same with the world's whole
family left out: a robot on ground of a kind that no world has.

All of it rests on robots like the worlds. A real machine differs from every one of
them, and is harder. Rows alone are tried here, of many the better part (`MOST_ROWS`); on
a machine points beside them are tried too.
"""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isnan, nan
from typing import Any

import numpy as np
import optuna
from optuna.study import StudyDirection

from storage.inputs import checks
from storage.inputs.errors import InputError
from study.sampler.arrays import Floats
from study.sampler.policy import TableExhaustedError
from study.sampler.risk import AllowedRisk, RiskError, allowed_risk
from study.sampler.rows import Rows
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from study.sampler.worlds import Worlds

TRIALS = 10
MOST_ROBOTS = 32  # of more worlds some, every family alike
MOST_WORLDS = 256  # that samplers know, likewise
MOST_ROWS = 2000  # of more rows the best thousand, and a thousand of all other ranks
SOON = 3  # trials: a family is hard if fewer than half of its robots succeed by then
INTERRUPTED = "interrupted: a forecast begins anew"
MIDDLE = (0.1, 0.5, 0.9)  # quantiles: the middle 80 %, and the median

Report = Callable[[int, int], object]
"""Is told how many robots are done, and of how many."""


@dataclass(frozen=True)
class Robot:
    """A world that took the machine's place.

    Attributes:
        family: of the world, by name.
        first: the trial of its first success, from 1; infinite: none was; NaN: nothing
            says what a success is.
        best: its best value after all trials; NaN: there was none, since no candidate
            was within the allowed risk.
        refused: whether its trials ended early, for that.
    """

    family: str
    first: float
    best: float
    refused: bool = False


@dataclass(frozen=True)
class Forecast:
    """What came of some robots, each of them a world that the sampler was not told of.

    Attributes:
        trials: that each robot had, at most.
        like: robots of whose family the sampler knew other worlds.
        strange: the same worlds, while it knew none of their family; none where there is
            one family.
    """

    trials: int
    like: tuple[Robot, ...]
    strange: tuple[Robot, ...]

    @property
    def first(self) -> tuple[float, float, float]:
        """The trial of the first success: the ends of the middle 80 %, and the median between."""
        return middle([robot.first for robot in self._all])

    @property
    def best(self) -> tuple[float, float, float]:
        """The best value after all trials, likewise."""
        return middle([robot.best for robot in self._all])

    @property
    def _all(self) -> tuple[Robot, ...]:
        return self.like + self.strange

    @property
    def hard(self) -> list[str]:
        """Families of which fewer than half succeed soon, and how many do."""
        found = list[str]()
        for family in dict.fromkeys(robot.family for robot in self.like):
            own = [robot for robot in self.like if robot.family == family]
            soon = sum(robot.first <= SOON for robot in own)
            if 2 * soon < len(own) and not isnan(own[0].first):
                found.append(f"{family} ({soon} of {len(own)})")
        return found

    def __str__(self) -> str:
        """Some lines for people."""
        count = "1 robot" if len(self.like) == 1 else f"{len(self.like)} robots"
        said = self._said(self.like)
        if isnan(self.like[0].first):
            lines = [f"{count} like your worlds: {said}"]
        else:
            lines = [f"Of {count} like your worlds {said}"]
        if self.strange:
            said = self._said(self.strange)
            lines.append(f"While no world of their kind was known, {said}")
        if self.hard:
            lines.append(f"Hard, within {SOON} trials: {', '.join(self.hard)}.")
        lines.append("Each is a world that was left out. Another machine is harder.")
        return "\n".join(lines)

    def _said(self, robots: Collection[Robot]) -> str:
        parts = list[str]()
        first = np.array([robot.first for robot in robots])
        if not np.isnan(first).any():
            parts.append(_successes(first, self.trials))
        refused = sum(robot.refused for robot in robots)
        if refused:
            parts.append(f"for {refused} no candidate was within the allowed risk")
        low, _, high = middle([robot.best for robot in robots])
        if not isnan(low):
            best = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            parts.append(f"best value after {self.trials}: {best} (the middle 80 %)")
        return "; ".join(parts) + "."


def middle(values: Collection[float]) -> tuple[float, float, float]:
    """Quantiles `MIDDLE` of values, of which some are infinite; NaN is none."""
    known = np.array([value for value in values if not isnan(value)])
    if not len(known):
        return nan, nan, nan
    # Not interpolated: between a number and infinity there is nothing.
    low, median, high = np.quantile(known, MIDDLE, method="inverted_cdf").tolist()
    return low, median, high


def _successes(first: Floats, trials: int) -> str:
    """In words when robots had their first success, [r]."""
    every, told = len(first), list[str]()
    if not np.isfinite(first).any():
        return f"none succeeded within {trials} trials"
    last = int(first[np.isfinite(first)].max())
    for count in sorted({1, min(SOON, last), last}):
        within = int((first <= count).sum())
        when = "in the first trial" if count == 1 else f"within {count} trials"
        if within:
            told.append(f"{'all' if within == every else within} {when}")
        if within == every:
            break
    missed = every - int(np.isfinite(first).sum())
    if missed:
        told.append(f"{missed} not within {trials}")
    told[0] = told[0].replace(" ", " succeeded ", 1)
    return ", ".join(told)


@checks.checked(
    table=checks.instance(FeatureTable),
    success=checks.optional(checks.number()),
    maximise=checks.flag,
    allowed_risk=checks.optional(allowed_risk),
    seed=checks.whole(0, checks.LARGEST_SEED),
    robots=checks.whole(1),
    report=checks.optional(checks.function),
)
def forecast(
    table: FeatureTable,
    *,
    success: float | None = None,
    maximise: bool = False,
    allowed_risk: AllowedRisk | None = None,
    seed: int = 0,
    robots: int = MOST_ROBOTS,
    report: Report | None = None,
) -> Forecast:
    """What to expect of a machine that is like the worlds of a table, before its first trial.

    Args:
        table: with outcomes in two worlds or more, in the unit of a trial's value.
        success: as of a sampler; None: values alone are told.
        maximise: whether high values are good.
        allowed_risk: as of a sampler; a left-out world tells of the table's limits too.
        seed: of the samplers.
        robots: at most so many worlds take the machine's place.
        report: is told of each robot that is done, and of how many.

    Raises:
        InputError: a table without such outcomes, or of several goals.
    """
    require_worlds(table.rows)
    rows = _some_rows(table.rows, maximise=maximise)
    options = {"seed": seed, "success": success, "allowed_risk": allowed_risk}
    return _Left(rows, options, maximise).forecast(robots, report)


def require_worlds(rows: Rows) -> None:
    """Refuse a table of which nothing can be forecast.

    Raises:
        InputError: no outcomes in two worlds, in the unit of the value.
    """
    field, worlds = "table.outcomes", rows.worlds
    if worlds is None:
        raise InputError(field, "none", "costs in two worlds or more")
    if worlds.better is not None:
        allowed = "costs: in units of their own they tell of no trial's value"
        raise InputError(field, f"better={worlds.better!r}", allowed)
    if worlds.goals > 1:
        raise InputError(field, f"{worlds.goals} goals", "costs of one goal")
    if len(worlds.names) < 2:
        raise InputError(field, "1 world", "two worlds or more: each is left out once")


def family_of(world: str) -> str:
    """The family of a world, by its name."""
    return world.rpartition(" ")[0]


def some_worlds(names: Sequence[str], most: int) -> list[int]:
    """All worlds by their places, or `most` of them, every family alike, spread evenly."""
    by_family = dict[str, list[int]]()
    for world, name in enumerate(names):
        by_family.setdefault(family_of(name), []).append(world)
    families = _spread([*by_family.values()], most)
    each, more = divmod(most, len(families))
    left, found = 0, list[int]()
    for place, worlds in enumerate(families):
        # What small families leave goes to those that come after them.
        count = each + (place < more) + left
        own = _spread(worlds, count)
        left = count - len(own)
        found += own
    return sorted(found)


def _spread(values: list[Any], most: int) -> list[Any]:
    """At most so many of some values, evenly spread."""
    if len(values) <= most:
        return values
    return [values[place * len(values) // most] for place in range(most)]


def _some_rows(rows: Rows, *, maximise: bool) -> Rows:
    """Rows that may be proposed in their worlds, or `MOST_ROWS` of them in `MOST_WORLDS`."""
    worlds, numbers = rows.worlds, rows.numbers
    assert worlds is not None
    if len(worlds.names) > MOST_WORLDS:
        known = some_worlds(worlds.names, MOST_WORLDS)
        left = {worlds.names[place] for place in known}
        worlds = worlds.without([name for name in worlds.names if name not in left])
    if len(numbers) > MOST_ROWS:
        sign = -1.0 if maximise else 1.0
        mean = sign * worlds.costs[numbers] @ worlds.weights
        best, others = np.split(np.argsort(mean, kind="stable"), [MOST_ROWS // 2])
        spread = np.linspace(0, len(others) - 1, MOST_ROWS - len(best))
        chosen = np.concatenate([best, others[spread.astype(np.int64)]])
        numbers = np.sort(numbers[chosen])
    return replace(
        rows,
        parameters=rows.parameters[numbers],
        features=rows.features[numbers],
        worlds=worlds.of_numbers(numbers),
        limits={name: limit.of_numbers(numbers) for name, limit in rows.limits.items()},
    )


class _Left:
    """Rows of which some worlds are left out.

    Args:
        rows: as they are.
        options: of the sampler.
        maximise: whether high values are good.
    """

    def __init__(self, rows: Rows, options: Mapping[str, Any], maximise: bool) -> None:
        assert rows.worlds is not None
        self._rows = rows
        self._worlds: Worlds = rows.worlds
        self._options = dict(options)
        self._maximise = maximise

    def forecast(self, robots: int, report: Report | None) -> Forecast:
        """Let at most so many worlds have their trials."""
        names, told = self._worlds.names, list[Robot]()
        alone = [(robot, {names[robot]}) for robot in some_worlds(names, robots)]
        kin = [(robot, self._kin(robot)) for robot, _ in alone]
        # A world without kin is strange already; without other families none is known.
        strange = [(robot, own) for robot, own in kin if 1 < len(own) < len(names)]
        verbosity = optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        try:
            for robot, unknown in [*alone, *strange]:
                # What is odd about the table was said of all its worlds.
                with warnings.catch_warnings(action="ignore", category=UserWarning):
                    told.append(self._tried(robot, unknown))
                if report is not None:
                    report(len(told), len(alone) + len(strange))
        except KeyboardInterrupt:
            raise KeyboardInterrupt(INTERRUPTED) from None
        finally:
            optuna.logging.set_verbosity(verbosity)
        return Forecast(TRIALS, tuple(told[: len(alone)]), tuple(told[len(alone) :]))

    def _kin(self, robot: int) -> set[str]:
        """The worlds of its family."""
        names = self._worlds.names
        own = family_of(names[robot])
        return {name for name in names if family_of(name) == own}

    def _tried(self, robot: int, unknown: Collection[str]) -> Robot:
        """A world as a robot, while some worlds are not known."""
        rows = self._rows
        known = replace(
            rows,
            worlds=self._worlds.without(unknown),
            limits={
                name: limit.without(unknown)
                for name, limit in rows.limits.items()
                if len(limit.without(unknown).names)
            },
        )
        table = FeatureTable(known)
        sampler = FeatureKernelSampler(table, off_grid=0, **self._options)
        direction = (
            StudyDirection.MAXIMIZE if self._maximise else StudyDirection.MINIMIZE
        )
        study = optuna.create_study(sampler=sampler, direction=direction)
        values, refused = list[float](), False
        for _ in range(TRIALS):
            try:
                trial = study.ask(rows.space.as_dict())
            except TableExhaustedError:
                break
            except RiskError:
                refused = True
                break
            # Of a table of one row Optuna asks no sampler, and there is no note.
            row = rows.find(trial.params)
            assert row is not None
            for name, limit in rows.limits.items():
                if self._worlds.names[robot] in limit.names:
                    world = limit.names.index(self._worlds.names[robot])
                    trial.set_constraint(name, 2.0 * limit.costs[row, world] - 1.0)
            values.append(float(self._worlds.costs[row, robot]))
            study.tell(trial, values[-1])
        return self._robot(robot, np.array(values), refused=refused)

    def _robot(self, robot: int, values: Floats, *, refused: bool) -> Robot:
        sign, success = -1.0 if self._maximise else 1.0, self._options["success"]
        first = nan
        if success is not None:
            good = np.flatnonzero(sign * values <= sign * success)
            first = float(good[0]) + 1.0 if len(good) else inf
        best = sign * float((sign * values).min()) if len(values) else nan
        family = family_of(self._worlds.names[robot])
        return Robot(family=family, first=first, best=best, refused=refused)

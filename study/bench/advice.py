"""What the trials of a bench tell: what to try next and why, what to expect, what is best.

All of it follows from a state, and is computed anew for another one. The sampler sees
the trials of the present context alone, in their order and without gaps: so what was
entered wrongly and corrected, broken off and tried again, or undone, leaves no trace in
later proposals. What was learned in other contexts is one more family of worlds. Limits
hold on any ground: what other contexts tell of them counts as if it had been seen here.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isclose
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.inputs.errors import InputError
from study.bench.journal import State, Trial
from study.bench.limits import FALL, named
from study.bench.plan import Plan, Safety
from study.bench.shown import frozen, study_of
from study.sampler.acquisition import Aim
from study.sampler.evidence import RANKED
from study.sampler.history import WHY_ATTRIBUTE
from study.sampler.policy import TableExhaustedError
from study.sampler.prediction import Best, Prediction
from study.sampler.risk import RiskError
from study.sampler.rows import Rows
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from study.sampler.worlds import Worlds

Mask = NDArray[np.bool_]

BEFORE = "as before"  # the world that other contexts tell of
EXPECTED = "Expected: "
NOT_ENTERED = "Not entered"
LIKELY = 0.5  # chance to keep the limits below which they are likelier to be broken
SHOWN_NUMBERS = 6  # of trials, in a sentence


@dataclass(frozen=True)
class Recommended(Best):
    """The trial of the best reading, of those that neither failed nor broke a limit.

    Attributes:
        remark: what is not known of it, or speaks against it; "": nothing.
    """

    remark: str = ""

    def __str__(self) -> str:
        return f"{super().__str__()} {self.remark}".strip()


class Advice:
    """What the trials of a state tell.

    Args:
        plan: of the bench.
        candidates: what may be tried.
        space: distributions of the parameters, by name.
        state: of the bench; its context is the present one.
        simulated: the least and the largest value in the worlds; None: in none of these
            units.
        errors: of predictions, as another process found them (the sampler's `errors`).
    """

    def __init__(
        self,
        plan: Plan,
        candidates: FeatureTable,
        space: Mapping[str, BaseDistribution],
        state: State,
        simulated: Sequence[float] | None,
        errors: Mapping[str, list[float]],
    ) -> None:
        self.plan = plan
        self.candidates = candidates
        self.space = space
        self.state = state
        self.simulated = simulated
        self.errors = errors
        self.here = state.of_context(state.context)
        self.told = [
            trial for trial in state.finished if trial.context == state.context
        ]
        elsewhere = [
            trial for trial in state.finished if trial.context != state.context
        ]
        self.others = list(dict.fromkeys(trial.context for trial in elsewhere))
        self.elsewhere = sorted(
            elsewhere, key=lambda trial: self.others.index(trial.context)
        )

    def propose(
        self, asked: Sequence[Trial]
    ) -> tuple[dict[str, Any], dict[str, Any], str]:
        """Parameters, notes and reason of the next trial, after those that were just asked for.

        Raises:
            InputError: no candidate is left, or none within the limits of [safety] or
                the risks of [limit].
        """
        trials = [*self.here, *asked]
        study = self._study(trials)
        study.sampler = self.sampler
        if self.plan.safety != Safety() or self._minds_limits_elsewhere:
            study.sampler = self._sampler(self._allowed(trials))
        try:
            trial = study.ask(dict(self.space))
        except RiskError as error:
            name = named(error.limit)
            allowed = error.allowed_by("trials of your own (`taichi-nmm bench add`)")
            raise InputError(
                f"limit.{name}", self.plan.allowed[name], allowed
            ) from None
        except TableExhaustedError as error:
            allowed = "a row that nobody has tried"
            raise InputError("candidates", str(error), allowed) from None
        notes = dict(study.get_trials(deepcopy=False)[trial.number].user_attrs)
        return trial.params, notes, self._why(notes.get(WHY_ATTRIBUTE))

    def expected(self, params: Sequence[Mapping[str, Any]]) -> list[str]:
        """What is expected of each candidate, in a sentence; "" where nothing is to be said."""
        if not params:
            return []
        study = self._study(self.told)  # what runs has told nothing
        found = self.sampler.predict(study, params)
        return [self._expected(found, place) for place in range(len(params))]

    def best(self) -> Recommended:
        """The trial of the best reading that neither failed nor broke a limit.

        Those come first of which no other trial with the same parameters did so either,
        and of which all limits were entered.

        Raises:
            InputError: there is none.
        """
        if not self._good:
            allowed = "a finished trial that neither failed nor broke a limit"
            found = "no trial yet"
            if self.told:
                found = f"none of {len(self.told)} trials"
            elif self.state.context:
                found += f" in context {self.state.context!r}"
            raise InputError("recommend", found, allowed)
        doubts = {trial.number: self._doubts_of(trial) for trial in self._good}
        least = min(map(len, doubts.values()))
        named = {number for number, doubt in doubts.items() if len(doubt) == least}
        study = self._study(())
        for trial in self.here:
            limits = {"may be named": -1.0 if trial.number in named else 1.0}
            study.add_trial(frozen(trial, self.space, self.plan, limits))
        best = self.sampler.best(study)
        chosen = self.here[best.number]
        others = [trial for trial in self._good if trial.number not in named]
        remarks = [*doubts[chosen.number], *self._passed_over(chosen, others)]
        known = vars(best) | {"number": chosen.number}
        return Recommended(**known, remark=" ".join(remarks))

    def repeat(self) -> int | None:
        """The trial of which a repeat would tell most: the least sure one that may be the best."""
        if not self._good:
            return None
        best = self.best()
        params = [trial.params for trial in self._good]
        found = self.sampler.predict(self._study(self.here), params)
        may_be = (
            found.high >= best.value
            if self.plan.goal.maximise
            else found.low <= best.value
        )
        if not may_be.any():
            return None
        sure = np.where(may_be, found.low - found.high, np.inf)
        return self._good[int(sure.argmin())].number

    def worth(self) -> str:
        """Which simulated worlds the machine is like, or what the features are worth."""
        if not self.sampler.has_features:
            return ""
        return str(self.sampler.worth(self._study(self.here)))

    @cached_property
    def _good(self) -> list[Trial]:
        """Finished trials that may be named."""
        return [trial for trial in self.told if self.plan.may_be_named(trial)]

    def _study(self, trials: Iterable[Trial]) -> optuna.Study:
        return study_of(trials, self.space, self.plan)

    def _unknown_limits(self, trials: Iterable[Trial]) -> str:
        """Columns with limits that were not entered of some trials, in a sentence, or ""."""
        missing = dict[str, list[int]]()
        for trial in trials:
            for name in self.plan.limited:
                if name not in trial.columns:
                    missing.setdefault(name, []).append(trial.number)
        if not missing:
            return ""
        parts = [f"{name} of {_trials(numbers)}" for name, numbers in missing.items()]
        return f"{NOT_ENTERED}, so that nobody knows whether it was kept: {'; '.join(parts)}."

    def _passed_over(self, chosen: Trial, others: Iterable[Trial]) -> list[str]:
        """What is not known of trials that had better values than the chosen one."""
        better = [
            trial
            for trial in others
            if self.plan.goal.is_better(trial.result, chosen.result)
        ]
        unknown = self._unknown_limits(better)
        if not unknown:
            return []
        numbers = _trials([trial.number for trial in better])
        return [f"{numbers.capitalize()} had better values. {unknown}"]

    def _doubts_of(self, trial: Trial) -> list[str]:
        """What speaks against a trial that may be named."""
        bad = [
            other.number
            for other in self.told
            if other.params == trial.params and not self.plan.may_be_named(other)
        ]
        found = []
        if bad:
            numbers = _trials(bad)
            found.append(
                f"But {numbers} of the same parameters failed or broke a limit."
            )
        unknown = self._unknown_limits([trial])
        return [*found, unknown] if unknown else found

    def _expected(self, found: Prediction, place: int) -> str:
        value = float(found.value[place])
        low = float(found.low[place])
        high = float(found.high[place])
        parts = list[str]()
        if np.isfinite(value):
            interval = "interval unknown"
            if np.isfinite([low, high]).all():
                interval = f"{low:.4g} to {high:.4g} with 95 %"
            better = " or better" if self._is_best(value) else ""
            parts.append(f"{value:.4g}{better} ({interval})")
            if self.simulated is not None:
                least, most = self.simulated
                if not least <= value <= most:
                    parts.append(
                        f"beyond all that was simulated, {least:.4g} to {most:.4g}"
                    )
        if np.isfinite(found.success[place]):
            parts.append(f"success {100 * found.success[place]:.0f} %")
        if FALL in found.risks:
            parts.append(f"a fall {_percent(found.risks[FALL][place])}")
        if self.plan.limited:
            parts.append(self._expected_limits(found, place))
        sentence = f"{EXPECTED}{', '.join(parts)}." if parts else ""
        unknown = self._unknown_limits(self.told)
        return " ".join(filter(None, [sentence, unknown, found.unlike]))

    def _is_best(self, value: float) -> bool:
        """Whether it is the best that was simulated or read: there an expectation ends."""
        if self.simulated is None:
            return False
        choose = max if self.plan.goal.maximise else min
        read = [trial.result for trial in self.told]
        return isclose(value, choose(*self.simulated, *read), rel_tol=1e-9)

    def _expected_limits(self, found: Prediction, place: int) -> str:
        """The chance that limits are kept, where anything tells of them; the unknown, by name."""
        limited = self.plan.limited
        chances = {name: 1.0 for name in map(named, found.risks) if name != FALL}
        for limit, risk in found.risks.items():
            if limit != FALL:
                chances[named(limit)] *= 1.0 - float(risk[place])
        told = {name: kept for name, kept in chances.items() if np.isfinite(kept)}
        kept = np.prod([*told.values()])
        known = ", ".join(name for name in limited if name in told)
        unknown = ", ".join(name for name in limited if name not in told)
        if not known:
            return f"limits unknown ({', '.join(limited)})"
        if unknown:
            return f"limits of {known} kept {100 * kept:.0f} %, of {unknown} unknown"
        all_kept = found.kept[place]
        if FALL in found.risks:
            all_kept = all_kept / max(1.0 - float(found.risks[FALL][place]), 1e-9)
        return f"all limits kept {100 * all_kept:.0f} %"

    def _why(self, aim: str | None) -> str:
        """Why a proposal is made, in a sentence or two.

        Args:
            aim: of the sampler; None: what was fixed left it no choice.
        """
        # A sheet may be read again after other trials have succeeded.
        why = (aim or "the only choice").capitalize()
        if aim == Aim.RANKING:
            with_before = f", {BEFORE!r} among them" if self.others else ""
            return f"{why} by what was simulated in all worlds{with_before}."
        if aim == Aim.LIMITS:
            return f"{why}; no trial had when it was chosen."
        if aim == Aim.SUCCESS and self.plan.goal.success is None:
            return "Likeliest to be of the good values that lie apart in the worlds; none was yet."
        if aim == Aim.SUCCESS:
            return f"{why}; no trial had succeeded when it was chosen."
        if aim == Aim.IMPROVEMENT:
            choose = max if self.plan.goal.maximise else min
            kept = self._within_limits(self.told) or self.told
            best = choose(trial.result for trial in kept)
            return f"{why} on {best:.4g}, the best when it was chosen."
        return f"{why}."

    @property
    def _broken_elsewhere(self) -> list[Trial]:
        """Trials that broke a limit in another context."""
        return [trial for trial in self.elsewhere if self.plan.broke(trial)]

    @property
    def _minds_limits_elsewhere(self) -> bool:
        """Whether a limit was broken elsewhere, and the next trial here is one of the ranking."""
        return len(self.told) < RANKED and bool(self._broken_elsewhere)

    def _allowed(self, trials: Sequence[Trial]) -> Mask:
        """Rows within the limits of [safety]; one at least."""
        safety = self.plan.safety
        rows = self.candidates.rows
        found = self.sampler.predict(self._study(trials))
        # What nobody knows the chance of is allowed: it is NaN.
        keeps = ~(
            (found.kept < safety.least_kept) | (found.success < safety.least_success)
        )
        if self._minds_limits_elsewhere:
            others = ~np.isin(found.rows, self._rows_of(self._broken_elsewhere))
            for wanted in (others, others & ~(found.kept < LIKELY)):
                if (wanted & keeps).any():
                    keeps &= wanted
        good = self._anchors()
        if good and safety.most_step < 1.0:
            apart = np.abs(rows.unit[:, None] - places_of(rows, good)[None])
            keeps &= apart.max(axis=2).min(axis=1) <= safety.most_step
        allowed = np.zeros(len(rows), dtype=bool)
        allowed[found.rows[keeps]] = True
        allowed[self._rows_of(trials)] = False
        if not allowed.any():
            raise InputError(
                "safety", "no candidate within the limits", "wider limits in [safety]"
            )
        return allowed

    def _rows_of(self, trials: Iterable[Trial]) -> list[int]:
        """The rows of the table that trials had."""
        found = [self.candidates.rows.find(trial.params) for trial in trials]
        return [row for row in found if row is not None]

    def _anchors(self) -> list[Trial]:
        """Trials that steps are measured from: that succeeded here, or else on other ground.

        Those that broke a limit count only where none else succeeded.
        """
        good = self._successful(self.told) or self._successful(self.elsewhere)
        return self._within_limits(good) or good

    def _successful(self, told: Iterable[Trial]) -> list[Trial]:
        """Trials that did not fail and, with `goal.success`, are as good as that."""
        return [
            trial
            for trial in told
            if not trial.failed and self.plan.goal.is_good(trial.result)
        ]

    def _within_limits(self, told: Iterable[Trial]) -> list[Trial]:
        """Trials that, as far as is known, broke no limit."""
        return [trial for trial in told if not self.plan.broke(trial)]

    @cached_property
    def sampler(self) -> FeatureKernelSampler:
        """The sampler of the present context."""
        return self._sampler()

    def _sampler(self, allowed: Mask | None = None) -> FeatureKernelSampler:
        limits = [frozen(trial, self.space, self.plan) for trial in self.elsewhere]
        # Other contexts are worlds that nobody simulates.
        may_ask = not self.others
        sampler = self.plan.sampler(self._known, allowed, limits, may_ask=may_ask)
        sampler.errors = self.errors
        return sampler

    @cached_property
    def _known(self) -> FeatureTable:
        """The candidates, with what other contexts tell of them."""
        found = self.candidates
        told = list[NDArray[np.float64]]()
        for context in self.others:
            study = self._study(self.state.of_context(context))
            known = self.plan.sampler(found).predict(study)
            column = np.full(len(found), np.nan)
            column[known.rows] = known.value
            told.append(column)
        if not told:
            return found
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            # They are of rows that are left out.
            columns = np.column_stack(told)
            return with_before(found, columns, maximise=self.plan.goal.maximise)


def places_of(rows: Rows, trials: Iterable[Trial]) -> NDArray[np.float64]:
    """Trials in the unit cube of the parameters, [n, e]."""
    return rows.space.unit(np.array([rows.space.row(each.params) for each in trials]))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "unknown"


def _trials(numbers: Sequence[int]) -> str:
    """Numbers of trials, in words."""
    shown = ", ".join(map(str, numbers[:SHOWN_NUMBERS]))
    if len(numbers) > SHOWN_NUMBERS:
        shown += f" and {len(numbers) - SHOWN_NUMBERS} more"
    return f"trials {shown}" if len(numbers) > 1 else f"trial {shown}"


def with_before(candidates: FeatureTable, told: Any, *, maximise: bool) -> FeatureTable:
    """Candidates of which k other contexts tell something too.

    It is a family of worlds with the weight of all others.

    Args:
        candidates: as they are.
        told: predicted values of the rows, in the study's units, [n, k]; NaN where
            unknown.
        maximise: high values are good.
    """
    rows = candidates.rows
    k = told.shape[1]
    worlds = Worlds(
        names=tuple(f"{BEFORE} {place}" for place in range(k)),
        costs=told,
        weights=np.full(k, 1.0 / k),
    )
    own = rows.worlds
    if own is not None:
        if own.better is not None:  # in units of their own: as many standard deviations
            sign = 1.0 if maximise is (own.better == "higher") else -1.0
            spread = float(np.nanstd(told)) or 1.0
            told = sign * (told - np.nanmean(told)) / spread * np.nanstd(own.costs)
            told = told + np.nanmean(own.costs)
        worlds = Worlds(
            names=(*own.names, *worlds.names),
            costs=np.hstack([own.costs, told]),
            weights=np.concatenate([own.weights, worlds.weights]) / 2.0,
            better=own.better,
        )
    return FeatureTable(replace(rows, worlds=worlds))


def simulated_range(rows: Rows) -> list[float] | None:
    """The least and the largest finite value that was simulated; None: in no worlds of these units.

    Infinity, for which two numbers stand, was not measured in any unit.
    """
    if rows.worlds is None or rows.worlds.better is not None:
        return None
    costs, before = rows.worlds.costs, rows.worlds.as_before
    if before is not None:
        costs = costs[costs == before]
    finite = costs[np.isfinite(costs)]
    return [float(finite.min()), float(finite.max())] if len(finite) else None

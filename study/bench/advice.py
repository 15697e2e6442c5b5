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
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.inputs.errors import InputError
from study.bench.journal import State, Trial
from study.bench.plan import Plan, Safety
from study.bench.shown import frozen, study_of
from study.sampler.policy import RANKED
from study.sampler.prediction import Best, Prediction
from study.sampler.rows import Rows
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from study.sampler.table_policy import TableExhaustedError
from study.sampler.worlds import Worlds

Mask = NDArray[np.bool_]

BEFORE = "as before"  # the world that other contexts tell of
EXPECTED = "Expected: "
LIKELY = 0.5  # chance to keep the limits below which they are likelier to be broken
SHOWN_NUMBERS = 6  # of trials, in a sentence


@dataclass(frozen=True)
class Recommended(Best):
    """The trial that is best by the model, of those that neither failed nor broke a limit.

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
    """

    def __init__(
        self,
        plan: Plan,
        candidates: FeatureTable,
        space: Mapping[str, BaseDistribution],
        state: State,
        simulated: Sequence[float] | None,
    ) -> None:
        self.plan = plan
        self.candidates = candidates
        self.space = space
        self.state = state
        self.simulated = simulated
        self.here = state.of_context(state.context)
        self.told = [trial for trial in self.here if trial.value is not None]

    @cached_property
    def others(self) -> dict[str, list[Trial]]:
        """The trials of each other context in which one is finished."""
        told = [
            trial.context
            for trial in self.state.trials.values()
            if trial.value is not None
        ]
        names = [name for name in dict.fromkeys(told) if name != self.state.context]
        return {name: self.state.of_context(name) for name in names}

    @cached_property
    def elsewhere(self) -> list[Trial]:
        """Finished trials of other contexts."""
        trials = [trial for trials in self.others.values() for trial in trials]
        return [trial for trial in trials if trial.value is not None]

    def propose(
        self, asked: Sequence[Trial]
    ) -> tuple[dict[str, Any], dict[str, Any], str]:
        """Parameters, notes and reason of the next trial, after those that were just asked for.

        Raises:
            InputError: no candidate is left, or none within the limits of [safety].
        """
        study = study_of([*self.here, *asked], self.space, self.plan)
        study.sampler = self.sampler
        if self.plan.safety != Safety() or self._limits_were_broken_elsewhere:
            study.sampler = self._sampler(self._allowed([*self.here, *asked]))
        try:
            trial = study.ask(dict(self.space))
        except TableExhaustedError as error:
            raise InputError(
                "candidates", str(error), "a row that nobody has tried"
            ) from None
        notes = dict(study.get_trials(deepcopy=False)[trial.number].user_attrs)
        return trial.params, notes, self._why()

    def expected(self, params: Sequence[Mapping[str, Any]]) -> list[str]:
        """What is expected of each candidate, in a sentence; "" where nothing is to be said."""
        if not params:
            return []
        study = study_of(self.told, self.space, self.plan)  # what runs has told nothing
        found = self.sampler.predict(study, params)
        return [self._expected(found, place) for place in range(len(params))]

    def best(self) -> Recommended:
        """The best trial by the model that neither failed nor broke a limit.

        Those come first of which no other trial with the same parameters did so either,
        and of which all limits were entered.

        Raises:
            InputError: there is none.
        """
        good = [trial for trial in self.told if self.plan.may_be_named(trial)]
        if not good:
            allowed = "a finished trial that neither failed nor broke a limit"
            context = f" in context {self.state.context!r}" * bool(self.state.context)
            found = (
                f"none of {len(self.told)} trials"
                if self.told
                else f"no trial yet{context}"
            )
            raise InputError("recommend", found, allowed)
        doubts = {trial.number: self._doubts_of(trial) for trial in good}
        least = min(map(len, doubts.values()))
        named = {number for number, doubt in doubts.items() if len(doubt) == least}
        study = study_of((), self.space, self.plan)
        for trial in self.here:
            limits = {"may be named": -1.0 if trial.number in named else 1.0}
            study.add_trial(frozen(trial, self.space, self.plan, limits))
        best = self.sampler.best(study)
        chosen = self.here[best.number]
        others = [trial for trial in good if trial.number not in named]
        remarks = [*doubts[chosen.number], *self._passed_over(chosen, others)]
        return Recommended(
            **vars(best) | {"number": chosen.number}, remark=" ".join(remarks)
        )

    def repeat(self) -> int | None:
        """The trial of which a repeat would tell most: the least sure one that may be the best."""
        good = [trial for trial in self.told if self.plan.may_be_named(trial)]
        if not good:
            return None
        best = self.best()
        study = study_of(self.here, self.space, self.plan)
        found = self.sampler.predict(study, [trial.params for trial in good])
        may_be = (
            found.high >= best.value
            if self.plan.goal.maximise
            else found.low <= best.value
        )
        sure = np.where(may_be, found.low - found.high, np.inf)
        return good[int(sure.argmin())].number if may_be.any() else None

    def worth(self) -> str:
        """Which simulated worlds the machine is like, or what the features are worth."""
        if not self.sampler.has_features:
            return ""
        return str(self.sampler.worth(study_of(self.here, self.space, self.plan)))

    def unknown_limits(self, trials: Iterable[Trial]) -> str:
        """Columns with limits that were not entered of some trials, in a sentence, or ""."""
        missing = dict[str, list[int]]()
        for trial in trials:
            for name in self.plan.limited:
                if name not in trial.columns:
                    missing.setdefault(name, []).append(trial.number)
        if not missing:
            return ""
        parts = [f"{name} of {_trials(numbers)}" for name, numbers in missing.items()]
        return f"Not entered, so that nobody knows whether it was kept: {'; '.join(parts)}."

    def _passed_over(self, chosen: Trial, others: Iterable[Trial]) -> list[str]:
        """What is not known of trials that had better values than the chosen one."""
        sign = -1.0 if self.plan.goal.maximise else 1.0
        better = [
            trial
            for trial in others
            if trial.value is not None
            and chosen.value is not None
            and sign * trial.value < sign * chosen.value
        ]
        unknown = self.unknown_limits(better)
        if not unknown:
            return []
        numbers = _trials([trial.number for trial in better])
        return [f"{numbers.capitalize()} had better values. {unknown}"]

    def _doubts_of(self, trial: Trial) -> list[str]:
        """What speaks against a trial that may be named."""
        same = [other for other in self.told if other.params == trial.params]
        bad = [other.number for other in same if not self.plan.may_be_named(other)]
        found = [
            f"But {_trials(bad)} of the same parameters failed or broke a limit."
        ] * bool(bad)
        unknown = self.unknown_limits([trial])
        return [*found, unknown] if unknown else found

    def _expected(self, found: Prediction, place: int) -> str:
        value, low, high = (
            float(x[place]) for x in (found.value, found.low, found.high)
        )
        parts = list[str]()
        if np.isfinite(value):
            known = np.isfinite(low) and np.isfinite(high)
            interval = "interval unknown"
            if known:
                interval = f"{low:.4g} to {high:.4g}, the mean without noise"
            parts.append(f"{value:.4g} ({interval})")
            if self.simulated is not None and self._is_beyond(value):
                least, most = self.simulated
                parts.append(
                    f"beyond all that was simulated, {least:.4g} to {most:.4g}"
                )
        if np.isfinite(found.success[place]):
            parts.append(f"success {100 * found.success[place]:.0f} %")
        if limits := self._expected_limits(float(found.kept[place])):
            parts.append(limits)
        return f"{EXPECTED}{', '.join(parts)}." if parts else ""

    def _is_beyond(self, value: float) -> bool:
        assert self.simulated is not None
        least, most = self.simulated
        return not least <= value <= most

    def _expected_limits(self, kept: float) -> str:
        """The chance that limits are kept, where trials tell of them; what is unknown, by name."""
        limited = self.plan.limited
        told = {
            name for trial in (*self.told, *self.elsewhere) for name in trial.columns
        }
        known = [name for name in limited if name in told]
        unknown = [name for name in limited if name not in told]
        if not known or not np.isfinite(kept):
            return f"limits unknown ({', '.join(limited)})" if limited else ""
        if unknown:
            chance = f"limits of {', '.join(known)} kept {100 * kept:.0f} %"
            return f"{chance}, of {', '.join(unknown)} unknown"
        return f"all limits kept {100 * kept:.0f} %"

    def _why(self) -> str:
        """Why a proposal is made, in a sentence or two."""
        if not self.told:
            known = ""
            if self.others:
                known = f"the best {BEFORE}, or "
            elif self.candidates.rows.worlds is not None:
                known = "the best simulated, or "
            return f"The first one: {known}one of several to begin with."
        unknown = self.unknown_limits(self.told)
        kept = [
            trial for trial in self.told if self.plan.kept(trial.columns) is not False
        ]
        if not kept:
            why = "No trial has kept all limits yet: the one that most likely does."
        elif self.plan.goal.success is not None and not self._successful(kept):
            why = "No trial has succeeded yet: the one that most likely does, or improves most."
        else:
            choose = max if self.plan.goal.maximise else min
            best = choose(trial.value for trial in kept if trial.value is not None)
            why = f"The largest improvement to be expected on {best:.4g}."
        return f"{why} {unknown}".strip()

    @property
    def _limits_were_broken_elsewhere(self) -> bool:
        """Whether the first trials here, which the ranking chooses, must mind limits too."""
        broken = (self.plan.kept(trial.columns) is False for trial in self.elsewhere)
        return len(self.told) < RANKED and any(broken)

    def _broken_elsewhere(self) -> list[int]:
        """Rows that broke a limit in another context."""
        rows = self.candidates.rows
        broken = (t for t in self.elsewhere if self.plan.kept(t.columns) is False)
        return [row for trial in broken if (row := rows.find(trial.params)) is not None]

    def _allowed(self, trials: Sequence[Trial]) -> Mask:
        """Rows within the limits of [safety]; one at least."""
        safety, rows = self.plan.safety, self.candidates.rows
        found = self.sampler.predict(study_of(trials, self.space, self.plan))
        keeps = ~(found.kept < safety.least_kept) & ~(
            found.success < safety.least_success
        )
        if self._limits_were_broken_elsewhere:
            others = ~np.isin(found.rows, self._broken_elsewhere())
            for wanted in (others, others & ~(found.kept < LIKELY)):
                keeps &= wanted | ~(wanted & keeps).any()
        good = self._anchors()
        if good and safety.most_step < 1.0:
            places = rows.space.unit(
                np.array([rows.space.row(trial.params) for trial in good])
            )
            steps = np.abs(rows.unit[:, None] - places[None]).max(axis=2).min(axis=1)
            keeps &= steps <= safety.most_step
        allowed = np.zeros(len(rows), dtype=bool)
        allowed[found.rows[keeps]] = True
        tried = [
            row for trial in trials if (row := rows.find(trial.params)) is not None
        ]
        allowed[tried] = False
        if not allowed.any():
            raise InputError(
                "safety", "no candidate within the limits", "wider limits in [safety]"
            )
        return allowed

    def _anchors(self) -> list[Trial]:
        """Trials that steps are measured from: that succeeded here, or else on other ground.

        Those that broke a limit count only where none else succeeded.
        """
        for told in (self.told, self.elsewhere):
            good = self._successful(told)
            kept = [
                trial for trial in good if self.plan.kept(trial.columns) is not False
            ]
            if good:
                return kept or good
        return []

    def _successful(self, told: Iterable[Trial]) -> list[Trial]:
        """Trials that did not fail and, with `goal.success`, are as good as that."""
        return [
            trial
            for trial in told
            if trial.value is not None
            and not trial.failed
            and self.plan.goal.is_good(trial.value)
        ]

    @cached_property
    def sampler(self) -> FeatureKernelSampler:
        """The sampler of the present context."""
        return self._sampler()

    def _sampler(self, allowed: Mask | None = None) -> FeatureKernelSampler:
        limits = [frozen(trial, self.space, self.plan) for trial in self.elsewhere]
        return self.plan.sampler(self._known, allowed, limits)

    @cached_property
    def _known(self) -> FeatureTable:
        """The candidates, with what other contexts tell of them."""
        found, told = self.candidates, list[NDArray[np.float64]]()
        for trials in self.others.values():
            study = study_of(trials, self.space, self.plan)
            known = self.plan.sampler(found).predict(study)
            column = np.full(len(found), np.nan)
            column[known.rows] = known.value
            told.append(column)
        if not told:
            return found
        with warnings.catch_warnings(
            action="ignore", category=UserWarning
        ):  # rows left out
            return with_before(
                found, np.column_stack(told), maximise=self.plan.goal.maximise
            )


def _trials(numbers: Sequence[int]) -> str:
    """Numbers of trials, in words."""
    shown = ", ".join(map(str, numbers[:SHOWN_NUMBERS]))
    more = (
        f" and {len(numbers) - SHOWN_NUMBERS} more"
        if len(numbers) > SHOWN_NUMBERS
        else ""
    )
    return f"trial{'s' if len(numbers) > 1 else ''} {shown}{more}"


def with_before(candidates: FeatureTable, told: Any, *, maximise: bool) -> FeatureTable:
    """Candidates of which k other contexts tell something too.

    It is a family of worlds with the weight of all others.

    Args:
        candidates: as they are.
        told: predicted values of the rows, in the study's units, [n, k]; NaN where
            unknown.
        maximise: high values are good.
    """
    rows, k = candidates.rows, told.shape[1]
    before, own = tuple(f"{BEFORE} {place}" for place in range(k)), rows.worlds
    if own is None:
        worlds = Worlds(names=before, costs=told, weights=np.full(k, 1.0 / k))
        return FeatureTable(replace(rows, worlds=worlds))
    if own.better is not None:  # in units of their own: as many standard deviations
        sign = 1.0 if maximise is (own.better == "higher") else -1.0
        spread = float(np.nanstd(told)) or 1.0
        told = sign * (told - np.nanmean(told)) / spread * np.nanstd(own.costs)
        told = told + np.nanmean(own.costs)
    weights = np.concatenate([own.weights / 2.0, np.full(k, 0.5 / k)])
    worlds = Worlds(
        names=(*own.names, *before),
        costs=np.hstack([own.costs, told]),
        weights=weights,
        better=own.better,
    )
    return FeatureTable(replace(rows, worlds=worlds))


def simulated_range(rows: Rows) -> list[float] | None:
    """The least and the largest value that was simulated; None: in no worlds of these units."""
    if rows.worlds is None or rows.worlds.better is not None:
        return None
    costs = rows.worlds.costs
    finite = costs[np.isfinite(costs)]
    return [float(finite.min()), float(finite.max())] if len(finite) else None

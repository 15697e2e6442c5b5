"""Numbers of a bench that were perhaps entered wrongly, as far as the entries can tell.

A number is questioned that no simulated world has, or that is far from those of all
other trials: another unit, a lost decimal point, a clock in nanoseconds. A wrong number
in the midst of others is not found.
"""

import math
import statistics
from collections.abc import Iterator, Sequence

from study.bench.journal import State, Trial
from study.bench.plan import Plan

Range = Sequence[float]

BEYOND_WORLDS = 0.5  # of their range: the machine is not quite any of them
# Of the least one, where all have one sign: a comma moves by 10, a unit mostly by more; the
# best row of the best world is ahead of what a machine does already.
LEAST_OF_WORLDS = 0.1
LEAST_KNOWN = 3  # other numbers, before one of them can be far from all
BEYOND_FAILURES = 3.0  # of the range of worlds: who fails may be worse than all of them
SAME_PRICE = 0.1  # relative, of a fall at once
APART = 1e3  # times the median: another wrong number, which must not hide this one
BEYOND_TRIALS = 3.0  # of their range
FACTOR = 3.0  # from the nearest one, of numbers of one sign
LARGEST = 1e100  # no measurement, in whatever unit


def odd_value(value: float, simulated: Range | None, others: Sequence[float]) -> str:
    """What speaks against a trial's value; "": nothing.

    Args:
        value: that was entered.
        simulated: the least and the largest one in the worlds; None: in none of these
            units.
        others: those of other trials.
    """
    if not abs(value) < LARGEST:
        return f"{value:g} is no measurement: is it right?"
    if simulated is None:
        return _odd_among(value, others)
    if not _is_far(value, simulated, BEYOND_WORLDS, LEAST_OF_WORLDS):
        return ""
    low, high = simulated
    return f"{value:g} is far from all that was simulated, {low:.4g} to {high:.4g}: is it right?"


def odd_failures(plan: Plan, simulated: Range | None) -> list[str]:
    """What is to be questioned of what failures are worth: values and worlds need one unit."""
    failures, fall = plan.goal.failures, plan.price_of_a_fall
    if not failures or simulated is None:
        return []
    at_once = failures["failed_at_once"]
    if fall is not None and abs(at_once - fall) > SAME_PRICE * abs(fall):
        return [
            f"goal.failed_at_once: {at_once:g}, but the store's cost prices falls itself, one at "
            f"once at {fall:.4g}: enter falls by their cost, or take a column of the store for it"
        ]
    low, high = simulated
    beyond = BEYOND_FAILURES * (high - low)
    return [
        f"goal.{key}: {value:g} is far from all that was simulated, {low:.4g} to {high:.4g}: "
        "do trials and worlds have one unit?"
        for key, value in failures.items()
        if not low - beyond <= value <= high + beyond
    ]


def doubts(plan: Plan, state: State, simulated: Range | None) -> dict[int, str]:
    """What is to be questioned, by the number of the trial.

    Args:
        plan: of the bench.
        state: of the bench.
        simulated: as of `odd_value`.
    """
    found = {}
    for trial in state.finished:
        others = [other for other in state.finished if other is not trial]
        said = list(_doubts_of(plan, trial, others, simulated))
        if said:
            found[trial.number] = "; ".join(said)
    return found


def _doubts_of(
    plan: Plan, trial: Trial, others: Sequence[Trial], simulated: Range | None
) -> Iterator[str]:
    if not trial.failed:
        said = odd_value(trial.result, simulated, [other.result for other in others])
        if said:
            yield f"{plan.goal.value} {said}"
    least = plan.least_of_a_walk
    if least is not None and trial.result < least:
        yield (
            f"{plan.goal.value} {trial.value:g} is less than a walk of {plan.goal.duration_s:g} s "
            f"can cost, {least:.4g}: was it a log with clock times?"
        )
    for name, value in trial.columns.items():
        known = [other.columns[name] for other in others if name in other.columns]
        if known:  # the limits of a column tell of its size too
            column = plan.columns[name]
            known += filter(math.isfinite, (column.least, column.most))
        said = odd_value(value, None, known)
        if said:
            yield f"{name} {said}"


def _odd_among(value: float, others: Sequence[float]) -> str:
    """Whether a number is far from all others, of which there are enough."""
    if others:
        middle = statistics.median(map(abs, others))
        others = [other for other in others if abs(other) <= APART * middle]
    if len(others) < LEAST_KNOWN:
        return ""
    low, high = min(others), max(others)
    nearest = low if value < low else high
    is_near = nearest * value > 0.0 and 1.0 / FACTOR <= value / nearest <= FACTOR
    if is_near or not _is_far(value, (low, high), BEYOND_TRIALS):
        return ""
    return (
        f"{value:g} is far from all other trials, {low:.4g} to {high:.4g}: is it right?"
    )


def _is_far(value: float, known: Range, share: float, least: float = 0.0) -> bool:
    """Whether a value is beyond a share of the range of all known ones.

    It is, too, if these have one sign, and it is less than `least` of the smallest: so
    is one of another sign.
    """
    low, high = known
    beyond = share * (high - low)
    smallest = max(low, min(high, 0.0))
    is_small = smallest != 0.0 and value / smallest < least
    return is_small or not low - beyond <= value <= high + beyond

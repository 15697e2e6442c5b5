"""The numbers of an experiment: of each arm, and of each arm against ours, or the paper's method.

Runs are the unit of intervals and tests: trials of one run are not independent. The
number of runs alone seeds the resampling: a report made twice is the same, and arms
with as many runs are resampled alike.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from study.experiment.arms import ARMS, OUR_ARM, PAPER_ARM, Kind
from study.report.runs import ArmRuns, Results

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
ENDS = (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE))  # as quantiles
RESAMPLES = 10_000
CURVE_RESAMPLES = 2_000  # of each of a curve's points
RESAMPLING_SEED = 2016


@dataclass(frozen=True)
class Interval:
    """An estimate with the ends of its 95 % confidence interval.

    Attributes:
        value: the estimate.
        low: the lower end.
        high: the upper end; infinite where too many runs have no value.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PairedTest:
    """Two arms on the same runs.

    Attributes:
        pairs: runs that both have, n.
        unequal: pairs that differ; the test rests on these.
        p: two-sided; 1 where no pair differs.
    """

    pairs: int
    unequal: int
    p: float


def wilson(successes: int, count: int) -> Interval:
    """A proportion with Wilson's score interval.

    Args:
        successes: 0 to `count`.
        count: of all, 1 or more.
    """
    test = scipy.stats.binomtest(successes, count)
    ends = test.proportion_ci(confidence_level=CONFIDENCE, method="wilson")
    return Interval(successes / count, float(ends.low), float(ends.high))


def median(values: ArrayLike) -> Interval:
    """Median over runs, [r], with its percentile bootstrap interval; infinities are allowed.

    A run without a walker counts as infinite: the median is known as long as half the
    runs are.

    Args:
        values: one a run, [r]; no NaN.
    """
    known = np.asarray(values, dtype=np.float64)
    # Not interpolated: between a number and infinity there is nothing.
    low, high = _bootstrap(known, RESAMPLES, "inverted_cdf")
    return Interval(float(np.median(known)), low, high)


def curve(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Median over runs of curves [r, t], and the ends of each point's bootstrap interval, [t].

    Args:
        values: [r, t].
    """
    low, high = np.array([_bootstrap(runs, CURVE_RESAMPLES) for runs in values.T]).T
    return np.median(values, axis=0), low, high


def _bootstrap(
    values: Floats, times: int, method: Literal["linear", "inverted_cdf"] = "linear"
) -> tuple[float, float]:
    """Ends of the percentile interval of the median over runs, [r]."""
    drawn = np.median(values[resamples(len(values), times)], axis=1)
    low, high = np.quantile(drawn, ENDS, method=method)
    return float(low), float(high)


@cache
def resamples(count: int, times: int) -> NDArray[np.int64]:
    """Indices of runs drawn with replacement, [times, count]; not to be written to."""
    seed = np.random.SeedSequence(RESAMPLING_SEED, spawn_key=(count,))
    return np.random.default_rng(seed).integers(count, size=(times, count))


def wilcoxon(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """Signed-rank test of paired values, each [n]; pairs that are equal are left out.

    Args:
        ours: [n].
        theirs: of the same runs, [n].
    """
    difference = np.asarray(ours, dtype=np.float64) - np.asarray(
        theirs, dtype=np.float64
    )
    unequal = difference[difference != 0]
    p = float(scipy.stats.wilcoxon(unequal).pvalue) if len(unequal) else 1.0
    return PairedTest(len(difference), len(unequal), p)


def mcnemar(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """McNemar's exact test of paired yes and no, each [n].

    Args:
        ours: [n].
        theirs: of the same runs, [n].
    """
    first, second = np.asarray(ours, dtype=bool), np.asarray(theirs, dtype=bool)
    only_first, only_second = int(np.sum(first & ~second)), int(np.sum(~first & second))
    unequal = only_first + only_second
    p = float(scipy.stats.binomtest(only_first, unequal).pvalue) if unequal else 1.0
    return PairedTest(len(first), unequal, p)


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p-values, in the order given."""
    order = np.argsort(p_values, kind="stable")
    factors = np.arange(len(order), 0, -1)
    adjusted = np.minimum(
        np.maximum.accumulate(np.asarray(p_values)[order] * factors), 1.0
    )
    return [float(p) for p in adjusted[np.argsort(order)]]


def label_of(arm: str) -> str:
    """The name of an arm for readers; for an arm that was removed, its own name."""
    return ARMS[arm].label if arm in ARMS else arm


def kind_of(arm: str) -> Kind:
    """The kind of an arm; an arm that was removed was ours."""
    return ARMS[arm].kind if arm in ARMS else "ours"


def best_peer(arms: Iterable[ArmRuns]) -> str | None:
    """The peer with most runs with a walker; of equals the earliest, then the cheapest."""
    peers = [arm for arm in arms if kind_of(arm.arm) == "peer"]
    return min(peers, key=_rank).arm if peers else None


def by_rank(arms: Mapping[str, ArmRuns]) -> list[str]:
    """The arms, best first: runs with a walker, then when, then at what cost."""
    return sorted(arms, key=lambda arm: _rank(arms[arm]))


def _rank(arm: ArmRuns) -> tuple[float, float, float]:
    share = arm.walkers / len(arm.runs)
    return -share, float(np.median(arm.first_walker)), float(np.median(arm.best[:, -1]))


WITHIN = (1, 3, 10, 30, 60, 100)  # trials
COST_AFTER = (10, 30, 100)  # trials
COMPARED_AFTER = (10, 30)  # trials


@dataclass(frozen=True)
class ArmNumbers:
    """The results of an arm.

    Attributes:
        arm: its name.
        family: its kind: "ours", "peer" or "control".
        runs: their number.
        trials: of every run; all other numbers but `found` are of these.
        found: trials of all runs together.
        walkers: runs with a walker.
        share: the same as a proportion, 0 to 1, with Wilson's interval.
        first_walker: median of the trials to the first walker; infinite where most runs
            have none.
        within: runs with a walker within so many trials: up to `trials`, or all of
            `WITHIN` if every run has a walker.
        cost_after: median best cost after so many trials, up to `trials`.
        best_cost: median best cost after the last of the trials.
        proposal_ms: median time of a proposal; None where it is not known.
    """

    arm: str
    family: Kind
    runs: int
    trials: int
    found: int
    walkers: int
    share: Interval
    first_walker: Interval
    within: dict[int, int]
    cost_after: dict[int, Interval]
    best_cost: Interval
    proposal_ms: float | None


@dataclass(frozen=True)
class Comparison:
    """An arm against the reference, on the runs that both have.

    Attributes:
        arm: its name.
        after: trials after which the best costs are compared.
        cost: Wilcoxon's signed-rank test of the best costs.
        cost_p_holm: its p, adjusted for all arms that are compared after as many
            trials.
        difference: of the best costs, median over runs; below 0 the arm is better.
        walkers: McNemar's exact test of a walker by the last trial that both have.
        walkers_p_holm: its p, adjusted likewise.
    """

    arm: str
    after: int
    cost: PairedTest
    cost_p_holm: float
    difference: Interval
    walkers: PairedTest
    walkers_p_holm: float


@dataclass(frozen=True)
class Numbers:
    """All numbers of an experiment.

    Attributes:
        experiment: its name.
        arms: best first.
        peer: the best of the peers; None without peers.
        reference: the arm to which the others are compared: ours, or the paper's; None
            without both.
        comparisons: by trials, then in the order of `arms`.
    """

    experiment: str
    arms: tuple[ArmNumbers, ...]
    peer: str | None
    reference: str | None
    comparisons: tuple[Comparison, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs; infinities are null."""
        return dict(plain(asdict(self)))


def numbers(results: Results) -> Numbers:
    """The figures of an experiment."""
    arms = [results.arms[arm] for arm in by_rank(results.arms)]
    reference = next((arm for arm in (OUR_ARM, PAPER_ARM) if arm in results.arms), None)
    return Numbers(
        results.name,
        tuple(_arm_numbers(arm) for arm in arms),
        best_peer(arms),
        reference,
        tuple(_comparisons(arms, results.arms[reference])) if reference else (),
    )


def _arm_numbers(arm: ArmRuns) -> ArmNumbers:
    ended = arm.walkers == len(arm.runs)
    limits = [limit for limit in WITHIN if limit <= arm.trials or ended]
    return ArmNumbers(
        arm=arm.arm,
        family=kind_of(arm.arm),
        runs=len(arm.runs),
        trials=arm.trials,
        found=arm.found,
        walkers=arm.walkers,
        share=wilson(arm.walkers, len(arm.runs)),
        first_walker=median(arm.first_walker),
        within={
            k: int(arm.has_walker[:, min(k, arm.trials) - 1].sum()) for k in limits
        },
        cost_after={
            k: median(arm.best[:, k - 1]) for k in COST_AFTER if k <= arm.trials
        },
        best_cost=median(arm.best[:, -1]),
        proposal_ms=arm.proposal_ms,
    )


def _comparisons(arms: list[ArmRuns], reference: ArmRuns) -> Iterator[Comparison]:
    """After each number of trials that some pair has, or after the last that it has."""
    found: dict[int, list[Comparison]] = {}
    for arm in arms:
        runs, ours, theirs = np.intersect1d(
            arm.runs, reference.runs, return_indices=True
        )
        if arm is reference or not len(runs):
            continue
        last = min(arm.trials, reference.trials)
        walkers = mcnemar(
            arm.has_walker[ours, last - 1], reference.has_walker[theirs, last - 1]
        )
        for after in dict.fromkeys(min(each, last) for each in COMPARED_AFTER):
            pair = arm.best[ours, after - 1], reference.best[theirs, after - 1]
            cost, difference = wilcoxon(*pair), median(pair[0] - pair[1])
            compared = Comparison(
                arm.arm, after, cost, cost.p, difference, walkers, walkers.p
            )
            found.setdefault(after, []).append(compared)
    for after in sorted(found):
        cost_p = holm([each.cost.p for each in found[after]])
        walkers_p = holm([each.walkers.p for each in found[after]])
        for each, of_cost, of_walkers in zip(
            found[after], cost_p, walkers_p, strict=True
        ):
            yield replace(each, cost_p_holm=of_cost, walkers_p_holm=of_walkers)


def plain(value: Any) -> Any:
    """A value for JSON: infinities and NaN are None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value

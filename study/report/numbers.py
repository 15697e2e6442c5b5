"""The figures of an experiment: of each arm, and of each arm against the paper's method."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from study.experiment.arms import PAPER_ARM, Kind
from study.report.appearance import best_peer, by_rank, kind_of
from study.report.runs import ArmRuns, Results
from study.report.statistics import Interval, PairedTest, holm, mcnemar, median, wilcoxon, wilson

WITHIN = (1, 3, 10, 30, 60, 100)  # trials
COST_AFTER = (10, 30, 100)  # trials
COMPARED_AFTER = 30  # trials


@dataclass(frozen=True)
class ArmNumbers:
    """What an arm reached.

    Attributes:
        arm: its name.
        family: whose it is.
        runs: how many.
        trials: that all of them have; every other figure is of these.
        found: trials of all runs together.
        walkers: runs with a walker.
        share: the same as a proportion, Wilson's interval.
        first_walker: median trial of the first walker; infinite where most runs have none.
        within: runs with a walker within so many trials, as far as the trials go, or all have one.
        cost_after: median best cost after so many trials, as far as the trials go.
        best_cost: median best cost after the last of the trials.
        proposal_ms: median time that the sampler took for a trial; None where it is not known.
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
    """An arm against the paper's method, on the runs that both have.

    Attributes:
        arm: its name.
        after: trials after which the best costs are compared.
        cost: Wilcoxon's signed-rank test of the best costs.
        cost_p_holm: its p, adjusted for all arms of the experiment.
        difference: median over runs of its best cost less the paper's method's; below 0 is better.
        walkers: McNemar's exact test of having a walker by the last trial that both have.
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
    """Everything that the table and the programs get.

    Attributes:
        experiment: its name.
        arms: best first.
        peer: the best of the peers, where there are peers.
        comparisons: with the paper's method, where that was run; in the order of the arms.
    """

    experiment: str
    arms: tuple[ArmNumbers, ...]
    peer: str | None
    comparisons: tuple[Comparison, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs; infinities are null."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def numbers(results: Results) -> Numbers:
    """The figures of an experiment."""
    arms = [results.arms[arm] for arm in by_rank(results.arms)]
    return Numbers(
        results.name,
        tuple(_arm_numbers(arm) for arm in arms),
        best_peer(arms),
        tuple(_comparisons(arms, results.arms.get(PAPER_ARM))),
    )


def _arm_numbers(arm: ArmRuns) -> ArmNumbers:
    return ArmNumbers(
        arm=arm.arm,
        family=kind_of(arm.arm),
        runs=len(arm.runs),
        trials=arm.trials,
        found=arm.found,
        walkers=arm.walkers,
        share=wilson(arm.walkers, len(arm.runs)),
        first_walker=median(arm.first_walker),
        within=_within(arm),
        cost_after={k: median(arm.best[:, k - 1]) for k in COST_AFTER if k <= arm.trials},
        best_cost=median(arm.best[:, -1]),
        proposal_ms=arm.proposal_ms,
    )


def _within(arm: ArmRuns) -> dict[int, int]:
    ended = arm.walkers == len(arm.runs)
    known = [limit for limit in WITHIN if limit <= arm.trials or ended]
    return {limit: int(arm.has_walker[:, min(limit, arm.trials) - 1].sum()) for limit in known}


def _comparisons(arms: list[ArmRuns], paper: ArmRuns | None) -> list[Comparison]:
    if paper is None:
        return []
    others = [
        arm for arm in arms if arm.arm != PAPER_ARM and len(np.intersect1d(arm.runs, paper.runs))
    ]
    costs, differences, walkers, afters = [], [], [], []
    for arm in others:
        _, ours, theirs = np.intersect1d(arm.runs, paper.runs, return_indices=True)
        last = min(arm.trials, paper.trials)
        after = min(COMPARED_AFTER, last)
        pair = arm.best[ours, after - 1], paper.best[theirs, after - 1]
        afters.append(after)
        costs.append(wilcoxon(*pair))
        differences.append(median(pair[0] - pair[1]))
        walkers.append(mcnemar(arm.has_walker[ours, last - 1], paper.has_walker[theirs, last - 1]))
    cost_p, walkers_p = (holm([test.p for test in tests]) for tests in (costs, walkers))
    return [
        Comparison(arm.arm, *row)
        for arm, *row in zip(
            others, afters, costs, cost_p, differences, walkers, walkers_p, strict=True
        )
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value

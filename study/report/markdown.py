"""The report of an experiment as Markdown: what each arm saw, what it reached, and the tests."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from study.experiment.arms import ARMS, PAPER_ARM, saw
from study.report.facts import facts
from study.report.numbers import Comparison, Numbers
from study.report.runs import Results
from study.report.statistics import RESAMPLES
from study.report.words import (
    first_walker_text,
    interval_text,
    label,
    p_text,
    share_text,
    table,
)

NO_STORES: Mapping[str, Path] = MappingProxyType({})
UNKNOWN = "not recorded"
METHOD = f"""\
A trial walks if it lasts to its end at 0.3 m/s or more; trials are counted from 1. Runs are the \
unit of all statistics: an arm's trials in one run are one sample. Intervals are 95 %: Wilson's \
score interval for proportions; for medians the percentile bootstrap over runs ({RESAMPLES:,} \
resamples from a fixed `SeedSequence`). A run without a walker counts as later than every trial, \
so that a median "> T" says that no more than half of the runs had one within T trials."""
TESTS = """\
Two-sided tests on pairs of runs, each a body and a ground that both arms met: Wilcoxon's \
signed-rank test of the best costs, McNemar's exact test of having a walker. `n` is the number of \
pairs, and of those that differ, on which a test rests. p is Holm's, adjusted over all arms of the \
table, the unadjusted in brackets. Below 0 the arm is better."""

PROPOSAL = "The last column is the median time in ms that the sampler took to propose a trial."


def report_text(
    results: Results,
    numbers: Numbers,
    optimum: float | None,
    strips: str = "",
    stores: Mapping[str, Path] = NO_STORES,
) -> str:
    """The document; figures are linked by their names beside it.

    Args:
        results: of the experiment.
        numbers: of the same.
        optimum: the estimated optimum, where it is known.
        strips: what the figure of stick figures shows; "" where there is none.
        stores: folders of the stores that the arms read, by key, where they are known.
    """
    figures = FIGURES | ({"strips": strips} if strips else {})
    parts = [
        f"# {results.name}",
        _state(results),
        _facts(results, optimum),
        "## What the arms reached",
        METHOD,
        _reached(numbers),
        _peer(numbers),
        "## Best cost",
        _costs(numbers, results.cost),
        PROPOSAL if any(arm.proposal_ms is not None for arm in numbers.arms) else "",
        *_tests(numbers),
        "## What the arms saw before their first trial",
        _saw(numbers, stores),
        "## Figures",
        *(f"![{words}]({name}.png)" for name, words in figures.items()),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


FIGURES = {
    "best-cost": "Best cost so far against trials",
    "walkers": "Share of runs with a walker against trials",
    "first-walker": "Trials to the first walker, a dot a run",
}


def _state(results: Results) -> str:
    if results.complete:
        most = f"{results.runs} runs of {results.trials} trials"
        until = results.facts.get("until_walker")
        how = f"{most} at most, until the first walker" if until else f"{most} each"
        return f"{len(results.arms)} arms, {how}."
    behind = [
        f"{name} {len(arm.runs)} x {arm.trials}"
        for name, arm in results.arms.items()
        if arm.found + arm.repeated < results.runs * results.trials
    ]
    return (
        f"**Unfinished: {results.found:,} of {results.planned:,} trials are there.** Figures are "
        "of the trials that all runs of an arm have (runs x trials; the most: "
        f"{results.runs} x {results.trials}): {', '.join(behind)}."
    )


def _facts(results: Results, optimum: float | None) -> str:
    """What is known of how the runs were made, a line a fact."""
    known = facts(results)
    if optimum is not None:
        known["estimated optimum"] = f"{optimum:.4g} (level ground, undisturbed body)"
    return "\n".join(f"- {key}: {value}" for key, value in known.items())


def _reached(numbers: Numbers) -> str:
    limits = sorted({limit for arm in numbers.arms for limit in arm.within})
    header = ["arm", "runs", "runs with a walker", "first walker, median trial"]
    rows = [
        [
            label(arm.arm), str(arm.runs), f"{arm.walkers}: {share_text(arm.share)}",
            first_walker_text(arm), *(str(arm.within.get(limit, "-")) for limit in limits),
        ]
        for arm in numbers.arms
    ]  # fmt: skip
    return table([*header, *(f"within {limit}" for limit in limits)], rows)


def _peer(numbers: Numbers) -> str:
    """Which of the peers the figures put in front."""
    if numbers.peer is None:
        return ""
    peer = next(arm for arm in numbers.arms if arm.arm == numbers.peer)
    return (
        f"Best of the peers (most runs with a walker, then the earliest): {label(peer.arm)}, "
        f"median trial {first_walker_text(peer)}."
    )


def _costs(numbers: Numbers, cost: str) -> str:
    after = sorted({trials for arm in numbers.arms for trials in arm.cost_after})
    until = [f"after {trials}" for trials in after] or ["after the last trial"]
    header = ["arm", *(f"median best {cost} cost {when}" for when in until), "ms"]
    rows = []
    for arm in numbers.arms:
        medians = [arm.cost_after.get(trials) for trials in after] or [arm.best_cost]
        time = "-" if arm.proposal_ms is None else f"{arm.proposal_ms:.3g}"
        rows.append([label(arm.arm), *map(interval_text, medians), time])
    return table(header, rows)


def _tests(numbers: Numbers) -> list[str]:
    if not numbers.comparisons:
        return []
    after = max(each.after for each in numbers.comparisons)
    header = [
        "arm", "n", f"best cost after {after} less {PAPER_ARM}'s, median", "Wilcoxon p",
        "n walkers", "McNemar p",
    ]  # fmt: skip
    rows = [_test_row(each, after) for each in numbers.comparisons]
    return [f"## Against the paper's method (`{PAPER_ARM}`)", TESTS, table(header, rows)]


def _test_row(each: Comparison, after: int) -> list[str]:
    remark = "" if each.after == after else f" (after {each.after})"
    return [
        label(each.arm),
        f"{each.cost.pairs}, {each.cost.unequal} differ",
        f"{interval_text(each.difference, '+.3g')}{remark}",
        f"{p_text(each.cost_p_holm)} ({p_text(each.cost.p)})",
        f"{each.walkers.pairs}, {each.walkers.unequal} differ",
        f"{p_text(each.walkers_p_holm)} ({p_text(each.walkers.p)})",
    ]


def _saw(numbers: Numbers, stores: Mapping[str, Path]) -> str:
    rows = [
        [label(each.arm), ARMS[each.arm].summary, saw(ARMS[each.arm], stores)]
        if each.arm in ARMS
        else [label(each.arm), UNKNOWN, UNKNOWN]
        for each in numbers.arms
    ]
    return table(["arm", "what it is", "what its store saw"], rows).replace("---:", "---")

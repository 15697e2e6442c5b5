"""The words of a report: an experiment, several side by side, what a comparison prints."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from study.experiment.arms import ARMS, BEST_ARM, PAPER_ARM, Kind, saw
from study.report.axes import kind_of, label_of
from study.report.numbers import (
    COMPARED_AFTER,
    RESAMPLES,
    ArmNumbers,
    Comparison,
    Interval,
    Numbers,
)
from study.report.runs import Results


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; all columns but the first are aligned right."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *rows))


def escaped(text: str) -> str:
    """Words of a file within Markdown: no tags, no columns, one line."""
    return " ".join(html.escape(text, quote=False).replace("|", "\\|").split())


def count_text(value: float, trials: int) -> str:
    """A trial, or that it is later than all trials."""
    return f"{value:g}" if np.isfinite(value) else f"> {trials}"


def share_text(share: Interval) -> str:
    """A proportion with its interval, in per cent."""
    return f"{share.value:.0%} ({share.low:.0%} to {share.high:.0%})".replace("%", " %")


def share_range(share: Interval) -> str:
    """The interval of a proportion alone, in per cent."""
    return f"{100 * share.low:.0f} to {100 * share.high:.0f} %"


def first_walker_text(arm: ArmNumbers) -> str:
    """The median trial with its interval."""
    low, high = (
        count_text(end, arm.trials) for end in (arm.first_walker.low, arm.first_walker.high)
    )
    return f"{count_text(arm.first_walker.value, arm.trials)} ({low} to {high})"


def p_text(p: float) -> str:
    """A p-value, to two digits."""
    return "< 1e-4" if p < 1e-4 else f"{p:.2g}"


def label(arm: str) -> str:
    """The name that the command knows, and what a reader calls it."""
    return arm if label_of(arm) == arm else f"{arm} ({label_of(arm)})"


def interval_text(interval: Interval | None, form: str = ".3g") -> str:
    """An estimate with its interval; "-" where there is none."""
    if interval is None:
        return "-"
    value, low, high = (format(x, form) for x in (interval.value, interval.low, interval.high))
    return f"{value} ({low} to {high})"


SECONDS_A_MINUTE = 60.0
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


SHOWN_WITHIN = (1, 3, 10, 30, 60)  # trials
ABSENT = "-"


def condensed_table(experiment: Numbers) -> str:
    """The arms, those first that have a walker in most runs, then the soonest; Markdown."""
    against = {each.arm: each for each in experiment.comparisons}
    arms = sorted(experiment.arms, key=lambda arm: (-arm.walkers, arm.first_walker.value))
    header = [
        "arm",
        "runs with a walker",
        "first walker, median trial",
        f"within {', '.join(map(str, SHOWN_WITHIN))}",
        f"best cost after {COMPARED_AFTER}, median",
        f"less that of `{PAPER_ARM}`, paired; p",
    ]
    return table(header, [_row(arm, against.get(arm.arm)) for arm in arms])


def _row(arm: ArmNumbers, against: Comparison | None) -> list[str]:
    cost = arm.cost_after.get(COMPARED_AFTER)
    return [
        f"`{arm.arm}`",
        f"{arm.walkers} of {arm.runs} ({share_range(arm.share)})",
        first_walker_text(arm),
        ", ".join(str(arm.within.get(limit, ABSENT)) for limit in SHOWN_WITHIN),
        ABSENT if cost is None else f"{cost.value:.4g}",
        ABSENT if against is None else _difference(against),
    ]


def _difference(against: Comparison) -> str:
    gap = against.difference
    return f"{gap.value:.3g} ({gap.low:.3g} to {gap.high:.3g}); {p_text(against.cost_p_holm)}"


SOON = (1, 3)  # trials
KINDS: tuple[Kind, ...] = ("peer", "control", "ours")


def overview_text(experiments: Sequence[Numbers]) -> str:
    """Experiments in rows, arms in columns: runs with a walker, and how soon."""
    arms = arms_of(experiments)
    rows = []
    for each in experiments:
        by_name = {arm.arm: arm for arm in each.arms}
        rows.append([each.experiment, *(_cell(by_name.get(arm)) for arm in arms)])
    header = ["experiment", *(label_of(arm) for arm in arms)]
    remark = (
        "Runs with a walker (95 % interval of their share); runs whose first trial walks; one of "
        "whose first three; median trial of the first walker (`> T`: no more than half of the runs "
        "had one in T trials)."
    )
    return f"{table(header, rows)}\n\n{remark}\n"


def arms_of(experiments: Sequence[Numbers]) -> list[str]:
    """All arms: the paper's, our best, then peers, controls and others of ours."""
    known = dict.fromkeys(arm.arm for each in experiments for arm in each.arms)
    first = [arm for arm in (PAPER_ARM, BEST_ARM) if arm in known]
    rest = [arm for kind in KINDS for arm in sorted(known) if kind_of(arm) == kind]
    return first + [arm for arm in rest if arm not in first]


def _cell(arm: ArmNumbers | None) -> str:
    if arm is None:
        return ""
    median = count_text(arm.first_walker.value, arm.trials)
    soon = "; ".join(str(arm.within.get(limit, ABSENT)) for limit in SOON)
    return f"{arm.walkers} of {arm.runs} ({share_range(arm.share)}); {soon}; {median}"


HEADER = "arm                runs  with a walker  first (median)  best cost (median)  ms a trial"


def arms_text(numbers: Numbers) -> str:
    """A table of the arms, in the order of their names."""
    return "\n".join([HEADER, *map(_line, _by_name(numbers))])


def arms_documents(numbers: Numbers, stores: Mapping[str, Path]) -> list[dict[str, Any]]:
    """The same as plain values; a first walker that most runs lack is None.

    Args:
        numbers: of the comparison.
        stores: folders of the experiment's stores, by key.
    """
    return [_document(arm, stores) for arm in _by_name(numbers)]


def _by_name(numbers: Numbers) -> list[ArmNumbers]:
    return sorted(numbers.arms, key=lambda arm: arm.arm)


def _line(arm: ArmNumbers) -> str:
    first = count_text(arm.first_walker.value, arm.trials)
    time = "-" if arm.proposal_ms is None else f"{arm.proposal_ms:.1f}"
    return (
        f"{arm.arm:<18} {arm.runs:>4}  {arm.walkers:>13}  {first:>14}"
        f"  {arm.best_cost.value:>18.4f}  {time:>10}"
    )


def _document(arm: ArmNumbers, stores: Mapping[str, Path]) -> dict[str, Any]:
    first = arm.first_walker.value
    return {
        "arm": arm.arm,
        "saw": saw(ARMS[arm.arm], stores) if arm.arm in ARMS else "",
        "runs": arm.runs,
        "trials": arm.found,
        "walkers": arm.walkers,
        "first_walker": first if np.isfinite(first) else None,
        "best_cost": arm.best_cost.value,
        "proposal_ms": arm.proposal_ms,
    }


def facts(results: Results) -> dict[str, str]:
    """A line a fact; what the folder does not say is left out."""
    sessions = results.facts.get("sessions", [])
    simulation = results.facts.get("simulation", {})
    found = {
        "date": _days(sessions),
        "machine": "; ".join(dict.fromkeys(_words(each.get("machine")) for each in sessions)),
        "wall time": _wall_time(sessions),
        "versions": _words(results.facts.get("versions")),
        "cost": results.cost,
        "a trial": f"{simulation['duration_s']:g} s" if "duration_s" in simulation else "",
        "simulation": _words({k: v for k, v in simulation.items() if k != "duration_s"}),
        "body": _words(results.facts.get("body")),
        "terrain": str(results.facts.get("terrain", {}).get("name", "")),
        "searched beside the 16 gains": ", ".join(results.facts.get("searched", [])),
        "seed": str(results.facts.get("seed", "")),
    }
    return {name: escaped(value) for name, value in found.items() if value}


def _days(sessions: list[dict[str, Any]]) -> str:
    """The first and the last day on which it ran."""
    days = sorted({str(each["started"])[:10] for each in sessions if "started" in each})
    return " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""


def _wall_time(sessions: list[dict[str, Any]]) -> str:
    """Minutes that all sessions took together, pictures and films not included."""
    if not sessions:
        return ""
    seconds = sum(float(each.get("wall_s", 0.0)) for each in sessions)
    trials = sum(int(each.get("trials", 0)) for each in sessions)
    times = f" in {len(sessions)} sessions" if len(sessions) > 1 else ""
    return f"{seconds / SECONDS_A_MINUTE:.1f} min for {trials:,} trials{times}"


def _words(values: dict[str, Any] | None) -> str:
    """Names and values in a line."""
    return ", ".join(f"{name} {value}" for name, value in (values or {}).items())

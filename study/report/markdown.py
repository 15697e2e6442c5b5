"""All words about results: reports, an overview, a table of `compare`, a note of the dashboard."""

import html
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from study.experiment.arms import ARMS, OUR_ARM, PAPER_ARM, Kind, saw
from study.experiment.experiment import study_name
from study.experiment.objective import FRONT
from study.report.numbers import (
    COMPARED_AFTER,
    RESAMPLES,
    ArmNumbers,
    Interval,
    Numbers,
    kind_of,
    label_of,
    plain,
)
from study.report.runs import ArmRuns, Results, runs_of

ABSENT = "-"
UNKNOWN = "not recorded"
WORDS = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)


def table(
    header: Sequence[str], rows: Sequence[Sequence[str]], rule: str = "---:"
) -> str:
    """A Markdown table; `rule` aligns all columns but the first, by default right."""
    rules = ["---", *[rule] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rules, *rows))


def escaped(text: str) -> str:
    """Words of a file within Markdown: no tags, no columns, one line."""
    return " ".join(html.escape(text, quote=False).replace("|", "\\|").split())


def count_text(value: float, trials: int) -> str:
    """A number of trials; "> T" if T were not enough."""
    return f"{value:g}" if np.isfinite(value) else f"> {trials}"


def _p_text(p: float) -> str:
    return "< 1e-4" if p < 1e-4 else f"{p:.2g}"


def _label(arm: str) -> str:
    """The name that commands take, and the name for readers."""
    return arm if label_of(arm) == arm else f"{arm} ({label_of(arm)})"


def _estimate(
    interval: Interval | None, shown: Callable[[float], str] = "{:.3g}".format
) -> list[str]:
    """Two cells: an estimate and its interval."""
    if interval is None:
        return [ABSENT, ABSENT]
    value, low, high = map(shown, astuple(interval))
    return [value, f"{low} to {high}"]


def _walkers(
    numbers: Numbers, limits: Sequence[int], name: Callable[[str], str]
) -> tuple[list[str], list[list[str]]]:
    """Header and a row an arm: runs with a walker, when, and how many within so many trials."""
    header = [
        "arm",
        "runs",
        "runs with a walker",
        "interval of their share, %",
        "trials to the first walker, median",
        "interval",
        *(f"within {limit}" for limit in limits),
    ]
    rows = [
        [
            name(arm.arm),
            str(arm.runs),
            str(arm.walkers),
            f"{100 * arm.share.low:.0f} to {100 * arm.share.high:.0f}",
            *_estimate(arm.first_walker, partial(count_text, trials=arm.trials)),
            *(str(arm.within.get(limit, ABSENT)) for limit in limits),
        ]
        for arm in numbers.arms
    ]
    return header, rows


def report_text(results: Results, numbers: Numbers, stores: Mapping[str, Path]) -> str:
    """The document; it links the figures beside it. `stores` as `saw` takes them."""
    within = {limit for arm in numbers.arms for limit in arm.within}
    parts = [
        f"# {results.name}",
        _state(results),
        "\n".join(f"- {key}: {value}" for key, value in facts(results).items()),
        "## What the arms reached",
        WORDS["method"].format(resamples=RESAMPLES),
        table(*_walkers(numbers, sorted(within), _label)),
        "## Best cost",
        WORDS["front"] if results.cost == FRONT else "",
        _costs(numbers, results.cost),
        WORDS["proposal"]
        if any(arm.proposal_ms is not None for arm in numbers.arms)
        else "",
        *_tests(numbers),
        "## What the arms saw before their first trial",
        _saw(numbers, stores),
        "## Figures",
        *(
            f"![{words}]({name}.png)"
            for name, words in WORDS["figures"].items()
            if name != "front" or results.goals
        ),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


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


def _costs(numbers: Numbers, cost: str) -> str:
    after = sorted({trials for arm in numbers.arms for trials in arm.cost_after})
    header = ["arm"]
    for when in [f"after {trials}" for trials in after] or ["after the last trial"]:
        header += [f"median best {cost} cost {when}", "interval"]
    rows = []
    for arm in numbers.arms:
        row = [_label(arm.arm)]
        for median in [arm.cost_after.get(trials) for trials in after] or [
            arm.best_cost
        ]:
            row += _estimate(median)
        rows.append(
            [*row, ABSENT if arm.proposal_ms is None else f"{arm.proposal_ms:.3g}"]
        )
    return table([*header, "ms"], rows)


def _tests(numbers: Numbers) -> list[str]:
    if not numbers.comparisons:
        return []
    header = [
        "arm",
        "trials",
        f"best cost less that of {numbers.reference}, median",
        "interval",
    ]
    for name in ("Wilcoxon", "McNemar"):
        header += [f"{name}: pairs", "differ", "Holm", "p"]
    rows = []
    for each in numbers.comparisons:
        row = [
            _label(each.arm),
            str(each.after),
            *_estimate(each.difference, "{:+.3g}".format),
        ]
        for test, holm in (
            (each.cost, each.cost_p_holm),
            (each.walkers, each.walkers_p_holm),
        ):
            row += [str(test.pairs), str(test.unequal), _p_text(holm), _p_text(test.p)]
        rows.append(row)
    return [f"## Against `{numbers.reference}`", WORDS["tests"], table(header, rows)]


def _saw(numbers: Numbers, stores: Mapping[str, Path]) -> str:
    rows = []
    for name in (each.arm for each in numbers.arms):
        arm = ARMS.get(name)
        known = [UNKNOWN, UNKNOWN] if arm is None else [arm.summary, saw(arm, stores)]
        rows.append([_label(name), *known])
    return table(["arm", "what it is", "what its store saw"], rows, "---")


def facts(results: Results) -> dict[str, str]:
    """How the runs were made, a line a fact; facts that the folder lacks are left out."""
    sessions = results.facts.get("sessions", [])
    simulation, objective = (
        results.facts.get(name, {}) for name in ("simulation", "objective")
    )
    how = "alone" if "fixed_gains" in results.facts else "beside the 16 gains"
    found = {
        "date": _days(sessions),
        "machine": "; ".join(
            dict.fromkeys(_words(each.get("machine")) for each in sessions)
        ),
        "wall time": _wall_time(sessions),
        "versions": _words(results.facts.get("versions")),
        "cost": results.cost,
        "what it weighs": _words(objective.get("goals", objective.get("terms"))),
        "a trial": f"{simulation['duration_s']:g} s"
        if "duration_s" in simulation
        else "",
        "simulation": _words(
            {k: v for k, v in simulation.items() if k != "duration_s"}
        ),
        "body": _words(results.facts.get("body")),
        "terrain": str(results.facts.get("terrain", {}).get("name", "")),
        "simulator": str(results.facts.get("simulator", "")),
        "noise of costs": str(objective.get("noise", "")),
        f"searched {how}": ", ".join(results.facts.get("searched", [])),
        "seed": str(results.facts.get("seed", "")),
    }
    return {name: escaped(value) for name, value in found.items() if value}


def _days(sessions: list[dict[str, Any]]) -> str:
    """The first day and the last."""
    days = sorted({str(each["started"])[:10] for each in sessions if "started" in each})
    return " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""


def _wall_time(sessions: list[dict[str, Any]]) -> str:
    """Minutes of all sessions together, pictures and films not included."""
    if not sessions:
        return ""
    seconds = sum(float(each.get("wall_s", 0.0)) for each in sessions)
    trials = sum(int(each.get("trials", 0)) for each in sessions)
    times = f" in {len(sessions)} sessions" if len(sessions) > 1 else ""
    return f"{seconds / 60.0:.1f} min for {trials:,} trials{times}"


def _words(values: dict[str, Any] | None) -> str:
    """Names and values in a line."""
    return ", ".join(f"{name} {value}" for name, value in (values or {}).items())


KINDS: tuple[Kind, ...] = ("peer", "control", "ours")
SHOWN_WITHIN = (1, 3, 10, 30, 60)  # trials
OVERVIEW: dict[str, Callable[[ArmNumbers], str]] = {
    "Runs with a walker": lambda arm: str(arm.walkers),
    "Runs whose first trial walks": lambda arm: str(arm.within.get(1, ABSENT)),
    "Runs with a walker within 3 trials": lambda arm: str(arm.within.get(3, ABSENT)),
    "Trials to the first walker, median": lambda arm: count_text(
        arm.first_walker.value, arm.trials
    ),
}


def overview_text(experiments: Sequence[Numbers]) -> str:
    """Tables with an experiment a row and an arm a column: runs with a walker, and how soon."""
    arms = arms_of(experiments)
    header = ["experiment", *(label_of(arm) for arm in arms)]
    parts = []
    for title, cell in OVERVIEW.items():
        rows = []
        for each in experiments:
            cells = {arm.arm: cell(arm) for arm in each.arms}
            rows.append([each.experiment, *(cells.get(arm, "") for arm in arms)])
        parts += [f"{title}:", table(header, rows)]
    remark = "`> T`: no more than half of the runs had a walker in T trials."
    return "\n\n".join([*parts, f"{remark} Intervals below are 95 %."]) + "\n"


def arms_of(experiments: Sequence[Numbers]) -> list[str]:
    """All arms: ours, the paper's, then peers, controls and others of ours."""
    known = dict.fromkeys(arm.arm for each in experiments for arm in each.arms)
    first = [arm for arm in (OUR_ARM, PAPER_ARM) if arm in known]
    rest = [arm for kind in KINDS for arm in sorted(known) if kind_of(arm) == kind]
    return first + [arm for arm in rest if arm not in first]


def condensed_table(experiment: Numbers) -> str:
    """A row an arm, best first."""
    against = {(each.arm, each.after): each for each in experiment.comparisons}
    header, rows = _walkers(experiment, SHOWN_WITHIN, "`{}`".format)
    for after in COMPARED_AFTER:
        less = f"less that of `{experiment.reference}`"
        header += [f"best cost after {after}, median", less, "p"]
        for arm, row in zip(experiment.arms, rows, strict=True):
            cost, known = arm.cost_after.get(after), against.get((arm.arm, after))
            difference = ABSENT if known is None else f"{known.difference.value:+.3g}"
            p = ABSENT if known is None else _p_text(known.cost_p_holm)
            row += [ABSENT if cost is None else f"{cost.value:.4g}", difference, p]
    return table(header, rows)


HEADER = "arm                runs  with a walker    after trials  best cost (median)  ms a trial"


def arms_text(numbers: Numbers) -> str:
    """A table of the arms, in the order of their names."""
    lines = [HEADER]
    for arm in sorted(numbers.arms, key=lambda arm: arm.arm):
        first = count_text(arm.first_walker.value, arm.trials)
        time = ABSENT if arm.proposal_ms is None else f"{arm.proposal_ms:.1f}"
        best = f"{arm.best_cost.value:>18.4f}  {time:>10}"
        lines.append(
            f"{arm.arm:<18} {arm.runs:>4}  {arm.walkers:>13}  {first:>14}  {best}"
        )
    return "\n".join(lines)


def arms_documents(
    numbers: Numbers, stores: Mapping[str, Path]
) -> list[dict[str, Any]]:
    """The same as plain values, and what each arm saw; None for a first walker that most lack."""
    return [
        {
            "arm": arm.arm,
            "saw": saw(ARMS[arm.arm], stores) if arm.arm in ARMS else "",
            "runs": arm.runs,
            "trials": arm.found,
            "walkers": arm.walkers,
            "first_walker": plain(arm.first_walker.value),
            "best_cost": arm.best_cost.value,
            "proposal_ms": arm.proposal_ms,
        }
        for arm in sorted(numbers.arms, key=lambda arm: arm.arm)
    ]


DASHBOARD = "/dashboard"  # where optuna-dashboard serves its pages


def dashboard_summary(
    name: str, trials: pa.Table, final: bool, studies: Mapping[str, int]
) -> str:
    """The note of an experiment's summary study, as `study.experiment.database.Summarise`.

    Of each arm those rows of the results table count that all its runs have. The note
    is renewed once a minute while the experiment runs: medians only, no resampling. Its
    second table links to the studies, of which the dashboard lists hundreds.
    """
    arms = list(runs_of(trials).values())
    state = (
        "all trials" if final else "so far; the experiment is running or was stopped"
    )
    heads, rows = (
        ["arm", "runs", "walked", "walked, %", "first walker", "best cost"],
        [],
    )
    for arm in arms:
        first = count_text(float(np.median(arm.first_walker)), arm.trials)
        percent, best = 100 * arm.walkers / len(arm.runs), np.median(arm.best[:, -1])
        counts = str(len(arm.runs)), str(arm.walkers), f"{percent:.0f}"
        rows.append([arm.arm, *counts, first, f"{best:.4g}"])
    tables = {"table": table(heads, rows), "links": _links(name, arms, studies)}
    return str(
        WORDS["note"].format(name=name, trials=len(trials), state=state, **tables)
    )


def _links(experiment: str, arms: Sequence[ArmRuns], studies: Mapping[str, int]) -> str:
    """A row a run and a column an arm: best costs, linked to the studies that are in `studies`."""
    rows = []
    for run in sorted({int(run) for arm in arms for run in arm.runs}):
        names = [study_name(experiment, arm.arm, run) for arm in arms]
        known = [str(studies[name]) for name in names if name in studies]
        cells = [
            _cell(arm, run, studies.get(name))
            for arm, name in zip(arms, names, strict=True)
        ]
        together = f"[compare]({DASHBOARD}/compare-studies?ids={','.join(known)})"
        rows.append([str(run), *cells, together if len(known) > 1 else ""])
    return table(["run", *(arm.arm for arm in arms), "all arms"], rows)


def _cell(arm: ArmRuns, run: int, number: int | None) -> str:
    """The best cost of an arm in a run."""
    place = np.flatnonzero(arm.runs == run)
    if not len(place):
        return ""
    cost = f"{arm.best[place[0], -1]:.4g}"
    cost = f"**{cost}**" if np.isfinite(arm.first_walker[place[0]]) else cost
    return cost if number is None else f"[{cost}]({DASHBOARD}/studies/{number})"

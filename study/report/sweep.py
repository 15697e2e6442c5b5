"""The report of a sweep: the best cost over the values, a table of the gaits, and their picture."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from numpy.typing import NDArray
from pyarrow.csv import write_csv

from storage.commit import commit, commit_json, commit_text, together
from study.experiment.sweep import Swept, Tuned
from study.pictures import strip, style
from study.report.figures import headline, log_costs
from study.report.markdown import count_text, escaped, table
from study.report.numbers import plain
from study.report.people import QUANTITIES, Known, not_human
from taichi_nmm.result import RESULT_DTYPE, unknown
from taichi_nmm.terrain import Terrain

Floats = NDArray[np.float64]

QUARTILES = (0.25, 0.5, 0.75)
WORDS = """\
`{arm}` tuned {robots} robots anew at each value of `{key}`, {trials} trials each; the \
configuration's seed draws the robots. Costs are {cost}, of the best trial: quartiles over robots. \
`best.csv` has all numbers of the best trial of each robot."""
BESIDE = """\
Medians over the best trials that walk. People: mean and two standard deviations to both sides, of \
walking at their own pace on level ground (Winter 1991; steps a minute: Bae et al. 2024); `-`: no \
table of them. Bold is what no person does; below, in words, at which values."""

Walks = Sequence[tuple[strip.Shown, Terrain]]
"""A walk of each value, and the ground that it walked on."""


def write_sweep(
    folder: Path,
    swept: Swept,
    arm: str,
    trials: int,
    tuned: Sequence[Tuned],
    walks: Walks,
) -> dict[str, Any]:
    """Write report.md, summary.json, best.csv and the figures of a sweep, all or none.

    Args:
        folder: to fill.
        swept: the key and its values.
        arm: its name.
        trials: of each robot at each value.
        tuned: what each value came to.
        walks: that are drawn; empty: of robots that are no walkers.

    Returns:
        What summary.json has.

    Raises:
        InputError: the folder cannot be written.
    """
    found = document(swept, arm, trials, tuned)
    with together(folder) as new:
        write_best_cost(new / "best-cost.png", swept, arm, trials, tuned)
        if walks:
            name = tuned[0].point.base
            title = f"{name}: best trials of robot 0 over {swept.key}"
            figure = strip.gallery_figure(walks, title)
            style.save_png(figure, new / "gaits.png")
        commit(
            new / "best.csv", partial(write_csv, best_table(swept, tuned)), Path.stat
        )
        commit_json(new / "summary.json", found)
        commit_text(new / "report.md", text(found, bool(walks)))
    return found


def document(
    swept: Swept, arm: str, trials: int, tuned: Sequence[Tuned]
) -> dict[str, Any]:
    """All that the report says, as plain values; None: unknown."""
    first = tuned[0].point
    return {
        "experiment": first.base,
        "key": swept.key,
        "arm": arm,
        "trials": trials,
        "robots": len(tuned[0].best),
        "cost": first.experiment.objective.cost,
        "values": [plain(_numbers(each)) for each in tuned],
    }


def _numbers(tuned: Tuned) -> dict[str, Any]:
    """Of one value."""
    low, middle, high = np.quantile(tuned.best_cost, QUARTILES).tolist()
    known = gait(tuned)
    return {
        "value": tuned.point.value,
        "folder": str(tuned.point.out),
        "walkers": int(np.isfinite(tuned.first_walker).sum()),
        "first_walker": float(np.median(tuned.first_walker)),
        "best_cost": middle,
        "best_cost_quartiles": [low, high],
        "gait": {each.column: each.value(known) for each in QUANTITIES if known},
        "not_human": not_human(known) if known else [],
    }


def gait(tuned: Tuned) -> Known:
    """The best trials that walk, medians by column; empty where none walks, or of other robots."""
    rows = tuned.rows[tuned.best["walked"].to_numpy(zero_copy_only=False)]
    if tuned.rows.dtype != RESULT_DTYPE or not len(rows):
        return {}
    found: dict[str, float | None] = {}
    for name in RESULT_DTYPE.names or ():
        values = rows[name][~unknown(name, rows)]
        found[name] = float(np.median(values)) if len(values) else None
    return found


def best_table(swept: Swept, tuned: Sequence[Tuned]) -> pa.Table:
    """The best trial of each robot at each value, with all numbers of the simulator."""
    tables = []
    for each in tuned:
        experiment, rows = each.point.experiment, each.rows
        given = {name: each.best[name] for name in ("run", "trial", "cost", "walked")}
        gains = {name: each.best[name] for name in experiment.names}
        numbers = {name: rows[name] for name in rows.dtype.names or ()}
        value = np.full(len(rows), each.point.value, np.float64)
        columns = {swept.key: value, **given, **gains, **numbers}
        tables.append(pa.table(columns | experiment.words(rows)))
    return pa.concat_tables(tables)


def costs_of(found: Mapping[str, Any]) -> list[list[str]]:
    """A row a value: how many walk, the first walker, and quartiles of the best cost."""
    rows = []
    for each in found["values"]:
        low, high = each["best_cost_quartiles"]
        when = each["first_walker"]
        first = count_text(np.inf if when is None else when, found["trials"])
        shown = [f"{cost:.4g}" for cost in (low, each["best_cost"], high)]
        rows.append([str(each["value"]), str(each["walkers"]), first, *shown])
    return rows


def text(found: Mapping[str, Any], is_drawn: bool) -> str:
    """The report, in Markdown; it links the figures beside it."""
    key, robots = found["key"], found["robots"]
    costs = ["lower quartile", "best cost, median", "upper quartile"]
    header = [
        f"`{key}`",
        f"walk, of {robots}",
        "trials to the first walker, median",
        *costs,
    ]
    parts = [
        f"# {escaped(found['experiment'])} over {escaped(key)}",
        WORDS.format(**found),
        table(header, costs_of(found)),
        "![Best cost over the values](best-cost.png)",
    ]
    if any(each["gait"] for each in found["values"]):
        parts += ["## Beside people", BESIDE, *_gaits(found["values"])]
    if is_drawn:
        parts += ["## The gaits", "![The gaits over the values](gaits.png)"]
    return "\n\n".join(part for part in parts if part) + "\n"


def _gaits(values: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """A row a number, and a column a value, bold where no person is; then why, in words."""
    header = ["", "people", *(str(each["value"]) for each in values)]
    rows = []
    words: dict[str, list[str]] = {}
    for of in QUANTITIES:
        row = [of.label, of.range_text]
        for each in values:
            value = each["gait"].get(of.column)
            far, shown = of.far(value), of.text(value)
            row.append(f"**{shown}**" if far else shown)
            if far:
                words.setdefault(far, []).append(str(each["value"]))
        rows.append(row)
    lines = [
        f"- {far}: {'all' if len(at) == len(values) else ', '.join(at)}"
        for far, at in words.items()
    ]
    return table(header, rows), "\n".join(lines)


SIZE_IN = (7.2, 4.4)
LEFT_IN, BOTTOM_IN, TOP_IN, RIGHT_IN = 0.85, 0.55, 0.75, 0.3
LOG_FROM = 10.0  # the largest cost over the smallest
HOW = "line: median of {robots} robots; band: quartiles; thin: each robot; open: it never walked"


def write_best_cost(
    path: Path, swept: Swept, arm: str, trials: int, tuned: Sequence[Tuned]
) -> Path:
    """The best cost over the values: median over robots, quartiles, and a thin line each."""
    wide, high = SIZE_IN
    figure = style.new_figure(wide, high)
    size = (wide - LEFT_IN - RIGHT_IN, high - BOTTOM_IN - TOP_IN)
    axes = style.axes_at(figure, LEFT_IN, BOTTOM_IN, *size)
    style.tidy(axes)
    order = np.argsort([each.point.value for each in tuned])
    values = np.array([tuned[place].point.value for place in order], np.float64)
    costs = np.array([tuned[place].best_cost for place in order])  # [values, robots]
    fell = np.array([np.isinf(tuned[place].first_walker) for place in order])
    _draw_costs(axes, values, costs, fell)
    cost = tuned[0].point.experiment.objective.cost
    axes.set_xlabel(swept.key, **style.TEXT)
    axes.set_ylabel(f"best {cost} cost of {trials} trials", **style.TEXT)
    title = f"{tuned[0].point.base}: best cost of {arm} over {swept.key}"
    headline(figure, LEFT_IN, title, HOW.format(robots=costs.shape[1]))
    return style.save_png(figure, path)


def _draw_costs(
    axes: Axes, values: Floats, costs: Floats, fell: NDArray[np.bool_]
) -> None:
    """Costs of r robots at v values, [v, r], and whether none of their trials walked, [v, r]."""
    axes.plot(values, costs, color=style.FAINT, linewidth=0.6, alpha=0.8, zorder=2.5)
    places, robots = np.nonzero(fell)
    if len(places):
        axes.plot(
            values[places],
            costs[places, robots],
            "o",
            markerfacecolor="white",
            markeredgecolor=style.FAINT,
            markersize=3.5,
            zorder=2.6,
        )
    low, middle, high = np.quantile(costs, QUARTILES, axis=1)
    axes.fill_between(
        values, low, high, color=style.VERMILION, alpha=0.2, linewidth=0, zorder=3.0
    )
    axes.plot(
        values, middle, "o-", color=style.VERMILION, linewidth=2.0, ms=5, zorder=4.0
    )
    if costs.min() > 0.0 and costs.max() > LOG_FROM * costs.min():
        log_costs(axes)

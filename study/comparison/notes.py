"""What the summary study of an experiment says in the dashboard: a table and a figure."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

FIGURE_POINTS = 50  # of a curve: attributes of a study hold 2 kB each
COLOURS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
)  # fmt: skip  # Okabe & Ito
DASHES = ("solid", "dash", "dot", "dashdot")


@dataclass(frozen=True, eq=False)
class ArmCurves:
    """The trials of an arm, [runs, trials]; where a run is not so far, NaN and False."""

    arm: str
    best_cost: NDArray[np.float64]
    walked: NDArray[np.bool_]

    @property
    def first_walker(self) -> NDArray[np.float64]:
        """Trials to the first walker, counted from 1, [runs]; infinite where there is none."""
        first = self.walked.argmax(axis=1) + 1.0
        return np.where(self.walked.any(axis=1), first, np.inf)


def arm_curves(trials: pa.Table) -> Iterator[ArmCurves]:
    """The arms of the results table, in the order of their names."""
    arms = np.array(trials["arm"].to_pylist(), dtype=object)
    run, trial = (np.asarray(trials[name]) for name in ("run", "trial"))
    best, walked = (np.asarray(trials[name]) for name in ("best_cost", "walked"))
    for arm in sorted(set(arms)):
        mine = arms == arm
        runs, row = np.unique(run[mine], return_inverse=True)
        shape = (len(runs), int(trial[mine].max()) + 1)
        curves = ArmCurves(str(arm), np.full(shape, np.nan), np.zeros(shape, dtype=bool))
        curves.best_cost[row, trial[mine]] = best[mine]
        curves.walked[row, trial[mine]] = walked[mine]
        yield curves


def summary_note(name: str, trials: pa.Table, final: bool) -> str:
    """A table of the arms in Markdown."""
    rows = [_table_row(curves) for curves in arm_curves(trials)]
    state = "all trials" if final else "so far; the experiment is running or was stopped"
    return "\n".join(
        [
            f"# {name}",
            f"{len(trials)} trials ({state}).",
            "",
            "| arm | runs | walked | first walker | best cost |",
            "|---|--:|--:|--:|--:|",
            *rows,
            "",
            "walked: runs with a walker, which lasts to the end at 0.3 m/s or more. first walker:"
            " trials to it, median over runs. best cost: median over runs.",
            "",
            f"The studies are `{name}/<arm>/run-NNN`; run r has the same body and ground in every"
            " arm. The best trial of each shows its picture and film.",
        ]
    )


def _table_row(curves: ArmCurves) -> str:
    walkers, runs = int(np.isfinite(curves.first_walker).sum()), len(curves.best_cost)
    median = np.median(curves.first_walker)
    first = f"{median:.0f}" if np.isfinite(median) else f"> {curves.best_cost.shape[1]}"
    best = np.median(np.nanmin(curves.best_cost, axis=1))
    share = f"{walkers} ({100 * walkers / runs:.0f} %)"
    return f"| {curves.arm} | {runs} | {share} | {first} | {best:.4g} |"


class BestCostFigure:
    """Median over runs of the best cost so far against trials, an arm a curve, as plotly's JSON."""

    def __init__(self, trials: pa.Table) -> None:
        self._curves = list(arm_curves(trials))

    def to_json(self) -> str:
        """The figure as plotly reads it."""
        return json.dumps({"data": list(self._traces()), "layout": self._layout()})

    def _traces(self) -> Iterator[dict[str, Any]]:
        for number, curves in enumerate(self._curves):
            median = np.nanmedian(curves.best_cost, axis=0)
            shown = np.unique(np.linspace(0, len(median) - 1, FIGURE_POINTS).astype(int))
            yield {
                "type": "scatter",
                "mode": "lines",
                "name": curves.arm,
                "x": (shown + 1).tolist(),
                "y": [float(f"{value:.5g}") for value in median[shown]],
                "line": {
                    "color": COLOURS[number % len(COLOURS)],
                    "dash": DASHES[number // len(COLOURS) % len(DASHES)],
                    "shape": "hv",
                },
            }

    def _layout(self) -> dict[str, Any]:
        return {
            "title": {"text": "best cost so far, median over runs"},
            "xaxis": {"title": {"text": "trials"}},
            "yaxis": {"title": {"text": "cost"}, "type": "log"},
            "template": {"layout": {"plot_bgcolor": "white"}},
        }

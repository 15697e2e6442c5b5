"""What the summary study of an experiment says in the dashboard: tables, links and a figure.

It is renewed once a minute while the experiment runs: medians only, no resampling. Its table leads
to the studies, of which the dashboard lists hundreds.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from study.comparison.database import Summary
from study.experiment.experiment import study_name
from study.palette import SERIES, SERIES_DASHES
from study.report.markdown import count_text
from study.report.runs import ArmRuns, runs_of

DASHBOARD = "/dashboard"  # where optuna-dashboard serves its pages


def study_links(
    experiment: str, arms: Sequence[ArmRuns], studies: Mapping[str, int]
) -> Iterator[str]:
    """A table in Markdown, a row a run and a column an arm: best costs that lead to the studies.

    Args:
        experiment: its name.
        arms: as far as all runs of each have come.
        studies: numbers of the studies by name; one that is not there has no link.
    """
    yield f"| run | {' | '.join(arm.arm for arm in arms)} | all arms |"
    yield f"|--:|{'--:|' * len(arms)}---|"
    for run in sorted({int(run) for arm in arms for run in arm.runs}):
        names = [study_name(experiment, arm.arm, run) for arm in arms]
        numbers = [str(studies[name]) for name in names if name in studies]
        cells = [_cell(arm, run, studies.get(name)) for arm, name in zip(arms, names, strict=True)]
        together = f"[compare]({DASHBOARD}/compare-studies?ids={','.join(numbers)})"
        yield f"| {run} | {' | '.join(cells)} | {together if len(numbers) > 1 else ''} |"
    yield ""
    yield "Behind each best cost is its study; bold are those with a walker."


def _cell(arm: ArmRuns, run: int, number: int | None) -> str:
    """The best cost of an arm in a run."""
    place = np.flatnonzero(arm.runs == run)
    if not len(place):
        return ""
    cost = f"{arm.best[place[0], -1]:.4g}"
    cost = f"**{cost}**" if np.isfinite(arm.first_walker[place[0]]) else cost
    return cost if number is None else f"[{cost}]({DASHBOARD}/studies/{number})"


FIGURE_POINTS = 50  # of a curve: attributes of a study hold 2 kB each


def dashboard_summary(
    name: str, trials: pa.Table, final: bool, studies: Mapping[str, int]
) -> Summary:
    """Note and figure of an experiment's trials.

    Args:
        name: of the experiment.
        trials: rows of the results table; of each arm those count that all its runs have.
        final: whether these are all.
        studies: numbers that the dashboard's addresses have for studies, by name.
    """
    arms = list(runs_of(trials).values())
    note = [_note(name, len(trials), arms, final), "", *study_links(name, arms, studies)]
    return Summary("\n".join(note), BestCostFigure(arms))


def _note(name: str, trials: int, arms: Sequence[ArmRuns], final: bool) -> str:
    state = "all trials" if final else "so far; the experiment is running or was stopped"
    return "\n".join(
        [
            f"# {name}",
            f"{trials} trials ({state}).",
            "",
            "| arm | runs | walked | first walker | best cost |",
            "|---|--:|--:|--:|--:|",
            *map(_row, arms),
            "",
            "walked: runs with a walker, which lasts to the end at 0.3 m/s or more. first walker:"
            " trials to it, median over runs. best cost: median over runs. All are of the trials"
            " that every run of the arm has.",
            "",
            "Run r has the same body and ground in every arm. The best trial of each study shows"
            " its picture, of the first runs its film too.",
        ]
    )


def _row(arm: ArmRuns) -> str:
    first = count_text(float(np.median(arm.first_walker)), arm.trials)
    share = f"{arm.walkers} ({100 * arm.walkers / len(arm.runs):.0f} %)"
    best = np.median(arm.best[:, -1])
    return f"| {arm.arm} | {len(arm.runs)} | {share} | {first} | {best:.4g} |"


class BestCostFigure:
    """Median over runs of the best cost so far against trials, an arm a curve.

    Plotly itself is not needed: the dashboard asks of a figure only that it turns into JSON.
    """

    def __init__(self, arms: Iterable[ArmRuns]) -> None:
        """A figure of these arms, coloured in their order."""
        self._arms = tuple(arms)

    def to_json(self) -> str:
        """The figure as plotly reads it."""
        return json.dumps({"data": list(self._traces()), "layout": self._layout()})

    def _traces(self) -> Iterator[dict[str, Any]]:
        for number, arm in enumerate(self._arms):
            median = np.median(arm.best, axis=0)
            shown = np.unique(np.linspace(0, len(median) - 1, FIGURE_POINTS).astype(int))
            yield {
                "type": "scatter",
                "mode": "lines",
                "name": arm.arm,
                "x": (shown + 1).tolist(),
                "y": [float(f"{value:.5g}") for value in median[shown]],
                "line": {
                    "color": SERIES[number % len(SERIES)],
                    "dash": SERIES_DASHES[number // len(SERIES) % len(SERIES_DASHES)],
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

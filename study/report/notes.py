"""The note of an experiment's summary study in the dashboard: two tables.

It is renewed once a minute while the experiment runs: medians only, no resampling. Its second table
links to the studies, of which the dashboard lists hundreds.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from study.experiment.experiment import study_name
from study.report.markdown import WORDS, count_text, table
from study.report.runs import ArmRuns, runs_of

DASHBOARD = "/dashboard"  # where optuna-dashboard serves its pages


def dashboard_summary(name: str, trials: pa.Table, final: bool, studies: Mapping[str, int]) -> str:
    """The note of an experiment's trials, as `study.experiment.database.Summarise`.

    Of each arm those rows of the results table count that all its runs have.
    """
    arms = list(runs_of(trials).values())
    state = "all trials" if final else "so far; the experiment is running or was stopped"
    heads = ["arm", "runs", "walked", "walked, %", "first walker", "best cost"]
    note: str = WORDS["note"].format(
        name=name,
        trials=len(trials),
        state=state,
        table=table(heads, list(map(_row, arms))),
        links=_links(name, arms, studies),
    )
    return note


def _row(arm: ArmRuns) -> list[str]:
    first = count_text(float(np.median(arm.first_walker)), arm.trials)
    percent = f"{100 * arm.walkers / len(arm.runs):.0f}"
    best = f"{np.median(arm.best[:, -1]):.4g}"
    return [arm.arm, str(len(arm.runs)), str(arm.walkers), percent, first, best]


def _links(experiment: str, arms: Sequence[ArmRuns], studies: Mapping[str, int]) -> str:
    """A row a run and a column an arm: best costs, linked to the studies that are in `studies`."""
    rows = []
    for run in sorted({int(run) for arm in arms for run in arm.runs}):
        names = [study_name(experiment, arm.arm, run) for arm in arms]
        known = [str(studies[name]) for name in names if name in studies]
        cells = [_cell(arm, run, studies.get(name)) for arm, name in zip(arms, names, strict=True)]
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

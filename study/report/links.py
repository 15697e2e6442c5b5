"""The way from an experiment's summary to its studies, of which the dashboard lists hundreds."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from study.experiment.experiment import study_name
from study.report.runs import ArmRuns

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

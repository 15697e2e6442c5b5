"""What worlds let expect of the walker, beside what came of the experiments' robots.

    python tools/compare_forecast.py out/compare/rough8-smooth out/compare/risers

For each comparison the worlds of its store, left out in turn, are the machine
(`study.sampler.forecast`): all of them, and those of the families whose ground is that of
the experiment. Prints a table of when the first success came, and of the least cost after
ten trials: the middle 80 % of the forecast, and the middle 80 % and the median of the
robots of the arm `worlds`. A line at the end counts the medians that are within.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np

    from storage.inputs.config import Table
    from storage.inputs.errors import InputError
    from study.experiment.features import world_table
    from study.experiment.objective import Objective, read_objective
    from study.options import Options
    from study.report.runs import Results, known_stores, read_results
    from study.sampler.forecast import TRIALS, Forecast, forecast, middle
    from taichi_nmm.result import RESULT_DTYPE

ARM = "worlds"
NONE = "none"
GROUNDS = {  # the families of a ground, by the begin of their names
    "rough": "rough",
    "outside-gravel": "",  # no family has its ground
    "outside": "rough",
    "risers": "blocks",
    "ramp-up": "up",
    "ramp-down": "down",
}


def main() -> None:
    parser = Options(__file__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR")
    for line in table(parser.parse_args().folders):
        print(line, flush=True)


def table(folders: list[Path]) -> Iterator[str]:
    """The lines of the table.

    Raises:
        InputError: before the first line: no comparison of walkers, or its store is gone.
    """
    every = [read_results(folder) for folder in folders]
    known = [known_of(results) for results in every]
    yield (
        "| experiment | first success: all worlds | of this ground | robots | median "
        f"| least cost after {TRIALS}: all worlds | of this ground | robots | median |"
    )
    yield "|---|---|---|---|---:|---|---|---|---:|"
    within = {"all worlds": 0, "of this ground": 0}
    count = 0
    for results, (objective, store) in zip(every, known, strict=True):
        arm = results.arms.get(ARM)
        if arm is None:
            print(f"{results.folder}: no trials of {ARM} yet", file=sys.stderr)
            continue
        forecasts = expected(results, objective, store)
        first = np.where(arm.first_walker <= TRIALS, arm.first_walker, np.inf)
        cells = list[str]()
        # Of robots whose trials ended with the first walker no later cost is known.
        best = arm.best[:, TRIALS - 1 : TRIALS]
        for name, values in (("first", first), ("best", best.ravel())):
            if not len(values):
                cells += 4 * ["-"]
                continue
            low, median, high = middle(values)
            for which, found in zip(within, forecasts, strict=True):
                ends = getattr(found, name)
                cells.append(f"{shown(ends[0])} to {shown(ends[2])}")
                if name == "first":
                    within[which] += ends[0] <= median <= ends[2]
            cells += [f"{shown(low)} to {shown(high)}", shown(median)]
        count += 1
        yield f"| {results.name} | {' | '.join(cells)} |"
    said = ", ".join(f"{which}: {number}" for which, number in within.items())
    yield f"\nMedian trials to the first success within the forecast, of {count}: {said}"


def shown(value: float) -> str:
    """A number in a cell."""
    return f"{value:.4g}" if value < float("inf") else NONE


def known_of(results: Results) -> tuple[Objective, Path]:
    """What a trial of the experiment costs, and the store whose worlds the arm knew.

    Raises:
        InputError: no walker had these trials, or the store is gone, or another one now.
    """
    facts, store = results.facts, known_stores(results).get(ARM)
    if store is None or "simulator" in facts or "objective" not in facts:
        allowed = f"a comparison of walkers, whose store of {ARM} is there, unchanged"
        raise InputError("folder", str(results.folder), allowed)
    given = Table(dict(facts["objective"]), "objective")
    return read_objective(given, RESULT_DTYPE.names or ()), store


def expected(
    results: Results, objective: Objective, store: Path
) -> tuple[Forecast, Forecast]:
    """The forecast for an experiment: of all worlds, and of those of its ground."""
    every = computed(store, objective, results.facts["simulation"]["duration_s"])
    ground = next((GROUNDS[key] for key in GROUNDS if results.name.startswith(key)), "")
    like, strange = (
        tuple(robot for robot in robots if robot.family.startswith(ground))
        for robots in (every.like, every.strange)
    )
    return every, replace(every, like=like, strange=strange)


@cache
def computed(store: Path, objective: Objective, duration_s: float) -> Forecast:
    """The forecast of all worlds of a store."""
    candidates = world_table(store, objective.in_worlds)
    assert candidates.rows.worlds is not None
    return forecast(
        candidates,
        success=objective.success(duration_s),
        robots=len(candidates.rows.worlds.names),
    )


if __name__ == "__main__":
    run_command(main)

"""A sweep: one arm tunes the same robots anew at each of several values of one key.

Each value has an experiment of its own, which differs from the configuration by this
key and by its name, and the folder of a comparison. So a sweep resumes as comparisons
do, and each of its folders is one.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from storage.inputs import typed
from storage.inputs.errors import InputError
from storage.inputs.reading import json_document
from storage.pool import local_pool
from storage.tables import document_hash
from study.experiment.arms import check_arms
from study.experiment.compare import Progress, Request, compare
from study.experiment.database import Summarise
from study.experiment.experiment import Experiment, Floats, Rows
from study.experiment.folder import (
    EXPERIMENT_NAME,
    ExperimentFolder,
    by_study,
    document,
)

MOST_VALUES = 100
LARGEST_WHOLE = 2**53  # beyond it a float is no exact whole number
KEY = re.compile(r"[\w-]+(\.[\w-]+)*", re.ASCII)
FORM = "KEY=START:STOP:STEP or KEY=VALUE,VALUE,..., such as world.muscles.SOL_left=1:0:-0.1"

Number = float | int


@dataclass(frozen=True)
class Swept:
    """What is swept.

    Attributes:
        key: of the configuration, with the tables that it lies in.
        values: that it has, each once; whole ones are `int`.
    """

    key: str
    values: tuple[Number, ...]

    @property
    def label(self) -> str:
        """The last part of the key."""
        return self.key.rpartition(".")[2]

    def over(self, value: Any) -> dict[str, Any]:
        """The tables of a configuration in which the key has a value."""
        found = value
        for name in reversed(self.key.split(".")):
            found = {name: found}
        return dict(found)


def read_swept(word: str) -> Swept:
    """What a user wrote, as `FORM`.

    Raises:
        InputError: another form, no numbers, or a range that never ends or misses its stop.
    """
    key, _, given = word.partition("=")
    parts = given.split(":")
    if not KEY.fullmatch(key) or not given or len(parts) not in (1, 3):
        raise InputError("over", word, FORM)
    if len(parts) == 3:
        start, stop, step = (typed.number("over", part) for part in parts)
        numbers = _range(word, start, stop, step)
    else:
        numbers = [typed.number("over", each) for each in given.split(",")]
    if len(numbers) > MOST_VALUES:
        raise InputError("over", word, f"at most {MOST_VALUES} values")
    return Swept(key, tuple(dict.fromkeys(map(_plain, numbers))))


def _range(word: str, start: float, stop: float, step: float) -> list[float]:
    """From start to stop, both of which are among them: in decimals."""
    first, last, by = (Decimal(str(number)) for number in (start, stop, step))
    steps = (last - first) / by if by else Decimal(-1)
    if steps < 0:
        allowed = "a step that leads from the start to the stop: this range never ends"
        raise InputError("over", word, allowed)
    if steps < MOST_VALUES and steps % 1:
        allowed = f"a step that ends at {stop:g}, or values with commas between them"
        raise InputError("over", word, allowed)
    count = int(min(steps, Decimal(MOST_VALUES))) + 1
    return [float(first + by * number) for number in range(count)]


def _plain(number: float) -> Number:
    whole = number.is_integer() and abs(number) < LARGEST_WHOLE
    return int(number) if whole else number


@dataclass(frozen=True)
class Point:
    """One value of a sweep.

    Attributes:
        value: of the key.
        base: name of the configuration.
        experiment: with this value, which its name tells.
        out: folder of its comparison.
    """

    value: Number
    base: str
    experiment: Experiment
    out: Path


Read = Callable[[Mapping[str, Any]], Experiment]
"""Reads a configuration, with tables laid over it."""


def points_of(swept: Swept, read: Read, out: Path) -> list[Point]:
    """The experiments of all values; each has all its trials, also after its first walker.

    Values of earlier calls in the folder are among them, so that its report loses none;
    the order is then from the least to the largest.

    Args:
        swept: the key and its values.
        read: the configuration.
        out: folder of the sweep; each value has one in it.

    Raises:
        InputError: an unknown key, a value that it does not allow, a key that decides
            no trial, or a folder with another experiment: it would get this report.
    """
    base = _read(swept, swept.values[0], read).name
    values: Collection[Number] = swept.values
    for file in sorted(out.rglob(EXPERIMENT_NAME)):
        name = json_document("out", file, "an experiment").get("name")
        shown = file.parent.name
        if name != f"{base}-{swept.label}-{shown}":
            allowed = f"a folder of this sweep alone: {file} is of {name}"
            raise InputError("out", str(out), allowed)
        earlier = _plain(typed.number("out", shown))
        if earlier not in values:
            values = sorted([*values, earlier])
    experiments = [
        replace(_read(swept, value, read), until_walker=False) for value in values
    ]
    different = {document_hash(document(each, ())) for each in experiments}
    if len(different) < len(experiments):
        allowed = (
            "a key that decides trials: with some of these values they are the same"
        )
        raise InputError("over", swept.key, allowed)
    points = []
    for value, experiment in zip(values, experiments, strict=True):
        shown = str(value).replace("+", "")
        named = replace(experiment, name=f"{base}-{swept.label}-{shown}")
        points.append(Point(value, base, named, out / shown))
    return points


def _read(swept: Swept, value: Number, read: Read) -> Experiment:
    """The experiment with a value; where the key has a range, this is the whole range."""
    try:
        return read(swept.over(value))
    except InputError as refused:
        if refused.field != swept.key:
            raise
        try:
            return read(swept.over([value, value]))
        except InputError:
            raise refused from None


@dataclass(frozen=True, eq=False)
class Tuned:
    """What one value came to, on r robots.

    Attributes:
        point: the value.
        best: the best trial of each robot, as tables of trials have it, [r].
        best_cost: after the last trial, `Objective.best`, [r].
        first_walker: trials to the first walker, its own among them; infinite where
            none walked, [r].
        rows: what the simulator gives of the best trials, [r].
    """

    point: Point
    best: pa.Table
    best_cost: Floats
    first_walker: Floats
    rows: Rows


def sweep(
    points: Sequence[Point],
    arm: str,
    request: Request,
    report: Callable[[Progress], None],
    summarise: Summarise,
) -> Iterator[Tuned]:
    """Tune at each value, or what is missing of it.

    Args:
        points: the values.
        arm: its name.
        request: as of a comparison; its folder, arms and storage are not looked at.
        report: called whenever trials are finished, with those of all values.
        summarise: as of a comparison.

    Raises:
        InputError: before anything is computed: as `compare`, of any of the values;
            later: as `compare`.
        KeyboardInterrupt: finished trials are kept.
    """
    for point in points:
        trials = request.trials or point.experiment.trials
        arms = check_arms(point.experiment, [arm], trials)
        ExperimentFolder.check(point.out, document(point.experiment, arms))
    # A cluster looks at the experiment; processes of this machine take any.
    opened = nullcontext() if request.cluster else local_pool(request.workers)
    with opened as pool:
        done = Progress(trials=0, total=0, studies=0, walkers=0)
        for point in points:

            def show(progress: Progress, before: Progress = done) -> None:
                nonlocal done
                done = Progress(
                    trials=before.trials + progress.trials,
                    total=progress.total * len(points),
                    studies=progress.studies * len(points),
                    walkers=before.walkers + progress.walkers,
                )
                report(done)

            asked = replace(
                request, out=point.out, arms=(arm,), storage=None, pool=pool
            )
            outcome = compare(point.experiment, asked, show, summarise)
            runs = request.runs or point.experiment.runs
            yield _tuned(point, _asked_for(outcome.trials, arm, runs, trials))


def _asked_for(table: pa.Table, arm: str, runs: int, trials: int) -> pa.Table:
    """The trials of a folder that this call asks for; an earlier one may have made more."""
    wanted = pc.and_(pc.less(table["run"], runs), pc.less(table["trial"], trials))
    return table.filter(pc.and_(wanted, pc.equal(table["arm"], arm)))


def _tuned(point: Point, table: pa.Table) -> Tuned:
    """The best trial of each robot, simulated once more for all of its numbers."""
    studies = [rows for _, _, rows in by_study(table)]
    best = pa.concat_tables(
        rows.slice(int(rows["cost"].to_numpy().argmin()), 1) for rows in studies
    )
    names = point.experiment.names
    searched = np.column_stack([best[name].to_numpy() for name in names])
    walks = [rows["walked"].to_numpy(zero_copy_only=False) for rows in studies]
    return Tuned(
        point=point,
        best=best,
        best_cost=np.array([rows["best_cost"][-1].as_py() for rows in studies]),
        first_walker=np.array(
            [walk.argmax() + 1.0 if walk.any() else np.inf for walk in walks]
        ),
        rows=point.experiment.simulate(best["run"].to_numpy(), searched),
    )

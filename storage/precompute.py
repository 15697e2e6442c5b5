"""Filling a store: shard after shard, from wherever an earlier run stopped."""

import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.cautions import cautions
from storage.inputs import checks
from storage.inputs.config import Table, completed
from storage.points import sobol_points
from storage.pool import IN_PROCESS, MOST_LOCAL, Pool, cores, local_pool, own_kind
from storage.search import evolved_points
from storage.simulator import Report, Simulator, a_simulator, failed_runs, run_points
from storage.specification import Family, Specification, read_specification
from storage.store import (
    EVOLVED_ROW,
    SOBOL_ROW,
    Store,
    evaluated_name,
    family_names,
    open_store,
    outcome_name,
    shard_table,
)
from storage.store_folder import StoreFolder

TYPICAL_ALIVE = 0.1  # of random points, at the age from which families run them
TYPICAL_KEPT = 0.01  # of random points, where a family comes after another one

Progress = Callable[[float], None]
"""Called with the points done so far, those of earlier runs and parts of a shard included.

The runs of a search count as points.
"""

ScoredRows = tuple[pa.Table, dict[str, Any]]
"""A table of rows, and names and versions of the software that computed it."""


class Unit(NamedTuple):
    """A unit of work: a shard, a part of one, or several that follow one another.

    Attributes:
        specification: of the store.
        shard: the first one's number, from 0.
        rows: of the store, all in these shards.
        evolved: the points of these rows, [n, p]; None: they are Sobol points.
        name_kind: whether to name the kind of machine that computes it.
    """

    specification: Specification
    shard: int
    rows: range
    evolved: NDArray[np.float64] | None
    name_kind: bool


@dataclass(frozen=True)
class Summary:
    """The end of a run, in numbers.

    Attributes:
        path: the store's folder.
        points: in the store.
        points_computed: by this run.
        walks_searched: by this run, for candidates beyond the grid.
        shards: in the store.
        alive_at_horizon: points that completed the base setting.
        alive_fraction: the same as a share of all points, 0 to 1.
        evaluated: points that were run in the worlds of each family, by its name.
        wall_s: of computing and writing, compilation included.
        walkers_per_s: points computed and walks searched, over `wall_s`; 0: there were
            none.
        specification_hash: SHA-256 of the specification.
        cautions: what makes the store a poor guide, a line each.
    """

    path: str
    points: int
    points_computed: int
    walks_searched: int
    shards: int
    alive_at_horizon: int
    alive_fraction: float
    evaluated: dict[str, int]
    wall_s: float
    walkers_per_s: float
    specification_hash: str
    cautions: list[str]


def precompute(
    specification: Specification,
    path: Path,
    fresh: bool = False,
    progress: Progress = lambda points: None,
    pool: Pool = IN_PROCESS,
) -> Summary:
    """Finish the store at `path`, or make it.

    However this ends, it loses the shards in work and no others. The next call goes on,
    unless it is to start over, `fresh`, and the manifest at the end is that of a run
    that nothing stopped. Files do not depend on the pool, by which shards are computed;
    a single one, in this process. Progress is told within a shard by a pool in this
    process, by others a shard at a time.

    Raises:
        InputError: see `StoreFolder.claim`; the disk is full, or a process of the pool
            was killed.
    """
    layout = specification.layout
    with StoreFolder.claim(path, specification.document, fresh) as folder:
        pool.agree(path)
        missing = folder.missing()
        grid = [number for number in missing if number < layout.grid_shards]
        computed = sum(layout.shard_range(number)[1] for number in missing)
        start_s = time.perf_counter()
        tally = Tally(progress, layout.rows - computed)
        _fill(folder, specification, grid, tally, pool)
        if specification.repertoire is not None:
            asked = _asked(specification, pool)
            points = evolved_points(
                folder, asked, specification.repertoire, pool, tally.walked
            )
            _fill(folder, specification, missing[len(grid) :], tally, pool, points)
        wall_s = time.perf_counter() - start_s
        folder.write_manifest()
        return _summary(specification, path, computed, tally.walks, wall_s)


@dataclass
class Tally:
    """Counts finished points and walks of a search, and reports the sum to `progress`.

    Attributes:
        progress: called with the sum.
        done: points, and walks of a search, those of earlier runs included.
        walks: of a search that this run did.
    """

    progress: Progress
    done: int
    walks: int = 0

    def add(self, points: int) -> None:
        """Count points that are done."""
        self.done += points
        self.progress(self.done)

    def walked(self, walks: int, now: bool) -> None:
        """Count walks of a search; those of earlier runs are not of `now`."""
        self.walks += walks if now else 0
        self.add(walks)


def _fill(
    folder: StoreFolder,
    specification: Specification,
    missing: list[int],
    tally: Tally,
    pool: Pool,
    evolved: NDArray[np.float64] | None = None,
) -> None:
    """Commit the missing shards as they come: those of the grid, or those of `evolved` points.

    These are the points of all rows after the grid's, [candidates, p]. A single shard
    of the grid is computed in this process, if the simulator has threads of its own.
    """
    simulator = specification.simulator
    code = {"code_version": simulator.code_version}
    has_threads = simulator.on_one_thread() is not simulator
    if len(missing) == 1 and evolved is None and not pool.kinds and has_threads:
        pool = IN_PROCESS
    units = _units(_asked(specification, pool), missing, pool, evolved)
    parts: dict[int, list[pa.Table]] = {number: [] for number in missing}

    def score_here(unit: Unit) -> ScoredRows:
        return _score(
            unit, lambda part: tally.progress(tally.done + part * len(unit.rows))
        )

    tally.add(0)
    score = score_here if pool.in_process else _score
    for unit, (table, computed_by) in pool.results(score, units):
        place, number = 0, unit.shard
        while place < len(table):
            first, size = folder.layout.shard_range(number)
            part = table.slice(place, first + size - unit.rows[place])
            parts[number].append(part)
            if sum(map(len, parts[number])) == size:
                whole = (
                    pa.concat_tables(parts.pop(number)).sort_by("row").combine_chunks()
                )
                folder.write_shard(number, whole, code | computed_by)
            place, number = place + len(part), number + 1
        tally.add(len(table))


def _units(
    asked: Specification,
    missing: list[int],
    pool: Pool,
    evolved: NDArray[np.float64] | None,
) -> deque[Unit]:
    """The shards; those of the last round in parts, two a slot, so that all slots end together.

    A mixed pool cuts none: a shard is of one machine. In this process shards of the
    grid that follow one another are a unit, as many as the simulator wants.
    """
    layout, last = asked.layout, len(missing) % pool.slots or pool.slots
    cut = 2 * pool.slots // last if pool.shares_machine and not pool.mixed else 1
    units: deque[Unit] = deque()
    most = asked.simulator.points_at_once if pool.in_process else 0
    for place, number in enumerate(missing):
        first, size = layout.shard_range(number)
        if units and evolved is None:
            before = units[-1].rows
            if before.stop == first and len(before) + size <= most:
                rows = range(before.start, first + size)
                units[-1] = units[-1]._replace(rows=rows)
                continue
        step = -(-size // cut) if place >= len(missing) - last else size
        for start in range(first, first + size, step):
            rows = range(start, min(start + step, first + size))
            points = (
                None
                if evolved is None
                else evolved[start - layout.samples :][: len(rows)]
            )
            units.append(Unit(asked, number, rows, points, pool.mixed))
    return units


def _asked(specification: Specification, pool: Pool) -> Specification:
    """The specification as units of work are to be run."""
    return specification.on_one_thread() if pool.shares_machine else specification


def _score(unit: Unit, report: Report = lambda part: None) -> ScoredRows:
    table, computed_by = score_rows(unit.specification, unit.rows, report, unit.evolved)
    kind = {"kind": own_kind(unit.specification.simulator)} if unit.name_kind else {}
    return table, computed_by | kind


def score_rows(
    specification: Specification,
    rows: range,
    report: Report,
    evolved: NDArray[np.float64] | None = None,
) -> ScoredRows:
    """Run the points of rows in the base setting, and those that last in the families' worlds.

    They are points of the grid, or `evolved` ones, [n, p]. A row depends on no other
    row. `report` is called with the fraction that is done.
    """
    simulator, horizon_s = specification.simulator, specification.horizon_s
    points = evolved
    if points is None:
        points = sobol_points(
            specification.seed, rows.start, len(rows), simulator.parameters
        )
    parts = progress_parts(specification, report)
    run, computed_by = run_points(
        simulator, points, specification.worlds, 1, horizon_s, parts[0]
    )
    base = run[:, 0]
    columns: dict[str, NDArray[Any]] = {}
    for family, part in zip(specification.families, parts[1:], strict=True):
        chosen = base[simulator.survived] >= family.min_survival_s / horizon_s
        if family.after:
            survived = columns[family_names(family.after, simulator.survived)[0]]
            chosen &= survived >= family.min_survived_fraction
        columns |= score_family(specification, family, points, chosen, part)
        part(1.0)
    origin = SOBOL_ROW if evolved is None else EVOLVED_ROW
    table = shard_table(
        specification.schema, simulator, rows.start, points, base, columns, origin
    )
    return table, dict(computed_by)


def score_family(
    specification: Specification,
    family: Family,
    points: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    report: Report,
) -> dict[str, NDArray[Any]]:
    """Mean and spread of every score over the worlds of a family, and the outcomes in each.

    Of what runs that failed did not give, they are over the others; NaN where all
    failed. Of the points [n, p] those `chosen`, [n], are run; the others get zeros.
    Columns are by name, [n] each; outcomes are [n, w], NaN for what a run that failed
    did not give.
    """
    simulator = specification.simulator
    outcomes = {
        name: outcome_name(family.name, name) for name in specification.outcomes
    }
    columns: dict[str, NDArray[Any]] = {evaluated_name(family.name): chosen}
    names = [family_names(family.name, score) for score in simulator.scores]
    columns |= {name: np.zeros(len(points)) for pair in names for name in pair}
    shape = len(points), family.settings
    columns |= {
        name: np.zeros(shape, simulator.outcome_type) for name in outcomes.values()
    }
    place = np.flatnonzero(chosen)
    if not len(place):
        return columns
    rows, _ = run_points(
        simulator,
        points[place],
        family.worlds,
        family.settings,
        family.horizon_s,
        report,
    )
    failed = failed_runs(simulator, rows)
    for score, (mean, spread) in zip(simulator.scores, names, strict=True):
        values = rows[score].astype(np.float64)
        columns[mean][place] = values.mean(axis=1)
        columns[spread][place] = values.std(axis=1)
        if score != simulator.survived:  # a failed run's zero is no number of it
            for row in np.flatnonzero(failed.any(axis=1)).tolist():
                given = values[row][~failed[row]]
                columns[mean][place[row]] = given.mean() if len(given) else np.nan
                columns[spread][place[row]] = given.std() if len(given) else np.nan
    for score, name in outcomes.items():
        with np.errstate(over="ignore"):
            values = rows[score].astype(simulator.outcome_type)
        # no infinity, a best or worst
        values[np.isinf(values) & np.isfinite(rows[score])] = np.nan
        if score != simulator.survived:
            values[failed] = np.nan  # no number, which a zero would be
        columns[name][place] = values
    return columns


def progress_parts(specification: Specification, report: Report) -> list[Report]:
    """`report` cut into one for the base setting and one a family, in proportion to their work."""
    work = [specification.horizon_s]
    for family in specification.families:
        share = TYPICAL_KEPT if family.after else TYPICAL_ALIVE
        work.append(share * family.settings * family.horizon_s)
    ends = np.cumsum([0.0, *work]) / sum(work)
    ends[-1] = 1.0

    def part(start: float, end: float) -> Report:
        return lambda done: report(start + (end - start) * min(done, 1.0))

    return [part(float(start), float(end)) for start, end in pairwise(ends)]


def _summary(
    specification: Specification, path: Path, computed: int, walks: int, wall_s: float
) -> Summary:
    store, rows = open_store(path), specification.layout.rows
    survived = specification.simulator.survived
    alive = np.count_nonzero(store.numpy([survived])[survived] >= 1.0)
    names = {
        family.name: evaluated_name(family.name) for family in specification.families
    }
    run = store.numpy(names.values())
    return Summary(
        path=str(path),
        points=rows,
        points_computed=computed,
        walks_searched=walks,
        shards=specification.layout.shards,
        alive_at_horizon=int(alive),
        alive_fraction=float(alive / rows),
        evaluated={family: int(run[name].sum()) for family, name in names.items()},
        wall_s=round(wall_s, 3),
        walkers_per_s=round((computed + walks) / wall_s, 1)
        if computed + walks
        else 0.0,
        specification_hash=specification.hash,
        cautions=cautions(store, survived),
    )


@checks.checked(
    simulator=a_simulator,
    out=checks.path,
    workers=checks.optional(checks.whole(1, MOST_LOCAL)),
    fresh=checks.flag,
)
def make_store(
    simulator: Simulator,
    out: str | Path,
    *,
    workers: int | None = None,
    fresh: bool = False,
    **configuration: Any,
) -> Store:
    """Fill the store of a simulator, or go on, and open it.

    A script that calls this with several workers does so below `if __name__ ==
    "__main__":`, since each worker imports it.

    Args:
        simulator: such as a `FunctionSimulator`.
        out: folder of the store.
        workers: processes; None is one a core.
        fresh: start over.
        **configuration: what a configuration of `taichi-nmm precompute` has: samples,
            seed, simulation, world, families, repertoire, ...

    Raises:
        InputError: a value out of range, a folder of another store, a simulator that
            does not keep what it promises.

    Warns:
        UserWarning: no row came to the end of the base setting, or of a family.
    """
    table = Table(completed(configuration))
    specification = read_specification(table, simulator=simulator)
    specification.simulator.require_machine()
    workers = simulator.processes(cores()) if workers is None else workers
    with local_pool(workers) as pool:
        summary = precompute(specification, Path(out), fresh, pool=pool)
    for line in summary.cautions:
        # of the caller, beyond the check of arguments
        warnings.warn(line, stacklevel=3)
    return open_store(out)

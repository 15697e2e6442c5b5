"""The search for candidates that survive a family: quality-diversity by CMA-ME.

Fontaine, Togelius, Nikolaidis & Hoover 2020, Covariance matrix adaptation for the rapid
illumination of behavior space; archive and emitters are those of pyribs. Every family
has a search of its own, so one goes on while another waits; each generation is a file
until the search is over.
"""

from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from storage.folder import remove
from storage.inputs.errors import InputError
from storage.points import in_unit_cube, within_bounds
from storage.pool import Pool
from storage.simulator import Simulator, judge_rows, run_points
from storage.specification import (
    BATCH,
    EMITTERS,
    STARTS,
    Family,
    Repertoire,
    Specification,
)
from storage.store import evaluated_name, family_names
from storage.store_folder import GENERATION_PATTERN, StoreFolder, Tried

if TYPE_CHECKING:
    from ribs.emitters import EvolutionStrategyEmitter

STEP = 0.1  # of an emitter at its start, in widths of the bounds
CELLS = 8  # of the archive, a measure

Walked = Callable[[int, bool], None]
"""Called with the runs of a generation, and whether this call made them or an earlier one."""

Search = Generator[NDArray[np.float64], Any, None]
"""Yields points that are to be run, and is sent their `Generation`."""


class Generation(NamedTuple):
    """Points that were tried for a family at a time, and their results.

    Attributes:
        points: [n, p], within the bounds, in units of the parameters.
        objective: of each, over the worlds of the search, the larger the better, [n].
        measures: of each, over the same worlds, in the order of the simulator's, [n,
            m].
    """

    points: NDArray[np.float64]
    objective: NDArray[np.float64]
    measures: NDArray[np.float64]

    @staticmethod
    def names(simulator: Simulator) -> list[str]:
        """Columns of a generation's file."""
        # Measures are in other worlds than a row's columns of the same names.
        tried = (f"tried_{name}" for name in simulator.measures)
        return [
            *(each.name for each in simulator.parameters),
            simulator.objective,
            *tried,
        ]

    def columns(self, simulator: Simulator) -> Tried:
        """The generation by column."""
        return dict(zip(self.names(simulator), np.column_stack(self).T, strict=True))

    @staticmethod
    def of(columns: Tried, simulator: Simulator) -> "Generation":
        """The generation of a file's columns."""
        every = np.column_stack([columns[name] for name in Generation.names(simulator)])
        count = len(simulator.parameters)
        return Generation(every[:, :count], every[:, count], every[:, count + 1 :])


@dataclass(frozen=True, eq=False)
class Unit:
    """A unit of work: a part of a generation, points [n, p] to be run in a family's worlds.

    Attributes:
        simulator: that runs the points.
        family: whose worlds they are run in.
        part: its number in the generation, from 0.
        parts: how many make up the generation.
        points: [n, p], in units of the parameters.
    """

    simulator: Simulator
    family: Family
    part: int
    parts: int
    points: NDArray[np.float64]


def evolved_points(
    folder: StoreFolder,
    asked: Specification,
    repertoire: Repertoire,
    pool: Pool,
    walked: Walked,
) -> NDArray[np.float64]:
    """The points of all rows after the grid's, [candidates, p]: kept ones, or found by a search.

    The grid of the folder is complete. The specification is as units of work are to be
    run.

    Raises:
        InputError: no point of the grid was run on a family, to start from.
    """
    kept = folder.read_repertoire()
    if kept is None:
        found = _search(folder, asked, repertoire, pool, walked)
        lengths = {name: len(generations) - 1 for name, generations in found.items()}
        chosen = choose(found, shares(repertoire.candidates, lengths), asked.simulator)
        columns = {
            name: [g.columns(asked.simulator) for g in found[name]] for name in found
        }
        folder.write_repertoire(columns, chosen)
        kept = folder.read_repertoire()
    else:
        walked(repertoire.walks, False)
    remove(folder.path, GENERATION_PATTERN)  # the repertoire holds all of them
    if kept is None:
        raise InputError(
            "out", str(folder.path), "a folder whose files stay as they were written"
        )
    return kept


def _search(
    folder: StoreFolder,
    asked: Specification,
    repertoire: Repertoire,
    pool: Pool,
    walked: Walked,
) -> dict[str, list[Generation]]:
    """All generations of all families, those of earlier calls included."""
    starts = _grid_starts(folder, asked, repertoire)
    found: dict[str, list[Generation]] = {}
    searches: dict[str, Search] = {}
    done: dict[str, dict[int, Generation]] = {}
    units: deque[Unit] = deque()

    def go_on(family: Family, tried: Generation | None) -> None:
        try:
            points = searches[family.name].send(tried)
        except StopIteration:
            del searches[family.name]
            return
        done[family.name] = {}
        # more where fewer go on
        count = min(len(points), -(-pool.slots // len(searches)))
        for part, piece in enumerate(np.array_split(points, count)):
            units.append(Unit(asked.simulator, family, part, count, piece))

    for family in repertoire.trials:
        own = found[family.name] = []
        evolution = Evolution(asked.simulator, repertoire.stream(family.name))
        start, length = starts[family.name]
        searches[family.name] = _search_for(
            family, folder, evolution, start, length, own, walked
        )
    for family in repertoire.trials:
        go_on(family, None)
    for unit, tried in pool.results(try_points, units):
        parts = done[unit.family.name]
        parts[unit.part] = tried
        if len(parts) == unit.parts:
            ordered = (parts[part] for part in range(unit.parts))
            go_on(
                unit.family,
                Generation(*map(np.concatenate, zip(*ordered, strict=True))),
            )
    return found


def _search_for(
    family: Family,
    folder: StoreFolder,
    evolution: "Evolution",
    start: NDArray[np.float64],
    length: int,
    found: list[Generation],
    walked: Walked,
) -> Search:
    """The search for one family, with worlds of the search's own; `found` gets its generations.

    The first one has the points of the grid, [n, p]; `length` generations of the
    evolution follow. A generation that a file keeps is taken from there. On another
    machine the search may ask for other points, in their last bits: then a file is not
    of this generation, and it and later ones are tried again.
    """
    simulator = evolution.simulator
    for number in range(1 + length):
        points = evolution.ask() if number else start
        columns = folder.read_generation(
            family.name, number, Generation.names(simulator)
        )
        kept = None if columns is None else Generation.of(columns, simulator)
        if kept is None or not np.array_equal(kept.points, points):
            tried: Generation = yield points
            folder.write_generation(family.name, number, tried.columns(simulator))
        else:
            tried = kept
        evolution.tell(tried)
        found.append(tried)
        walked(len(points) * family.settings, tried is not kept)


def _grid_starts(
    folder: StoreFolder, specification: Specification, repertoire: Repertoire
) -> dict[str, tuple[NDArray[np.float64], int]]:
    """For each family, the points of the grid that survive it longest, and generations after them.

    The less the grid survives a family, the longer is the search for it.
    """
    names = [parameter.name for parameter in specification.simulator.parameters]
    share = specification.simulator.survived
    families = [family.name for family in repertoire.families]
    survived = [family_names(name, share)[0] for name in families]
    table = folder.read_grid([*names, *survived, *map(evaluated_name, families)])
    points = np.column_stack([table[name].to_numpy() for name in names])
    starts, falls = {}, {}
    for name, column in zip(families, survived, strict=True):
        run = np.flatnonzero(table[evaluated_name(name)].to_numpy())
        if not len(run):
            allowed = f"a grid of which some point is run on the family {name}"
            raise InputError("samples", specification.samples, allowed)
        fraction = table[column].to_numpy()[run]
        best = np.argsort(-fraction, kind="stable")[:STARTS]
        starts[name], falls[name] = (
            points[run[best]],
            1.0 - float(fraction[best].mean()),
        )
    generations = shares(repertoire.generations, falls)
    return {name: (starts[name], generations[name]) for name in families}


def try_points(unit: Unit) -> Generation:
    """The points of a unit with their results."""
    simulator, family = unit.simulator, unit.family
    rows, _ = run_points(
        simulator, unit.points, family.worlds, family.settings, family.horizon_s
    )
    return Generation(unit.points, *judge_rows(simulator, rows, family.horizon_s))


class Evolution:
    """An archive of candidates, and the evolution strategies (CMA-ES) that fill it.

    The parameters of the simulator are searched, and the archive covers its measures.
    The points depend on the seed and on the generations told, on nothing else. The
    library works on the unit cube.
    """

    def __init__(self, simulator: Simulator, seed: np.random.SeedSequence) -> None:
        """Nothing is known yet."""
        # here: it compiles, and most stores do without
        from ribs.archives import GridArchive

        self.simulator = simulator
        own, *self._seeds = map(int, seed.generate_state(1 + EMITTERS))
        self._archive: GridArchive = GridArchive(
            solution_dim=len(simulator.parameters),
            dims=(CELLS,) * len(simulator.measures),
            ranges=tuple(simulator.measures.values()),
            seed=own,
        )
        self._emitters: list[EvolutionStrategyEmitter] = []

    def ask(self) -> NDArray[np.float64]:
        """The next generation, [GENERATION, p]."""
        unit = folded(np.concatenate([emitter.ask() for emitter in self._emitters]))
        return within_bounds(unit, self.simulator.parameters)

    def tell(self, tried: Generation) -> None:
        """Take the results of the last generation; or first, of the points to start from.

        Emitters begin at the best of these.
        """
        from ribs.emitters import EvolutionStrategyEmitter

        points = in_unit_cube(tried.points, self.simulator.parameters)
        added = self._archive.add(points, tried.objective, tried.measures)
        for number, emitter in enumerate(self._emitters):
            own = slice(number * BATCH, (number + 1) * BATCH)
            told = {name: values[own] for name, values in added.items()}
            emitter.tell(points[own], tried.objective[own], tried.measures[own], told)
        if not self._emitters:
            best = points[np.argsort(-tried.objective, kind="stable")]
            self._emitters = [
                EvolutionStrategyEmitter(
                    self._archive,
                    x0=best[number % len(best)],
                    sigma0=STEP,
                    ranker="2imp",  # new cells first, then by what a cell gained
                    batch_size=BATCH,
                    seed=seed,
                )
                for number, seed in enumerate(self._seeds)
            ]


def folded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points beyond the unit cube's faces, reflected into it.

    The library would draw until all are inside, for ever where a wide strategy sits in
    a corner.

    Args:
        points: [n, p]; inside is 0 to 1.
    """
    return 1.0 - np.abs(np.mod(points, 2.0) - 1.0)


def choose(
    found: dict[str, list[Generation]], shares: dict[str, int], simulator: Simulator
) -> dict[str, NDArray[np.int64]]:
    """Candidates of each family that become rows of the store.

    Half of a family's are the best of a cell each, which keeps ways to succeed apart;
    the others the best of all, however alike: of two that do the same in the search's
    worlds, one may survive in a world where the other fails. The grid's own points, the
    first generation, are rows already.

    Args:
        found: generations of each family, by its name; the first has points of the
            grid.
        shares: how many candidates each family gets.
        simulator: whose measures make the cells.

    Returns:
        By family, numbers of points, counted through its generations; the best come
            first.
    """
    chosen = {}
    for family, generations in found.items():
        objective = np.concatenate([one.objective for one in generations])
        cell = _cells(np.concatenate([one.measures for one in generations]), simulator)
        best = np.argsort(-objective, kind="stable")
        best = best[best >= len(generations[0].points)]
        _, first = np.unique(cell[best], return_index=True)
        elites = best[np.sort(first)][: shares[family] // 2]
        others = best[~np.isin(best, elites)][: shares[family] - len(elites)]
        both = np.concatenate([elites, others])
        chosen[family] = both[np.argsort(-objective[both], kind="stable")]
    return chosen


def _cells(measured: NDArray[np.float64], simulator: Simulator) -> NDArray[np.int64]:
    """Numbers of the archive's cells that measures [n, m] lie in, [n]; beyond: the last one."""
    low, high = np.transpose(list(simulator.measures.values()))
    place = (measured - low) / (high - low) * CELLS
    inside = np.clip(place.astype(np.int64), 0, CELLS - 1)
    return np.asarray(
        np.ravel_multi_index(tuple(inside.T), (CELLS,) * len(low)), dtype=np.int64
    )


def shares(whole: int, weights: dict[str, float] | dict[str, int]) -> dict[str, int]:
    """Parts of a whole in proportion to weights, each at least 1; the largest remainders go up."""
    total, rest = sum(weights.values()), whole - len(weights)
    equal = 1.0 / len(weights)
    exact = {
        key: rest * (value / total if total else equal)
        for key, value in weights.items()
    }
    parts = {key: 1 + int(value) for key, value in exact.items()}
    left = whole - sum(parts.values())
    for key in sorted(exact, key=lambda key: int(exact[key]) - exact[key])[:left]:
        parts[key] += 1
    return parts

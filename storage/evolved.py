"""The candidates of a store: from its repertoire's file, or by the search that writes it."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.chosen import choose
from storage.pool import Pool
from storage.repertoire import STARTS, Repertoire
from storage.schema import evaluated_name, family_names
from storage.scoring import SURVIVED
from storage.search import Start, Walked, search
from storage.shard import read_columns, shard_name
from storage.specification import Specification
from storage.store_folder import StoreFolder
from taichi_nmm.errors import InputError


def evolved_points(
    folder: StoreFolder,
    asked: Specification,
    repertoire: Repertoire,
    pool: Pool,
    walked: Walked,
) -> NDArray[np.float64]:
    """The points of all rows after the grid's, [candidates, 16 + k].

    Args:
        folder: whose grid is complete.
        asked: the store's specification, as units of work are to be run.
        repertoire: of the store.
        pool: what walks the candidates.
        walked: called with the walks of the search as they are done.

    Raises:
        InputError: the grid has no point to start from.
    """
    kept = folder.repertoire.read()
    if kept is None:
        starts = grid_starts(folder, repertoire)
        found = search(asked, repertoire, starts, folder.generations, pool, walked)
        lengths = {name: start.generations for name, start in starts.items()}
        folder.repertoire.write(found, choose(found, shares(repertoire.candidates, lengths)))
        kept = folder.repertoire.read()
    else:
        walked(repertoire.walks, False)
    folder.finish_search()
    if kept is None:
        raise InputError("out", str(folder.repertoire.path), "a file that is as it was written")
    return kept


def grid_starts(folder: StoreFolder, repertoire: Repertoire) -> dict[str, Start]:
    """For each family, the points of the grid that survive it longest.

    The less they survive, the longer is the search: what the grid has needs no finding.

    Raises:
        InputError: none was run on a family.
    """
    specification = folder.specification
    names = [parameter.name for parameter in specification.parameters]
    families = [family.name for family in repertoire.families]
    survived = [family_names(name, SURVIVED)[0] for name in families]
    wanted = [*names, *survived, *map(evaluated_name, families)]
    files = (folder.path / shard_name(number) for number in range(specification.grid_shards))
    table = pa.concat_tables(read_columns(file, wanted) for file in files)
    points = np.column_stack([table[name].to_numpy() for name in names])
    starts, falls = {}, {}
    for name, column in zip(families, survived, strict=True):
        run = np.flatnonzero(table[evaluated_name(name)].to_numpy())
        if not len(run):
            allowed = f"a grid of which some point is run on the family {name}"
            raise InputError("samples", specification.samples, allowed)
        fraction = table[column].to_numpy()[run]
        best = np.argsort(-fraction, kind="stable")[:STARTS]
        starts[name], falls[name] = points[run[best]], 1.0 - float(fraction[best].mean())
    generations = shares(repertoire.generations, falls)
    return {name: Start(points, generations[name]) for name, points in starts.items()}


def shares(whole: int, weights: dict[str, float] | dict[str, int]) -> dict[str, int]:
    """Parts of a whole in proportion to weights, each at least 1; the largest remainders go up."""
    total, rest = sum(weights.values()), whole - len(weights)
    equal = 1.0 / len(weights)
    exact = {key: rest * (value / total if total else equal) for key, value in weights.items()}
    parts = {key: 1 + int(value) for key, value in exact.items()}
    left = whole - sum(parts.values())
    for key in sorted(exact, key=lambda key: int(exact[key]) - exact[key])[:left]:
        parts[key] += 1
    return parts

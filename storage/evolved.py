"""The candidates of a store: from its repertoire's file, or by the search that writes it."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.chosen import choose
from storage.pool import Pool
from storage.repertoire import STARTS, Repertoire
from storage.schema import evaluated_name, family_names
from storage.scoring import SURVIVED
from storage.search import Starts, Walked, search
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
        folder.repertoire.write(found, choose(found, repertoire.candidates))
        kept = folder.repertoire.read()
    else:
        walked(repertoire.walks, False)
    folder.finish_search()
    if kept is None:
        raise InputError("out", str(folder.repertoire.path), "a file that is as it was written")
    return kept


def grid_starts(folder: StoreFolder, repertoire: Repertoire) -> Starts:
    """For each family, the points of the grid that survive it longest.

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
    starts = {}
    for name, column in zip(families, survived, strict=True):
        run = np.flatnonzero(table[evaluated_name(name)].to_numpy())
        if not len(run):
            allowed = f"a grid of which some point is run on the family {name}"
            raise InputError("samples", specification.samples, allowed)
        best = np.argsort(-table[column].to_numpy()[run], kind="stable")[:STARTS]
        starts[name] = points[run[best]]
    return starts

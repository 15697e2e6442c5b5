"""What can be taken from the page, as the bytes of files; made in a process beside the page's."""

import io
import json
import tempfile
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from storage.store import open_store
from study.explore.store_view import Ranges, selected
from study.explore.walk import Walk
from study.explore.walk import walk as walk_again
from study.pictures import write_gait_cycle, write_movie, write_strip
from study.pictures.trajectory_files import FORMATS, RECORD_RATE_HZ, trajectory_text

FILM_S = 20.0  # of a walk's end
GAINS, CONFIG = "gains.json", "walk.toml"  # what every command takes as --gains and --config
STRIP, CYCLE, FILM = "strip.png", "gait_cycle.png", "walk.mp4"
NAMES = (GAINS, CONFIG, *(f"walk{suffix}" for suffix in FORMATS), STRIP, CYCLE, FILM)


def command_line(walk: Walk) -> str:
    """The command that does the same without a page, in a folder with `GAINS` and `CONFIG`."""
    run = f" --run {walk.setting.run}" if walk.setting.run else ""
    return f"taichi-nmm walk --gains {GAINS} --config {CONFIG}{run} --trajectory walk.sto"


def file_of_walk(walk: Walk, name: str) -> tuple[str, bytes]:
    """One of `NAMES` and its content, of the same walk with the samples of walks that are kept.

    Raises:
        InputError: a film without a working ffmpeg.
    """
    if name == GAINS:
        return name, f"{json.dumps(walk.gains.as_document(), indent=1)}\n".encode()
    if name == CONFIG:
        return name, walk.setting.toml().encode()
    walk = walk_again(walk.gains, walk.setting, RECORD_RATE_HZ)
    suffix = Path(name).suffix
    if suffix in FORMATS:
        return name, trajectory_text(walk.trajectory, suffix, walk.gains.name).encode()
    terrain = walk.setting.terrain
    title = f"{walk.gains.name} on {terrain.name}: {walk.ended}"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name == STRIP:
            write_strip(path, walk.trajectory, terrain, title)
        elif name == CYCLE:
            write_gait_cycle(path, walk.trajectory, walk.setting.weight_n, title)
        else:
            write_movie(path, walk.trajectory, terrain, FILM_S, title)
        return name, path.read_bytes()


def file_of_selection(store: Path, ranges: Ranges, suffix: str) -> tuple[str, bytes]:
    """All columns of the selected rows of a store, as .csv or .parquet."""
    table = open_store(store, unfinished=True).table()
    chosen = selected(ranges, lambda name: table[name].to_numpy(), len(table))
    table = table.filter(pa.array(chosen))
    content = io.BytesIO()
    if suffix == ".csv":
        pyarrow.csv.write_csv(_without_lists(table), content)
    else:
        pyarrow.parquet.write_table(table, content, compression="zstd")
    return f"selection{suffix}", content.getvalue()


def _without_lists(table: pa.Table) -> pa.Table:
    """A list of what each world gave becomes a column a world: CSV has no lists."""
    columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_fixed_size_list(column.type):
            for world in range(column.type.list_size):
                columns[f"{name}_{world}"] = pc.list_element(column, world)
        else:
            columns[name] = column
    return pa.table(columns)

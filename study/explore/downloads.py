"""What can be taken from the page, as the bytes of files; made in a process beside the page's."""

import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from storage.store import open_store
from study.explore.store_view import Ranges, selected
from study.explore.walk import Walk
from study.explore.walk import walk as walk_again
from study.pictures import write_gait_cycle, write_movie, write_strip
from study.trajectory_files import FORMATS, RECORD_RATE_HZ, trajectory_text

FILM_S = 20.0  # of a walk's end


def gains_file(walk: Walk) -> bytes:
    """JSON that every command takes as --gains."""
    return f"{json.dumps(walk.gains.as_document(), indent=1)}\n".encode()


def config_file(walk: Walk) -> bytes:
    """TOML that every command takes as --config: the same body, ground, world and engine."""
    return walk.setting.toml().encode()


def command_line(walk: Walk) -> str:
    """What does the same without a page, where both files are."""
    run = f" --run {walk.setting.run}" if walk.setting.run else ""
    return f"taichi-nmm walk --gains gains.json --config walk.toml{run} --trajectory walk.sto"


def _strip(walk: Walk, path: Path) -> None:
    write_strip(path, walk.trajectory, walk.terrain, _title(walk))


def _cycle(walk: Walk, path: Path) -> None:
    write_gait_cycle(path, walk.trajectory, walk.weight_n, _title(walk))


def _film(walk: Walk, path: Path) -> None:
    write_movie(path, walk.trajectory, walk.terrain, FILM_S, _title(walk))


def _title(walk: Walk) -> str:
    return f"{walk.gains.name} on {walk.terrain.name}: {walk.ended}"


PICTURES: dict[str, Callable[[Walk, Path], None]] = {
    "strip.png": _strip, "gait_cycle.png": _cycle, "walk.mp4": _film,
}  # fmt: skip
TEXTS: dict[str, Callable[[Walk], bytes]] = {"gains.json": gains_file, "walk.toml": config_file}
NAMES = (*TEXTS, *(f"walk{suffix}" for suffix in FORMATS), *PICTURES)


def file_of_walk(walk: Walk, name: str) -> tuple[str, bytes]:
    """One of `NAMES` and its content, of the same walk with the samples of walks that are kept.

    Raises:
        InputError: a film without a working ffmpeg.
    """
    if name in TEXTS:
        return name, TEXTS[name](walk)
    walk = walk_again(walk.gains, walk.setting, RECORD_RATE_HZ)
    if name in PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            PICTURES[name](walk, path)
            return name, path.read_bytes()
    text = trajectory_text(walk.trajectory, Path(name).suffix, walk.gains.name)
    return name, text.encode()


def file_of_selection(store: Path, ranges: Ranges, suffix: str) -> tuple[str, bytes]:
    """All columns of the selected rows of a store, as .csv or .parquet."""
    opened = open_store(store, unfinished=True)
    table = opened.table()
    chosen = selected(ranges, lambda name: table[name].to_numpy(), len(table))
    table = table.filter(pa.array(chosen))
    content = io.BytesIO()
    if suffix == ".csv":
        pyarrow.csv.write_csv(table, content)
    else:
        pyarrow.parquet.write_table(table, content, compression="zstd")
    return f"selection{suffix}", content.getvalue()

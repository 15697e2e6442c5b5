"""What can be taken from the page, as the bytes of files; made in a process beside the page's."""

import io
import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet

from storage.store import open_store
from study.experiment.experiment import as_written
from study.explore.store_view import Ranges, selected
from study.explore.walk import Walk, to_toml

GAINS, CONFIG = NAMES = "gains.json", "walk.toml"  # what every command takes: --gains, --config


# What does the same without a page, in a folder with both files.
COMMAND = f"taichi-nmm walk --gains {GAINS} --config {CONFIG} --trajectory walk.sto"


def file_of_walk(walk: Walk, name: str) -> tuple[str, bytes]:
    """One of `NAMES` and its content."""
    if name == CONFIG:
        return name, to_toml(as_written(walk.experiment)).encode()
    return name, f"{json.dumps(walk.gains.as_document(), indent=1)}\n".encode()


def file_of_selection(store: Path, ranges: Ranges) -> tuple[str, bytes]:
    """All columns of the selected rows of a store, as Parquet."""
    table = open_store(store, unfinished=True).table()
    chosen = selected(ranges, lambda name: table[name].to_numpy(), len(table))
    content = io.BytesIO()
    pyarrow.parquet.write_table(table.filter(pa.array(chosen)), content, compression="zstd")
    return "selection.parquet", content.getvalue()

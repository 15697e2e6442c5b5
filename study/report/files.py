"""The files that a comparison leaves in its folder, as a report reads them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from study.comparison.experiment_folder import ARMS_NAME, RESULTS_NAME
from taichi_nmm.errors import InputError


def read_document(path: Path) -> dict[str, Any]:
    """A JSON object; empty where there is no such file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(path.name, str(path), f"a readable JSON object ({error})") from None
    return document


def read_trials(path: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of a table of trials.

    Raises:
        InputError: not readable, or a column is missing.
    """
    try:
        known = pq.read_schema(path).names
        for name in columns:
            if name not in known:
                raise InputError(f"{path.name}: column", name, f"one of {', '.join(known)}")
        return pq.read_table(path, columns=list(columns))
    except (OSError, pa.ArrowInvalid) as error:
        reason = str(error).splitlines()[0]
        raise InputError(path.name, str(path), f"a readable table of trials ({reason})") from None


def table_files(folder: Path) -> list[Path]:
    """The final table of a folder, then the checkpoints of its arms: those that there are.

    Raises:
        InputError: no such folder.
    """
    if not folder.is_dir():
        raise InputError("folder", str(folder), "the output folder of tools/compare.py")
    final = folder / RESULTS_NAME
    checkpoints = sorted((folder / ARMS_NAME).glob("[!.]*.parquet"))
    return ([final] if final.exists() else []) + checkpoints

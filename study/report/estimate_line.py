"""The line of a figure that shows the estimated optimum of its cost: of taichi-nmm optimum."""

from collections.abc import Sequence
from pathlib import Path

from study.comparison.optimum import OPTIMUM_NAME
from study.report.documents import is_number, read_document
from study.report.runs import Results
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_file


def find_optimum(results: Results, given: Sequence[Path]) -> float | None:
    """The best cost of the first document of the experiment's cost: given, or in its folder.

    Raises:
        InputError: a document that was given is missing, or none of taichi-nmm optimum.
    """
    for path in given:
        if not is_file(path):
            raise InputError("optimum", str(path), f"an {OPTIMUM_NAME} that exists")
    for path in (*given, results.folder / OPTIMUM_NAME):
        document = read_document(path)
        if not document:
            continue
        cost, best = document.get("cost"), document.get("best_cost")
        if not isinstance(cost, str) or best is None or not is_number(best):
            raise InputError("optimum", str(path), "a document of taichi-nmm optimum")
        if cost == results.cost:
            return float(best)
    return None

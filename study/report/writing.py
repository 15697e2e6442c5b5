"""Writes a report, or the overview of several, into its folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from storage.commit import commit_json, commit_text, together
from study.experiment.optimum import OPTIMUM_NAME
from study.report.before_after import Pair, write_strips
from study.report.figures import write_best_cost, write_first_walker, write_grid, write_walkers
from study.report.markdown import NO_STORES, condensed_table, overview_text, report_text
from study.report.numbers import Numbers, numbers
from study.report.runs import NUMBER, Results, read_document
from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_file

REPORT_NAME = "report"


def write_report(
    results: Results,
    optimum: float | None,
    pair: Pair | None = None,
    folder: Path | None = None,
    stores: Mapping[str, Path] = NO_STORES,
) -> Numbers:
    """Write report.md, summary.json and the figures of one experiment, all of them or none.

    The folder is by default `report` in the experiment's own. `optimum` is the estimated optimum of
    its cost, and `stores` are folders of the stores that its arms read, where they are known.

    Raises:
        InputError: the folder cannot be written.
    """
    found = numbers(results)
    strips = f"{pair.first.title}. {pair.second.title}. Run {pair.run}." if pair else ""
    text = report_text(results, found, optimum, strips, stores)
    document = {
        "complete": results.complete,
        "trials_found": results.found,
        "trials_planned": results.planned,
        "cost": results.cost,
        "optimum": optimum,
        **found.as_dict(),
    }
    with together(folder or results.folder / REPORT_NAME) as new:
        write_best_cost(new, results, optimum)
        write_walkers(new, results)
        write_first_walker(new, results)
        if pair is not None:
            write_strips(new, f"{results.name}, run {pair.run}: before and after", pair)
        commit_json(new / "summary.json", document)
        commit_text(new / "report.md", text)
    return found


def write_overview(folder: Path, experiments: Sequence[Numbers]) -> None:
    """Write overview.md, overview.json and a figure of several experiments, all or none.

    Raises:
        InputError: the folder cannot be written.
    """
    text = (
        f"# {len(experiments)} experiments\n\n{overview_text(experiments)}\n"
        "![Runs with a walker](overview.png)\n"
    ) + "".join(f"\n## {each.experiment}\n\n{condensed_table(each)}\n" for each in experiments)
    with together(folder) as new:
        document = {"experiments": [each.as_dict() for each in experiments]}
        commit_json(new / "overview.json", document)
        write_grid(new, experiments)
        commit_text(new / "overview.md", text)


def find_optimum(results: Results, given: Sequence[Path]) -> float | None:
    """The best cost of the first document (given, or in the folder) of the experiment's cost.

    Raises:
        InputError: a given document is missing, or is not of taichi-nmm optimum.
    """
    for path in given:
        if not is_file(path):
            raise InputError("optimum", str(path), f"an {OPTIMUM_NAME} that exists")
    for path in (*given, results.folder / OPTIMUM_NAME):
        document = read_document(path)
        if not document:
            continue
        field = f"optimum: {path.name}"
        cost = checks.text(f"{field}: cost", document.get("cost"))
        best = NUMBER(f"{field}: best_cost", document.get("best_cost"))
        if cost == results.cost:
            return float(best)
    return None

"""Writes a report, or the overview of several, into its folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from storage.commit import commit_json, commit_text, together
from study.report.figures import write_best_cost, write_first_walker
from study.report.markdown import NO_STORES, condensed_table, overview_text, report_text
from study.report.numbers import Numbers, numbers
from study.report.runs import Results

REPORT_NAME = "report"


def write_report(
    results: Results,
    folder: Path | None = None,
    stores: Mapping[str, Path] = NO_STORES,
) -> Numbers:
    """Write report.md, summary.json and the figures of one experiment, all of them or none.

    The folder is by default `report` in the experiment's own. `stores` are folders of the stores
    that its arms read, where they are known.

    Raises:
        InputError: the folder cannot be written.
    """
    found = numbers(results)
    text = report_text(results, found, stores)
    document = {
        "complete": results.complete,
        "trials_found": results.found,
        "trials_planned": results.planned,
        "cost": results.cost,
        **found.as_dict(),
    }
    with together(folder or results.folder / REPORT_NAME) as new:
        write_best_cost(new / "best-cost.png", results)
        write_first_walker(new / "first-walker.png", results)
        commit_json(new / "summary.json", document)
        commit_text(new / "report.md", text)
    return found


def write_overview(folder: Path, experiments: Sequence[Numbers]) -> None:
    """Write overview.md and overview.json of several experiments, both or none.

    Raises:
        InputError: the folder cannot be written.
    """
    parts = [f"## {each.experiment}\n\n{condensed_table(each)}\n" for each in experiments]
    text = "\n".join([f"# {len(experiments)} experiments\n", overview_text(experiments), *parts])
    with together(folder) as new:
        document = {"experiments": [each.as_dict() for each in experiments]}
        commit_json(new / "overview.json", document)
        commit_text(new / "overview.md", text)

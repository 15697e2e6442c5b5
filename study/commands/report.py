"""Make figures and tables of one or several comparisons."""

from argparse import Namespace

from storage.commit import require_named
from storage.inputs.errors import InputError
from study.report.figures import REPORT_NAME, write_overview, write_report
from study.report.runs import known_stores, read_results


def main(args: Namespace) -> None:
    """Report on every folder."""
    if args.out is not None and len(args.folders) == 1:
        raise InputError(
            "out",
            str(args.out),
            f"two folders or more; of one, it is DIR/{REPORT_NAME}",
        )
    everything = [read_results(folder) for folder in args.folders]
    if args.out is not None:
        require_named(args.out)
    found = []
    for results in everything:
        found.append(write_report(results, stores=known_stores(results)))
        state = (
            ""
            if results.complete
            else f" ({results.found:,} of {results.planned:,} trials)"
        )
        print(f"{results.folder / REPORT_NAME}: {results.name}{state}", flush=True)
    if args.out is not None:
        write_overview(args.out, found)
        print(f"{args.out}: overview of {len(found)} experiments")

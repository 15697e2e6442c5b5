"""Time one proposal of the feature-kernel sampler, and measure the memory it holds.

    python tools/time_sampler.py                   # a table and a plot into docs/; minutes
    python tools/time_sampler.py --rows 5000 --sweep 10,50 --json
    python tools/time_sampler.py --store-rows 10000000    # that alone, of a store made up for it

Each figure comes from a fresh process on one thread. Optuna's GPSampler is timed in the same run
where PyTorch, which it needs, is installed; greenlet, where it is installed too, halves its time.
Run it on an idle machine.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from tqdm import tqdm

    from storage.commit import commit_text, require_folder, writable
    from study.benchmarks import comparison_report, large_store, sampler_timing
    from study.benchmarks.large_store import LargeStore
    from study.benchmarks.run_cache import ONE_THREAD, ROOT, torch_is_installed
    from study.benchmarks.sampler_timing import Case, Measured
    from study.experiment.experiment import MOST_TRIALS
    from study.options import Options
    from taichi_nmm.errors import InputError

# Milliseconds of the processor, by sampler and number of features.
BARS_MS = {("ours", 1): 10.0, ("ours", 5): 45.0, ("rbf", 1): 10.0}
MOST_FEATURES = 5
MOST_ROWS = 10_000_000
MOST_STORE_ROWS = 100_000_000
BEST_FEATURES, BEST_BAR_MS = 6, 10.0
LONG_BAR_MS = 1000.0  # at the largest number of observations
GP_RATIO_BAR = 5.0  # GPSampler's time over ours with one feature
MEMORY_BAR_MIB = 200e6 / 2**20  # 200 MB, for the largest number of features


@dataclass(frozen=True)
class Timings:
    """All that was measured."""

    proposals: list[Measured]  # as `BARS_MS`
    best: Measured
    peer: Measured | None
    sweep: list[Measured]  # by observations
    large: Measured

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs."""
        return {
            "machine": comparison_report.machine(),
            "versions": comparison_report.versions(),
            "proposals": [measured.as_dict() for measured in self.proposals],
            "best": self.best.as_dict(),
            "gp_sampler": None if self.peer is None else self.peer.as_dict(),
            "sweep": [measured.as_dict() for measured in self.sweep],
            "large": self.large.as_dict(),
        }


def main() -> None:
    options = parse()
    os.environ.update(ONE_THREAD)
    if options.store_rows is not None:
        found = large(options.store_rows)
        print(json.dumps(found.as_dict()) if options.json else large_text(found))
        return
    timings = measure(options)
    if options.json:
        print(json.dumps(timings.as_dict()))
        return
    text = markdown(timings, options)
    with writable(options.out):
        options.out.mkdir(parents=True, exist_ok=True)
    plot(timings, options.out / "sampler-timing.png")
    commit_text(options.out / "sampler-timing.md", text)
    print(text)


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--rows", 1, MOST_ROWS, default=100_000, help="of the table; %(default)s")
    parser.whole("--observations", 1, MOST_TRIALS, default=100, help="%(default)s")
    parser.whole("--repeats", 1, MOST_TRIALS, default=11, help="of each proposal; %(default)s")
    parser.add_argument("--sweep", default="10,30,100,300,1000", help="observations; %(default)s")
    parser.whole("--large-rows", 1, MOST_ROWS, default=1_000_000, help="%(default)s")
    parser.whole("--store-rows", 100, MOST_STORE_ROWS, help="time a store of so many rows, no more")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="of the table and plot")
    parser.add_argument("--json", action="store_true", help="print one object, write no document")
    options = parser.parse_args()
    require_folder(options.out)
    options.sweep = counts("sweep", options.sweep)
    most = max(options.observations, *options.sweep) + options.repeats
    if min(options.rows, options.large_rows) <= most:
        raise InputError("rows", options.rows, f"more than {most}, for the trials to come from")
    return options


def counts(field: str, listed: str) -> list[int]:
    """The comma-separated counts, ascending."""
    try:
        found = sorted({int(count) for count in listed.split(",")})
    except ValueError:
        found = [0]
    if not 1 <= found[0] <= found[-1] <= MOST_TRIALS:
        raise InputError(field, listed, f"counts from 1 to {MOST_TRIALS}, such as 10,100,1000")
    return found


def measure(options: argparse.Namespace) -> Timings:
    """Every case in a process of its own, one after the other."""
    base = Case("ours", options.rows, 1, options.observations, options.repeats)
    proposals = [replace(base, sampler=sampler, features=k) for sampler, k in BARS_MS]
    sweep = [replace(base, observations=n) for n in options.sweep]
    large = replace(base, rows=options.large_rows, features=MOST_FEATURES, repeats=1)
    best = replace(base, sampler="best", features=BEST_FEATURES)
    peer = [replace(base, sampler="gp")] if peer_can_run() else []
    cases = tqdm([*proposals, *sweep, best, large, *peer], unit="case")
    done = iter([fresh(case) for case in cases])
    return Timings(
        proposals=list(islice(done, len(proposals))),
        sweep=list(islice(done, len(sweep))),
        best=next(done),
        large=next(done),
        peer=next(done, None),
    )


def large(rows: int) -> LargeStore:
    """Of a store in a folder that goes again."""
    with tempfile.TemporaryDirectory() as scratch:
        large_store.make(rows, Path(scratch, "store"))
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            return pool.submit(large_store.measure, Path(scratch, "store")).result()


def large_text(found: LargeStore) -> str:
    lines = [
        ("rows of the store", f"{found.rows:,} ({found.disk_bytes / 2**30:.2f} GiB)"),
        ("open_store", f"{found.open_s:.1f} s"),
        ("16 parameters, 2 features", f"{found.table_s:.1f} s"),
        ("first proposal", f"{found.first_s:.1f} s"),
        ("proposals of the model, median", f"{found.median_s:.2f} s"),
        ("memory at the peak", mib(found.peak_mib)),
    ]
    return "\n".join(f"{name:<32} {value}" for name, value in lines)


def peer_can_run() -> bool:
    if torch_is_installed():
        return True
    print("GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr)
    return False


def fresh(case: Case) -> Measured:
    """Measure in a new process, so that memory is its own and nothing is warm."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(sampler_timing.measure, case).result()


def markdown(timings: Timings, options: argparse.Namespace) -> str:
    lines = [
        "# One proposal of the feature-kernel sampler",
        "",
        f"Written by `{' '.join(['python', 'tools/time_sampler.py', *sys.argv[1:]])}` on"
        f" {date.today()}: {comparison_report.machine()}; {comparison_report.versions()}.",
        f"One thread; median of {options.repeats} proposals, each in a study of"
        f" {options.observations} finished trials of 16 parameters, {options.rows:,} rows. Ours"
        " with its defaults, where nothing else is said.",
        "",
        "| case | median | fastest to slowest | processor, median | bar of the processor's |",
        "|---|---|---|---|---|",
        *(proposal_row(measured) for measured in timings.proposals),
        best_row(timings.best),
        *peer_rows(timings),
        "",
        "![Time of a proposal against finished trials](sampler-timing.png)",
        "",
        "| finished trials | median | processor, median | bar |",
        "|---|---|---|---|",
        *(sweep_row(measured, timings.sweep[-1]) for measured in timings.sweep),
        "",
        "| rows | parameters + features | median | memory kept | at the peak | bar |",
        "|---|---|---|---|---|---|",
        memory_row(timings.proposals[1], MEMORY_BAR_MIB),
        memory_row(timings.large, None),
    ]
    return "\n".join(lines) + "\n"


def proposal_row(measured: Measured) -> str:
    case = measured.case
    plural = "" if case.features == 1 else "s"
    kernel = ", the paper's kernel" if case.sampler == "rbf" else ""
    bar = verdict(measured.median_cpu_ms, BARS_MS[case.sampler, case.features], "ms")
    return f"| {case.features} feature{plural}{kernel} | {spread(measured)} | {bar} |"


def best_row(measured: Measured) -> str:
    bar = verdict(measured.median_cpu_ms, BEST_BAR_MS, "ms")
    return f"| `SurvivalSampler`, a tenth of the rows are candidates | {spread(measured)} | {bar} |"


def peer_rows(timings: Timings) -> list[str]:
    if timings.peer is None:
        return ["| GPSampler | not measured: no PyTorch | | | |"]
    ours = timings.proposals[0].median_ms
    ratio = timings.peer.median_ms / ours
    holds = "holds" if ratio >= GP_RATIO_BAR else "**missed**"
    bar = f"at least {GP_RATIO_BAR:g} x ours: {ratio:.1f} x, {holds}"
    return [f"| GPSampler | {spread(timings.peer)} | {bar} |"]


def spread(measured: Measured) -> str:
    low, high = 1e3 * min(measured.seconds), 1e3 * max(measured.seconds)
    cpu = f"{measured.median_cpu_ms:.0f} ms"
    return f"{measured.median_ms:.0f} ms | {low:.0f} to {high:.0f} ms | {cpu}"


def sweep_row(measured: Measured, last: Measured) -> str:
    bar = verdict(measured.median_ms, LONG_BAR_MS, "ms") if measured is last else ""
    cpu = f"{measured.median_cpu_ms:.0f} ms"
    return f"| {measured.case.observations:,} | {measured.median_ms:.0f} ms | {cpu} | {bar} |"


def memory_row(measured: Measured, bar_mib: float | None) -> str:
    case = measured.case
    kept, most = mib(measured.grown_mib), mib(measured.peak_grown_mib)
    bar = "" if bar_mib is None else verdict(measured.peak_grown_mib, bar_mib, "MiB")
    return (
        f"| {case.rows:,} | {sampler_timing.DIMENSION} + {case.features}"
        f" | {measured.median_ms:.0f} ms | {kept} | {most} | {bar} |"
    )


def mib(value: float | None) -> str:
    return "unknown" if value is None else f"{value:,.0f} MiB"


def verdict(value: float | None, bar: float, unit: str) -> str:
    if value is None:
        return "not measured"
    return f"at most {bar:.0f} {unit}: {'holds' if value <= bar else '**missed**'}"


def plot(timings: Timings, path: Path) -> None:
    """Time of a proposal against finished trials."""
    from study.pictures import style  # not in the processes that are measured

    figure = style.new_figure(5.0, 3.4)
    axes = figure.add_subplot()
    style.tidy(axes)
    observations = [measured.case.observations for measured in timings.sweep]
    times_ms = [measured.median_ms for measured in timings.sweep]
    axes.loglog(observations, times_ms, color=style.MODEL, marker="o", label="ours, 1 feature")
    if timings.peer is not None:
        peer = timings.peer
        axes.plot(peer.case.observations, peer.median_ms, "s", color=style.INK, label="GPSampler")
    axes.set_xlabel("finished trials", fontsize=style.TEXT_PT)
    axes.set_ylabel("median time of a proposal (ms)", fontsize=style.TEXT_PT)
    axes.legend(fontsize=style.SMALL_PT, frameon=False)
    figure.tight_layout()
    style.save_png(figure, path)


if __name__ == "__main__":
    run_command(main)

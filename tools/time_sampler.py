"""Time one proposal of the feature-kernel sampler, and measure the memory it holds.

    python tools/time_sampler.py                   # a table into out/benchmarks; minutes
    python tools/time_sampler.py --rows 5000 --out out/timing

Each figure comes from a fresh process on one thread. Run it on an idle machine.
"""

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna
    from numpy.typing import NDArray
    from optuna.distributions import BaseDistribution, FloatDistribution
    from optuna.exceptions import ExperimentalWarning
    from tqdm import tqdm

    from storage.commit import require_folder
    from storage.processes import Processes
    from study import FeatureKernelSampler, FeatureTable
    from study.options import Options
    from study.sampler.history import ROW_ATTRIBUTE
    from tools.page import ROOT, write_page

Floats = NDArray[np.float64]

NAME = "sampler-timing"
DIMENSION = 16
SPACE: dict[str, BaseDistribution] = {
    f"p{number:02d}": FloatDistribution(0.0, 1.0) for number in range(DIMENSION)
}
SEED = 16
NOISE = 0.3  # of the cost, in standard deviations of what the features explain

FINISHED, MOST_FINISHED = 100, 1000  # trials before the first proposal
REPEATS = 11  # proposals after the first one
MOST_FEATURES = 5
WORLDS, ROWS_IN_WORLDS = 128, 20_000
ALIKE_ROWS = 20_000  # at most, of a Gram matrix: 1.6 GB in 32 bits
LEAST_ROWS, MOST_ROWS = 5_000, 1_000_000  # a tenth has trials to choose
LARGE = 10  # times as many rows
LABELS = {
    "ours": "ours",
    "rbf": "ours, the paper's kernel",
    "worlds": "ours, costs in so many worlds in place of features",
    "similarity": "ours, a similarity of all rows in place of features",
}


@dataclass(frozen=True)
class Case:
    """A sampler, a table and a study; our defaults, unless the sampler's label says otherwise.

    Attributes:
        sampler: one of `LABELS`.
        rows: of the table.
        features: of a row.
        observations: finished trials before the first proposal.
        bars: the most that is allowed, by names of `Measured`, in their units.
    """

    sampler: str
    rows: int
    features: int
    observations: int
    bars: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Measured:
    """Times and memory of one case.

    Attributes:
        case: that was measured.
        median_ms: of a proposal after the first, as the next two.
        fastest_ms: likewise.
        slowest_ms: likewise.
        median_cpu_ms: on the processor: on a busy machine a proposal waits for it.
        first_cpu_ms: of the first proposal, which puts the table on the scales of the
            model.
        kept_mib: by which the process grew from before the table was made; NaN but on
            Linux.
        peak_mib: the same at the peak.
    """

    case: Case
    median_ms: float
    fastest_ms: float
    slowest_ms: float
    median_cpu_ms: float
    first_cpu_ms: float
    kept_mib: float
    peak_mib: float


def main() -> None:
    parser = Options(__file__)
    parser.whole(
        "--rows", LEAST_ROWS, MOST_ROWS, default=100_000, help="of a table; %(default)s"
    )
    parser.path(
        "--out", "of the page; out/benchmarks", default=ROOT / "out" / "benchmarks"
    )
    options = parser.parse_args()
    require_folder(options.out)
    measured = [fresh(case) for case in tqdm(cases(options.rows), unit="case")]
    options.out.mkdir(parents=True, exist_ok=True)
    title = "One proposal of the feature-kernel sampler"
    write_page(options.out / f"{NAME}.md", title, figures(measured))


def cases(rows: int) -> list[Case]:
    """What is measured."""
    base = Case(sampler="ours", rows=rows, features=1, observations=FINISHED)
    many = replace(base, features=MOST_FEATURES)
    worlds = replace(base, sampler="worlds", rows=ROWS_IN_WORLDS, features=WORLDS)
    alike = replace(many, sampler="similarity", rows=min(rows, ALIKE_ROWS))
    return [
        replace(base, bars={"median_cpu_ms": 6.0}),
        replace(many, bars={"median_cpu_ms": 15.0, "peak_mib": 200e6 / 2**20}),
        replace(base, sampler="rbf", bars={"median_cpu_ms": 10.0}),
        replace(worlds, bars={"median_cpu_ms": 15.0}),
        replace(alike, bars={"median_cpu_ms": 30.0, "peak_mib": 4e9 / 2**20}),
        replace(base, observations=MOST_FINISHED, bars={"median_ms": 1000.0}),
        replace(many, rows=LARGE * rows, bars={"first_cpu_ms": 500.0}),
    ]


def figures(measured: Sequence[Measured]) -> list[str]:
    """A row for each case, then the bars."""
    lines = [
        "| sampler | rows | features | finished trials | proposals | median | fastest | slowest"
        " | processor: median | processor: first | memory kept | at the peak |",
        "|---|" + "--:|" * 11,
    ]
    bars = ["", "## Bars", "", "| what | measured | holds |", "|---|---|---|"]
    for each in measured:
        case, label = each.case, LABELS[each.case.sampler]
        numbers = (
            case.rows,
            case.features,
            case.observations,
            REPEATS,
            each.median_ms,
            each.fastest_ms,
            each.slowest_ms,
            each.median_cpu_ms,
            each.first_cpu_ms,
            each.kept_mib,
            each.peak_mib,
        )
        lines.append(f"| {label} | {' | '.join(f'{n:,.0f}' for n in numbers)} |")
        size = f"{case.rows:,} rows x {case.features:,}, {case.observations:,} trials"
        for name, most in case.bars.items():
            value, words = getattr(each, name), name.replace("_", " ")
            holds = "yes" if value <= most else "**no**"
            what = f"{label}, {size}: {words} | {value:.0f}, at most {most:.0f}"
            bars.append(f"| {what} | {holds} |")
    return [*lines, *bars]


def fresh(case: Case) -> Measured:
    """Measure in a new process, so that memory is its own and nothing is warm."""
    with Processes(1) as pool:
        measured: Measured = pool.submit(measure_case, case).result()
        return measured


def measure_case(case: Case) -> Measured:
    """Propose `REPEATS` times; each proposal sees one finished trial more than the one before."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    small = replace(case, sampler="ours", rows=1000, observations=10)
    _propose(_prepare(small), case.features)  # loads the libraries
    before_mib = memory_mib("VmRSS")
    study = _prepare(case)
    first_cpu_ms = _propose(study, case.features)[1]
    ms, cpu_ms = np.transpose([_propose(study, case.features) for _ in range(REPEATS)])
    return Measured(
        case=case,
        median_ms=float(np.median(ms)),
        fastest_ms=ms.min(),
        slowest_ms=ms.max(),
        median_cpu_ms=float(np.median(cpu_ms)),
        first_cpu_ms=first_cpu_ms,
        kept_mib=memory_mib("VmRSS") - before_mib,
        peak_mib=memory_mib("VmHWM") - before_mib,
    )


def _prepare(case: Case) -> optuna.Study:
    """A study with the sampler and with `observations` finished trials."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(size=(case.rows, DIMENSION))
    features = _features(points, case.features)
    seen = rng.choice(case.rows, case.observations, replace=False)
    costs = features[seen].sum(axis=1) + NOISE * rng.standard_normal(case.observations)
    study = optuna.create_study(sampler=_sampler(case, points, features))
    for row, cost in zip(seen, costs, strict=True):
        trial = optuna.create_trial(
            params=dict(zip(SPACE, points[row].tolist(), strict=True)),
            distributions=SPACE,
            user_attrs={ROW_ATTRIBUTE: int(row)},
            value=float(cost),
        )
        study.add_trial(trial)
    return study


def _features(points: Floats, k: int) -> Floats:
    """k smooth numbers of each point, of about unit variance, [n, k]."""
    directions = np.random.default_rng(SEED).standard_normal((DIMENSION, k))
    return np.asarray(np.sqrt(2.0) * np.sin(2.0 * points @ directions))


def _sampler(case: Case, points: Floats, features: Floats) -> FeatureKernelSampler:
    """The sampler of a case, over points [n, 16] with features [n, k]."""
    warnings.simplefilter("ignore", ExperimentalWarning)
    names = [f"feature_{column}" for column in range(case.features)]
    columns = dict(zip(SPACE, points.T, strict=True))
    if case.sampler == "worlds":
        table = FeatureTable.from_arrays(columns, outcomes=features, space=SPACE)
        return FeatureKernelSampler(table, seed=SEED)
    if case.sampler == "similarity":
        small = features.astype(np.float32)
        gram = np.empty((case.rows, case.rows), dtype=np.float32)
        for row, own in zip(gram, small, strict=True):
            np.exp(-0.5 * ((small - own) ** 2).sum(axis=1), out=row)
        return FeatureKernelSampler(FeatureTable.from_kernel(gram, columns), seed=SEED)
    table = FeatureTable.from_arrays(columns, features, names, space=SPACE)
    return FeatureKernelSampler(
        table, seed=SEED, kernel="rbf" if case.sampler == "rbf" else None
    )


def _propose(study: optuna.Study, features: int) -> tuple[float, float]:
    """Milliseconds, and those of the processor, from asking for a trial to its last parameter.

    Then the trial finishes.
    """
    began, cpu_began = time.perf_counter(), time.process_time()
    trial = study.ask(SPACE)
    spent, cpu_spent = time.perf_counter() - began, time.process_time() - cpu_began
    point = [trial.params[name] for name in SPACE]
    study.tell(trial, float(_features(np.array([point]), features).sum()))
    return 1e3 * spent, 1e3 * cpu_spent


def memory_mib(field_name: str) -> float:
    """Resident memory of this process (VmRSS) or the most it ever was (VmHWM); NaN but on Linux."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    for line in lines:
        if line.startswith(f"{field_name}:"):
            return int(line.split()[1]) / 1024
    return float("nan")


if __name__ == "__main__":
    run_command(main)

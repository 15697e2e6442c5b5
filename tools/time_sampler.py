"""Time one proposal of the feature-kernel sampler, and measure the memory it holds.

    python tools/time_sampler.py                   # a table and a plot into docs/; minutes
    python tools/time_sampler.py --rows 5000 --sweep 10,50 --json

Each figure comes from a fresh process on one thread. Optuna's GPSampler is timed in the same run
where PyTorch, which it needs, is installed; greenlet, where it is installed too, halves its time.
Run it on an idle machine.
"""

import time
import warnings
from argparse import Namespace
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna
    from optuna.distributions import BaseDistribution, FloatDistribution
    from optuna.exceptions import ExperimentalWarning
    from optuna.samplers import BaseSampler, GPSampler
    from tqdm import tqdm

    from storage.processes import Processes
    from study import FeatureKernelSampler, FeatureTable, SurvivalSampler
    from study.experiment.experiment import MOST_TRIALS
    from study.experiment.features import MEAN
    from study.options import Options
    from study.sampler.history import ROW_ATTRIBUTE
    from taichi_nmm.errors import InputError
    from tools.benchmark import Bar, Floats, made_by, parsed, publish, torch_is_installed

NAME = "sampler-timing"
DIMENSION = 16
SPACE: dict[str, BaseDistribution] = {
    f"p{number:02d}": FloatDistribution(0.0, 1.0) for number in range(DIMENSION)
}
SEED = 16
NOISE = 0.3  # of the cost, in standard deviations of what the features explain
STANDING = 0.1  # of the rows of a table like that of `best`: the others fell, and have no features

MOST_FEATURES = 5
MOST_ROWS = 10_000_000
GP_RATIO_BAR = 5.0  # GPSampler's time over ours with one feature
LABELS = {
    "ours": "ours",
    "foreign": "ours, trials that are no rows of the table",
    "rbf": "ours, the paper's kernel",
    "best": "`SurvivalSampler`, a tenth of the rows are candidates",
    "gp": "GPSampler",
}


@dataclass(frozen=True)
class Case:
    """A sampler, a table and a study whose proposals are timed.

    Ours has its defaults, unless its label says otherwise; GPSampler is in the box of the table.
    """

    sampler: str  # one of `LABELS`
    rows: int  # of the table
    features: int  # of a row
    observations: int  # finished trials before the first proposal
    repeats: int  # proposals after the first one
    bars: tuple[tuple[str, float], ...] = ()  # the most that is allowed, by names of `Measured`


@dataclass(frozen=True)
class Measured:
    """Times and memory of one case."""

    case: Case
    median_ms: float  # of a proposal after the first, as the next two
    fastest_ms: float
    slowest_ms: float
    median_cpu_ms: float  # on the processor: on a busy machine a proposal waits for it
    first_cpu_ms: float  # of the first proposal, which puts the table on the scales of the model
    kept_mib: float  # by which the process grew from before the table was made; NaN but on Linux
    peak_mib: float  # the same at the peak


@dataclass(frozen=True)
class Timings:
    """All that was measured; the first is of our sampler with one feature."""

    cases: list[Measured]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for programs."""
        return asdict(self)

    def markdown(self) -> str:
        """The document: a row for each case, then the bars."""
        lines = [
            "# One proposal of the feature-kernel sampler",
            "",
            "Time and memory of one proposal, for looking up;"
            " [the benchmarks](sampler-benchmarks.md#fast-enough) have the conclusions.",
            "",
            made_by(),
            "One thread; studies of 16 parameters. Ours has its defaults unless the row says"
            " otherwise. Times are in ms, memory in MiB. *First* is the first proposal of a process"
            " that has loaded the libraries; the other times are of later proposals. On a machine"
            " that other work shares, only the processor's times count.",
            "",
            f"![Processor time of a proposal against finished trials]({NAME}.png)",
            "",
            "| sampler | rows | features | finished trials | proposals | median | fastest | slowest"
            " | processor: median | processor: first | memory kept | at the peak |",
            "|---|" + "--:|" * 11,
        ]
        for each in self.cases:
            (sampler, *sizes, _), *measured = astuple(each)
            cells = " | ".join(f"{number:,.0f}" for number in (*sizes, *measured))
            lines.append(f"| {LABELS[sampler]} | {cells} |")
        if all(each.case.sampler != "gp" for each in self.cases):
            lines += ["", "GPSampler was not measured: no PyTorch."]
        return "\n".join([*lines, *Bar.table(self.bars, "measured")]) + "\n"

    @property
    def bars(self) -> list[Bar]:
        """The bars of all cases, and of GPSampler's time over ours."""
        found = []
        for each in self.cases:
            case = each.case
            size = f"{case.rows:,} rows x {case.features}, {case.observations:,} trials"
            for name, most in case.bars:
                value = getattr(each, name)
                what = f"{LABELS[case.sampler]}, {size}: {name.replace('_', ' ')}"
                found.append(Bar(what, f"{value:.0f}, at most {most:.0f}", value <= most))
            if case.sampler == "gp":
                ratio = each.median_ms / self.cases[0].median_ms
                measured = f"{ratio:.1f}, at least {GP_RATIO_BAR:g}"
                found.append(Bar("GPSampler's median over ours", measured, ratio >= GP_RATIO_BAR))
        return found

    def plot(self, path: Path) -> None:
        """Processor time of a proposal against finished trials, with one feature."""
        from study.pictures import style  # not in the processes that are measured

        figure = style.new_figure(5.0, 3.4)
        axes = figure.add_subplot()
        style.tidy(axes)
        rows = self.cases[0].case.rows
        for name, colour, marker in (("ours", style.MODEL, "o-"), ("gp", style.INK, "s")):
            points = sorted(
                (each.case.observations, each.median_cpu_ms)
                for each in self.cases
                if (each.case.sampler, each.case.rows, each.case.features) == (name, rows, 1)
            )
            if points:
                axes.semilogx(*zip(*points, strict=True), marker, color=colour, label=LABELS[name])
        axes.set_xlabel("finished trials", fontsize=style.TEXT_PT)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("processor time of a proposal (ms)", fontsize=style.TEXT_PT)
        axes.legend(fontsize=style.SMALL_PT, frameon=False)
        figure.tight_layout()
        style.save_png(figure, path)


def main() -> None:
    options = parse()
    publish(options, NAME, measure(options))


def parse() -> Namespace:
    parser = Options(__file__)
    parser.whole("--rows", 1, MOST_ROWS, default=100_000, help="of the table; %(default)s")
    parser.whole("--observations", 1, MOST_TRIALS, default=100, help="%(default)s")
    parser.whole("--repeats", 1, MOST_TRIALS, default=11, help="of each proposal; %(default)s")
    parser.add_argument("--sweep", default="10,30,100,300,1000", help="observations; %(default)s")
    parser.whole("--large-rows", 1, MOST_ROWS, default=1_000_000, help="%(default)s")
    options = parsed(parser)
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


def measure(options: Namespace) -> Timings:
    """Every case in a process of its own, one after the other."""
    base = Case("ours", options.rows, 1, options.observations, options.repeats)

    few, some, more, many = ((("median_cpu_ms", most),) for most in (6.0, 10.0, 13.0, 15.0))
    memory, first = ("peak_mib", 200e6 / 2**20), ("first_cpu_ms", 500.0)  # 200 MB
    most = options.sweep[-1]
    cases = [
        replace(base, bars=few),
        replace(base, features=MOST_FEATURES, bars=(*many, memory)),
        replace(base, sampler="foreign", bars=more),
        replace(base, sampler="foreign", observations=most, bars=more),
        replace(base, sampler="rbf", bars=some),
        replace(base, sampler="best", features=6, bars=some),
        *(replace(base, observations=n) for n in options.sweep[:-1] if n != base.observations),
        replace(base, observations=most, bars=(("median_ms", 1000.0),)),
        replace(base, rows=options.large_rows, features=MOST_FEATURES, bars=(first,)),
    ]
    if torch_is_installed():
        cases.append(replace(base, sampler="gp"))
    return Timings([fresh(case) for case in tqdm(cases, unit="case")])


def fresh(case: Case) -> Measured:
    """Measure in a new process, so that memory is its own and nothing is warm."""
    with Processes(1) as pool:
        measured: Measured = pool.submit(measure_case, case).result()
        return measured


def measure_case(case: Case) -> Measured:
    """Propose `repeats` times; each proposal sees one finished trial more than the one before."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    small = replace(case, sampler="ours", rows=1000, observations=10)
    _propose(_prepare(small), case.features)  # loads the libraries
    before_mib = memory_mib("VmRSS")
    study = _prepare(case)
    (_, first), *later = (_propose(study, case.features) for _ in range(1 + case.repeats))
    ms, cpu_ms = zip(*later, strict=True)
    kept, peak = memory_mib("VmRSS") - before_mib, memory_mib("VmHWM") - before_mib
    return Measured(case, median(ms), min(ms), max(ms), median(cpu_ms), first, kept, peak)


def _prepare(case: Case) -> optuna.Study:
    """A study with the sampler and with `observations` finished trials."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(size=(case.rows, DIMENSION))
    features = _features(points, case.features)
    standing = np.arange(case.rows)
    if case.sampler == "best":
        standing = np.sort(rng.choice(standing, int(STANDING * case.rows), replace=False))
    seen = rng.choice(standing, case.observations, replace=False)
    costs = features[seen].sum(axis=1) + NOISE * rng.standard_normal(case.observations)
    known = np.full_like(features, np.nan)
    known[standing] = features[standing]
    study = optuna.create_study(sampler=_sampler(case, points, known))
    foreign = case.sampler == "foreign"
    for row, cost in zip(seen, costs, strict=True):
        point = rng.uniform(size=DIMENSION) if foreign else points[row]
        trial = optuna.create_trial(
            params=dict(zip(SPACE, point.tolist(), strict=True)), distributions=SPACE,
            user_attrs={} if foreign else {ROW_ATTRIBUTE: int(row)}, value=float(cost),
        )  # fmt: skip
        study.add_trial(trial)
    return study


def _features(points: Floats, k: int) -> Floats:
    """k smooth numbers of each point, of about unit variance, [n, k]."""
    directions = np.random.default_rng(SEED).standard_normal((DIMENSION, k))
    return np.asarray(np.sqrt(2.0) * np.sin(2.0 * points @ directions))


def _sampler(case: Case, points: Floats, features: Floats) -> BaseSampler:
    """The sampler of a case, over points [n, 16] with features [n, k]."""
    warnings.simplefilter("ignore", ExperimentalWarning)
    warnings.simplefilter("ignore", UserWarning)  # of rows without features, of foreign trials
    if case.sampler == "gp":
        return GPSampler(seed=SEED)
    names = [f"feature_{column}" for column in range(case.features)]
    columns = dict(zip(SPACE, points.T, strict=True))
    if case.sampler == "best":
        table = FeatureTable.from_arrays(columns, features, [MEAN, *names[1:]], space=SPACE)
        return SurvivalSampler(table, seed=SEED)
    table = FeatureTable.from_arrays(columns, features, names, space=SPACE)
    return FeatureKernelSampler(table, seed=SEED, kernel="rbf" if case.sampler == "rbf" else None)


def _propose(study: optuna.Study, features: int) -> tuple[float, float]:
    """Milliseconds, and those of the processor, from asking for a trial to its last parameter.

    Then the trial finishes.
    """
    began, cpu_began = time.perf_counter(), time.process_time()
    trial = study.ask(SPACE)
    spent = (1e3 * (time.perf_counter() - began), 1e3 * (time.process_time() - cpu_began))
    point = [trial.params[name] for name in SPACE]
    study.tell(trial, float(_features(np.array([point]), features).sum()))
    return spent


def memory_mib(field: str) -> float:
    """Resident memory of this process (VmRSS) or the most it ever was (VmHWM); NaN but on Linux."""
    status = Path("/proc/self/status")
    for line in status.read_text(encoding="ascii").splitlines() if status.exists() else ():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) / 1024
    return float("nan")


if __name__ == "__main__":
    run_command(main)

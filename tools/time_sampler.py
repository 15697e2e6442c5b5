"""Time one proposal of the feature-kernel sampler, and measure the memory it holds.

    python tools/time_sampler.py              # prints a table; minutes
    python tools/time_sampler.py --rows 5000

Each row comes from a fresh process on one thread: milliseconds of the processor, and the
MiB by which the process grew at its peak from before the table was made. A bar follows
each number, and a number above it is bold.
"""

import math
import sys
import time
import warnings
from typing import NamedTuple

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna
    from numpy.typing import NDArray
    from optuna.distributions import BaseDistribution, FloatDistribution
    from optuna.exceptions import ExperimentalWarning

    from storage.processes import Processes
    from study import FeatureKernelSampler, FeatureTable
    from study.options import Options
    from study.sampler.history import ROW_ATTRIBUTE

Floats = NDArray[np.float64]

DIMENSION = 16
SPACE: dict[str, BaseDistribution] = {
    f"p{number:02d}": FloatDistribution(0.0, 1.0) for number in range(DIMENSION)
}
SEED = 16
NOISE = 0.3  # of the cost, in standard deviations of what the features explain
REPEATS = 11  # proposals after the first one
ALIKE_ROWS = 20_000  # at most, of a Gram matrix: 1.6 GB in 32 bits
LEAST_ROWS, MOST_ROWS = 5_000, 1_000_000  # a tenth has trials to choose
NO_BAR = math.inf
LABELS = {
    "ours": "ours",
    "rbf": "ours, the paper's kernel",
    "worlds": "ours, costs in so many worlds in place of features",
    "similarity": "ours, a similarity of all rows in place of features",
}
HEADER = """\
| sampler | rows | features | finished trials | a proposal, ms | bar \
| the first, ms | bar | memory, MiB | bar |
|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|"""


class Case(NamedTuple):
    """A sampler, a table and a study; our defaults, unless the sampler's label says otherwise.

    Attributes:
        sampler: one of `LABELS`.
        rows: of the table.
        features: of a row.
        observations: finished trials before the first proposal.
        bars: the most that is allowed of each of `Measured`.
    """

    sampler: str
    rows: int
    features: int
    observations: int
    bars: tuple[float, float, float] = (NO_BAR, NO_BAR, NO_BAR)


class Measured(NamedTuple):
    """What one case took.

    Attributes:
        proposal_ms: on the processor, median of those after the first.
        first_ms: on the processor, of the first, which puts the table on the model's
            scales.
        peak_mib: by which the process grew at its peak.
    """

    proposal_ms: float
    first_ms: float
    peak_mib: float


def main() -> None:
    parser = Options(__file__)
    parser.whole(
        "--rows", LEAST_ROWS, MOST_ROWS, default=100_000, help="of a table; %(default)s"
    )
    options = parser.parse_args()
    print(HEADER)
    for case in cases(options.rows):
        with Processes(1) as fresh:
            print(row(case, fresh.submit(measure, case).result()), flush=True)


def cases(rows: int) -> list[Case]:
    """What is measured."""
    return [
        Case("ours", rows, 1, 100, bars=(6.0, NO_BAR, NO_BAR)),
        Case("ours", rows, 5, 100, bars=(15.0, NO_BAR, 191.0)),
        Case("rbf", rows, 1, 100, bars=(10.0, NO_BAR, NO_BAR)),
        Case("worlds", 20_000, 128, 100, bars=(15.0, NO_BAR, NO_BAR)),
        Case("similarity", min(rows, ALIKE_ROWS), 5, 100, bars=(30.0, NO_BAR, 3815.0)),
        Case("ours", rows, 1, 1000, bars=(1000.0, NO_BAR, NO_BAR)),
        Case("ours", 10 * rows, 5, 100, bars=(NO_BAR, 500.0, NO_BAR)),
    ]


def row(case: Case, measured: Measured) -> str:
    """A row of the table."""
    cells = [LABELS[case.sampler]]
    cells += [f"{n:,}" for n in (case.rows, case.features, case.observations)]
    for number, bar in zip(measured, case.bars, strict=True):
        shown = f"{number:,.0f}"
        cells.append(f"**{shown}**" if number > bar else shown)
        cells.append("-" if bar == NO_BAR else f"{bar:,.0f}")
    return f"| {' | '.join(cells)} |"


def measure(case: Case) -> Measured:
    """Propose `REPEATS` times; each proposal sees one finished trial more than the one before."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", ExperimentalWarning)
    small = Case("ours", 1000, case.features, 10)
    _propose_ms(_prepare(small), case.features)  # loads the libraries
    before_mib = peak_mib()
    study = _prepare(case)
    first_ms = _propose_ms(study, case.features)
    later_ms = [_propose_ms(study, case.features) for _ in range(REPEATS)]
    return Measured(float(np.median(later_ms)), first_ms, peak_mib() - before_mib)


def _prepare(case: Case) -> optuna.Study:
    """A study with the sampler and with `observations` finished trials."""
    rng = np.random.default_rng(SEED)
    points = rng.uniform(size=(case.rows, DIMENSION))
    features = _features(points, case.features)
    seen = rng.choice(case.rows, case.observations, replace=False)
    costs = features[seen].sum(axis=1) + NOISE * rng.standard_normal(case.observations)
    study = optuna.create_study(sampler=_sampler(case, points, features))
    for number, cost in zip(seen, costs, strict=True):
        trial = optuna.create_trial(
            params=dict(zip(SPACE, points[number].tolist(), strict=True)),
            distributions=SPACE,
            user_attrs={ROW_ATTRIBUTE: int(number)},
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
    columns = dict(zip(SPACE, points.T, strict=True))
    if case.sampler == "worlds":
        table = FeatureTable.from_arrays(columns, outcomes=features, space=SPACE)
        return FeatureKernelSampler(table, seed=SEED)
    if case.sampler == "similarity":
        small = features.astype(np.float32)
        gram = np.empty((case.rows, case.rows), dtype=np.float32)
        for line, own in zip(gram, small, strict=True):
            np.exp(-0.5 * ((small - own) ** 2).sum(axis=1), out=line)
        return FeatureKernelSampler(FeatureTable.from_kernel(gram, columns), seed=SEED)
    table = FeatureTable.from_arrays(columns, features, space=SPACE)
    kernel = "rbf" if case.sampler == "rbf" else None
    return FeatureKernelSampler(table, seed=SEED, kernel=kernel)


def _propose_ms(study: optuna.Study, features: int) -> float:
    """On the processor, from asking for a trial to its last parameter; then the trial finishes."""
    began_s = time.process_time()
    trial = study.ask(SPACE)
    spent_s = time.process_time() - began_s
    point = [trial.params[name] for name in SPACE]
    study.tell(trial, float(_features(np.array([point]), features).sum()))
    return 1e3 * spent_s


def peak_mib() -> float:
    """Most memory that this process has held."""
    import resource  # of POSIX

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    run_command(main)

"""How long one proposal takes and how much memory it holds, measured in this process."""

import statistics
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import FloatDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, GPSampler

from study.features.feature_table import FeatureTable
from study.features.survival import MEAN, SurvivalSampler
from study.sampler.feature_sampler import FeatureKernelSampler
from study.sampler.history import ROW_ATTRIBUTE

Floats = NDArray[np.float64]

DIMENSION = 16
NAMES = tuple(f"p{number:02d}" for number in range(DIMENSION))
SEED = 16
NOISE = 0.3  # of the cost, in standard deviations of what the features explain
STANDING = 0.1  # of the rows of a table like that of `best`: the others fell, and have no features
WARM_UP = 1  # proposals that are not counted: the first one loads libraries


@dataclass(frozen=True)
class Case:
    """What is measured.

    Attributes:
        sampler: "ours", with its defaults; "rbf", ours with the paper's kernel; "best",
            `SurvivalSampler` on a table of which a tenth may be proposed; or "gp" (Optuna's
            GPSampler, in the box of the table).
        rows: of the table.
        features: of a row.
        observations: finished trials before the first proposal.
        repeats: proposals, after one that is not counted.
    """

    sampler: str
    rows: int
    features: int
    observations: int
    repeats: int


@dataclass(frozen=True)
class Measured:
    """Seconds of each proposal; MiB by which the process grew from before the table was made.

    On a busy machine a proposal waits for the processor; `cpu_seconds` leaves the waiting out.
    """

    case: Case
    seconds: tuple[float, ...]
    cpu_seconds: tuple[float, ...]
    grown_mib: float | None
    peak_grown_mib: float | None

    @property
    def median_ms(self) -> float:
        """Median time of a proposal, milliseconds."""
        return 1e3 * statistics.median(self.seconds)

    @property
    def median_cpu_ms(self) -> float:
        """Median processor time of a proposal, milliseconds."""
        return 1e3 * statistics.median(self.cpu_seconds)

    def as_dict(self) -> dict[str, Any]:
        """The case, all times and their medians as plain values."""
        medians = {"median_ms": self.median_ms, "median_cpu_ms": self.median_cpu_ms}
        return {**asdict(self), **medians}


def measure(case: Case) -> Measured:
    """Propose `repeats` times; each proposal sees one finished trial more than the one before."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    before_mib = memory_mib("VmRSS")
    study = _prepare(case)
    spent = [_propose(study, case) for _ in range(WARM_UP + case.repeats)][WARM_UP:]
    seconds, cpu_seconds = zip(*spent, strict=True)
    after_mib, peak_mib = memory_mib("VmRSS"), memory_mib("VmHWM")
    kept, most = _less(after_mib, before_mib), _less(peak_mib, before_mib)
    return Measured(case, seconds, cpu_seconds, kept, most)


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
    trials = [_finished(points, row, cost) for row, cost in zip(seen, costs, strict=True)]
    known = np.full_like(features, np.nan)
    known[standing] = features[standing]
    study = optuna.create_study(sampler=_sampler(case, points, known))
    study.add_trials(trials)
    return study


def _features(points: Floats, k: int) -> Floats:
    """k smooth numbers of each point, of about unit variance, [n, k]."""
    directions = np.random.default_rng(SEED).standard_normal((DIMENSION, k))
    return np.asarray(np.sqrt(2.0) * np.sin(2.0 * points @ directions))


def _sampler(case: Case, points: Floats, features: Floats) -> BaseSampler:
    """The sampler of a case, over points [n, 16] with features [n, k]."""
    if case.sampler == "gp":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            return GPSampler(seed=SEED)
    space = {name: FloatDistribution(0.0, 1.0) for name in NAMES}
    columns = dict(zip(NAMES, points.T, strict=True))
    names = [f"feature_{column}" for column in range(case.features)]
    if case.sampler == "best":
        names[0] = MEAN
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of the rows that fell
            table = FeatureTable.from_arrays(columns, features, names, space=space)
        return SurvivalSampler(table, seed=SEED)
    table = FeatureTable.from_arrays(columns, features, names, space=space)
    kernel = "rbf" if case.sampler == "rbf" else None
    return FeatureKernelSampler(table, seed=SEED, kernel=kernel)


def _finished(points: Floats, row: int, cost: float) -> optuna.trial.FrozenTrial:
    """A trial of a row, with the note that the sampler leaves in those that it proposes."""
    return optuna.create_trial(
        params=dict(zip(NAMES, points[row].tolist(), strict=True)),
        distributions={name: FloatDistribution(0.0, 1.0) for name in NAMES},
        user_attrs={ROW_ATTRIBUTE: int(row)},
        value=float(cost),
    )


def _propose(study: optuna.Study, case: Case) -> tuple[float, float]:
    """Seconds and processor's seconds from asking for a trial to its last parameter.

    Then the trial finishes.
    """
    began, cpu_began = time.perf_counter(), time.process_time()
    trial = study.ask()
    point = [trial.suggest_float(name, 0.0, 1.0) for name in NAMES]
    spent = (time.perf_counter() - began, time.process_time() - cpu_began)
    study.tell(trial, float(_features(np.array([point]), case.features).sum()))
    return spent


def memory_mib(field: str) -> float | None:
    """Resident memory of this process (VmRSS) or the most it ever was (VmHWM); None off Linux."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    for line in status.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) / 1024
    return None


def _less(after: float | None, before: float | None) -> float | None:
    """The difference; None where either is unknown."""
    return None if after is None or before is None else after - before

"""Ways of choosing trials on measured worlds: ours, plain ones, and samplers of others."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import scipy
from optuna.samplers import BaseSampler

from study.experiment import samplers
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from study.sampler.worlds import Better
from tools import measured, peers
from tools.measured import Target
from tools.page import ROOT
from tools.runs import Arm, Batches, Floats, Run, study_costs


def of_worlds(better: Better | None = None) -> Callable[..., Floats]:
    """Of our sampler over a table of the worlds, with its defaults.

    Nothing was measured but the candidates: no point off the table is proposed.
    """

    def costs(target: Target, seed: int, batches: Batches) -> Floats:
        table = FeatureTable.from_arrays(
            target.columns, outcomes=target.outcomes, space=target.space, better=better
        )
        sampler = FeatureKernelSampler(table, seed=seed, off_grid=0)
        return study_costs(target, sampler, batches)

    return costs


def of_ranking(
    made: Callable[..., BaseSampler], by_rank: bool = False, **options: Any
) -> Callable[..., Floats]:
    """Of a sampler over the mean of the worlds, or over the mean of a candidate's ranks in them."""

    def costs(target: Target, seed: int, batches: Batches) -> Floats:
        worlds = scipy.stats.rankdata(target.outcomes, axis=0) if by_rank else None
        score = -(target.outcomes if worlds is None else worlds).mean(axis=1)
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            table = FeatureTable.from_arrays(target.columns, score, space=target.space)
        return study_costs(target, made(table, seed, **options), batches)

    return costs


def of_kin(costs: Callable[..., Floats]) -> Callable[..., Floats]:
    """Of an arm that is given the worlds of the machine's own kind alone."""

    def of_fewer(target: Target, seed: int, batches: Batches) -> Floats:
        worlds = target.outcomes[:, target.kin]
        fewer = replace(target, outcomes=worlds, kin=target.kin[target.kin])
        return costs(fewer, seed, batches)

    return of_fewer


LIKE_WORLDS, COSTS, MEAN = "the worlds, as scores", "the worlds, as costs", "their mean"
KIN = "worlds of its kind"
STUDIES = f"{peers.MOST_STUDIED:,} rows of each world"
SOME = f"{peers.BEST} best and {peers.DRAWN} other rows of each world"
ARMS = {
    "ours": Arm("ours", of_worlds(), ours=True, sees=COSTS),
    "ours-scores": Arm(
        'ours, better="lower"', of_worlds("lower"), ours=True, sees=LIKE_WORLDS
    ),
    "ours-kin": Arm("ours, its kind alone", of_kin(of_worlds()), ours=True, sees=KIN),
    "ranking-kin": Arm(
        "ranking by the mean of its kind",
        of_kin(of_ranking(samplers.RankedSampler)),
        sees=KIN,
    ),
    "ranking-mean": Arm(
        "ranking by mean", of_ranking(samplers.RankedSampler), sees=MEAN
    ),
    "ranking-rank": Arm(
        "ranking by mean rank",
        of_ranking(samplers.RankedSampler, by_rank=True),
        sees="their mean rank",
    ),
    "hill": Arm("hill climber after 3", of_ranking(samplers.hill_ranking), sees=MEAN),
    "residual": Arm(
        "residual process",
        of_ranking(samplers.residual, off_grid=0),
        ours=True,
        sees=MEAN,
    ),
    "tpe": Arm("TPESampler after 3", of_ranking(samplers.tpe_ranking), sees=MEAN),
    "gp": Arm(
        "GPSampler after 3", of_ranking(samplers.gp_ranking), sees=MEAN, needs="torch"
    ),
    "meta-tpe": Arm(
        "MetaLearnTPE after 3",
        peers.meta_learn_tpe,
        sees=STUDIES,
        lacks=peers.hub_lacks,
    ),
    "multi-task": Arm(
        "BoTorch's MultiTaskGP after 3",
        peers.after_ranking(peers.multi_task),
        sees=SOME,
        needs="botorch",
    ),
    "baybe": Arm("BayBE", peers.baybe, sees=SOME, needs="baybe"),
}


@dataclass(frozen=True)
class MeasuredRun(Run):
    """One study on a target.

    Attributes:
        folder: of all data.
    """

    folder: Path

    SOURCES = (Path(measured.__file__), ROOT / "study" / "experiment" / "samplers.py")

    @property
    def pool(self) -> Target:
        """The target of that name."""
        return measured.target(self.folder, self.problem)

    @property
    def way(self) -> Arm[Target]:
        """The arm of that name."""
        return ARMS[self.arm]

    @property
    def data(self) -> tuple[Path, ...]:
        """The files of the target's family."""
        return measured.measurements(self.folder, self.pool.family).files

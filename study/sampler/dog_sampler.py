"""The determinants-of-gait sampler: the paper's settings of `FeatureKernelSampler`.

Antonova, Rai, Atkeson 2016: two parameter sets are alike when their scores are,

    k(x, x') = exp(-(phi(x) - phi(x'))^2 / 2),

the score phi of each having been computed beforehand, on a grid from which candidates are taken.
"""

from typing import Any

from study.sampler.candidate_table import CandidateTable
from study.sampler.feature_sampler import FeatureKernelSampler

# Options of `FeatureKernelSampler`; those that are not named keep their defaults.
PAPER: dict[str, Any] = {"kernel": "rbf"}


class DoGSampler(FeatureKernelSampler):
    """A squared exponential on the table's score, a constant mean, expected improvement.

    Scale, length scale and noise are learned; everything else is as in the paper. Expected
    improvement is compared by its logarithm, which has the same maximum and does not underflow.

    Args:
        table: parameter sets and their score (or scores, with one length scale for all).
        seed: of all draws; None takes one from the machine's entropy.
        **options: of `FeatureKernelSampler`, for what differs from `PAPER`.
    """

    def __init__(self, table: CandidateTable, *, seed: int | None = None, **options: Any) -> None:
        """As `FeatureKernelSampler`, with other defaults."""
        super().__init__(table, seed=seed, **PAPER | options)

"""`PoolSampler`: Bayesian optimisation over a fixed set of candidates with a known similarity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike


try:
    from study import FeatureKernelSampler
    from study import FeatureTable
except ImportError as error:
    raise ImportError(
        "samplers/pool needs taichi-nmm-sampler: install it as its README says, and see that no "
        "file or folder of yours is called `study`"
    ) from error


__all__ = ["PoolSampler"]


class PoolSampler(FeatureKernelSampler):
    """A Gaussian process over n candidates, whose covariance is given; log expected improvement.

    Each trial is a candidate that no trial has taken. It is `FeatureKernelSampler` of taichi-nmm
    on `FeatureTable.from_kernel` or `from_graph`.

    Args:
        kernel: a Gram matrix [n, n], symmetric and positive semidefinite.
        graph: weights of edges [n, n], an array or a sparse matrix; Matern's covariance is made of
            the spectrum of the Laplacian (Borovitskiy et al. 2021). One of the two is given.
        candidates: columns that the study suggests, by name, a value a candidate; by default the
            number of the candidate, an integer `row` from 0 to n - 1.
        hops: how many edges away nodes of the graph are still alike.
        seed: of all draws.
        options: of `FeatureKernelSampler`, such as `success` and `strict`.

    Raises:
        ValueError: a matrix that is none of these, both of them, or neither.
    """

    def __init__(
        self,
        kernel: ArrayLike | None = None,
        graph: Any = None,
        *,
        candidates: Mapping[str, ArrayLike] | None = None,
        hops: float = 10.0,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        if (kernel is None) == (graph is None):
            raise ValueError("PoolSampler takes one of kernel= and graph=")
        if kernel is not None:
            table = FeatureTable.from_kernel(kernel, candidates)
        else:
            table = FeatureTable.from_graph(graph, candidates, hops=hops)
        super().__init__(table, seed=seed, **options)

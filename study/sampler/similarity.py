"""Pools of which only a similarity is known: a Gram matrix, or a graph.

The covariance of the rows is K, so y = s f + noise with f ~ N(0, K). The process takes
a factor F [n, r] of it as features, K ~ F F', and is linear in these: s^2 F_i . F_j.
"""

from typing import Any

import numpy as np
import scipy

from storage.inputs import checks
from storage.inputs.errors import InputError
from study.sampler.arrays import Floats
from study.sampler.transforms import Columns, new_columns
from study.sampler.worlds import Ensemble

MOST_RANK = 512  # of K; what it leaves out counts as no covariance at all
GRAPH_RANK = 256  # smoothest functions on a graph
LEFT = 1e-6  # share of the variance of K at which the factor is complete
ROUNDING = 1e-6  # of the largest variance; Gram matrices may come in 32 bits
BLOCK = 1024  # rows at a time
SMOOTHNESS = 1.5  # nu of Matern's covariance


class Alike:
    """Rows as the model takes them in place of `worlds.Ensemble`: nothing is expected of any."""

    def __init__(self, factor: Floats) -> None:
        self.parts = factor  # F, [m, r]
        self.mean = np.zeros(len(factor))  # none is expected to be better
        nothing = np.zeros((len(factor), 3))  # no shift, no mean, no gap
        self.columns = np.hstack([factor, nothing])  # as `transforms.Columns` has them
        self.kept: dict[Any, Any] = {}

    def layout(self, features: int, coordinates: int) -> Columns:
        """The columns of points that have `columns` between features and coordinates."""
        return new_columns(features, coordinates, self.parts.shape[1])


Relation = Ensemble | Alike
"""What is known of rows beside features."""


def factor_of_gram(gram: Any) -> Floats:
    """F [n, r] of a Gram matrix [n, n], by pivoted Cholesky factorisation (Harbrecht et al. 2012).

    Of the rows that are left, the one with the largest variance comes next: r is at
    most `MOST_RANK`, and no second [n, n] matrix is made.

    Raises:
        InputError: not square, not finite, not symmetric, or not positive semidefinite.
    """
    field, allowed = "table.gram", "a symmetric positive semidefinite matrix [n, n]"
    matrix = gram if isinstance(gram, np.ndarray) else checks.numbers(field, gram)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not len(matrix):
        raise InputError(f"{field}.shape", matrix.shape, "[n, n], n at least 1")
    if matrix.dtype.kind not in "biuf":
        raise InputError(field, str(matrix.dtype), "numbers, [n, n]")
    for first in range(0, len(matrix), BLOCK):
        block = slice(first, first + BLOCK)
        if not np.allclose(matrix[block], matrix[:, block].T, rtol=1e-4, atol=1e-6):
            raise InputError(field, "not symmetric, or not finite", allowed)
    left = np.array(matrix.diagonal(), dtype=np.float64)
    total, slack = float(left.sum()), ROUNDING * float(left.max())
    if left.min() < -slack or total <= 0.0:
        raise InputError(
            f"{field}[{int(left.argmin())}, same]", float(left.min()), allowed
        )
    factor = np.zeros((len(matrix), min(MOST_RANK, len(matrix))))
    for rank in range(factor.shape[1]):
        pivot = int(left.argmax())
        if left.clip(0.0).sum() <= LEFT * total or left[pivot] <= slack:
            return factor[:, :rank]
        column = matrix[:, pivot] - factor[:, :rank] @ factor[pivot, :rank]
        # Of what is left, |S_ij|^2 <= S_ii S_jj, or the matrix has a negative
        # eigenvalue.
        if (
            column**2 > (left[pivot] + slack) * (left.clip(0.0) + slack) * (1.0 + 1e-3)
        ).any():
            raise InputError(field, f"no variance that row {pivot} can have", allowed)
        factor[:, rank] = column / np.sqrt(left[pivot])
        left -= factor[:, rank] ** 2
        left[pivot] = 0.0
    return factor


def factor_of_graph(weights: Any, hops: float) -> Floats:
    """F [n, r] of Matern's covariance on a graph, of variance 1 at each node.

    K ~ U (2 nu / hops^2 + lambda)^-nu U', with eigenvalues lambda and eigenvectors U of
    the normalised Laplacian I - D^-1/2 W D^-1/2 (Borovitskiy et al. 2021, "Matern
    Gaussian processes on graphs", equation 10); of the smallest `GRAPH_RANK`. As it is,
    its variance is largest at the rim, where the first trials would then be.

    Args:
        weights: W, of edges, [n, n]: an array or a sparse matrix, symmetric, 0 where
            there is none.
        hops: how far rows are alike, in edges.

    Raises:
        InputError: not square, negative or not finite, or not symmetric.
    """
    field = "table.weights"
    try:
        edges = scipy.sparse.csr_array(weights, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            field, type(weights).__name__, "weights of edges, [n, n]"
        ) from None
    n = edges.shape[0]
    if edges.ndim != 2 or edges.shape != (n, n) or n < 2:
        raise InputError(f"{field}.shape", edges.shape, "[n, n], n at least 2")
    if not (np.isfinite(edges.data).all() and (edges.data >= 0.0).all()):
        raise InputError(
            field, "a negative or infinite weight", "weights of at least 0"
        )
    if abs(edges - edges.T).max() > ROUNDING * max(float(edges.max()), 1e-300):
        raise InputError(field, "not symmetric", "one weight an edge, both ways")
    degree = np.asarray(edges.sum(axis=0)).ravel()
    root = scipy.sparse.diags_array(1.0 / np.sqrt(np.where(degree > 0.0, degree, 1.0)))
    smooth = scipy.sparse.eye_array(n) + root @ edges @ root  # 2 - the Laplacian
    if n <= 2 * GRAPH_RANK:
        values, vectors = np.linalg.eigh(smooth.toarray())
    else:
        start = np.ones(n)  # the same vectors each time
        values, vectors = scipy.sparse.linalg.eigsh(
            smooth, k=GRAPH_RANK, which="LA", v0=start
        )
    spectrum = (
        2.0 * SMOOTHNESS / hops**2 + np.maximum(2.0 - values, 0.0)
    ) ** -SMOOTHNESS
    factor = vectors * np.sqrt(spectrum)
    norms = np.linalg.norm(factor, axis=1, keepdims=True)
    return np.asarray(factor / np.where(norms > 0.0, norms, 1.0))

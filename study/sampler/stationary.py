"""Kernels of the distance in length scales, r^2 = sum_j (x_j - x'_j)^2 / l_j^2; one at r = 0.

Distances are taken as -r^2/2 = a . b - |a|^2/2 - |b|^2/2, with a and b in length scales: one
product of matrices, in 64 bits always. It is wrong by 1e-16 of |a|^2 + |b|^2.
"""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from study.sampler.parts import Bounds, Floats, Part, Pull, Towards

AnyFloats = NDArray[Any]

NEGLIGIBLE = -80.0  # exp of it is 1e-35


@dataclass(frozen=True)
class Stationary(Part):
    """A kernel of the distance between two rows, over some of their columns.

    Attributes:
        scales: l, one a column, or a single one for all of them.
        limits: of each.
        columns: that it sees, k of them.
    """

    scales: tuple[float, ...]
    limits: Bounds
    columns: slice

    @property
    def theta(self) -> Floats:
        """Logarithms of the length scales."""
        return np.log(self.scales)

    @property
    def bounds(self) -> Floats:
        """Of the logarithms."""
        return np.log([self.limits] * len(self.scales))

    @property
    def shortest(self) -> float:
        """The smallest of them."""
        return min(self.scales)

    def with_theta(self, theta: Floats) -> Self:
        """Other length scales."""
        return replace(self, scales=tuple(np.exp(theta).tolist()))

    def gram(self, x: Floats) -> tuple[Floats, Pull]:
        """The kernel of all pairs; dk/dlog l_j = slope (x_j - x'_j)^2 / l_j^2."""
        scaled = self._scaled(x)
        value, slope = self.with_slope(_left(scaled).T @ _right(scaled))

        def pull(weights: Floats) -> Floats:
            # sum_ij w_ij (s_i - s_j)^2 = sum_i s_i^2 (row + column) - 2 sum_ij s_i w_ij s_j
            weights = weights * slope
            ends = weights.sum(axis=0) + weights.sum(axis=1)
            each = scaled**2 @ ends - 2.0 * np.einsum("kn,kn->k", scaled @ weights, scaled)
            return each if len(self.scales) == len(each) else np.array([each.sum()])

        return value, pull

    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """The kernel of rows a and others."""
        left = _left(self._scaled(a)).T

        def cross(x: Floats) -> AnyFloats:
            half = left @ _right(self._scaled(x))
            return self.of_half(half.astype(precision, copy=False))

        return cross

    def variance(self, x: Floats) -> float:
        """One: the distance is zero."""
        return 1.0

    @abstractmethod
    def of_half(self, half: AnyFloats) -> AnyFloats:
        """The kernel where -r^2/2 is `half` [n, m], which it may overwrite."""

    @abstractmethod
    def with_slope(self, half: Floats) -> tuple[Floats, Floats]:
        """The same, and its derivative by -r^2/2, the slope, [n, m] each."""

    def _scaled(self, x: Floats) -> Floats:
        """The columns seen, in length scales, as rows: [k, n]."""
        return np.asarray(x[:, self.columns].T / np.array(self.scales)[:, None])


@dataclass(frozen=True)
class RBF(Stationary):
    """Squared exponential: exp(-r^2 / 2)."""

    def of_half(self, half: AnyFloats) -> AnyFloats:
        """In place."""
        return np.asarray(np.exp(half, out=half))

    def with_slope(self, half: Floats) -> tuple[Floats, Floats]:
        """It is its own slope; never so small that products of it are denormal, which is slow."""
        value = self.of_half(np.maximum(half, NEGLIGIBLE, out=half))
        return value, value


def _left(scaled: Floats) -> Floats:
    """a, -|a|^2/2 and -1/2 on top of each other, [k + 2, n]; `_left`^T `_right` is -r^2/2."""
    extended = _right(scaled)
    extended[-2:] = -0.5 * extended[:-3:-1]
    return extended


def _right(scaled: Floats) -> Floats:
    """b, 1 and |b|^2 on top of each other, [k + 2, m]."""
    count, m = scaled.shape
    extended = np.empty((count + 2, m))
    extended[:count] = scaled
    extended[count] = 1.0
    np.einsum("km,km->m", scaled, scaled, out=extended[-1])
    return extended

"""What kernels are made of: parts that know their covariance, and how it follows their constants.

`theta` are the logarithms of a part's constants, [t]. A gradient is never a stack of n x n
matrices: with K = K(theta) the covariance of n rows, a part takes the derivative W of any number by
each entry of K, and gives that number's derivative by theta, sum_ij W_ij dK_ij/dtheta (reverse
accumulation; Griewank, Walther 2008, chapter 3). A sum hands W on; a product hands on W times its
other factor.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Towards = Callable[[Floats], Any]  # rows [m, p] -> covariance with the rows before, [n, m]
Pull = Callable[[Floats], Floats]  # W [n, n] -> sum_ij W_ij dK_ij/dtheta, [t]
Bounds = tuple[float, float]


class Part(ABC):
    """A kernel without noise. Where it is constant, a number stands for its matrix."""

    @property
    @abstractmethod
    def theta(self) -> Floats:
        """Logarithms of the constants, [t]."""

    @property
    @abstractmethod
    def bounds(self) -> Floats:
        """Least and greatest `theta`, [t, 2]."""

    @abstractmethod
    def with_theta(self, theta: Floats) -> Self:
        """The same with other constants, given as logarithms [t]."""

    @abstractmethod
    def gram(self, x: Floats) -> tuple[Any, Pull]:
        """Covariance of rows [n, p] with each other, [n, n], and its pull, for W of any form."""

    @abstractmethod
    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """Covariance of rows a [n, p] with others, still to come; in 32 or 64 bits."""

    @abstractmethod
    def variance(self, x: Floats) -> Any:
        """k(x, x) of rows [m, p], [m]."""

    @property
    def shortest(self) -> float:
        """The smallest length scale, in standard units; infinite without any."""
        return np.inf


@dataclass(frozen=True)
class Constant(Part):
    """The same covariance everywhere: a factor, such as a variance."""

    value: float
    limits: Bounds

    @property
    def theta(self) -> Floats:
        """Logarithm of the value."""
        return np.log([self.value])

    @property
    def bounds(self) -> Floats:
        """Of the logarithm."""
        return np.log([self.limits])

    def with_theta(self, theta: Floats) -> "Constant":
        """Another value."""
        return Constant(float(np.exp(theta[0])), self.limits)

    def gram(self, x: Floats) -> tuple[float, Pull]:
        """The value, which is its own derivative by its logarithm."""
        return self.value, lambda weights: np.array([self.value * weights.sum()])

    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """The value."""
        return lambda x: self.value

    def variance(self, x: Floats) -> float:
        """The value."""
        return self.value


@dataclass(frozen=True)
class Linear(Part):
    """a . b over some columns: a linear function of them, slopes of variance one; no constants."""

    columns: slice

    @property
    def theta(self) -> Floats:
        """None."""
        return np.empty(0)

    @property
    def bounds(self) -> Floats:
        """None."""
        return np.empty((0, 2))

    def with_theta(self, theta: Floats) -> "Linear":
        """Itself."""
        return self

    def gram(self, x: Floats) -> tuple[Floats, Pull]:
        """Products of all pairs."""
        seen = x[:, self.columns]
        return seen @ seen.T, lambda weights: np.empty(0)

    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """Products of all pairs."""
        seen = a[:, self.columns]
        return lambda x: (seen @ x[:, self.columns].T).astype(precision, copy=False)

    def variance(self, x: Floats) -> Floats:
        """Products of rows with themselves."""
        seen = x[:, self.columns]
        return np.asarray(np.einsum("mp,mp->m", seen, seen))

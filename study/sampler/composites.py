"""Kernels made of kernels: sums and products."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from study.sampler.parts import Floats, Part, Pull, Towards


@dataclass(frozen=True)
class Pair(Part):
    """Two kernels; the constants of the first come first."""

    first: Part
    second: Part

    @property
    def theta(self) -> Floats:
        """Of both."""
        return np.concatenate([self.first.theta, self.second.theta])

    @property
    def bounds(self) -> Floats:
        """Of both."""
        return np.concatenate([self.first.bounds, self.second.bounds])

    @property
    def shortest(self) -> float:
        """The smaller one's."""
        return min(self.first.shortest, self.second.shortest)

    def with_theta(self, theta: Floats) -> Self:
        """Other constants of both."""
        count = len(self.first.theta)
        first, second = self.first.with_theta(theta[:count]), self.second.with_theta(theta[count:])
        return type(self)(first, second)


@dataclass(frozen=True)
class Sum(Pair):
    """The covariance of a sum of independent functions."""

    def gram(self, x: Floats) -> tuple[Any, Pull]:
        """The sum of both."""
        (a, pull_a), (b, pull_b) = self.first.gram(x), self.second.gram(x)
        return a + b, lambda weights: np.concatenate([pull_a(weights), pull_b(weights)])

    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """The sum of both."""
        first, second = self.first.towards(a, precision), self.second.towards(a, precision)

        def cross(x: Floats) -> Any:
            k = first(x)
            k += second(x)
            return k

        return cross

    def variance(self, x: Floats) -> Any:
        """The sum of both."""
        return self.first.variance(x) + self.second.variance(x)


@dataclass(frozen=True)
class Product(Pair):
    """A covariance that is large only where both of its kernels are."""

    def gram(self, x: Floats) -> tuple[Any, Pull]:
        """The product of both."""
        (a, pull_a), (b, pull_b) = self.first.gram(x), self.second.gram(x)
        return a * b, lambda weights: np.concatenate([pull_a(weights * b), pull_b(weights * a)])

    def towards(self, a: Floats, precision: type[np.floating[Any]]) -> Towards:
        """The product of both."""
        first, second = self.first.towards(a, precision), self.second.towards(a, precision)

        def cross(x: Floats) -> Any:
            k = second(x)
            k *= first(x)
            return k

        return cross

    def variance(self, x: Floats) -> Any:
        """The product of both."""
        return self.first.variance(x) * self.second.variance(x)

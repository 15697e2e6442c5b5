"""A kernel together with what is thought of its constants before any trial."""

from dataclasses import dataclass

from study.sampler.composites import Product, Sum
from study.sampler.parts import Part


@dataclass(frozen=True)
class Prior:
    """A normal density of the logarithm of a constant."""

    mode: float
    sd: float


@dataclass(frozen=True)
class Term:
    """A kernel, and the priors of its constants in the order of its `theta`."""

    kernel: Part
    priors: tuple[Prior, ...]

    def __add__(self, other: "Term") -> "Term":
        """The covariance of a sum of independent functions."""
        return Term(Sum(self.kernel, other.kernel), self.priors + other.priors)

    def __mul__(self, other: "Term") -> "Term":
        """Large where both are."""
        return Term(Product(self.kernel, other.kernel), self.priors + other.priors)

"""Kernels made of kernels: sums, products, and a kernel on some of the columns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.gaussian_process import kernels

from study.sampler.parts import Part

Floats = NDArray[np.float64]


class Sum(Part, kernels.Sum):  # type: ignore[misc]
    """The covariance of a sum of independent functions."""

    k1: Part
    k2: Part

    def cross(self, a: Floats, b: Floats, fast: bool) -> Any:
        """The sum of both."""
        return self.k1.cross(a, b, fast) + self.k2.cross(a, b, fast)

    def variance(self, x: Floats) -> Any:
        """The sum of both."""
        return self.k1.variance(x) + self.k2.variance(x)

    @property
    def noise(self) -> float:
        """The sum of both."""
        return self.k1.noise + self.k2.noise

    @property
    def shortest(self) -> float:
        """The smaller one's."""
        return min(self.k1.shortest, self.k2.shortest)


class Product(Part, kernels.Product):  # type: ignore[misc]
    """A covariance that is large only where both of its kernels are; neither has noise."""

    k1: Part
    k2: Part

    def cross(self, a: Floats, b: Floats, fast: bool) -> Any:
        """The product of both."""
        return self.k1.cross(a, b, fast) * self.k2.cross(a, b, fast)

    def variance(self, x: Floats) -> Any:
        """The product of both."""
        return self.k1.variance(x) * self.k2.variance(x)

    @property
    def shortest(self) -> float:
        """The smaller one's."""
        return min(self.k1.shortest, self.k2.shortest)


class Slice(Part):
    """A kernel that sees columns `start` to `end` of its input only."""

    def __init__(self, kernel: Part, start: int, end: int) -> None:
        """As scikit-learn wants it: arguments are kept as they are."""
        self.kernel = kernel
        self.start = start
        self.end = end

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The arguments, and those of the kernel inside."""
        params = {"kernel": self.kernel, "start": self.start, "end": self.end}
        if deep:
            params |= {f"kernel__{name}": v for name, v in self.kernel.get_params().items()}
        return params

    @property
    def hyperparameters(self) -> list[Any]:
        """The constants of the kernel inside."""
        return list(self.kernel.hyperparameters)

    @property
    def theta(self) -> Floats:
        """Logarithms of the constants of the kernel inside."""
        return np.asarray(self.kernel.theta)

    @theta.setter
    def theta(self, theta: Floats) -> None:
        self.kernel.theta = theta

    @property
    def bounds(self) -> Floats:
        """Of `theta`, as logarithms, [t, 2]."""
        return np.asarray(self.kernel.bounds)

    def __call__(self, X: Floats, Y: Floats | None = None, eval_gradient: bool = False) -> Any:  # noqa: N803
        """The kernel of each row of X with each of Y, [n, m]."""
        return self.kernel(
            X[:, self.start : self.end],
            None if Y is None else Y[:, self.start : self.end],
            eval_gradient=eval_gradient,
        )

    def cross(self, a: Floats, b: Floats, fast: bool) -> Any:
        """The kernel inside, of these columns."""
        columns = slice(self.start, self.end)
        return self.kernel.cross(a[:, columns], b[:, columns], fast)

    def variance(self, x: Floats) -> Any:
        """The kernel inside, of these columns."""
        return self.kernel.variance(x[:, self.start : self.end])

    @property
    def noise(self) -> float:
        """The noise of the kernel inside."""
        return self.kernel.noise

    @property
    def shortest(self) -> float:
        """That of the kernel inside."""
        return self.kernel.shortest

    def diag(self, X: Floats) -> Floats:  # noqa: N803
        """The kernel of each row with itself, [n]."""
        return np.asarray(self.kernel.diag(X[:, self.start : self.end]))

    def is_stationary(self) -> bool:
        """Whether the kernel inside depends on distances alone."""
        return bool(self.kernel.is_stationary())

    def __repr__(self) -> str:
        return f"{self.kernel!r}[{self.start}:{self.end}]"

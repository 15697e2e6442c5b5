"""Building blocks of kernels: a kernel with its priors, a kernel on some columns."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from sklearn.gaussian_process import kernels
from sklearn.gaussian_process.kernels import Kernel

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """A normal density of the logarithm of a constant."""

    mode: float
    sd: float


@dataclass(frozen=True)
class Term:
    """A kernel, and the priors of its constants in the order of its `theta`."""

    kernel: Kernel
    priors: tuple[Prior, ...]

    def __add__(self, other: "Term") -> "Term":
        return Term(self.kernel + other.kernel, self.priors + other.priors)

    def __mul__(self, other: "Term") -> "Term":
        return Term(self.kernel * other.kernel, self.priors + other.priors)


class Listed:
    """Tells scikit-learn what its kernels' constants are without a search, ten times a step."""

    _constants: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Search once a class."""
        cls._constants = tuple(name for name in dir(cls) if name.startswith("hyperparameter_"))

    @property
    def hyperparameters(self) -> list[Any]:
        """In the order of their names, as scikit-learn has them."""
        return [getattr(self, name) for name in self._constants]


class RBF(Listed, kernels.RBF):  # type: ignore[misc]
    """Squared exponential."""


class Matern(Listed, kernels.Matern):  # type: ignore[misc]
    """Matern."""


class ConstantKernel(Listed, kernels.ConstantKernel):  # type: ignore[misc]
    """A constant, for a variance."""


class WhiteKernel(Listed, kernels.WhiteKernel):  # type: ignore[misc]
    """Noise."""


class Slice(Kernel):  # type: ignore[misc]
    """A kernel that sees columns `start` to `end` of its input only."""

    def __init__(self, kernel: Kernel, start: int, end: int) -> None:
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
        """Those of the kernel inside."""
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
        """Of `theta`."""
        return np.asarray(self.kernel.bounds)

    def __call__(self, X: Floats, Y: Floats | None = None, eval_gradient: bool = False) -> Any:  # noqa: N803
        """The kernel of each row of X with each of Y, [n, m]."""
        return self.kernel(
            X[:, self.start : self.end],
            None if Y is None else Y[:, self.start : self.end],
            eval_gradient=eval_gradient,
        )

    def diag(self, X: Floats) -> Floats:  # noqa: N803
        """The kernel of each row with itself, [n]."""
        return np.asarray(self.kernel.diag(X[:, self.start : self.end]))

    def is_stationary(self) -> bool:
        """As the kernel inside."""
        return bool(self.kernel.is_stationary())

    def __repr__(self) -> str:
        return f"{self.kernel!r}[{self.start}:{self.end}]"

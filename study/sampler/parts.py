"""What kernels are made of: scikit-learn's, which also answer what the posterior asks of them.

scikit-learn fits. For many candidates its kernels are slow, and know only 64 bits.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import kernels
from sklearn.gaussian_process.kernels import Kernel

Floats = NDArray[np.float64]
AnyFloats = NDArray[Any]


class Part(Kernel):  # type: ignore[misc]
    """A kernel; where it is also one of scikit-learn's, this base is named before that one."""

    @abstractmethod
    def cross(self, a: Floats, b: Floats, fast: bool) -> Any:
        """Covariance of rows a [n, p] and other rows b [m, p], without noise.

        Returns [n, m], 32-bit if `fast`, or a number where it is constant.
        """

    @abstractmethod
    def variance(self, x: Floats) -> Any:
        """k(x, x) of rows [m, p] without noise: [m], or a number where it is constant."""

    @property
    def noise(self) -> float:
        """Variance of the white noise, in standard units."""
        return 0.0

    @property
    def shortest(self) -> float:
        """The smallest length scale, in standard units; infinite without any."""
        return np.inf


class Listed:
    """Tells scikit-learn what its kernels' constants are without a search, ten times a step."""

    _constants: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Look for the constants, once a class."""
        cls._constants = tuple(name for name in dir(cls) if name.startswith("hyperparameter_"))

    @property
    def hyperparameters(self) -> list[Any]:
        """In the order of their names, as scikit-learn has them."""
        return [getattr(self, name) for name in self._constants]


class Stationary(Listed, Part):
    """A kernel of the distance, in length scales, between two rows; one at distance zero."""

    length_scale: Any

    def cross(self, a: Floats, b: Floats, fast: bool) -> AnyFloats:
        """The kernel of distances in length scales, [n, m]."""
        a, b = a / self.length_scale, b / self.length_scale
        square = _squared_distances(a, b) if fast else cdist(a, b, "sqeuclidean")
        return self.of_square(_precise(square, fast))

    def variance(self, x: Floats) -> float:
        """One: the distance is zero."""
        return 1.0

    @property
    def shortest(self) -> float:
        """Of one length scale, or of one a column."""
        return float(np.min(self.length_scale))

    @abstractmethod
    def of_square(self, square: AnyFloats) -> AnyFloats:
        """The kernel at squared distances [n, m], which it may overwrite."""


class RBF(Stationary, kernels.RBF):  # type: ignore[misc]
    """Squared exponential."""

    def of_square(self, square: AnyFloats) -> AnyFloats:
        """exp(-r^2 / 2), in place."""
        square *= -0.5
        return np.asarray(np.exp(square, out=square))


class Matern(Stationary, kernels.Matern):  # type: ignore[misc]
    """Matern with nu = 5/2."""

    nu: float

    def of_square(self, square: AnyFloats) -> AnyFloats:
        """(1 + sqrt5 r + 5/3 r^2) exp(-sqrt5 r)."""
        assert self.nu == 2.5  # the only one that is built
        distance = np.sqrt(5.0 * square)
        return np.asarray((1.0 + distance + distance**2 / 3.0) * np.exp(-distance))


class ConstantKernel(Listed, Part, kernels.ConstantKernel):  # type: ignore[misc]
    """The same covariance everywhere: a factor, such as a variance."""

    constant_value: float

    def cross(self, a: Floats, b: Floats, fast: bool) -> float:
        """The constant."""
        return float(self.constant_value)

    def variance(self, x: Floats) -> float:
        """The constant."""
        return float(self.constant_value)


class WhiteKernel(Listed, Part, kernels.WhiteKernel):  # type: ignore[misc]
    """Noise, independent from row to row."""

    noise_level: float

    def cross(self, a: Floats, b: Floats, fast: bool) -> float:
        """Nothing: noises of different rows are independent."""
        return 0.0

    def variance(self, x: Floats) -> float:
        """Nothing here: it is the `noise`."""
        return 0.0

    @property
    def noise(self) -> float:
        """The level that was learned."""
        return float(self.noise_level)


class DotProduct(Listed, Part, kernels.DotProduct):  # type: ignore[misc]
    """sigma_0^2 + a . b: a linear function of the columns."""

    sigma_0: float

    def cross(self, a: Floats, b: Floats, fast: bool) -> AnyFloats:
        """Products of all pairs of rows, [n, m]."""
        return _precise(self.sigma_0**2 + a @ b.T, fast)

    def variance(self, x: Floats) -> Floats:
        """Products of rows with themselves, [m]."""
        return np.asarray(self.sigma_0**2 + np.einsum("mp,mp->m", x, x))


def _squared_distances(a: Floats, b: Floats) -> Floats:
    """|a - b|^2 = |a|^2 + |b|^2 - 2 a b, as one product of matrices, [n, m]."""
    if a.shape[1] == 1:
        return np.asarray((a - b.T) ** 2)
    left = np.column_stack([-2.0 * a, np.einsum("np,np->n", a, a), np.ones(len(a))])
    right = np.column_stack([b, np.ones(len(b)), np.einsum("mp,mp->m", b, b)])
    return np.asarray(np.maximum(left @ right.T, 0.0))


def _precise(values: Floats, fast: bool) -> AnyFloats:
    """As 32-bit numbers if `fast`."""
    return values.astype(np.float32) if fast else values

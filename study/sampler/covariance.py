"""The whole covariance of the trials: a kernel, and noise that is independent from row to row."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.sampler.parts import Bounds, Part
from study.sampler.terms import Prior

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Covariance:
    """k(x, x') + noise [x is x'], and what is thought of its constants before any trial.

    Attributes:
        kernel: without noise.
        noise: its variance, in standard units.
        noise_limits: of it.
        priors: of the kernel's constants, then of the noise, t of them.
    """

    kernel: Part
    noise: float
    noise_limits: Bounds
    priors: tuple[Prior, ...]

    @property
    def theta(self) -> Floats:
        """Logarithms of the constants, [t]; the noise is the last."""
        return np.append(self.kernel.theta, np.log(self.noise))

    @property
    def bounds(self) -> Floats:
        """Least and greatest `theta`, [t, 2]."""
        return np.vstack([self.kernel.bounds, np.log(self.noise_limits)])

    @cached_property
    def modes(self) -> Floats:
        """Where the priors are largest, [t]."""
        return np.array([prior.mode for prior in self.priors])

    @cached_property
    def spreads(self) -> Floats:
        """Standard deviations of the priors, [t]."""
        return np.array([prior.sd for prior in self.priors])

    def with_theta(self, theta: Floats) -> "Covariance":
        """The same with other constants, given as logarithms [t]."""
        kernel = self.kernel.with_theta(theta[:-1])
        return replace(self, kernel=kernel, noise=float(np.exp(theta[-1])))

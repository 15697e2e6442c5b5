"""The Gaussian process of the sampler: its kernels, their constants, and the posterior.

| symbol | shape | meaning |
|---|---|---|
| phi | [n, k] | features, in standard units |
| u | [n, e] | parameters as coordinates in the unit cube; d parameters have e >= d coordinates |
| X = (phi, u) | [n, p] | trials, a row each |
| y | [n] | their costs, in standard units |
| theta | [t] | logarithms of the constants of a kernel, the noise variance last |
| K | [n, n] | covariance of the trials, noise included |
| L | [n, n] | Cholesky factor of K |
| a | [n] | K^-1 y |
| k | [n, m] | covariance of the trials and m candidates |
| W | [n, n] | derivative of a number by each entry of K |

A kernel is a sum of terms, each a variance times a shape:

| term | formula | kernels |
|---|---|---|
| slopes | v phi . phi' | additive, worlds |
| likeness | s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2) | these; rbf: l shared |
| nearness | t^2 exp(-sum_j (u_j - u'_j)^2 / 2 L_j^2) | euclidean; additive, worlds: L shared |
| worlds | a^2 d . d', d being what each world adds to the mean over the worlds | worlds |
| mean | v m m', m being the mean over the worlds | worlds |
| shift | c^2 for all rows, where outcomes are in the unit of the costs | worlds |
| similarity | s^2 K, of a pool (`study.sampler.similarity`) | similarity |

With slopes w ~ N(0, v I), the first term is the covariance of w . phi (Rasmussen,
Williams 2006, section 2.7). The constants maximise

    log p(y | X, theta) + sum_i log N(theta_i; mode_i, sd_i^2),
    log p(y | X, theta) = -(y . a + log det K + n log 2 pi) / 2,

whose derivative by K is (a a^T - K^-1) / 2 (equations 2.30 and 5.9 there). With few
trials the likelihood alone would allow almost any constants. The posterior at a
candidate x has

    mean = k^T K^-1 y = (L^-1 k)^T (L^-1 y),   variance = k(x, x) - |L^-1 k|^2  (algorithm 2.1).

The priors are normal in the logarithm of each constant. Length scales of parameters
follow Hvarfner, Hellsten, Nardi 2024 ("Vanilla Bayesian optimization performs great in
high dimensions"): log-normal with mu = sqrt 2 + (log d) / 2, sigma = sqrt 3, so that
the assumed complexity does not grow with d. A log-normal density of L is, as a function
of log L and up to a factor, a normal density around mu - sigma^2; so is BoTorch's
log-normal(-4, 1) of the noise around -5.

Parameter sets with equal features differ in cost, and no repetition would show it. Over
features, noise is that spread, so it is expected to be large.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, log, sqrt
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.arrays import Floats, Whole
from study.sampler.transforms import Columns, Points

AnyFloats = NDArray[Any]
Pull = Callable[[Floats], Floats]  # W [n, n] -> sum_ij W_ij dK_ij/dtheta, [t]
Towards = Callable[[Floats], AnyFloats]  # candidates [m, p] -> k [n, m]

# Bounds of the constants; they keep 32-bit arithmetic right.
SIGNAL_BOUNDS = (1e-2, 1e2)
SLOPE_BOUNDS = (1e-4, 1e2)
FEATURE_SCALE_BOUNDS = (5e-2, 5e1)
PARAMETER_SCALE_BOUNDS = (5e-2, 1e2)
NOISE_BOUNDS = (1e-4, 1e1)

NEGLIGIBLE = -80.0  # exp of it is 1e-35
JITTER = 1e-10  # variance added to the noise, so that equal rows do no harm
LIKELIHOOD_TRIALS = 120  # at most; constants are few, and the cost grows with the cube
ITERATIONS = 40
# Added to the log noise: the likelihood has a mode that is all noise.
NOISE_STARTS = (0.0, 3.0)
SECOND_START_TRIALS = 30  # up to so many: with more, the modes are rarely two
BLOCK = 512  # candidates at a time, so that a block stays in the cache
LARGEST_RATIO = 5e2  # of prior variance to noise, for which 32 bits keep within 1e-4


@dataclass(frozen=True)
class Kernel:
    """The meaning of a kernel's name.

    Attributes:
        slopes: whether the cost has a part that is linear in the features.
        feature_scales: length scales of the features: "each", "shared", or None: no
            likeness.
        parameter_scales: the same for the parameters; None: they do not count.
        by_order: whether features count by their order, and costs by their logarithm;
            else both count as they are.
        related: whether what is known of rows beside features counts: their costs in
            simulated worlds, or their similarity.
    """

    slopes: bool
    feature_scales: str | None
    parameter_scales: str | None
    by_order: bool
    related: bool = False

    @cached_property
    def of_features(self) -> bool:
        """Whether features count."""
        return self.slopes or self.feature_scales is not None or self.related

    @cached_property
    def of_parameters(self) -> bool:
        """Whether coordinates count; if not, candidates of equal features are the same."""
        return self.parameter_scales is not None


ADDITIVE = Kernel(
    slopes=True, feature_scales="each", parameter_scales="shared", by_order=True
)
NEARNESS = replace(ADDITIVE, slopes=False, feature_scales=None)
WITH_WORLDS = replace(ADDITIVE, related=True)
SIMILARITY = replace(NEARNESS, parameter_scales=None, related=True)
RBF = Kernel(
    slopes=False, feature_scales="shared", parameter_scales=None, by_order=False
)
EUCLIDEAN = replace(RBF, feature_scales=None, parameter_scales="each")
KERNELS = {"additive": ADDITIVE, "rbf": RBF, "euclidean": EUCLIDEAN}


@dataclass(frozen=True)
class Constant:
    """A positive constant to be learned: bounds, and a normal prior of its logarithm.

    Attributes:
        mode: of the prior, on the scale of the logarithm.
        sd: of the prior, on the same scale.
        bounds: the least and the greatest value, positive, not logarithms.
    """

    mode: float
    sd: float
    bounds: tuple[float, float]


SIGNAL = Constant(0.0, 1.5, SIGNAL_BOUNDS)  # s^2, t^2: cost^2
SLOPE = Constant(log(0.3), 1.5, SLOPE_BOUNDS)  # v: (cost / feature)^2
FEATURE_NOISE = Constant(log(0.1), 1.5, NOISE_BOUNDS)  # cost^2
PARAMETER_NOISE = Constant(-5.0, 1.0, NOISE_BOUNDS)  # log-normal(-4, 1)
# Of costs in units of a table, of whose costs in all worlds the standard deviation is
# one.
WORLD = Constant(log(0.25), 1.4, SIGNAL_BOUNDS)  # a^2
SHIFT = Constant(0.0, 0.1, SIGNAL_BOUNDS)  # c^2
BEYOND = Constant(log(0.3), 1.4, SIGNAL_BOUNDS)  # t^2
# L, in ranges of the parameters.
BEYOND_SCALE = Constant(log(0.8), 0.7, PARAMETER_SCALE_BOUNDS)
WORLD_NOISE = Constant(log(0.0025), 1.0, NOISE_BOUNDS)


@dataclass(frozen=True)
class Term:
    """A variance times a shape over some columns.

    Attributes:
        columns: those of X that count, next to each other.
        variance: v, s^2, t^2, a^2 or c^2 of the module's table.
        scales: length scales of a squared exponential, one a column or one for all; ()
            where the term is linear.
    """

    columns: range
    variance: Constant
    scales: tuple[Constant, ...] = ()


@dataclass(frozen=True)
class Covariance:
    """A kernel for rows of some layout: the sum of its terms, and independent noise.

    Attributes:
        terms: one or more.
        noise: variance of the noise.
        standardised: whether costs have a mean of 0 and a variance of 1; if not, they
            are in units of a table.
    """

    terms: tuple[Term, ...]
    noise: Constant
    standardised: bool = True

    @cached_property
    def constants(self) -> tuple[Constant, ...]:
        """The constants as theta has them, t: variance and scales of each term, then the noise."""
        found: list[Constant] = []
        for term in self.terms:
            found += [term.variance, *term.scales]
        return (*found, self.noise)

    @cached_property
    def start(self) -> Floats:
        """Theta before any trial, [t]: the likeliest values within the bounds."""
        likeliest = [exp(constant.mode) for constant in self.constants]
        low, high = zip(*(constant.bounds for constant in self.constants), strict=True)
        return np.asarray(np.log(np.clip(likeliest, low, high)))

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest theta, [t, 2]."""
        return np.log([constant.bounds for constant in self.constants])

    @cached_property
    def modes(self) -> Floats:
        """Where the priors are largest, [t]."""
        return np.array([constant.mode for constant in self.constants])

    @cached_property
    def spreads(self) -> Floats:
        """Standard deviations of the priors, [t]."""
        return np.array([constant.sd for constant in self.constants])

    def valued(self, theta: Floats) -> Iterator[tuple[Term, float, Floats]]:
        """Each term with the values of its variance and of its length scales."""
        place = 0
        for term in self.terms:
            values = np.exp(theta[place : place + 1 + len(term.scales)])
            yield term, float(values[0]), values[1:]
            place += len(values)

    def gram(self, theta: Floats, x: Floats) -> tuple[Floats, Pull]:
        """K without noise of rows [n, p], and the derivative of a number by theta, from its W.

        No derivative of K is formed: sum_ij W_ij dK_ij/dtheta is taken term by term
        (reverse accumulation; Griewank, Walther 2008, chapter 3). W may be of any form,
        as triangular.
        """
        k: Any = 0.0
        parts: list[tuple[float, Floats, Pull]] = []
        for term, variance, scales in self.valued(theta):
            shape, pull = shape_of(seen_by(term, x), scales)
            parts.append((variance, shape, pull))
            k = k + variance * shape

        def pull_all(weights: Floats) -> Floats:
            slopes: list[Floats] = []
            for variance, shape, pull in parts:
                slopes.append(np.array([variance * (weights * shape).sum()]))
                slopes.append(pull(weights * variance))
            return np.concatenate(slopes)

        return k, pull_all

    def towards(
        self, theta: Floats, a: Floats, precision: type[np.floating[Any]]
    ) -> Towards:
        """The covariance, without noise, of rows a [n, p] and others; in 32 or 64 bits.

        Distances are taken in 64 bits always; what is of size [n, m] after that may be
        in 32.
        """
        weights = np.zeros(a.shape[1])  # of linear terms, which are one product
        curved = []
        for term, variance, scales in self.valued(theta):
            if len(scales):
                left = _left(_scaled(seen_by(term, a), scales)).T
                curved.append((term, variance, scales, left))
            else:
                weights[term.columns.start : term.columns.stop] += variance
        used = np.flatnonzero(weights)
        straight = slice(used[0], used[-1] + 1) if len(used) else slice(0)
        slopes = a[:, straight] * weights[straight]

        def cross(x: Floats) -> AnyFloats:
            total = (slopes @ x[:, straight].T).astype(precision, copy=False)
            for term, variance, scales, left in curved:
                half = left @ _right(_scaled(seen_by(term, x), scales))
                k = half.astype(precision, copy=False)
                np.exp(k, out=k)
                k *= variance
                total += k
            return total

        return cross

    def variance(self, theta: Floats, x: Floats) -> Any:
        """k(x, x) of rows [m, p], [m], or a number where it is the same for all."""
        total: Any = 0.0
        for term, variance, scales in self.valued(theta):
            seen = seen_by(term, x)
            shape = 1.0 if len(scales) else np.einsum("mp,mp->m", seen, seen)
            total = total + variance * shape
        return total


def new_covariance(
    kernel: Kernel, columns: Columns, parameters: int, *, standardised: bool = True
) -> Covariance:
    """The covariance of rows with these columns.

    Args:
        kernel: which terms there are.
        columns: of the rows.
        parameters: d, their number; its prior length scales grow with it.
        standardised: see `Covariance`.
    """
    if kernel.related and not kernel.of_parameters:
        return Covariance((Term(columns.worlds, SIGNAL),), FEATURE_NOISE)
    terms = []
    if kernel.related:
        terms = [Term(columns.worlds, WORLD), Term(columns.mean, SLOPE)]
        if not standardised:
            terms.append(Term(columns.one, SHIFT))
    own = columns.features
    if kernel.slopes and own:
        terms.append(Term(own, SLOPE))
    if kernel.feature_scales is not None and own:
        scale = Constant(log(sqrt(len(own))), 1.0, FEATURE_SCALE_BOUNDS)
        count = len(own) if kernel.feature_scales == "each" else 1
        terms.append(Term(own, SIGNAL, (scale,) * count))
    if kernel.related:
        terms.append(Term(columns.coordinates, BEYOND, (BEYOND_SCALE,)))
        return Covariance(tuple(terms), WORLD_NOISE, standardised)
    if kernel.parameter_scales is not None:
        mode = sqrt(2.0) + log(parameters) / 2.0 - 3.0
        scale = Constant(mode, sqrt(3.0), PARAMETER_SCALE_BOUNDS)
        count = len(columns.coordinates) if kernel.parameter_scales == "each" else 1
        terms.append(Term(columns.coordinates, SIGNAL, (scale,) * count))
    noise = FEATURE_NOISE if kernel.of_features else PARAMETER_NOISE
    return Covariance(tuple(terms), noise)


def seen_by(term: Term, x: Floats) -> Floats:
    """The columns of rows [n, p] that a term looks at, a view of them."""
    return x[:, term.columns.start : term.columns.stop]


def shape_of(x: Floats, scales: Floats) -> tuple[Floats, Pull]:
    """The shape of a term for all pairs of rows [n, q], and its pull by the log length scales.

    Without scales x . x'; else exp(-r^2 / 2), r the distance in length scales, whose
    derivative by log l_j is itself times (x_j - x'_j)^2 / l_j^2.
    """
    if not len(scales):
        return x @ x.T, lambda weights: np.empty(0)
    scaled = _scaled(x, scales)
    half = _left(scaled).T @ _right(scaled)
    # Never so small that products of it are denormal numbers, which are slow.
    np.maximum(half, NEGLIGIBLE, out=half)
    value = np.exp(half, out=half)

    def pull(weights: Floats) -> Floats:
        # sum_ij w_ij (s_i - s_j)^2 = sum_i s_i^2 (row + column) - 2 sum_ij s_i w_ij s_j
        weights = weights * value
        ends = weights.sum(axis=0) + weights.sum(axis=1)
        each = scaled**2 @ ends - 2.0 * np.einsum("kn,kn->k", scaled @ weights, scaled)
        return each if len(scales) == len(each) else np.array([each.sum()])

    return value, pull


def _scaled(x: Floats, scales: Floats) -> Floats:
    """Rows [n, q] in length scales, as columns: [q, n]."""
    return np.asarray(x.T / scales[:, None])


def _left(scaled: Floats) -> Floats:
    """a, -|a|^2/2 and -1/2 on top of each other, [q + 2, n].

    `_left`^T `_right` is -r^2/2 = a . b - |a|^2/2 - |b|^2/2, by one product of
    matrices; it is wrong by 1e-16 of |a|^2 + |b|^2.
    """
    extended = _right(scaled)
    extended[-2:] = -0.5 * extended[:-3:-1]
    return extended


def _right(scaled: Floats) -> Floats:
    """b, 1 and |b|^2 on top of each other, [q + 2, m]."""
    count, m = scaled.shape
    extended = np.empty((count + 2, m))
    extended[:count] = scaled
    extended[count] = 1.0
    np.einsum("km,km->m", scaled, scaled, out=extended[-1])
    return extended


def misfit(
    covariance: Covariance, x: Floats, y: Floats, theta: Floats
) -> tuple[float, Floats]:
    """-log p(y | X, theta) - sum_i log N(theta_i; mode_i, sd_i^2), and its gradient [t].

    The constant of the normal densities is left out. Infinite, with gradient zero,
    where rounding leaves K without a Cholesky factor.
    """
    noise = float(np.exp(theta[-1]))
    k, pull = covariance.gram(theta, x)
    factor, failed = cholesky(k, noise)
    if failed:
        return np.inf, np.zeros_like(theta)
    alpha = scipy.linalg.lapack.dpotrs(factor, y, lower=1)[0]
    log_root = np.log(factor.diagonal()).sum()  # of det K
    value = 0.5 * y @ alpha + (log_root + 0.5 * len(y) * np.log(2 * np.pi))
    # The lower halves of K^-1 and of K^-1 - a a^T. K is symmetric: one half, of which
    # the diagonal counts once and the rest twice, stands for both.
    inverse = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
    syrk = scipy.linalg.blas.dsyrk
    w = syrk(-1.0, alpha[:, None], beta=1.0, c=inverse, lower=1, overwrite_c=1).T
    np.einsum("ii->i", w)[:] *= 0.5
    gradient = np.append(pull(w), noise * np.trace(w))
    z = (theta - covariance.modes) / covariance.spreads
    return float(value + 0.5 * z @ z), gradient + z / covariance.spreads


def cholesky(k: Floats, noise: float) -> tuple[Floats, bool]:
    """L [n, n] with L L^T = k + noise I, zero above its diagonal, and whether there is none."""
    matrix = np.array(k.T, order="F")  # as it lies in memory: it is symmetric
    np.einsum("ii->i", matrix)[:] += noise + JITTER
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=1, overwrite_a=1)
    return factor, info != 0


def learn(covariance: Covariance, x: Floats, y: Floats) -> Floats:
    """Theta [t] from trials x [n, p] with costs y [n], by L-BFGS."""
    some = _informative(y)
    scaled = _standard(y)[0] if covariance.standardised else y
    x, y = x[some], scaled[some]
    starts = NOISE_STARTS if len(scaled) <= SECOND_START_TRIALS else NOISE_STARTS[:1]
    found = []
    for shift in starts:
        start = covariance.start.copy()
        start[-1] += shift
        result = scipy.optimize.minimize(
            lambda theta: misfit(covariance, x, y, theta),
            np.clip(start, *covariance.bounds.T),
            jac=True,
            method="L-BFGS-B",
            bounds=covariance.bounds,
            options={"maxiter": ITERATIONS, "ftol": 1e-5},
        )
        found.append(result)
    return np.asarray(min(found, key=lambda result: float(result.fun)).x)


def condition(
    covariance: Covariance, theta: Floats, x: Floats, y: Floats, *, noisy: bool
) -> "Posterior":
    """The posterior under given constants, after trials x [n, p] with costs y [n]."""
    scaled, mean, sd = _standard(y) if covariance.standardised else (y, 0.0, 1.0)
    return Posterior(
        covariance=covariance,
        theta=theta,
        x=x,
        y=scaled,
        cost_mean=mean,
        cost_sd=sd,
        noisy=noisy,
    )


def _standard(y: Floats) -> tuple[Floats, float, float]:
    """Costs in standard units, their mean and their standard deviation (one if they are equal)."""
    mean = float(y.mean())
    sd = float(np.sqrt(np.mean((y - mean) ** 2)))
    sd = sd if sd > 1e-12 * abs(mean) and sd > 0 else 1.0
    return (y - mean) / sd, mean, sd


def _informative(y: Floats) -> Whole:
    """Trials that the constants are learned from: the best half of the limit, the rest evenly."""
    if len(y) <= LIKELIHOOD_TRIALS:
        return np.arange(len(y))
    order = np.argsort(y, kind="stable")
    best, others = np.split(order, [LIKELIHOOD_TRIALS // 2])
    spread = np.linspace(0, len(others) - 1, LIKELIHOOD_TRIALS - len(best))
    return np.sort(np.concatenate([best, others[spread.astype(np.int64)]]))


@dataclass(frozen=True, eq=False)
class Posterior:
    """The distribution of the cost, in its own unit, after some trials.

    Where 32 bits are enough, the mean is (L^-1 k)^T (L^-1 y), whose factors are of the
    size of the costs; those of k^T K^-1 y would cancel.

    Attributes:
        covariance: of the trials.
        theta: the constants that were learned, [t].
        x: X, the trials, [n, p].
        y: their costs in standard units, [n].
        cost_mean: what `y` was centred by, in the unit of the cost.
        cost_sd: what `y` was divided by, in the same unit, positive.
        noisy: whether the variance is that of the next trial, noise included; if not,
            of its expectation.
    """

    covariance: Covariance
    theta: Floats
    x: Floats
    y: Floats
    cost_mean: float
    cost_sd: float
    noisy: bool

    @property
    def noise(self) -> float:
        """Variance of the noise, in standard units."""
        return float(np.exp(self.theta[-1]))

    @property
    def shortest_scale(self) -> float:
        """The smallest length scale, in standard units; infinite without any."""
        values = self.covariance.valued(self.theta)
        return float(min(scales.min(initial=np.inf) for _, _, scales in values))

    def gram(self) -> Floats:
        """K without noise, [n, n]."""
        return self.covariance.gram(self.theta, self.x)[0]

    @cached_property
    def precision(self) -> type[np.floating[Any]]:
        """The precision of all that is [n, m]: 32 bits where rounding, which grows with the ratio
        of prior variance to noise, is small.
        """
        prior = np.max(self.covariance.variance(self.theta, self.x))
        return np.float32 if prior <= LARGEST_RATIO * self.noise else np.float64

    def predict(self, points: Points) -> tuple[Floats, Floats]:
        """Mean and variance of the cost at m candidates, [m] each."""
        mean, variance = np.empty(len(points)), np.empty(len(points))
        weights = (self._inverse @ self.y).astype(self.precision)
        ones = np.ones_like(weights)
        for start in range(0, len(points), BLOCK):
            block = slice(start, start + BLOCK)
            x = points.part(block)
            whitened = self._whitened(x)
            mean[block] = weights @ whitened
            variance[block] = self.covariance.variance(self.theta, x)
            variance[block] -= ones @ np.square(whitened, out=whitened)
        np.maximum(variance, 0.0, out=variance)
        variance += self.noise if self.noisy else 0.0
        return self.cost_mean + self.cost_sd * mean, self.cost_sd**2 * variance

    def mean(self, points: Points) -> Floats:
        """The mean alone, of few candidates, [m]."""
        alpha = self._inverse.T @ (self._inverse @ self.y)
        return self.cost_mean + self.cost_sd * (self._cross(points.matrix).T @ alpha)

    def believing(self, points: Points) -> "Posterior":
        """The posterior after further trials with their expected costs; constants are kept."""
        y = (self.mean(points) - self.cost_mean) / self.cost_sd
        x = np.vstack([self.x, points.matrix])
        return replace(self, x=x, y=np.concatenate([self.y, y]))

    @cached_property
    def _cross(self) -> Towards:
        """Covariance of the trials and candidates [m, p]: [n, m]."""
        return self.covariance.towards(self.theta, self.x, self.precision)

    @cached_property
    def _inverse(self) -> Floats:
        """L^-1, [n, n]."""
        factor, failed = cholesky(self.gram(), self.noise)
        if failed:
            raise np.linalg.LinAlgError(
                "the covariance of the trials has no Cholesky factor"
            )
        return np.asarray(scipy.linalg.lapack.dtrtri(factor, lower=1, overwrite_c=1)[0])

    @cached_property
    def _whitener(self) -> AnyFloats:
        return np.asfortranarray(self._inverse.astype(self.precision))

    def _whitened(self, x: Floats) -> AnyFloats:
        """L^-1 k of candidates [b, p], [n, b]: by a triangle, in half the steps of a square."""
        times = scipy.linalg.get_blas_funcs("trmm", [self._whitener])
        # BLAS counts along columns: to it, k is its transpose, and is multiplied from
        # the right.
        options = {"side": 1, "lower": 1, "trans_a": 1, "overwrite_b": 1}
        return np.asarray(times(1.0, self._whitener, self._cross(x).T, **options).T)

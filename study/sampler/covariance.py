"""The kernels of the sampler: their terms, and what is expected of their constants.

| symbol | shape | meaning |
|---|---|---|
| phi | [n, k] | features, in standard units |
| u | [n, e] | parameters as coordinates in the unit cube; d parameters have e >= d coordinates |
| X = (phi, u) | [n, p] | trials, a row each |
| theta | [t] | logarithms of the constants of a kernel, the noise variance last |
| K | [n, n] | covariance of the trials |
| W | [n, n] | derivative of a number by each entry of K |

A kernel is a sum of terms, each a variance times a shape:

| term | formula | kernels |
|---|---|---|
| slopes | v phi . phi' | additive, worlds |
| likeness | s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2) | these; rbf: l shared |
| nearness | t^2 exp(-sum_j (u_j - u'_j)^2 / 2 L_j^2) | additive: L shared; worlds: L_j each |
| roughness | t^2 (1 + q + q^2 / 3) exp(-q), q^2 = 5 sum_j (u_j - u'_j)^2 / L_j^2 | euclidean |
| worlds | a^2 d . d', d being what each world adds to the mean over the worlds | worlds |
| mean | v m m', m being the mean over the worlds | worlds |
| guess | e^2 g g' times the shape of roughness, L shared, g being the gap to the rows | worlds |
| shift | c^2 for all rows, where outcomes are in the unit of the costs | worlds |
| similarity | s^2 K, of a pool (`study.sampler.similarity`) | similarity |

With slopes w ~ N(0, v I), the first term is the covariance of w . phi (Rasmussen,
Williams 2006, section 2.7). Roughness is Matern's covariance of order 5/2 (equation
4.17 there): costs that bend more sharply than a squared exponential lets expect.

The priors are normal in the logarithm of each constant. Where parameters are all that is
known (euclidean), their length scales are expected around half of a range. In additive
kernels they follow Hvarfner, Hellsten, Nardi 2024 ("Vanilla Bayesian optimization
performs great in high dimensions"): log-normal with mu = sqrt 2 + (log d) / 2, sigma =
sqrt 3, so that the assumed complexity does not grow with d. A log-normal density of L
is, as a function of log L and up to a factor, a normal density around mu - sigma^2; so is
BoTorch's log-normal(-4, 1) of the noise around -5.

Beside worlds, what no world explains (nearness) has a length scale for each parameter,
and the trials are few. So these scales share most of their prior:

    log L_j = mode + common + own_j,   common ~ N(0, 0.7^2),   own_j ~ N(0, 0.35^2),

that is, they are learned as one scale, from which single parameters depart where trials
ask for it.

Points between the rows of a table have what rows near them cost in worlds. If these tell
nothing of such points (`between.error_of_guess`), that counts as a cost of their own, which
is 0 at a row, and which two points share that are near to each other.

Parameter sets with equal features differ in cost, and no repetition would show it. Over
features, noise is that spread, so it is expected to be large.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.sampler.arrays import Floats
from study.sampler.transforms import Columns

AnyFloats = NDArray[Any]
Pull = Callable[[Floats], Floats]  # W [n, n] -> sum_ij W_ij dK_ij/dtheta, [t]
Towards = Callable[[Floats], AnyFloats]  # candidates [m, p] -> k [n, m]

# Bounds of the constants; they keep 32-bit arithmetic right.
SIGNAL_BOUNDS = (1e-2, 1e2)
SLOPE_BOUNDS = (1e-4, 1e2)
FEATURE_SCALE_BOUNDS = (5e-2, 5e1)
PARAMETER_SCALE_BOUNDS = (5e-2, 1e2)
NOISE_BOUNDS = (1e-4, 1e1)
ROUGH_NOISE_BOUNDS = (1e-6, 1e1)

NEGLIGIBLE = -80.0  # exp of it is 1e-35
NARROW = 8  # columns, which are cheaper to take along than to leave out


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
        rough: whether parameters have the covariance of Matern 5/2; else they have a
            squared exponential.
        related: whether what is known of rows beside features counts: their costs in
            simulated worlds, or their similarity.
    """

    slopes: bool
    feature_scales: str | None
    parameter_scales: str | None
    by_order: bool
    rough: bool = False
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
WITH_WORLDS = replace(ADDITIVE, parameter_scales="each", related=True)
SIMILARITY = replace(NEARNESS, parameter_scales=None, related=True)
RBF = Kernel(
    slopes=False, feature_scales="shared", parameter_scales=None, by_order=False
)
EUCLIDEAN = Kernel(
    slopes=False,
    feature_scales=None,
    parameter_scales="each",
    by_order=True,
    rough=True,
)
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
# Of euclidean: t^2 is SIGNAL, L in ranges of the parameters, noise in cost^2.
ROUGH_SCALE = Constant(log(0.5), 1.0, PARAMETER_SCALE_BOUNDS)
ROUGH_NOISE = Constant(-7.0, 2.0, ROUGH_NOISE_BOUNDS)
# Of costs in units of a table, of whose costs in all worlds the standard deviation is
# one.
WORLD = Constant(log(0.25), 1.4, SIGNAL_BOUNDS)  # a^2
# The same where costs are in units of the trials: on some grounds worlds tell walks
# apart, on others they tell who falls alone, and only trials know which. Of smooth costs
# too (71:47 on 120 plants unlike all worlds after 30 trials, 33:27 on 60 like them). And of
# a machine that is like no world, until it has succeeded: rows that a world promised fell
# one by one.
DOUBTED = Constant(log(0.02), 2.0, (1e-5, 1e2))
SHIFT = Constant(0.0, 0.1, SIGNAL_BOUNDS)  # c^2
BEYOND = Constant(log(0.3), 1.4, SIGNAL_BOUNDS)  # t^2
# L_j, in ranges of the parameters: what is a parameter's own, and what all share.
BEYOND_SCALE = Constant(log(0.8), 0.35, PARAMETER_SCALE_BOUNDS)
BEYOND_SHARED_SD = 0.7
# v of the mean over w worlds is expected to be 1 / w, and no less than this. It is what a
# robot's ranking may differ from theirs: of many worlds one or two falls shall not turn
# it round.
LEAST_RANKING = 0.03
RANKING_SD = 0.5
# Of fewer worlds it tells less of the robot, but is not left before trials say that it is
# wrong: with 1 / w, one world on another machine lost to its own ranking.
FEW_WORLDS = 10
RANKING_OF_FEW = Constant(log(0.1), 1.0, SLOPE_BOUNDS)
WORLD_NOISE = Constant(log(0.0025), 1.0, NOISE_BOUNDS)
# The same of trials that have all fallen: when a walker falls is chance. With less, three
# falls of the best rows on MuJoCo's ground sent the model to rows on which worlds disagree.
# Where it is none, as with a success that asks too much, trials lower it.
FALL_NOISE = Constant(log(0.25), 2.0, NOISE_BOUNDS)
# And where one has succeeded: that is no luck. With more, a success among falls was taken
# for noise, and its surroundings were left for good.
SUCCESS_NOISE = replace(WORLD_NOISE, bounds=(NOISE_BOUNDS[0], 0.1))
GUESS_SD = 0.5  # of the logarithms of e^2 and of its L: the table tells both


@dataclass(frozen=True)
class GuessError:
    """What the rows' guess of a point between them may be off by.

    Attributes:
        variance: e^2, in table units squared.
        length: L, in ranges of the parameters.
    """

    variance: float
    length: float


@dataclass(frozen=True)
class Term:
    """A variance times a shape over some columns.

    Attributes:
        columns: those of X that count, next to each other.
        variance: v, s^2, t^2, a^2 or c^2 of the module's table.
        scales: length scales, one a column or one for all; () where the term is linear.
        shared_sd: standard deviation of a factor that the logarithms of all its length
            scales share; 0: they are independent.
        rough: whether its shape is that of Matern 5/2; else it is a squared
            exponential.
        gapped: whether its shape is multiplied by the first of the columns of both
            rows, and is one of the others.
    """

    columns: range
    variance: Constant
    scales: tuple[Constant, ...] = ()
    shared_sd: float = 0.0
    rough: bool = False
    gapped: bool = False


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
    def prior(self) -> Floats:
        """Covariance of theta before any trial, [t, t]."""
        prior = np.diag([constant.sd**2 for constant in self.constants])
        place = 0
        for term in self.terms:
            scales = slice(place + 1, place + 1 + len(term.scales))
            prior[scales, scales] += term.shared_sd**2
            place = scales.stop
        return prior

    @cached_property
    def prior_precision(self) -> Floats:
        """The inverse of `prior`, [t, t]."""
        return np.asarray(np.linalg.inv(self.prior), dtype=np.float64)

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
            gap, seen = _gap_of(term, x)
            shape, pull = shape_of(seen, scales, rough=term.rough, gap=gap)
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
                own_gap, seen = _gap_of(term, a)
                left = _left(_scaled(seen, scales)).T
                curved.append((term, variance, scales, left, own_gap))
            else:
                weights[term.columns.start : term.columns.stop] += variance
        straight = [(part, a[:, part] * weights[part]) for part in _runs(weights)]

        def cross(x: Floats) -> AnyFloats:
            total = np.zeros((len(a), len(x)), precision)
            for part, slopes in straight:
                total += (slopes @ x[:, part].T).astype(precision, copy=False)
            for term, variance, scales, left, own_gap in curved:
                gap, seen = _gap_of(term, x)
                half = left @ _right(_scaled(seen, scales))
                k = half.astype(precision, copy=False)
                k = fall(k, rough=term.rough)
                k *= variance
                if own_gap is not None and gap is not None:
                    k *= np.outer(own_gap, gap).astype(precision, copy=False)
                total += k
            return total

        return cross

    def variance(self, theta: Floats, x: Floats) -> Any:
        """k(x, x) of rows [m, p], [m], or a number where it is the same for all."""
        total: Any = 0.0
        for term, variance, scales in self.valued(theta):
            gap, seen = _gap_of(term, x)
            shape: Any = 1.0
            if gap is not None:
                shape = gap**2
            elif not len(scales):
                shape = np.einsum("mp,mp->m", seen, seen)
            total = total + variance * shape
        return total


def new_covariance(
    kernel: Kernel,
    columns: Columns,
    parameters: int,
    *,
    standardised: bool = True,
    is_familiar: bool = False,
    likeness: Constant = WORLD,
    noise: Constant = WORLD_NOISE,
    guess_error: GuessError | None = None,
) -> Covariance:
    """The covariance of rows with these columns.

    Args:
        kernel: which terms there are.
        columns: of the rows.
        parameters: d, their number; its prior length scales grow with it.
        standardised: see `Covariance`.
        is_familiar: whether trials tell how far costs lie apart, so that no single one
            can turn the worlds' ranking round: it is then free to fit them.
        likeness: a^2, how much the machine may be like some worlds and unlike others.
        noise: of costs beside worlds; other kernels have their own.
        guess_error: of points between rows; None: they count as if they were rows.
    """
    if kernel.related and not kernel.of_parameters:
        return Covariance((Term(columns.worlds, SIGNAL),), FEATURE_NOISE)
    terms = []
    if kernel.related:
        worlds = len(columns.worlds)
        slope = RANKING_OF_FEW
        if is_familiar or worlds >= FEW_WORLDS:
            expected = 1.0 if is_familiar else max(1.0 / worlds, LEAST_RANKING)
            slope = Constant(log(expected), RANKING_SD, SLOPE_BOUNDS)
        terms = [Term(columns.worlds, likeness), Term(columns.mean, slope)]
        if not standardised:
            terms.append(Term(columns.one, SHIFT))
    own = columns.features
    if kernel.slopes and own:
        terms.append(Term(own, SLOPE))
    if kernel.feature_scales is not None and own:
        scale = Constant(log(sqrt(len(own))), 1.0, FEATURE_SCALE_BOUNDS)
        count = len(own) if kernel.feature_scales == "each" else 1
        terms.append(Term(own, SIGNAL, (scale,) * count))
    nearby, d = columns.coordinates, parameters
    if kernel.related:
        scales = (BEYOND_SCALE,) * len(nearby)
        terms.append(Term(nearby, BEYOND, scales, shared_sd=BEYOND_SHARED_SD))
        if guess_error is not None:
            variance = Constant(log(guess_error.variance), GUESS_SD, SIGNAL_BOUNDS)
            scale = Constant(log(guess_error.length), GUESS_SD, PARAMETER_SCALE_BOUNDS)
            seen = range(columns.gap.start, nearby.stop)
            terms.append(Term(seen, variance, (scale,), rough=True, gapped=True))
        return Covariance(tuple(terms), noise, standardised)
    if kernel.rough:
        scales = (ROUGH_SCALE,) * len(nearby)
        return Covariance((Term(nearby, SIGNAL, scales, rough=True),), ROUGH_NOISE)
    if kernel.of_parameters:
        mode = sqrt(2.0) + log(d) / 2.0 - 3.0
        scale = Constant(mode, sqrt(3.0), PARAMETER_SCALE_BOUNDS)
        terms.append(Term(nearby, SIGNAL, (scale,)))
    own_noise = FEATURE_NOISE if kernel.of_features else PARAMETER_NOISE
    return Covariance(tuple(terms), own_noise)


def _runs(weights: Floats) -> Iterator[slice]:
    """Columns [p] that have a weight, in as few slices as leave out no wide gap."""
    used = np.flatnonzero(weights)
    for run in np.split(used, np.flatnonzero(np.diff(used) > NARROW) + 1):
        if len(run):
            yield slice(int(run[0]), int(run[-1]) + 1)


def seen_by(term: Term, x: Floats) -> Floats:
    """The columns of rows [n, p] that a term looks at, a view of them."""
    return x[:, term.columns.start : term.columns.stop]


def _gap_of(term: Term, x: Floats) -> tuple[Floats | None, Floats]:
    """The gap of rows [n, p], [n], if the term has one; the columns of its shape, [n, q]."""
    seen = seen_by(term, x)
    return (seen[:, 0], seen[:, 1:]) if term.gapped else (None, seen)


def shape_of(
    x: Floats, scales: Floats, *, rough: bool, gap: Floats | None = None
) -> tuple[Floats, Pull]:
    """The shape of a term for all pairs of rows [n, q], and its pull by the log length scales.

    Without scales x . x'; else a function of r, the distance in length scales, whose
    derivative by log l_j is its steepness times (x_j - x'_j)^2 / l_j^2. With a gap [n]
    all of it is multiplied by those of both rows.
    """
    if not len(scales):
        return x @ x.T, lambda weights: np.empty(0)
    scaled = _scaled(x, scales)
    half = _left(scaled).T @ _right(scaled)
    steep = _matern_steepness(half) if rough else None
    value = np.asarray(fall(half, rough=rough), dtype=np.float64)
    if gap is not None:
        both = np.outer(gap, gap)
        value *= both
        steep = None if steep is None else steep * both

    def pull(weights: Floats) -> Floats:
        # sum_ij w_ij (s_i - s_j)^2 = sum_i s_i^2 (row + column) - 2 sum_ij s_i w_ij s_j
        weights = weights * (value if steep is None else steep)
        ends = weights.sum(axis=0) + weights.sum(axis=1)
        each = scaled**2 @ ends - 2.0 * np.einsum("kn,kn->k", scaled @ weights, scaled)
        return each if len(scales) == len(each) else np.array([each.sum()])

    return value, pull


def fall(half: AnyFloats, *, rough: bool) -> AnyFloats:
    """The shape by -r^2 / 2, r being the distance in length scales; in place."""
    if not rough:
        # Never so small that products of it are denormal numbers, which are slow.
        np.maximum(half, NEGLIGIBLE, out=half)
        return np.asarray(np.exp(half, out=half))
    q = _matern_distance(half)
    np.exp(-q, out=half)
    half *= 1.0 + q * (1.0 + q / 3.0)
    return half


def _matern_steepness(half: Floats) -> Floats:
    """-2 times the derivative of Matern's shape by r^2, by -r^2 / 2.

    A squared exponential is its own.
    """
    q = _matern_distance(half)
    return np.asarray(5.0 / 3.0 * (1.0 + q) * np.exp(-q))


def _matern_distance(half: AnyFloats) -> AnyFloats:
    """q = sqrt 5 r, by -r^2 / 2, which rounding may leave above 0."""
    q = half * -10.0
    np.clip(q, 0.0, NEGLIGIBLE**2, out=q)
    return np.asarray(np.sqrt(q, out=q))


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

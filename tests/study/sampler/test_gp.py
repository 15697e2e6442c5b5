"""The Gaussian process against scikit-learn's: kernels, likelihood, constants and posterior."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from study.sampler import covariance as kinds
from study.sampler import gp
from study.sampler.acquisition import along_feature
from study.sampler.transforms import Points, new_columns
from tests.study.sampler import reference

LAYOUT = (3, 4, 4)  # features, coordinates, parameters
GAPPED = "worlds, with gaps"  # its three features are a one, a mean and a gap
KINDS = (*reference.FORMS, GAPPED)
EXACT = 1e-8
FAST = 1e-4  # of the prior's scale
X = np.random.default_rng(0).standard_normal((12, 7))


def covariance_of(form, layout=LAYOUT):
    features, coordinates, parameters = layout
    if form == GAPPED:
        columns = new_columns(0, coordinates, worlds=0)
        error = kinds.GuessError(1.5, 0.3)
        return kinds.new_covariance(
            kinds.WITH_WORLDS, columns, parameters, guess_error=error
        )
    columns = new_columns(features, coordinates)
    return kinds.new_covariance(reference.FORMS[form], columns, parameters)


def some_points(count, seed):
    rng = np.random.default_rng(seed)
    return Points.of(rng.standard_normal((count, 3)), rng.uniform(size=(count, 4)))


def costs(points, seed=0):
    noise = np.random.default_rng(seed).standard_normal(len(points))
    smooth = np.sin(points.features[:, 0]) + (points.coordinates - 0.4).sum(axis=1) ** 2
    return 50.0 + 20.0 * smooth + noise


def trials(count, seed):
    """Rows [n, 7] and costs [n], in standard units."""
    points = some_points(max(count, 2), seed)
    y = costs(points, seed)
    return points.matrix[:count], ((y - y.mean()) / y.std())[:count] * (count > 1)


# Kernels.
@pytest.mark.parametrize("form", KINDS)
def test_kernels_are_scikit_learns(form):
    ours = covariance_of(form)
    theta = ours.start + np.linspace(-1.0, 1.0, len(ours.start))
    theirs = reference.of_covariance(ours, theta)
    assert_allclose(theta, theirs.theta)
    assert_allclose(ours.bounds, theirs.bounds)
    noise = np.exp(theta[-1])
    assert_allclose(ours.gram(theta, X)[0] + noise * np.eye(12), theirs(X), atol=1e-12)
    assert_allclose(
        ours.towards(theta, X, np.float64)(X[:5]), theirs(X, X[:5]), atol=1e-12
    )
    assert_allclose(ours.variance(theta, X) + noise * np.ones(12), theirs.diag(X))
    half = ours.towards(theta, X, np.float32)(X[:5])
    assert half.dtype == np.float32
    assert_allclose(half, theirs(X, X[:5]), atol=1e-5)


SEEN = {"rbf": (1, 0), "euclidean": (0, 1), "nearness": (0, 1), "additive": (1, 1)}


@pytest.mark.parametrize("form", SEEN)
def test_kernels_see_their_columns(form):
    """The covariance of what is alike in features, and in parameters, alone."""
    built, origin, far = covariance_of(form), np.zeros((1, 7)), 1e3 * np.ones((1, 7))
    towards = built.towards(built.start, origin, np.float64)
    for alike, expected in zip((slice(3), slice(3, 7)), SEEN[form], strict=True):
        other = far.copy()
        other[:, alike] = 0.0
        assert_allclose(towards(other), expected, atol=1e-9)


def test_the_additive_one_is_its_formula():
    """v phi^T phi' + s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2) + t^2 exp(-|u - u'|^2 / 2L^2)."""
    v, s2, l1, l2, l3, t2, nearness = constants = np.array(
        [0.2, 1.3, 0.7, 2.0, 1.1, 0.4, 0.9]
    )
    theta = np.append(np.log(constants), 0.0)
    phi, u = X[:, :3], X[:, 3:]
    difference = (phi[:, None] - phi[None]) / [l1, l2, l3]
    away = ((u[:, None] - u[None]) ** 2).sum(axis=-1) / nearness**2
    likeness = s2 * np.exp(-0.5 * (difference**2).sum(axis=-1))
    expected = v * phi @ phi.T + likeness + t2 * np.exp(-0.5 * away)
    assert_allclose(covariance_of("additive").gram(theta, X)[0], expected, rtol=1e-10)


def test_length_scales_are_shared_or_one_a_feature_and_scaled_by_the_dimension():
    counts = {"rbf": 3, "euclidean": 6, "nearness": 3, "additive": 8}
    assert {form: len(covariance_of(form).start) for form in counts} == counts
    for d in (1, 16, 100):
        mu, sigma = np.sqrt(2) + np.log(d) / 2, np.sqrt(3)  # Hvarfner et al. 2024
        for form, place in (("nearness", 1), ("additive", 4)):
            prior = covariance_of(form, (1, d, d)).constants[place]
            assert_allclose(prior.mode, mu - sigma**2)
            assert_allclose(prior.sd, sigma)


def test_without_features_length_scales_are_around_half_of_a_range():
    for d in (1, 16):
        scales = covariance_of("euclidean", (0, d, d)).constants[1:-1]
        assert len(scales) == d
        assert {(scale.mode, scale.sd) for scale in scales} == {(np.log(0.5), 1.0)}


def with_worlds(worlds, coordinates):
    """The covariance beside worlds, and its columns."""
    columns = new_columns(worlds + 2, coordinates, worlds)
    return kinds.new_covariance(kinds.WITH_WORLDS, columns, coordinates), columns


def test_beside_worlds_length_scales_share_the_most_of_their_prior():
    covariance, _ = with_worlds(5, 3)
    draws = np.random.default_rng(0).multivariate_normal(
        covariance.modes, covariance.prior, size=200_000
    )
    scales = draws[:, -4:-1]
    own, shared = 0.35, 0.7
    assert_allclose(scales.mean(axis=0), np.log(0.8), atol=0.01)
    assert_allclose(scales.std(axis=0), np.hypot(own, shared), rtol=0.01)
    assert_allclose(np.corrcoef(scales.T)[0, 1], 0.8, atol=0.01)
    assert_allclose(np.corrcoef(draws.T)[0, -4], 0.0, atol=0.01)


def test_a_ranking_by_few_worlds_is_less_sure():
    """The slope of the mean over w worlds is expected to be 1 / w from theirs; of few, a tenth."""
    for worlds, expected in ((1, 0.1), (9, 0.1), (16, 1 / 16), (128, 0.03)):
        covariance, columns = with_worlds(worlds, 2)
        (slope,) = (t.variance for t in covariance.terms if t.columns == columns.mean)
        assert_allclose(np.exp(slope.mode), expected)


# Likelihood and constants.
@pytest.mark.parametrize("form", KINDS)
def test_the_misfit_and_its_gradient_are_scikit_learns(form):
    covariance = covariance_of(form)
    for seed, count in enumerate((1, 2, 9, 40, 120)):
        x, y = trials(count, seed)
        for draw in range(3):  # constants within their bounds, as the priors have them
            theta = np.random.default_rng(draw).multivariate_normal(
                covariance.modes, covariance.prior
            )
            theta = np.clip(theta, *covariance.bounds.T)
            expected, slopes = reference.misfit(covariance, x, y, theta)
            found, gradient = gp.misfit(covariance, x, y, theta)
            assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
            assert_allclose(
                gradient, slopes, rtol=1e-6, atol=1e-6 * np.abs(slopes).max()
            )


@pytest.mark.parametrize("count", [1, 2, 8, 30, 31, gp.LIKELIHOOD_TRIALS])
@pytest.mark.parametrize("form", KINDS)
def test_the_constants_are_those_that_scikit_learn_finds(form, count):
    covariance = covariance_of(form)
    x, y = trials(count, seed=count)
    assert_allclose(
        gp.learn(covariance, x, y), reference.learned(covariance, x, y), atol=1e-6
    )


def test_without_a_cholesky_factor_the_misfit_is_infinite():
    covariance = kinds.Covariance(
        (kinds.Term(range(1), kinds.SLOPE),), kinds.FEATURE_NOISE
    )
    x = np.array([[1.0], [1.0], [3.0]]) * 1e12
    theta = np.array([0.0, np.log(1e-4)])
    found, gradient = gp.misfit(covariance, x, np.ones(3), theta)
    assert found == np.inf
    assert_allclose(gradient, 0.0)


# The posterior.
def learned(covariance, x, y):
    return gp.condition(covariance, gp.learn(covariance, x, y), x, y, noisy=True)


def fitted(covariance, count):
    points = some_points(count, seed=1)
    return learned(covariance, points.matrix, costs(points))


@pytest.fixture
def exact(monkeypatch):
    """64 bits everywhere."""
    monkeypatch.setattr(gp, "LARGEST_RATIO", 0.0)


def oracle(posterior, candidates):
    """Mean and variance by scikit-learn, of the same kernel on the same trials."""
    known = posterior.covariance, posterior.theta, posterior.x, posterior.y
    mean, sd = reference.conditioned(*known).predict(candidates.matrix, return_std=True)
    mean, sd = posterior.cost_mean + posterior.cost_sd * mean, posterior.cost_sd * sd
    return mean, sd**2


@pytest.mark.parametrize(
    ("form", "count"),
    [
        *((form, 40) for form in KINDS),
        *(("euclidean", n) for n in (1, 2, 7, 1000)),
    ],
)
def test_the_posterior_is_scikit_learns(form, count, exact):
    candidates = some_points(2 * gp.BLOCK + 17, seed=2)
    posterior = fitted(covariance_of(form), count)
    expected = oracle(posterior, candidates)
    assert_allclose(posterior.predict(candidates), expected, rtol=EXACT)
    assert_allclose(posterior.mean(candidates), expected[0], rtol=EXACT)


def assert_near(
    posterior,
    candidates,
    found,
    tolerance,
):
    """Mean and variance are scikit-learn's, within a share of the prior's scale, noise included."""
    prior = (
        posterior.covariance.variance(posterior.theta, candidates.matrix)
        + posterior.noise
    )
    prior = posterior.cost_sd**2 * prior * np.ones(len(candidates))
    mean, variance = oracle(posterior, candidates)
    assert np.max(np.abs(found[0] - mean) / np.sqrt(prior)) < tolerance
    assert np.max(np.abs(found[1] - variance) / prior) < tolerance


@pytest.mark.parametrize("form", KINDS)
def test_in_32_bits_it_is_near_by_the_priors_scale_noise_included(form):
    candidates = some_points(2 * gp.BLOCK + 17, seed=2)
    posterior = fitted(covariance_of(form), 100)
    assert_near(posterior, candidates, posterior.predict(candidates), FAST)


@pytest.mark.parametrize(("fast", "tolerance"), [(False, EXACT), (True, FAST)])
@pytest.mark.parametrize("values", [30, 20_000])
def test_along_one_feature(monkeypatch, fast, tolerance, values):
    if not fast:
        monkeypatch.setattr(gp, "LARGEST_RATIO", 0.0)
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 4, (60, 1))
    y = 5.0 + 2.0 * np.sin(x[:, 0]) + 0.3 * rng.standard_normal(60)
    posterior = learned(covariance_of("rbf", (1, 0, 2)), x, y)
    feature = np.random.default_rng(1).choice(np.linspace(-3, 8, values), 20_000)[
        :, None
    ]
    candidates = Points.of(feature, np.empty((len(feature), 0)))

    def along(which):
        return along_feature(
            posterior, candidates, lambda points: posterior.predict(points)[which]
        )

    assert_near(posterior, candidates, (along(0), along(1)), tolerance)


def test_believing_adds_trials_and_keeps_constants():
    posterior = fitted(covariance_of("rbf"), 20)
    more = some_points(3, seed=5)
    believed = posterior.believing(more)
    candidates = some_points(200, seed=6)
    mean, variance = posterior.predict(candidates)
    assert_allclose(believed.theta, posterior.theta)
    assert_allclose(believed.predict(candidates)[0], mean, rtol=1e-6)
    assert np.all(believed.predict(candidates)[1] <= variance * (1 + 1e-9))
    assert believed.predict(more)[1].sum() < posterior.predict(more)[1].sum()


def test_the_unit_of_cost_does_not_matter_and_equal_costs_are_no_accident():
    points, candidates = some_points(20, seed=1), some_points(50, seed=2)
    x, y, covariance = points.matrix, costs(points), covariance_of("additive")
    ours, scaled = (
        learned(covariance, x, c).predict(candidates) for c in (y, 1e6 * y - 7e6)
    )
    assert_allclose(scaled[0], 1e6 * ours[0] - 7e6, rtol=1e-3)
    assert_allclose(scaled[1], 1e12 * ours[1], rtol=1e-2)
    two = some_points(2, seed=0)
    mean, variance = learned(covariance, two.matrix, np.full(2, 3.0)).predict(two)
    assert_allclose(mean, 3.0)
    assert np.isfinite(variance).all()

"""Which part of the costs of the candidates a model puts down to what.

A function of the candidates varies among m of them by (1/m) sum_a (f_a - mean f)^2. With the
learned constants, a model expects of its parts, in standard units of the cost,

| part | expected variation among the candidates |
|---|---|
| slope along column j | E[w_j^2 given the trials] var(phi_j) |
| likeness, nearness | s^2 (1 - mean_ab k(x_a, x_b)): little where length scales are long |
| noise | its variance |

The slopes have one variance v in common, which says nothing of one feature: so they count as the
trials leave them, w = m + v Phi^T K^-1 y with covariance v I - v^2 Phi^T K^-1 Phi, m being what the
user says of the feature (Rasmussen, Williams 2006, section 2.7). Where m = 0 and v is likeliest, v
is the mean of these E[w_j^2] (a fixed point of expectation maximisation: Dempster, Laird, Rubin
1977). Likeness is divided among the columns by var(phi_j) / l_j^2, their share of a squared
distance.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.sampler.composites import Product, Sum
from study.sampler.likelihood import JITTER
from study.sampler.model import Model
from study.sampler.parts import Constant, Linear, Part
from study.sampler.points import Points
from study.sampler.stationary import Stationary

Floats = NDArray[np.float64]

CANDIDATES = 512  # that are looked at, evenly among all


@dataclass(frozen=True)
class Weights:
    """Shares of the expected variation, which sum to 1.

    Attributes:
        features: of each of the k features.
        parameters: of their likeness; 0 where the kernel does not look at them.
        noise: of what nothing explains.
    """

    features: tuple[float, ...]
    parameters: float
    noise: float


def weights_of(model: Model, candidates: Points, owners: tuple[int, ...], count: int) -> Weights:
    """The shares that a model gives.

    Args:
        model: after at least one trial.
        candidates: the m rows that may be proposed, or points anywhere.
        owners: of each column of their features, the number of the feature.
        count: of features, k.
    """
    points = candidates.take(_evenly(len(candidates)))
    x = points.only(features=True, coordinates=model.kernel.of_parameters).matrix()
    posterior, columns = model.posterior, len(owners)
    each, parameters = np.zeros(columns), 0.0
    spread = x[:, :columns].var(axis=0)
    for factor, part in _terms(posterior.kernel):
        if isinstance(part, Linear):
            each += _slopes_squared(model, factor, columns) * spread
        elif isinstance(part, Stationary) and (part.columns.start or 0) < columns:
            relative = spread / np.broadcast_to(part.scales, columns) ** 2
            if relative.any():
                each += factor * _variation(part, x) * relative / relative.sum()
        else:
            parameters += factor * _variation(part, x)
    features = np.bincount(owners, each, minlength=count)
    total = float(features.sum()) + parameters + posterior.noise
    shares = tuple((features / total).tolist())
    return Weights(shares, parameters / total, posterior.noise / total)


def percents(shares: tuple[float, ...]) -> tuple[int, ...]:
    """Shares that sum to 1 as whole percents that sum to 100, the largest remainders rounded up."""
    exact = 100.0 * np.array(shares)
    rounded = np.floor(exact)
    missing = round(100 - float(rounded.sum()))
    up = np.argsort(rounded - exact, kind="stable")[:missing]
    rounded[up] += 1.0
    return tuple(rounded.astype(int).tolist())


def _evenly(count: int) -> NDArray[np.int64]:
    """Numbers of the candidates that are looked at."""
    return np.unique(np.linspace(0, count - 1, min(count, CANDIDATES)).astype(np.int64))


def _terms(part: Part) -> Iterator[tuple[float, Part]]:
    """The parts that a kernel adds up, and the variance that each is multiplied by."""
    if isinstance(part, Sum):
        yield from _terms(part.first)
        yield from _terms(part.second)
    elif isinstance(part, Product) and isinstance(part.first, Constant):
        yield part.first.value, part.second
    else:
        yield 1.0, part


def _variation(part: Part, x: Floats) -> float:
    """1 - mean_ab k(x_a, x_b) of a kernel that is one at distance zero."""
    k, _ = part.gram(x)
    return max(1.0 - float(np.mean(k)), 0.0)


def _slopes_squared(model: Model, v: float, columns: int) -> Floats:
    """E[w_j^2] of the first columns after the trials, in standard units of the cost, [columns]."""
    posterior = model.posterior
    k, _ = posterior.kernel.gram(posterior.x)
    phi = posterior.x[:, :columns]
    noisy = k + (posterior.noise + JITTER) * np.eye(len(k))
    solved = np.linalg.solve(noisy, np.column_stack([posterior.y, phi]))
    ends = Points(np.eye(columns), np.empty((columns, 0)))
    told = model.guessed(ends, model.cost()) / posterior.cost_sd
    mean = told + v * (phi.T @ solved[:, 0])
    variance = v - v**2 * np.einsum("nj,nj->j", phi, solved[:, 1:])
    return np.asarray(mean**2 + np.maximum(variance, 0.0))

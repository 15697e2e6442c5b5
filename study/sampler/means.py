"""The mean of the process. A constant one is the mean of the costs and needs nothing more.

A linear one, m(x) = w^T phi(x) with w ~ N(0, v I), is the covariance v phi(x)^T phi(x') (Rasmussen,
Williams 2006, section 2.7): what the slopes are, and how sure that is, follows with the rest.
"""

from math import log

from study.sampler.parts import Constant, Linear
from study.sampler.terms import Prior, Term

SLOPE_VARIANCE = 0.3
SLOPE_BOUNDS = (1e-4, 1e2)


def linear_mean(features: int) -> Term:
    """v phi^T phi' over the first `features` columns, [k]; v is learned."""
    slope = Term(Constant(SLOPE_VARIANCE, SLOPE_BOUNDS), (Prior(log(SLOPE_VARIANCE), 1.5),))
    return slope * Term(Linear(slice(0, features)), ())

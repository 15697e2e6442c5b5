"""Chemistry: how to set SciPy's `solve_ivp` for reactions that spread in a tube.

The Brusselator with diffusion (Hairer and Wanner, Solving Ordinary Differential Equations II,
section IV.1) by the method of lines. Cheap runs are short or on few points; the costly one is long,
on many. Work is counted in evaluations of the right-hand side. What is wanted is little work for an
error of `WANTED`; a larger one costs as much more work as a method of order two needs to mend it.
"""

import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution
from scipy import sparse
from scipy.integrate import solve_ivp

from study.benchmarks.outside.definition import Definition, Feature, Settings

Floats = NDArray[np.float64]

FEED_A, FEED_B = 1.0, 3.0
DIFFUSION = 0.02
WANTED = 1e-4  # error to the largest concentration
ORDER = 2.0  # log10 of work, for log10 of error
MOST_EVALUATIONS = 8000
FACTOR_EVALUATIONS = 2  # that a factorisation is worth


@dataclass(frozen=True)
class Case:
    """Points of the tube, and the time to integrate to."""

    points: int
    end: float


COARSE = Case(12, 4.0)
SHORT = Case(20, 3.0)
LARGE = Case(40, 8.0)

SPACE = {
    "method": CategoricalDistribution(("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")),
    "rtol": FloatDistribution(1e-9, 1e-1, log=True),
    "atol": FloatDistribution(1e-11, 1e-1, log=True),
    "max_step": FloatDistribution(0.01, 2.0, log=True),
    "first_step": FloatDistribution(1e-6, 1e-1, log=True),
    "jacobian": CategoricalDistribution(("banded", "dense")),
}


@dataclass(frozen=True)
class Integrated:
    """What came of one run.

    Attributes:
        work: in evaluations of the right-hand side.
        error: at the end, largest, to the largest concentration; infinite where it failed.
    """

    work: float
    error: float

    @property
    def cost(self) -> float:
        """log10 of work, more where the error is larger than wanted; finite."""
        orders_above = np.log10(np.clip(self.error, WANTED, 1.0) / WANTED)
        return float(np.log10(self.work) + orders_above / ORDER)


def cheap(settings: Settings) -> tuple[float, ...]:
    """Work, error and cost of the short run, and the cost of the coarse one."""
    short = _integrate(settings, SHORT)
    return short.work, short.error, short.cost, _integrate(settings, COARSE).cost


def costly(settings: Settings) -> float:
    """Cost of the long run."""
    return _integrate(settings, LARGE).cost


def _rates(points: int) -> Any:
    """Right-hand side of y [2 points], both substances by turns, so that its Jacobian is a band."""
    strength = DIFFUSION * (points + 1) ** 2

    def rates(_: float, y: Floats) -> Floats:
        u, v = y[0::2], y[1::2]
        beyond_u = np.concatenate([[FEED_A], u, [FEED_A]])
        beyond_v = np.concatenate([[FEED_B], v, [FEED_B]])
        reaction = u * u * v
        change = np.empty_like(y)
        change[0::2] = FEED_A + reaction - (FEED_B + 1.0) * u + strength * np.diff(beyond_u, 2)
        change[1::2] = FEED_B * u - reaction + strength * np.diff(beyond_v, 2)
        return change

    return rates


def _start(points: int) -> Floats:
    """Concentrations at time 0, [2 points]."""
    place = np.arange(1, points + 1) / (points + 1)
    start = np.full(2 * points, FEED_B)
    start[0::2] = 1.0 + np.sin(2.0 * np.pi * place)
    return start


@cache
def _truth(case: Case) -> Floats:
    """Concentrations at the end, to nine digits."""
    run = solve_ivp(
        _rates(case.points), (0.0, case.end), _start(case.points), method="Radau",
        rtol=1e-10, atol=1e-12, jac_sparsity=_band(case.points),
    )  # fmt: skip
    return np.asarray(run.y[:, -1])


@cache
def _band(points: int) -> Any:
    """Where the Jacobian may be other than zero."""
    size = 2 * points
    return sparse.diags([1.0] * 5, range(-2, 3), shape=(size, size)).tocsc()


def _integrate(settings: Settings, case: Case) -> Integrated:
    """One run; given up after the most evaluations."""
    rates, evaluations = _rates(case.points), [0]

    def counted(time: float, y: Floats) -> Floats:
        evaluations[0] += 1
        if evaluations[0] > MOST_EVALUATIONS:
            raise _GivenUp
        return np.asarray(rates(time, y))

    first = min(float(settings["first_step"]), float(settings["max_step"]))
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            run = solve_ivp(
                counted, (0.0, case.end), _start(case.points), method=settings["method"],
                rtol=settings["rtol"], atol=settings["atol"], max_step=settings["max_step"],
                first_step=first, **_jacobian(settings, case),
            )  # fmt: skip
        except (_GivenUp, ValueError, np.linalg.LinAlgError):
            return Integrated(float(MOST_EVALUATIONS), float("inf"))
    true = _truth(case)
    error = float(np.abs(run.y[:, -1] - true).max() / true.max()) if run.success else float("inf")
    # Those for Jacobians by differences are among them, which `run.nfev` leaves out.
    work = evaluations[0] + FACTOR_EVALUATIONS * run.nlu
    return Integrated(float(work), error if np.isfinite(error) else float("inf"))


def _jacobian(settings: Settings, case: Case) -> dict[str, Any]:
    """How an implicit method is told that the Jacobian is a band; nothing for the others."""
    if settings["jacobian"] == "dense":
        return {}
    if settings["method"] == "LSODA":
        return {"lband": 2, "uband": 2}
    return {"jac_sparsity": _band(case.points)} if settings["method"] in ("Radau", "BDF") else {}


class _GivenUp(Exception):  # noqa: N818 - the end of a run, not an error
    """More evaluations than a run may take."""


DEFINITION = Definition(
    name="stiff-reactions",
    purpose="reported",
    field="chemistry",
    cost_meaning="log10 of work on 40 points to time 8, more for errors above 1e-4",
    space=SPACE,
    features={
        "short_work": Feature("low", "work on 20 points to time 3, evaluations"),
        "short_error": Feature("low", "its error, to the largest concentration; infinite: failed"),
        "short_cost": Feature("low", "what is minimised, of that run"),
        "coarse_cost": Feature("low", "what is minimised, on 12 points to time 4"),
    },
    cheap=cheap,
    costly=costly,
)

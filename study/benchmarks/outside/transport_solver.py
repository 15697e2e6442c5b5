"""Numerical linear algebra: incomplete factors and a Krylov method for transport by a flow.

The recirculating-wind problem of Elman, Silvester and Wathen (Finite Elements and Fast Iterative
Solvers, example 3.1.4), by central differences: -nu laplace(u) + w . grad(u) = 1 on [-1, 1]^2.
SciPy's `spilu` preconditions `gmres`, `lgmres` or `bicgstab`. Work is counted in multiply-adds, not
timed. Where the iteration fails, a complete factorisation follows: its work comes on top.
"""

import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from scipy import sparse
from scipy.sparse import linalg

from study.benchmarks.outside.definition import Definition, Feature, Settings

VISCOSITY = 1.0 / 100.0
COARSE, FINE = 14, 64  # inner points a side
TOLERANCE = 1e-8  # of the residual to the right-hand side
MOST_PRODUCTS = 400  # with the matrix, before the iteration is given up
MEGA = 1e-6
VECTORS_OF_BICGSTAB = 6  # multiply-adds of length n that a product costs beside it

SPACE = {
    "ordering": CategoricalDistribution(("COLAMD", "MMD_AT_PLUS_A", "MMD_ATA", "NATURAL")),
    "drop_tolerance": FloatDistribution(1e-5, 0.5, log=True),
    "fill_factor": FloatDistribution(1.0, 20.0, log=True),
    "pivot_threshold": FloatDistribution(0.0, 1.0),
    "shift": FloatDistribution(1e-6, 1.0, log=True),  # of the diagonal, in the factored matrix
    "method": CategoricalDistribution(("gmres", "lgmres", "bicgstab")),
    "restart": IntDistribution(3, 60, log=True),  # of gmres and lgmres
}


@dataclass(frozen=True)
class Solved:
    """What came of one linear system.

    Attributes:
        converged: to `TOLERANCE`.
        products: with the matrix and the preconditioner.
        work: multiply-adds in all, millions.
    """

    converged: bool
    products: int
    work: float


def cheap(settings: Settings) -> tuple[float, ...]:
    """Work, products, fill and one application of the preconditioner, on the coarse grid."""
    matrix = _matrix(COARSE)
    factors = _factored(settings, matrix)
    if factors is None:
        return float("nan"), float("inf"), float("nan"), float("nan")
    solved = _solve(settings, matrix, factors)
    probe = np.ones(matrix.shape[0])
    with np.errstate(all="ignore"):
        left = np.linalg.norm(probe - matrix @ factors.solve(probe)) / np.linalg.norm(probe)
    products = float(solved.products) if solved.converged else float("inf")
    return solved.work, products, _entries(factors) / matrix.nnz, float(left)


def costly(settings: Settings) -> float:
    """Work on the fine grid, with that of the complete factorisation where the iteration fails."""
    matrix = _matrix(FINE)
    factors = _factored(settings, matrix)
    if factors is None:
        return _fallback()
    solved = _solve(settings, matrix, factors)
    return solved.work if solved.converged else solved.work + _fallback()


@cache
def _matrix(side: int) -> Any:
    """The operator on side^2 inner points, sparse columns, times the square of their distance."""
    step = 2.0 / (side + 1)
    places = -1.0 + step * np.arange(1, side + 1)
    x, y = np.meshgrid(places, places)
    second = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    first = sparse.diags([-0.5, 0.5], [-1, 1], shape=(side, side))
    one = sparse.eye(side)
    along_x = sparse.diags((2.0 * y * (1.0 - x**2)).ravel())
    along_y = sparse.diags((-2.0 * x * (1.0 - y**2)).ravel())
    diffusion = VISCOSITY * (sparse.kron(one, second) + sparse.kron(second, one))
    flow = along_x @ sparse.kron(one, first) + along_y @ sparse.kron(first, one)
    return sparse.csc_matrix(diffusion + step * flow)


def _factored(settings: Settings, matrix: Any) -> Any:
    """SuperLU's incomplete factors of the shifted matrix; None where it meets a zero pivot."""
    shifted = matrix + float(settings["shift"]) * sparse.diags(np.abs(matrix.diagonal()))
    try:
        return linalg.spilu(
            sparse.csc_matrix(shifted),
            drop_tol=settings["drop_tolerance"],
            fill_factor=settings["fill_factor"],
            permc_spec=settings["ordering"],
            diag_pivot_thresh=settings["pivot_threshold"],
        )
    except RuntimeError:
        return None


def _solve(settings: Settings, matrix: Any, factors: Any) -> Solved:
    """Iterate from zero; products are counted, and the iteration is stopped after the most."""
    size = matrix.shape[0]
    products = 0

    def multiply(vector: Any) -> Any:
        nonlocal products
        products += 1
        if products > MOST_PRODUCTS:
            raise _GivenUp
        return matrix @ factors.solve(vector)  # preconditioned on the right: the residual is true

    operator = linalg.LinearOperator((size, size), multiply, dtype=np.float64)
    right = np.ones(size)
    converged = False
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            solution, information = _iterate(settings, operator, right)
            residual = np.linalg.norm(right - matrix @ factors.solve(solution))
            converged = information == 0 and bool(residual <= 2.0 * TOLERANCE * np.sqrt(size))
        except (_GivenUp, np.linalg.LinAlgError, ValueError):
            products = min(products, MOST_PRODUCTS)
    return Solved(converged, products, MEGA * _work(settings, matrix, factors, products))


def _iterate(settings: Settings, operator: Any, right: Any) -> tuple[Any, int]:
    """One of SciPy's methods, and what it says of its end."""
    limits = {"rtol": TOLERANCE, "atol": 0.0, "maxiter": MOST_PRODUCTS}
    restart = int(settings["restart"])
    if settings["method"] == "gmres":
        solution, information = linalg.gmres(operator, right, restart=restart, **limits)
    elif settings["method"] == "lgmres":
        solution, information = linalg.lgmres(operator, right, inner_m=restart, **limits)
    else:
        solution, information = linalg.bicgstab(operator, right, **limits)
    return solution, int(information)


def _work(settings: Settings, matrix: Any, factors: Any, products: int) -> float:
    """Multiply-adds of factors and iteration."""
    size = matrix.shape[0]
    of_products = products * (matrix.nnz + _entries(factors))
    if settings["method"] == "bicgstab":
        vectors = VECTORS_OF_BICGSTAB * products
    else:  # each new vector is made orthogonal to those since the restart: a product and a sum each
        vectors = int((2 * (np.arange(products) % int(settings["restart"]) + 1)).sum())
    return float(_factor_work(factors) + of_products + size * vectors)


def _entries(factors: Any) -> int:
    """Numbers in both factors."""
    return int(factors.L.nnz + factors.U.nnz)


def _factor_work(factors: Any) -> float:
    """Multiply-adds of an elimination that leaves these factors: column of L times row of U."""
    below = np.diff(factors.L.tocsc().indptr).astype(np.float64)
    right = np.diff(factors.U.tocsr().indptr).astype(np.float64)
    return float(below @ right)


@cache
def _fallback() -> float:
    """Work of the complete factorisation of the fine grid, millions of multiply-adds."""
    factors = linalg.splu(_matrix(FINE), permc_spec="COLAMD")
    return MEGA * (_factor_work(factors) + _entries(factors))


class _GivenUp(Exception):  # noqa: N818 - the end of a loop, not an error
    """More products than the iteration may take."""


DEFINITION = Definition(
    name="transport-solver",
    purpose="tuning",
    field="numerical linear algebra",
    cost_meaning="work to solve on a grid of 64 x 64, millions of multiply-adds",
    space=SPACE,
    features={
        "coarse_work": Feature("low", "work on 14 x 14, millions of multiply-adds"),
        "coarse_products": Feature("low", "matrix products on 14 x 14; infinite: not solved"),
        "fill": Feature("low", "entries of the factors to entries of the matrix, on 14 x 14"),
        "left_over": Feature("low", "of a vector of ones, what one application leaves, a ratio"),
    },
    cheap=cheap,
    costly=costly,
)

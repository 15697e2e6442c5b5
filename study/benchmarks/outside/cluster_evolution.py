"""Global optimisation: how to set SciPy's differential evolution to find clusters of atoms.

Argon-like atoms attract and repel each other by Lennard-Jones' potential; the arrangement of least
energy is sought, a standard test of global optimisers (Wales and Doye 1997). The costly runs are
for six atoms, the cheap ones for three and four, where few evaluations do.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from study.benchmarks.outside.definition import Definition, Feature, Settings

Floats = NDArray[np.float64]

SEED = 1997
EVALUATIONS = {3: 240, 4: 500, 6: 3000}  # of a run, by the number of atoms
RUNS = 3  # of six atoms
FOUND_3 = -2.7  # energy at which three atoms are nearly a triangle, which has -3
DIMENSIONS = 3

SPACE = {
    "strategy": CategoricalDistribution(
        ("best1bin", "best1exp", "rand1bin", "rand2bin", "randtobest1bin", "currenttobest1bin")
    ),
    "population": IntDistribution(6, 120, log=True),
    "mutation": FloatDistribution(0.1, 1.3),
    "dither": FloatDistribution(0.0, 0.6),  # mutation is drawn anew from a range so wide
    "recombination": FloatDistribution(0.0, 1.0),
    "start": CategoricalDistribution(("latinhypercube", "sobol", "random")),
    "half_width": FloatDistribution(0.7, 6.0, log=True),  # of the box of atoms, in diameters
}


@dataclass(frozen=True)
class Evolved:
    """One run.

    Attributes:
        energy: the least that was met, well depths.
        spread: standard deviation of the last population's coordinates, diameters.
        found_after: evaluations until `FOUND_3` was met; infinite: never.
    """

    energy: float
    spread: float
    found_after: float


def cheap(settings: Settings) -> tuple[float, ...]:
    """Energies of three and four atoms, how soon the first, and what variety is left."""
    three, four = _evolve(settings, 3, 0), _evolve(settings, 4, 0)
    return three.energy, four.energy, three.found_after, four.spread


def costly(settings: Settings) -> float:
    """Mean least energy of six atoms."""
    return float(np.mean([_evolve(settings, 6, run).energy for run in range(RUNS)]))


def energies(places: Floats) -> Floats:
    """Lennard-Jones energy of clusters, places [members, atoms, 3] -> [members], well depths."""
    first, second = np.triu_indices(places.shape[1], 1)
    squared = ((places[:, first] - places[:, second]) ** 2).sum(axis=2)
    attraction = 1.0 / np.maximum(squared, 1e-3) ** 3  # atoms in one place: large, not infinite
    return np.asarray((4.0 * (attraction**2 - attraction)).sum(axis=1))


def _evolve(settings: Settings, atoms: int, run: int) -> Evolved:
    """One run for so many atoms, in a cube about the origin."""
    population = int(settings["population"])
    seed = np.random.SeedSequence(SEED, spawn_key=(atoms, run))
    seen = [0]
    found = [float("inf")]

    def energy(vectors: Floats) -> Floats:
        values = energies(np.asarray(vectors.T).reshape(-1, atoms, DIMENSIONS))
        seen[0] += len(values)
        if found[0] == float("inf") and values.min() < FOUND_3:
            found[0] = float(seen[0])
        return values

    # SciPy multiplies a population by the number of variables, unless it is given whole.
    rng = np.random.default_rng(seed)
    start = _start(str(settings["start"]), population, atoms * DIMENSIONS, rng)
    half = float(settings["half_width"])
    low = float(settings["mutation"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = differential_evolution(
            energy,
            [(-half, half)] * (atoms * DIMENSIONS),
            strategy=settings["strategy"],
            init=half * (2.0 * start - 1.0),
            mutation=(low, low + float(settings["dither"])),
            recombination=settings["recombination"],
            maxiter=max(EVALUATIONS[atoms] // population - 1, 1),
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=rng,
        )
    return Evolved(float(result.fun), float(result.population.std(axis=0).mean()), found[0])


def _start(kind: str, members: int, variables: int, rng: np.random.Generator) -> Floats:
    """The first population in the unit cube, [members, variables]."""
    if kind == "random":
        return rng.random((members, variables))
    engine = qmc.Sobol if kind == "sobol" else qmc.LatinHypercube
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Sobol: not a power of two
        return np.asarray(engine(variables, rng=rng).random(members))


DEFINITION = Definition(
    name="cluster-evolution",
    purpose="tuning",
    field="global optimisation",
    cost_meaning="least energy of six atoms after 3,000 evaluations, mean of 3 runs, well depths",
    space=SPACE,
    features={
        "energy_3": Feature(
            "low", "least energy of three atoms after 240 evaluations, well depths"
        ),
        "energy_4": Feature("low", "least energy of four atoms after 500 evaluations, well depths"),
        "found_3": Feature(
            "low", "evaluations until three atoms are nearly a triangle; infinite: never"
        ),
        "spread_4": Feature("low", "variety of the last population of four atoms, diameters"),
    },
    cheap=cheap,
    costly=costly,
)

"""The configuration of an estimate of the optimum."""

from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from storage.document import FORMAT
from study.comparison.experiment import MOST_RUNS, MOST_TRIALS, Experiment
from study.config import COSTS, LARGEST_DURATION_S, read_name
from taichi_nmm import __version__
from taichi_nmm.config import read_settings, read_toml
from taichi_nmm.errors import InputError

LEVEL = {"kind": "flat"}
PACKAGES = ("taichi", "cma", "numpy")
LARGEST_POPULATION = 10_000
MOST_GENERATIONS = 100_000


@dataclass(frozen=True)
class CmaesOptions:
    """How each run of CMA-ES goes.

    Attributes:
        sigma: first spread, of each range.
        population: of a generation; 0 is the library's, 4 + 3 ln(number of parameters).
        tolerance: pycma's `tolfun`: converged when the cost has changed by less in 50 generations
            or so. Its other criteria are as they are by default.
        max_generations: where a run is cut that has not converged.
    """

    sigma: float
    population: int
    tolerance: float
    max_generations: int


@dataclass(frozen=True, eq=False)
class OptimumConfig:
    """What is estimated.

    Attributes:
        experiment: level ground, undisturbed body, the arm `dog`; its seed is also that of CMA-ES.
        cmaes: how each run of it goes.
    """

    experiment: Experiment
    cmaes: CmaesOptions

    def document(self) -> dict[str, Any]:
        """What decides the result of CMA-ES; the number of runs and of generations may grow."""
        experiment, settings = self.experiment, self.experiment.settings
        return {
            "format": FORMAT,
            "versions": {"taichi-nmm": __version__} | {name: version(name) for name in PACKAGES},
            "name": experiment.name,
            "seed": experiment.seed,
            "objective": {"cost": experiment.cost},
            "simulation": {
                "duration_s": experiment.duration_s,
                "physics_step_s": settings.physics_step_s,
                "contact_relaxation_speed_mps": settings.contact_relaxation_speed_mps,
                "precision": settings.precision,
            },
            "parameters": {p.name: [float(p.low), float(p.high)] for p in experiment.parameters},
            "cmaes": {
                "sigma": self.cmaes.sigma,
                "population": self.cmaes.population,
                "tolerance": self.cmaes.tolerance,
            },
        }


def read_optimum_config(
    path: str | Path, arch: str | None = None, max_generations: int | None = None
) -> OptimumConfig:
    """Read and check a configuration; `arch` and `max_generations` override the file's.

    Raises:
        InputError: an unknown key, a wrong type, or a value out of range.
    """
    table = read_toml(path)
    objective, simulation = table.table("objective"), table.table("simulation")
    cmaes, dog = table.table("cmaes"), table.table("dog")
    experiment = Experiment(
        name=read_name(table),
        seed=table.integer("seed"),
        runs=table.integer("runs", 50, 1, MOST_RUNS),
        trials=dog.integer("trials", 100, 1, MOST_TRIALS),
        arms=("dog",),
        searched=(),
        cost=objective.text("cost", "smooth", COSTS),
        duration_s=simulation.number("duration_s", 100.0, 1.0, LARGEST_DURATION_S),
        settings=read_settings(simulation, arch),
        disturbance=0.0,
        ground=LEVEL,
        stores={"flat": Path(dog.text("store"))},
    )
    options = CmaesOptions(
        sigma=cmaes.number("sigma", 0.3, 1e-6, 1.0),
        population=cmaes.integer("population", 0, 0, LARGEST_POPULATION),
        tolerance=cmaes.number("tolerance", 1e-11, 0.0, 100.0),
        max_generations=cmaes.integer("max_generations", 400, 1, MOST_GENERATIONS),
    )
    if max_generations is not None:
        if not 1 <= max_generations <= MOST_GENERATIONS:
            allowed = f"a whole number from 1 to {MOST_GENERATIONS}"
            raise InputError("max-generations", max_generations, allowed)
        options = replace(options, max_generations=max_generations)
    if options.population in (1, 2):
        raise InputError(
            "cmaes.population", options.population, "0 for the library's, or 3 or more"
        )
    for part in (objective, simulation, cmaes, dog, table):
        part.done()
    return OptimumConfig(experiment, options)

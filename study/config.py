"""The configuration of a study: one body, one ground and one cost, drawn once from a seed."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.draws import Purpose, stream
from study.sampler.feature_sampler import STARTUP_TRIALS
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_bodies, read_settings, read_terrain, read_toml
from taichi_nmm.errors import InputError
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain

COSTS = ("smooth", "walking")
LARGEST_DURATION_S = 1000.0
SURVIVAL_STORE = "out/store-diverse"
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]*"


@dataclass(frozen=True, eq=False)
class StudyConfig:
    """What a study is about.

    Attributes:
        name: of the experiment; a study is called name/sampler.
        seed: of the body, the ground and the samplers.
        cost: "smooth" or "walking", the paper's two.
        duration_s: of a trial.
        settings: of the simulation.
        bodies: one body.
        terrain: one ground.
        store: folder of scores for the DoG sampler.
        score: the store's column that it compares rows by.
        startup_trials: rows at random before its first fit.
        survival_store: folder of scores for the best sampler.
    """

    name: str
    seed: int
    cost: str
    duration_s: float
    settings: Settings
    bodies: Bodies
    terrain: Terrain
    store: Path
    score: str
    startup_trials: int
    survival_store: Path

    def identity(self) -> dict[str, str | int | float]:
        """What decides a trial's value, in short: body and ground by digest.

        The architecture is not part of it: a study begun on one machine may go on on another.
        """
        bodies = (self.bodies.mass_kg, self.bodies.inertia_kgm2, self.bodies.com_m)
        return {
            "seed": self.seed,
            "objective.cost": self.cost,
            "simulation.duration_s": self.duration_s,
            "simulation.physics_step_s": self.settings.physics_step_s,
            "simulation.contact_relaxation_speed_mps": self.settings.contact_relaxation_speed_mps,
            "simulation.precision": self.settings.precision,
            "body": _digest(*bodies),
            "terrain": _digest(self.terrain.height_m),
        }


def read_study_config(path: str | Path, arch: str | None = None) -> StudyConfig:
    """Read and check a study's TOML; `arch` overrides the file's."""
    table = read_toml(path)
    name, seed = read_name(table), table.integer("seed")
    objective, simulation = table.table("objective"), table.table("simulation")
    dog, best = table.table("dog"), table.table("best")
    config = StudyConfig(
        name=name,
        seed=seed,
        cost=objective.text("cost", "smooth", COSTS),
        duration_s=simulation.number("duration_s", 100.0, 1.0, LARGEST_DURATION_S),
        settings=read_settings(simulation, arch),
        bodies=read_bodies(table.table("body"), stream(seed, Purpose.BODY)),
        terrain=read_terrain(table.table("terrain"), stream(seed, Purpose.TERRAIN)),
        store=Path(dog.text("store")),
        score=dog.text("score", "phi_printed"),
        startup_trials=dog.integer("startup_trials", STARTUP_TRIALS, low=1, high=1000),
        survival_store=Path(best.text("store", SURVIVAL_STORE)),
    )
    for part in (objective, simulation, dog, best, table):
        part.done()
    return config


def read_name(table: Table) -> str:
    """The key "name", which becomes a part of studies' and folders' names."""
    name = table.text("name")
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError("name", name, "letters, digits, '.', '_' and '-', first a letter or digit")
    return name


def _digest(*arrays: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """Short fingerprint of numbers, to a nanometre or a milligram or so."""
    digest = hashlib.sha256()
    for values in arrays:
        # Adding zero turns -0.0 into 0.0.
        digest.update((np.round(values, 9) + 0.0).tobytes())
    return digest.hexdigest()[:16]

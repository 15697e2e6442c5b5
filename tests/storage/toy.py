"""A simulator of three parameters in one file, as CONTRIBUTING.md describes one.

A cart is pushed with force `thrust` against wind and a drag of `drag` times its speed;
a controller of gain `steer` keeps it on its way. It fails when the wind has blown it
off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from storage.inputs.config import Table
from storage.inputs.errors import InputError
from storage.simulator import Report, Simulator, Uniform


@dataclass(frozen=True)
class Winds:
    lowest: float
    highest: float

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> NDArray[np.float64]:
        """Speeds, [w]."""
        draws = [
            np.random.default_rng(seed).uniform(self.lowest, self.highest)
            for seed in seeds
        ]
        return np.array(draws)

    def document(self, worlds: NDArray[np.float64]) -> dict[str, Any]:
        return {"wind": [self.lowest, self.highest]}


@dataclass(frozen=True)
class Cart(Simulator):
    mass_kg: float = 1.0

    code_version = "1"
    parameters = (
        Uniform("thrust", 0.0, 10.0),
        Uniform("drag", 0.1, 1.0),
        Uniform("steer", -1.0, 1.0),
    )
    columns = np.dtype([("way", "f8"), ("end_reason", "u1"), ("speed", "f4")])
    survived = "way"
    words: ClassVar = {"end_reason": ("arrived", "blown off")}
    measures: ClassVar = {"speed": (0.0, 50.0)}

    @classmethod
    def read(cls, table: Table, arch: str | None) -> "Cart":
        if arch is not None:
            raise InputError("arch", arch, "nothing: the cart has none")
        return cls(table.table("simulator").number("mass_kg", 1.0, 0.1, 10.0))

    def read_worlds(self, table: Table) -> Winds:
        return Winds(*table.range("wind", (0.0, 0.0), 0.0, 100.0))

    def run(
        self,
        points: NDArray[Any],
        worlds: NDArray[Any],
        horizon_s: float,
        report: Report,
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        thrust, drag, steer = points.T[:, :, None]
        rows = np.zeros((len(points), len(worlds)), self.columns)
        rows["speed"] = thrust / drag / self.mass_kg
        lasted_s = horizon_s * np.exp(0.5 - worlds * np.abs(steer))
        rows["end_reason"] = lasted_s < horizon_s
        rows["way"] = np.minimum(lasted_s / horizon_s, 1.0)
        report(1.0)
        return rows, {"engine": "cart"}

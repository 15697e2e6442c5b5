"""A simulator of three parameters in one file, as CONTRIBUTING.md describes one.

A cart is pushed with force `thrust` against wind and a drag of `drag` times its speed; a controller
of gain `steer` keeps it on its way. It fails when the wind has blown it off.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.config import Table
from taichi_nmm.errors import InputError

runs: list[int] = []  # sizes of batches


class Parameter(NamedTuple):
    name: str
    low: float
    high: float


@dataclass(frozen=True)
class Winds:
    lowest: float
    highest: float

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> NDArray[np.float64]:
        """Speeds, [w]."""
        draws = [np.random.default_rng(seed).uniform(self.lowest, self.highest) for seed in seeds]
        return np.array(draws)

    def document(self, worlds: NDArray[np.float64]) -> dict[str, Any]:
        return {"wind": [self.lowest, self.highest]}


@dataclass(frozen=True)
class Cart:
    mass_kg: float = 1.0

    name: ClassVar[str] = "cart"
    code_version: ClassVar[str] = "1"
    packages: ClassVar[tuple[str, ...]] = ("numpy",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("thrust", 0.0, 10.0),
        Parameter("drag", 0.1, 1.0),
        Parameter("steer", -1.0, 1.0),
    )
    columns: ClassVar[np.dtype[np.void]] = np.dtype(
        [("duration_s", "f8"), ("end_reason", "u1"), ("survived_fraction", "f8"), ("speed", "f4")]
    )
    ends: ClassVar[tuple[str, ...]] = ("arrived", "blown off")
    scores: ClassVar[tuple[str, ...]] = ("survived_fraction", "speed")
    objective: ClassVar[str] = "way"
    measures: ClassVar[dict[str, tuple[float, float]]] = {"speed": (0.0, 50.0)}

    @classmethod
    def read(cls, settings: Table, searched: Sequence[str], arch: str | None) -> "Cart":
        if searched:
            raise InputError("searched", searched[0], "nothing: all parameters are searched")
        return cls(settings.number("mass_kg", 1.0, 0.1, 10.0))

    @classmethod
    def parameters_of(cls, names: Sequence[str]) -> tuple[Parameter, ...]:
        return cls.parameters

    def document(self) -> dict[str, Any]:
        return {"simulation": {"mass_kg": self.mass_kg}}

    def versions(self) -> dict[str, str]:
        return {}

    def read_worlds(self, table: Table) -> Winds:
        return Winds(*table.range("wind", (0.0, 0.0), 0.0, 100.0))

    def run(
        self,
        points: NDArray[np.float64],
        worlds: NDArray[np.float64],
        horizon_s: float,
        report: Callable[[float], None],
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        runs.append(len(points))
        thrust, drag, steer = points.T[:, :, None]
        rows = np.zeros((len(points), len(worlds)), self.columns)
        rows["speed"] = thrust / drag / self.mass_kg
        lasted = horizon_s * np.exp(0.5 - worlds * np.abs(steer))
        rows["duration_s"] = np.minimum(lasted, horizon_s)
        rows["end_reason"] = lasted < horizon_s
        rows["survived_fraction"] = rows["duration_s"] / horizon_s
        report(1.0)
        return rows, {"engine": "cart"}

    def judge(
        self, rows: NDArray[np.void], horizon_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        way = (rows["speed"] * rows["duration_s"]).mean(axis=1)
        return way, rows["speed"].mean(axis=1, keepdims=True).astype(np.float64)

    def canary(self) -> NDArray[np.void]:
        return self.run(np.full((2, 3), 0.3), np.ones(2), 1.0, lambda part: None)[0]

    def on_one_thread(self) -> "Cart":
        return self

    def require_machine(self) -> None:
        pass

    def processes(self, cores: int) -> int:
        return cores

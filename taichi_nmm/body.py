"""The seven rigid segments: masses, inertias and centres of mass, nominal and disturbed.

Source: Geyer & Herr 2010, as in the walker T (80 kg, 1.80 m); disturbances: Antonova et al. 2016.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm import checks
from taichi_nmm.errors import InputError

GRAVITY_MPS2 = 9.81
THIGH_LENGTH_M = 0.50
SHANK_LENGTH_M = 0.50
HEEL_OFFSET_M = -0.04  # heel behind the ankle, along the foot
BALL_OFFSET_M = 0.16  # ball ahead of the ankle, along the foot


@dataclass(frozen=True)
class Segment:
    """One link. `com_m` runs from its proximal joint along the link (HAT: upward from the hip)."""

    name: str
    mass_kg: float
    inertia_kgm2: float
    length_m: float
    com_m: float


HAT = Segment("hat", 53.5, 3.0, 0.80, 0.35)
THIGH = Segment("thigh", 8.5, 0.15, THIGH_LENGTH_M, 0.20)
SHANK = Segment("shank", 3.5, 0.05, SHANK_LENGTH_M, 0.20)
FOOT = Segment("foot", 1.25, 0.005, 0.20, 0.02)

SEGMENTS: tuple[Segment, ...] = (HAT, THIGH, SHANK, FOOT, THIGH, SHANK, FOOT)
SEGMENT_NAMES: tuple[str, ...] = (
    "hat", "thigh_l", "shank_l", "foot_l", "thigh_r", "shank_r", "foot_r",
)  # fmt: skip

LARGEST_DISTURBANCE = 0.15  # of mass and inertia; of half the length for the centre of mass


@dataclass(frozen=True, eq=False)
class Bodies:
    """A batch of bodies, one row each, segments in the order of `SEGMENT_NAMES`.

    Attributes:
        mass_kg: [n, 7], positive.
        inertia_kgm2: about the centre of mass, [n, 7], positive.
        com_m: from the proximal joint along the link, [n, 7].
    """

    mass_kg: NDArray[np.float64]
    inertia_kgm2: NDArray[np.float64]
    com_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("mass_kg", "inertia_kgm2", "com_m"):
            values = checks.numbers(f"bodies.{name}", getattr(self, name))
            if values.ndim != 2 or values.shape[1] != len(SEGMENTS):
                raise InputError(f"bodies.{name}.shape", values.shape, f"[n, {len(SEGMENTS)}]")
            checks.finite(f"bodies.{name}", values)
            if name != "com_m" and not np.all(values > 0):
                raise InputError(f"bodies.{name}", float(values.min()), "positive numbers")
            object.__setattr__(self, name, values)
        if not len(self.mass_kg) == len(self.inertia_kgm2) == len(self.com_m):
            raise InputError("bodies", "arrays of different length", "one row a body in each")

    def __len__(self) -> int:
        return len(self.mass_kg)

    def take(self, index: ArrayLike) -> "Bodies":
        """The bodies of these rows, in this order (rows may repeat)."""
        rows = checks.row_numbers("index", index, len(self))
        return Bodies(self.mass_kg[rows], self.inertia_kgm2[rows], self.com_m[rows])

    @staticmethod
    @checks.checked(count=checks.whole(0, checks.MOST_ROWS))
    def nominal(count: int = 1) -> "Bodies":
        """`count` undisturbed bodies."""

        def column(attribute: str) -> NDArray[np.float64]:
            return np.tile([getattr(segment, attribute) for segment in SEGMENTS], (count, 1))

        return Bodies(column("mass_kg"), column("inertia_kgm2"), column("com_m"))

    @staticmethod
    @checks.checked(seeds=checks.each(checks.seed))
    def disturbed(
        seeds: Iterable[int | np.random.SeedSequence], fraction: float = LARGEST_DISTURBANCE
    ) -> "Bodies":
        """One body a seed: m, I times 1 + U(-f, f); centre of mass moved by U(-f, f) L/2.

        Left and right legs differ. Lengths, contact points and muscles are not changed.
        """
        below_one = checks.number(0.0, math.nextafter(1.0, 0.0), "0 or more, below 1")
        fraction = below_one("body.disturbance", fraction)
        draws = np.array(
            [np.random.default_rng(seed).uniform(-fraction, fraction, (3, 7)) for seed in seeds]
        ).reshape(-1, 3, len(SEGMENTS))
        nominal = Bodies.nominal(len(draws))
        half_length = 0.5 * np.array([segment.length_m for segment in SEGMENTS])
        return Bodies(
            nominal.mass_kg * (1.0 + draws[:, 0]),
            nominal.inertia_kgm2 * (1.0 + draws[:, 1]),
            nominal.com_m + draws[:, 2] * half_length,
        )

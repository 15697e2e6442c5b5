"""The seven rigid segments: masses, inertias and centres of mass, nominal and disturbed.

Source: Geyer & Herr 2010, as in the walker T (80 kg, 1.80 m); disturbances: Antonova et
al. 2016.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError

GRAVITY_MPS2 = 9.81
THIGH_LENGTH_M = 0.50
SHANK_LENGTH_M = 0.50
HEEL_OFFSET_M = -0.04  # heel behind the ankle, along the foot
BALL_OFFSET_M = 0.16  # ball ahead of the ankle, along the foot


@dataclass(frozen=True)
class Segment:
    """One link of the body.

    Attributes:
        name: without a side.
        mass_kg: its mass.
        inertia_kgm2: about its centre of mass.
        length_m: of the whole link; of the foot from the heel to the ball.
        com_m: where its centre of mass is, from the proximal joint along the link (of
            the trunk upward from the hip).
    """

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
    "hat",
    "thigh_l",
    "shank_l",
    "foot_l",
    "thigh_r",
    "shank_r",
    "foot_r",
)

SIDES = ("left", "right")
OF_A_LEG = ("thigh", "shank", "foot")
FACTOR_NAMES = ("hat", *(f"{name}_{side}" for side in SIDES for name in OF_A_LEG))

# The paper's: of mass and inertia; of half the length for the centre of mass.
LARGEST_DISTURBANCE = 0.15
MOST_DISTURBANCE = 0.9  # of a configuration; beyond it masses come near zero
FACTORS = (0.05, 20.0)  # of a configuration, of masses and inertias
AS_NOMINAL = (1.0,) * len(SEGMENTS)


class Collection:
    """Bodies or worlds: a child is a frozen dataclass of arrays with a row each."""

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def take(self, index: ArrayLike) -> Self:
        """Some rows as a batch.

        Args:
            index: their numbers, in the order of the new batch; they may repeat.
        """
        rows = checks.row_numbers("index", index, len(self))
        taken = {name: values[rows] for name, values in vars(self).items()}
        return type(self)(**taken)

    @classmethod
    def stacked(cls, worlds: Iterable[Self]) -> Self:
        """Several batches as one; they may be of bodies as well."""
        parts = checks.each(checks.instance(cls), least=1)(cls.__name__.lower(), worlds)
        return cls(
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in vars(parts[0])
            }
        )

    def _check_shapes(
        self, one: str, of_a_row: Callable[[str], tuple[int, ...]]
    ) -> None:
        """Take the arrays as float64; `one` is a row, and `of_a_row` the shape of a field's row."""
        name = type(self).__name__.lower()
        for key, given in vars(self).items():
            values = checks.numbers(f"{name}.{key}", given)
            shape = of_a_row(key)
            if values.ndim != 1 + len(shape) or values.shape[1:] != shape:
                allowed = "[" + ", ".join(["n", *map(str, shape)]) + "]"
                raise InputError(f"{name}.{key}.shape", values.shape, allowed)
            object.__setattr__(self, key, values)
        if len({len(values) for values in vars(self).values()}) != 1:
            raise InputError(
                name, "arrays of different length", f"one row a {one} in each"
            )


@dataclass(frozen=True, eq=False)
class Bodies(Collection):
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
        self._check_shapes("body", lambda name: (len(SEGMENTS),))
        for name, values in vars(self).items():
            checks.finite(f"bodies.{name}", values)
            if name != "com_m" and not np.all(values > 0):
                raise InputError(
                    f"bodies.{name}", float(values.min()), "positive numbers"
                )

    @staticmethod
    @checks.checked(count=checks.whole(0, checks.MOST_ROWS))
    def nominal(count: int = 1) -> "Bodies":
        """`count` undisturbed bodies."""

        def column(attribute: str) -> NDArray[np.float64]:
            return np.tile(
                [getattr(segment, attribute) for segment in SEGMENTS], (count, 1)
            )

        return Bodies(
            mass_kg=column("mass_kg"),
            inertia_kgm2=column("inertia_kgm2"),
            com_m=column("com_m"),
        )

    @staticmethod
    @checks.checked(seeds=checks.each(checks.seed))
    def disturbed(
        seeds: Iterable[int | np.random.SeedSequence],
        fraction: float = LARGEST_DISTURBANCE,
    ) -> "Bodies":
        """One body a seed: m, I times 1 + U(-f, f); centre of mass moved by U(-f, f) L/2.

        Left and right legs differ. Lengths, contact points and muscles are not changed.

        Args:
            seeds: one a body, n of them.
            fraction: f, from 0 to below 1; 0.15 in the paper.
        """
        below_one = checks.number(0.0, math.nextafter(1.0, 0.0), "0 or more, below 1")
        fraction = below_one("body.disturbance", fraction)
        draws = np.array(
            [
                np.random.default_rng(seed).uniform(-fraction, fraction, (3, 7))
                for seed in seeds
            ]
        ).reshape(-1, 3, len(SEGMENTS))
        nominal = Bodies.nominal(len(draws))
        half_length = 0.5 * np.array([segment.length_m for segment in SEGMENTS])
        return Bodies(
            mass_kg=nominal.mass_kg * (1.0 + draws[:, 0]),
            inertia_kgm2=nominal.inertia_kgm2 * (1.0 + draws[:, 1]),
            com_m=nominal.com_m + draws[:, 2] * half_length,
        )


@dataclass(frozen=True)
class Build:
    """What bodies are drawn around: factors of the nominal segments, and a largest disturbance.

    Attributes:
        disturbance: largest share by which a mass or an inertia differs, and of half a
            length by which a centre of mass moves, 0 to 0.9 (`Bodies.disturbed`).
        mass: factors of the nominal masses, in the order of `SEGMENT_NAMES`, [7].
        inertia: factors of the nominal inertias, likewise.
    """

    disturbance: float = 0.0
    mass: tuple[float, ...] = AS_NOMINAL
    inertia: tuple[float, ...] = AS_NOMINAL

    def draw(self, seeds: Iterable[int | np.random.SeedSequence]) -> Bodies:
        """One body a seed.

        Args:
            seeds: one a body, n of them.
        """
        drawn = Bodies.disturbed(seeds, self.disturbance)
        return Bodies(
            mass_kg=drawn.mass_kg * self.mass,
            inertia_kgm2=drawn.inertia_kgm2 * self.inertia,
            com_m=drawn.com_m,
        )

    def document(self) -> dict[str, Any]:
        """The table [body]; factors only where they are not those that are read without them."""
        document: dict[str, Any] = {"disturbance": self.disturbance}
        if self.mass != AS_NOMINAL:
            document["mass"] = dict(zip(FACTOR_NAMES, self.mass, strict=True))
        if self.inertia != self.mass:
            document["inertia"] = dict(zip(FACTOR_NAMES, self.inertia, strict=True))
        return document


def read_body(table: Table) -> Build:
    """The table [body]: `disturbance` (0.15 in the paper), and factors of masses and inertias.

    [body.mass] and [body.inertia] have them by segment (`hat`, `thigh`, `shank`,
    `foot`), by segment and side (`shank_left`), or for `all`. An inertia that is not
    named grows with its mass. Lengths are those of the model. Reads every key.

    Raises:
        InputError: naming the key.
    """
    disturbance = table.number("disturbance", 0.0, 0.0, MOST_DISTURBANCE)
    mass = _read_factors(table.table("mass"), AS_NOMINAL)
    build = Build(disturbance, mass, _read_factors(table.table("inertia"), mass))
    table.done()
    return build


def _read_factors(table: Table, otherwise: tuple[float, ...]) -> tuple[float, ...]:
    """Factors of all segments; `otherwise` those that are not named."""
    given = table.unread
    names = ("all", *OF_A_LEG, *FACTOR_NAMES)
    named = {name: table.number(name, 1.0, *FACTORS) for name in names}
    table.done()
    factors = []
    for name, factor in zip(FACTOR_NAMES, otherwise, strict=True):
        # The narrowest that is named counts.
        wider = (name, name.partition("_")[0], "all")
        factors.append(next((named[each] for each in wider if each in given), factor))
    return tuple(factors)

"""What differs from walker to walker besides links and ground: contact, muscles, nerves.

The nominal world is that of the published walker. `WorldRanges` draws others.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from taichi_nmm import checks
from taichi_nmm.body import Rows
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.result import MUSCLES
from taichi_nmm.settings import OWN_ENGINE

FRICTION_COEFFICIENT = 0.9  # Geyer & Herr 2010, sticking; here sliding too (they: 0.8)
MUSCLE_COUNT = 2 * len(MUSCLES)

Range = tuple[float, float]
AS_NOMINAL: Range = (1.0, 1.0)
NONE: Range = (0.0, 0.0)
NOISE_SEEDS = 2**24  # whole numbers that float32 holds

LIMITS: dict[str, Range] = {
    "contact_stiffness": (0.01, 100.0),
    "relaxation_speed": (0.1, 100.0),
    "friction": (0.05, 10.0),
    "strength": (0.1, 10.0),
    "nerve_lag_s": (0.0, 1.0),
    "sensing_noise": (0.0, 10.0),
    "noise_seed": (0.0, NOISE_SEEDS - 1.0),
    "overall_strength": (0.1, 10.0),
    "catch_ns": (0.0, 50.0),
}


@dataclass(frozen=True, eq=False)
class Worlds(Rows):
    """A batch of worlds, one row each.

    Attributes:
        contact_stiffness: over the nominal, with which a body at rest sinks 1 cm into the ground on
            one point, [n].
        relaxation_speed: at which a contact lets go, over that of the `Settings`, [n]. The lower,
            the more a contact damps.
        friction: Coulomb's coefficient, [n].
        strength: largest force over the nominal of each muscle of the left leg, then the right,
            [n, 14]. Nerves feel the force itself: a weaker muscle's reflex gets less.
        nerve_lag_s: time constant of a low pass of the signals, besides their delay, [n].
        sensing_noise: half the width of uniform noise on the signals, each tick anew, [n]: of
            forces over Fmax, lengths over the optimal one, loads over body weight, angles in rad,
            angular rates in 10 rad/s. Contact flags have neither noise nor lag.
        noise_seed: of the noise and the catches, whole numbers below 2^24, [n].
        catch_ns: largest impulse, N s, that holds a foot back when it catches, about once a second
            (`kernel.dynamics.catch_feet`), [n].
    """

    contact_stiffness: NDArray[np.float64]
    relaxation_speed: NDArray[np.float64]
    friction: NDArray[np.float64]
    strength: NDArray[np.float64]
    nerve_lag_s: NDArray[np.float64]
    sensing_noise: NDArray[np.float64]
    noise_seed: NDArray[np.float64]
    catch_ns: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._check_shapes("world", _size)
        for name, values in vars(self).items():
            low, high = LIMITS[name]
            outside = values[~((values >= low) & (values <= high))]
            if outside.size:
                raise InputError(f"worlds.{name}", float(outside[0]), f"{low:g} to {high:g}")

    @staticmethod
    @checks.checked(count=checks.whole(0, checks.MOST_ROWS))
    def nominal(count: int = 1) -> "Worlds":
        """`count` worlds of the published walker."""
        one, zero, strength = np.ones(count), np.zeros(count), np.ones((count, MUSCLE_COUNT))
        return Worlds(one, one, FRICTION_COEFFICIENT * one, strength, *[zero] * 4)


@dataclass(frozen=True)
class WorldRanges:
    """The ranges that worlds are drawn from: lowest and highest value of each number.

    Contact stiffness and relaxation speed are drawn log-uniformly, the others uniformly, each from
    a stream of its own, and so is the seed of noise and catches. A muscle is `overall_strength`,
    which all of a walker's muscles share, times its own `strength`. They pickle and hash.
    """

    contact_stiffness: Range = AS_NOMINAL
    relaxation_speed: Range = AS_NOMINAL
    friction: Range = (FRICTION_COEFFICIENT, FRICTION_COEFFICIENT)
    strength: Range = AS_NOMINAL
    nerve_lag_s: Range = NONE
    sensing_noise: Range = NONE
    overall_strength: Range = AS_NOMINAL
    catch_ns: Range = NONE

    def __post_init__(self) -> None:
        pairs = {each.name: checks.interval(*LIMITS[each.name]) for each in fields(self)}
        checks.check_fields(self, "world.", **pairs)
        low, high = LIMITS["strength"]
        for each, overall in zip(self.strength, self.overall_strength, strict=True):
            if not low <= each * overall <= high:
                allowed = f"with world.strength {each:g} a product of {low:g} to {high:g}"
                raise InputError("world.overall_strength", overall, allowed)

    @checks.checked(seeds=checks.each(checks.seed))
    def draw(self, seeds: Iterable[int | np.random.SeedSequence]) -> Worlds:
        """One world a seed."""
        streams = [_streams(seed) for seed in seeds]
        drawn: dict[str, NDArray[np.float64]] = {}
        for each in fields(self):
            size, (low, high) = _size(each.name), getattr(self, each.name)
            shares = np.array([stream[each.name].random(size) for stream in streams])
            shares = shares.reshape(-1, *size)
            if each.name in OWN_CONTACT:
                drawn[each.name] = low * (high / low) ** shares
            else:
                drawn[each.name] = low + (high - low) * shares
        drawn["strength"] = drawn["strength"] * drawn.pop("overall_strength")[:, None]
        noise_seeds = [stream["noise_seed"].integers(NOISE_SEEDS) for stream in streams]
        return Worlds(**drawn, noise_seed=np.array(noise_seeds, dtype=np.float64))

    def document(self) -> dict[str, list[float]]:
        """The table [world] of these ranges: only those that are not nominal."""
        return {
            each.name: list(getattr(self, each.name))
            for each in fields(self)
            if getattr(self, each.name) != getattr(NOMINAL, each.name)
        }


NOMINAL = WorldRanges()
STREAMS = tuple(LIMITS)  # in this order; a new one comes last
OWN_CONTACT = ("contact_stiffness", "relaxation_speed")  # numbers of our own engine's contact law
NOT_OURS = "1 with the engine mujoco, whose contact is a setting of its own"


def read_world(table: Table, engine: str = OWN_ENGINE) -> WorldRanges:
    """The table [world]: pairs of numbers, lowest and highest; a missing one is nominal.

    Reads every key.

    Raises:
        InputError: an unknown key, a range that is empty or out of bounds, or a contact of our own
            engine for another one.
    """
    ranges = WorldRanges(
        **{
            each.name: table.range(each.name, getattr(NOMINAL, each.name), *LIMITS[each.name])
            for each in fields(NOMINAL)
        }
    )
    table.done()
    if engine != OWN_ENGINE:
        for name in set(ranges.document()) & set(OWN_CONTACT):
            raise InputError(table.path(name), getattr(ranges, name), NOT_OURS)
    return ranges


def _streams(seed: int | np.random.SeedSequence) -> dict[str, np.random.Generator]:
    """A stream for each of a world's numbers, so that a new number changes no other's."""
    known = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    unused = np.random.SeedSequence(known.entropy, spawn_key=known.spawn_key)  # of no child yet
    streams = map(np.random.default_rng, unused.spawn(len(STREAMS)))
    return dict(zip(STREAMS, streams, strict=True))


def _size(name: str) -> tuple[int, ...]:
    """Numbers of that name in one world."""
    return (MUSCLE_COUNT,) if name == "strength" else ()

"""What differs from walker to walker besides links and ground: contact, muscles, nerves.

The nominal world is that of the published walker. `WorldRanges` draws others.
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from storage.inputs import checks
from storage.inputs.config import REQUIRED, Table
from storage.inputs.errors import InputError
from taichi_nmm.body import SIDES, Collection
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
HEALTHY = (1.0,) * MUSCLE_COUNT
MUSCLE_LIMITS: dict[str, Range] = {  # of each muscle, over the nominal
    "optimal_length": (0.5, 2.0),
    "slack_length": (0.5, 2.0),
    "activation_time": (0.1, 10.0),
}
PROSTHESIS_LIMITS: dict[str, Range] = {
    "stiffness_nmprad": (0.0, 2000.0),
    "damping_nmsprad": (0.0, 5.0),
    "rest_rad": (
        math.radians(-20.0),
        math.radians(40.0),
    ),  # between the stops of `kernel.joints`
}
# Of a push and of a slip; times are whole ticks of the controller.
BEGINS: dict[str, Range] = {"time_s": (0.0, 1e4), "duration_s": (1e-3, 1e4)}
EVENT_LIMITS = {
    "push": BEGINS | {"force_n": (-5000.0, 5000.0)},
    "slip": BEGINS | {"friction": (0.0, LIMITS["friction"][1])},
}
ACROSS_ANKLE = ("SOL", "TA", "GAS")
MOTIONS = {  # of an exoskeleton: hip extension, knee flexion and plantarflexion, positive
    "hip_extension": (1.0, 0.0, 0.0),
    "hip_flexion": (-1.0, 0.0, 0.0),
    "knee_extension": (0.0, -1.0, 0.0),
    "knee_flexion": (0.0, 1.0, 0.0),
    "plantarflexion": (0.0, 0.0, 1.0),
    "dorsiflexion": (0.0, 0.0, -1.0),
}
POWER_W: Range = (1.0, 1e6)  # the last is no limit
FOOT_SHAPE = (len(SIDES), len(PROSTHESIS_LIMITS))  # of a world's numbers
DEVICE_SHAPE = (len(SIDES), 4)
EVENT_SHAPE = (3,)


@dataclass(frozen=True)
class Prosthesis:
    """A passive foot: a linear spring and damper in an ankle that no muscle crosses any more.

    Its torque on the foot is stiffness (rest - angle) - damping rate; angles are
    plantarflexion positive, 0 being a foot square to the shank. The ankle keeps its
    stops, and the leg its masses.

    Attributes:
        side: "left" or "right".
        stiffness_nmprad: 0 to 2000.
        damping_nmsprad: 0 to 5.
        rest_rad: the angle without torque.
    """

    side: str
    stiffness_nmprad: float
    damping_nmsprad: float
    rest_rad: float = 0.0

    def __post_init__(self) -> None:
        numbers = {
            name: checks.number(*limits) for name, limits in PROSTHESIS_LIMITS.items()
        }
        checks.check_fields(self, "prosthesis.", side=checks.word(*SIDES), **numbers)

    @property
    def row(self) -> NDArray[np.float64]:
        """As `Worlds` have it, [2, 3]."""
        numbers = (self.stiffness_nmprad, self.damping_nmsprad, self.rest_rad)
        return np.array(
            [numbers if side == self.side else (0.0,) * 3 for side in SIDES]
        )


@dataclass(frozen=True)
class Exoskeleton:
    """What an exoskeleton does with its torque, whose curve low-level gains tell (`exo_torque`).

    Attributes:
        motion: that it helps, of `MOTIONS`.
        side: "left", "right" or "both".
        power_w: the most that it gives to a leg, W; its torque is lowered to this.
    """

    motion: str = "plantarflexion"
    side: str = "both"
    power_w: float = POWER_W[1]

    def __post_init__(self) -> None:
        words = {"motion": checks.word(*MOTIONS), "side": checks.word("both", *SIDES)}
        checks.check_fields(
            self, "exoskeleton.", **words, power_w=checks.number(*POWER_W)
        )

    @property
    def row(self) -> NDArray[np.float64]:
        """As `Worlds` have it, [2, 4]."""
        shares = {
            side: MOTIONS[self.motion] if self.side in ("both", side) else (0.0,) * 3
            for side in SIDES
        }
        return np.array([(*shares[side], self.power_w) for side in SIDES])


@dataclass(frozen=True)
class Push:
    """A horizontal push at the trunk's centre of mass, once in a walk.

    Attributes:
        time_s: when it begins, before the walk ends.
        duration_s: how long it lasts, 0.001 at least.
        force_n: forwards; below 0 backwards, -5000 to 5000.
    """

    time_s: float
    duration_s: float
    force_n: float

    def __post_init__(self) -> None:
        _check_event(self, "push")


@dataclass(frozen=True)
class Slip:
    """Other friction of the ground, once in a walk.

    Attributes:
        time_s: when it begins, before the walk ends.
        duration_s: how long it lasts, 0.001 at least.
        friction: Coulomb's coefficient meanwhile, 0 to 10.
    """

    time_s: float
    duration_s: float
    friction: float

    def __post_init__(self) -> None:
        _check_event(self, "slip")


Event = TypeVar("Event", Push, Slip)


def _check_event(event: Push | Slip, name: str) -> None:
    limits = EVENT_LIMITS[name]
    numbers = {key: checks.number(*ends) for key, ends in limits.items()}
    checks.check_fields(event, f"{name}.", **numbers)


@dataclass(frozen=True, eq=False)
class Worlds(Collection):
    """A batch of worlds, one row each.

    Attributes:
        contact_stiffness: over the nominal, with which a body at rest sinks 1 cm into
            the ground on one point, [n].
        relaxation_speed: at which a contact lets go, over that of the `Settings`, [n].
            The lower, the more a contact damps.
        friction: Coulomb's coefficient, [n].
        strength: largest force over the nominal of each muscle of the left leg, then
            the right, [n, 14]; 0 where it is missing. Nerves feel the force itself: a
            weaker muscle's reflex gets less.
        nerve_lag_s: time constant of a low pass of the signals, besides their delay,
            [n].
        sensing_noise: half the width of uniform noise on the signals, each tick anew,
            [n]: of forces over Fmax, lengths over the optimal one, loads over body
            weight, angles in rad, angular rates in 10 rad/s. Contact flags have neither
            noise nor lag.
        noise_seed: of the noise and the catches, whole numbers below 2^24, [n].
        catch_ns: largest impulse, N s, that holds a foot back when it catches, about
            once a second (`kernel.dynamics.catch_feet`), [n].
        prosthesis: stiffness, damping and rest angle of a passive foot on the left leg,
            then on the right, as in `Prosthesis`, [n, 2, 3]; 0 where there is none.
        optimal_length: of each muscle's fibre over the nominal, as `strength`, [n, 14].
        slack_length: of its tendon, likewise; where it is attached does not change.
        activation_time: the time constant from an order to the activation, likewise.
        exoskeleton: of the left leg, then the right: the shares of its torque that
            extend the hip, flex the knee and turn the foot down, -1 to 1, and its
            largest power in W, [n, 2, 4].
        push: when it begins, how long it lasts, and its force, as in `Push`, [n, 3]; 0
            where there is none.
        slip: as in `Slip`, likewise.
    """

    contact_stiffness: NDArray[np.float64]
    relaxation_speed: NDArray[np.float64]
    friction: NDArray[np.float64]
    strength: NDArray[np.float64]
    nerve_lag_s: NDArray[np.float64]
    sensing_noise: NDArray[np.float64]
    noise_seed: NDArray[np.float64]
    catch_ns: NDArray[np.float64]
    prosthesis: NDArray[np.float64]
    optimal_length: NDArray[np.float64]
    slack_length: NDArray[np.float64]
    activation_time: NDArray[np.float64]
    exoskeleton: NDArray[np.float64]
    push: NDArray[np.float64]
    slip: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._check_shapes("world", _size)
        every = LIMITS | MUSCLE_LIMITS
        within = {
            name: (vars(self)[name], every[name])
            for name in every
            if name in vars(self)
        }
        within["strength"] = self.strength, (0.0, LIMITS["strength"][1])
        for place, (name, limits) in enumerate(PROSTHESIS_LIMITS.items()):
            within[f"prosthesis.{name}"] = self.prosthesis[..., place], limits
        within["exoskeleton.share"] = self.exoskeleton[..., :3], (-1.0, 1.0)
        within["exoskeleton.power_w"] = self.exoskeleton[..., 3], POWER_W
        for event, ends in EVENT_LIMITS.items():
            columns = getattr(self, event).T
            for (name, (low, high)), values in zip(ends.items(), columns, strict=True):
                within[f"{event}.{name}"] = values, (min(low, 0.0), high)
        for name, (values, (low, high)) in within.items():
            outside = values[~((values >= low) & (values <= high))]
            if outside.size:
                raise InputError(
                    f"worlds.{name}", float(outside[0]), f"{low:g} to {high:g}"
                )

    @staticmethod
    @checks.checked(count=checks.whole(0, checks.MOST_ROWS))
    def nominal(count: int = 1) -> "Worlds":
        """`count` worlds of the published walker."""
        one = replace(NOMINAL.draw([0]), noise_seed=np.zeros(1))
        return one.take(np.zeros(count, dtype=np.intp))


def require_begun(worlds: Worlds, duration_s: float) -> None:
    """Refuse a push or a slip that begins once a walk of this length has ended.

    Raises:
        InputError: there is one.
    """
    for event in EVENT_LIMITS:
        begins_s, lasts_s, _ = getattr(worlds, event).T
        late = begins_s[(lasts_s > 0.0) & (begins_s >= duration_s)]
        if late.size:
            allowed = f"below {duration_s:g}, when the walk ends"
            raise InputError(f"world.{event}.time_s", float(late[0]), allowed)


@dataclass(frozen=True)
class WorldRanges:
    """The ranges that worlds are drawn from: lowest and highest value of each number.

    Each number is drawn from a stream of its own, and so is the seed of noise and
    catches: contact stiffness and relaxation speed log-uniformly, the others uniformly.
    Units are those of `Worlds`. A muscle's strength is `overall_strength` times its own
    `strength` times what `muscles` has for it. They pickle and hash.

    Attributes:
        contact_stiffness: over the nominal, 0.01 to 100.
        relaxation_speed: over that of the `Settings`, 0.1 to 100.
        friction: Coulomb's coefficient, 0.05 to 10.
        strength: of each muscle on its own, over the nominal, 0.1 to 10.
        nerve_lag_s: time constant of a low pass of the signals, 0 to 1.
        sensing_noise: half the width of uniform noise on the signals, 0 to 10.
        overall_strength: which all of a walker's muscles share, over the nominal, 0.1
            to 10.
        catch_ns: largest impulse that holds a foot back, N s, 0 to 50.
        muscles: factors of the strength in all worlds, the left leg's first, [14]: a
            weak soleus, a muscle that is missing (0).
        prosthesis: that all worlds have; None: none.
        optimal_length: factors of the fibres' optimal lengths in all worlds, as
            `muscles`, 0.5 to 2.
        slack_length: of the tendons' slack lengths, likewise.
        activation_time: of the time constants of activation, likewise, 0.1 to 10.
        exoskeleton: that all worlds have; without a peak torque among the gains it does
            nothing.
        push: that all worlds have; None: none.
        slip: likewise.
    """

    contact_stiffness: Range = AS_NOMINAL
    relaxation_speed: Range = AS_NOMINAL
    friction: Range = (FRICTION_COEFFICIENT, FRICTION_COEFFICIENT)
    strength: Range = AS_NOMINAL
    nerve_lag_s: Range = NONE
    sensing_noise: Range = NONE
    overall_strength: Range = AS_NOMINAL
    catch_ns: Range = NONE
    muscles: tuple[float, ...] = HEALTHY
    prosthesis: Prosthesis | None = None
    optimal_length: tuple[float, ...] = HEALTHY
    slack_length: tuple[float, ...] = HEALTHY
    activation_time: tuple[float, ...] = HEALTHY
    exoskeleton: Exoskeleton = Exoskeleton()
    push: Push | None = None
    slip: Slip | None = None

    def __post_init__(self) -> None:
        pairs = {name: checks.interval(*LIMITS[name]) for name in RANGES}
        low, high = LIMITS["strength"]
        checks.check_fields(
            self,
            "world.",
            **pairs,
            prosthesis=checks.optional(checks.instance(Prosthesis)),
            exoskeleton=checks.instance(Exoskeleton),
            push=checks.optional(checks.instance(Push)),
            slip=checks.optional(checks.instance(Slip)),
        )
        for name in ("muscles", *MUSCLE_LIMITS):
            given = getattr(self, name)
            if checks.numbers(f"world.{name}", given).shape != (MUSCLE_COUNT,):
                raise InputError(f"world.{name}", given, f"{MUSCLE_COUNT} numbers")
        for each, overall in zip(self.strength, self.overall_strength, strict=True):
            if not low <= each * overall <= high:
                allowed = (
                    f"with world.strength {each:g} a product of {low:g} to {high:g}"
                )
                raise InputError("world.overall_strength", overall, allowed)
        most = self.strength[1] * self.overall_strength[1]
        for name, factor in zip(MUSCLE_NAMES, self.muscles, strict=True):
            if not 0.0 <= factor * most <= high:
                raise InputError(
                    f"world.muscles.{name}", factor, f"0 to {high / most:g}"
                )

    @checks.checked(seeds=checks.each(checks.seed))
    def draw(self, seeds: Iterable[int | np.random.SeedSequence]) -> Worlds:
        """One world a seed.

        Args:
            seeds: one a world, n of them; a number of a world has a stream of its own.
        """
        streams = [_streams(seed) for seed in seeds]
        drawn = {name: self._drawn(name, streams) for name in RANGES}
        overall = drawn.pop("overall_strength")[:, None]
        drawn["strength"] = drawn["strength"] * overall * self.muscles
        foot = self.prosthesis
        if foot is not None:
            gone = [MUSCLE_NAMES.index(f"{name}_{foot.side}") for name in ACROSS_ANKLE]
            drawn["strength"][:, gone] = 0.0
        # What all of these worlds have.
        shared = {name: np.array(getattr(self, name), float) for name in MUSCLE_LIMITS}
        shared["prosthesis"] = np.zeros(FOOT_SHAPE) if foot is None else foot.row
        shared["exoskeleton"] = self.exoskeleton.row
        for event in EVENT_LIMITS:
            own = getattr(self, event)
            shared[event] = np.array(astuple(own) if own else np.zeros(EVENT_SHAPE))
        for name, row in shared.items():
            drawn[name] = np.repeat(row[None], len(streams), axis=0)
        noise_seeds = [stream["noise_seed"].integers(NOISE_SEEDS) for stream in streams]
        return Worlds(**drawn, noise_seed=np.array(noise_seeds, dtype=np.float64))

    def _drawn(
        self, name: str, streams: list[dict[str, np.random.Generator]]
    ) -> NDArray[np.float64]:
        """A number of each world, [n] or [n, 14], within its range."""
        size, (low, high) = _size(name), getattr(self, name)
        shares = np.array([stream[name].random(size) for stream in streams])
        shares = shares.reshape(-1, *size)
        if name in OWN_CONTACT:
            return np.asarray(low * (high / low) ** shares)
        return np.asarray(low + (high - low) * shares)

    def document(self) -> dict[str, Any]:
        """The table [world] of these ranges: only what is not nominal."""
        document: dict[str, Any] = {
            name: list(getattr(self, name))
            for name in RANGES
            if getattr(self, name) != getattr(NOMINAL, name)
        }
        muscles: dict[str, Any] = _changed(self.muscles)
        for name in MUSCLE_LIMITS:
            if changed := _changed(getattr(self, name)):
                muscles[name] = changed
        if muscles:
            document["muscles"] = muscles
        for name in ("prosthesis", *EVENT_LIMITS):
            if own := getattr(self, name):
                document[name] = asdict(own)
        if self.exoskeleton != NOMINAL.exoskeleton:
            document["exoskeleton"] = asdict(self.exoskeleton)
        return document


MUSCLE_NAMES = tuple(f"{muscle}_{side}" for side in SIDES for muscle in MUSCLES)
RANGES = tuple(each.name for each in fields(WorldRanges) if each.name in LIMITS)
NOMINAL = WorldRanges()
STREAMS = tuple(LIMITS)  # in this order; a new one comes last
# These belong to our own engine's contact law.
OWN_CONTACT = (
    "contact_stiffness",
    "relaxation_speed",
)
NOT_OURS = "1 with the engine mujoco, whose contact is a setting of its own"
NO_SLIP = "none with the engine mujoco, whose friction stays"


def read_world(table: Table, engine: str = OWN_ENGINE) -> WorldRanges:
    """The table [world]: pairs of numbers, lowest and highest; a missing one is nominal.

    [world.muscles] has factors of the strength of single muscles, by name (`SOL`), or
    name and side (`SOL_left`); its tables `optimal_length`, `slack_length` and
    `activation_time` those of these. [world.prosthesis] has the fields of `Prosthesis`,
    [world.exoskeleton] those of `Exoskeleton`, [world.push] those of `Push`,
    [world.slip] those of `Slip`. Reads every key.

    Raises:
        InputError: an unknown key, a range that is empty or out of bounds, or a contact
            of our own engine for another one.
    """
    pairs = {
        name: table.range(name, getattr(NOMINAL, name), *LIMITS[name])
        for name in RANGES
    }
    named = table.table("muscles")
    muscles = _read_muscles(named, 0.0, LIMITS["strength"][1])
    own = dict[str, Any]()
    for name, limits in MUSCLE_LIMITS.items():
        own[name] = _read_muscles(named.table(name), *limits)
        named.table(name).done()
    named.done()
    ranges = WorldRanges(
        **pairs,
        **own,
        muscles=muscles,
        prosthesis=_read_prosthesis(table),
        exoskeleton=_read_exoskeleton(table.table("exoskeleton")),
        push=_read_event(table, "push", Push),
        slip=_read_event(table, "slip", Slip),
    )
    table.done()
    if engine != OWN_ENGINE:
        for name in set(ranges.document()) & set(OWN_CONTACT):
            raise InputError(table.path(name), getattr(ranges, name), NOT_OURS)
        if ranges.slip:
            raise InputError(table.path("slip"), "a table", NO_SLIP)
    return ranges


def _changed(factors: tuple[float, ...]) -> dict[str, float]:
    """Those of 14 that are not 1, by muscle and side."""
    both = zip(MUSCLE_NAMES, factors, strict=True)
    return {name: factor for name, factor in both if factor != 1.0}


def _read_muscles(table: Table, low: float, high: float) -> tuple[float, ...]:
    both = {muscle: table.number(muscle, 1.0, low, high) for muscle in MUSCLES}
    return tuple(
        table.number(f"{muscle}_{side}", both[muscle], low, high)
        for side in SIDES
        for muscle in MUSCLES
    )


def _read_prosthesis(world: Table) -> Prosthesis | None:
    if not world.has("prosthesis"):
        return None
    table = world.table("prosthesis")
    side = table.text("side", choices=SIDES)
    numbers = {}
    for name, limits in PROSTHESIS_LIMITS.items():
        usual = Prosthesis.rest_rad if name == "rest_rad" else REQUIRED
        numbers[name] = table.number(name, usual, *limits)
    table.done()
    return Prosthesis(side, **numbers)


def _read_exoskeleton(table: Table) -> Exoskeleton:
    usual = Exoskeleton()
    motion = table.text("motion", usual.motion, choices=tuple(MOTIONS))
    side = table.text("side", usual.side, choices=("both", *SIDES))
    power_w = table.number("power_w", usual.power_w, *POWER_W)
    table.done()
    return Exoskeleton(motion=motion, side=side, power_w=power_w)


def _read_event(world: Table, name: str, kind: type[Event]) -> Event | None:
    if not world.has(name):
        return None
    table = world.table(name)
    numbers = {
        key: table.number(key, REQUIRED, *ends)
        for key, ends in EVENT_LIMITS[name].items()
    }
    table.done()
    return kind(**numbers)


def _streams(seed: int | np.random.SeedSequence) -> dict[str, np.random.Generator]:
    """A stream for each of a world's numbers, so that a new number changes no other's."""
    sequence = (
        seed
        if isinstance(seed, np.random.SeedSequence)
        else np.random.SeedSequence(seed)
    )
    # One of the same numbers that has spawned no child yet.
    unused = np.random.SeedSequence(sequence.entropy, spawn_key=sequence.spawn_key)
    streams = map(np.random.default_rng, unused.spawn(len(STREAMS)))
    return dict(zip(STREAMS, streams, strict=True))


def _size(name: str) -> tuple[int, ...]:
    """Numbers of that name in one world."""
    if name == "prosthesis":
        return FOOT_SHAPE
    if name == "exoskeleton":
        return DEVICE_SHAPE
    if name in EVENT_LIMITS:
        return EVENT_SHAPE
    return (MUSCLE_COUNT,) if name in ("strength", *MUSCLE_LIMITS) else ()

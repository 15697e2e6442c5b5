"""The walkers of a call: their input, checked, as a `Batch`, and the constants of the kernels.

Constants stay as they are, unless the walkers have a `Switch` to other gains.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.body import (
    GRAVITY_MPS2,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
    Bodies,
    Collection,
)
from taichi_nmm.initial import initial_rows
from taichi_nmm.kernel.contact import STATIC_DEFLECTION_M
from taichi_nmm.kernel.layout import LEGS, LOW_LEVEL, PER_WALKER, Const, WalkerRows
from taichi_nmm.kernel.muscle import ACTIVATION_TIME_S, SHORTEST_FIBRE
from taichi_nmm.kernel.muscle_table import (
    OPTIMAL_LENGTH_M,
    SLACK_LENGTH_M,
    T_STRAIN,
    muscle_table,
)
from taichi_nmm.kernel.reflexes import LOAD_FILTER_S
from taichi_nmm.packs import Packs
from taichi_nmm.parameters import (
    ASYMMETRIES,
    GAINS,
    LOW_LEVEL_GAINS,
    Parameter,
    gain_rows,
)
from taichi_nmm.settings import CONTROL_TICK_S, Settings
from taichi_nmm.terrain import Terrain, flat
from taichi_nmm.world import Worlds

R = TypeVar("R", bound=Collection)

CHUNK_TICKS = 250  # 0.25 s: fallen walkers leave the packs this often
WALKERS_AT_ONCE = 4096  # whose gains the nearer caches hold
BLEND_TICKS = 10  # of a switch, for which gains stay the same


@dataclass(frozen=True, eq=False)
class Batch:
    """Checked input: n walkers, each with its gains, body and terrain.

    Attributes:
        gains: in the order of `parameters.GAINS`, [n, 16].
        low_level: in the order of `parameters.LOW_LEVEL_GAINS`, [n, 28], or [1, 28] of
            all walkers.
        bodies: one a walker, n of them, or one of all.
        worlds: likewise.
        terrains: the different grounds.
        terrain_index: the ground of each walker, [n].
    """

    gains: NDArray[np.float64]
    low_level: NDArray[np.float64]
    bodies: Bodies
    worlds: Worlds
    terrains: tuple[Terrain, ...]
    terrain_index: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.gains)

    @property
    def is_alike(self) -> bool:
        """Whether walkers differ in gains and terrain alone."""
        return len(self.low_level) == len(self.bodies) == len(self.worlds) == 1

    def each(self) -> "Batch":
        """The same with a body and a world for each walker."""
        every = np.arange(len(self))
        bodies, worlds = self.bodies, self.worlds
        return replace(
            self,
            bodies=bodies.take(every % len(bodies)),
            worlds=worlds.take(every % len(worlds)),
        )


def check_batch(
    gains: ArrayLike,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    terrain_index: ArrayLike | None = None,
    low_level_gains: ArrayLike | None = None,
    worlds: Worlds | None = None,
) -> Batch:
    """A `Batch` from the arguments of `simulate`; see there for defaults.

    Raises:
        InputError: a shape, a value or an index that cannot be used.
    """
    rows = gain_rows(gains)
    count = len(rows)
    defaults = [parameter.default for parameter in LOW_LEVEL_GAINS]
    given = defaults if low_level_gains is None else low_level_gains
    low_level = _row_each("low_level_gains", given, LOW_LEVEL_GAINS, count)
    bodies = Bodies.nominal() if bodies is None else bodies
    worlds = Worlds.nominal() if worlds is None else worlds
    grounds, index = _check_terrains(terrains, terrain_index, count)
    return Batch(
        gains=rows,
        low_level=low_level,
        bodies=_one_each("bodies", "body", bodies, Bodies, count),
        worlds=_one_each("worlds", "world", worlds, Worlds, count),
        terrains=grounds,
        terrain_index=index,
    )


def _one_each(field: str, one: str, given: R, kind: type[R], count: int) -> R:
    """Bodies or worlds of `count` walkers, one each or one of all."""
    rows: R = checks.instance(kind)(field, given)
    if len(rows) not in (1, count):
        raise InputError(field, len(rows), f"one {one}, or {count}: one a walker")
    return rows


def _row_each(
    field: str, given: ArrayLike, group: tuple[Parameter, ...], count: int
) -> NDArray[np.float64]:
    """Gains of `count` walkers, [n, gain], or of all, [1, gain]."""
    rows = gain_rows(given, group, field)
    size = len(group)
    if len(rows) not in (1, count):
        raise InputError(f"{field}.shape", rows.shape, f"[{count}, {size}] or [{size}]")
    return rows


def _check_terrains(
    terrains: Terrain | Sequence[Terrain] | None,
    terrain_index: ArrayLike | None,
    count: int,
) -> tuple[tuple[Terrain, ...], NDArray[np.int32]]:
    terrains = flat() if terrains is None else terrains
    listed = (terrains,) if isinstance(terrains, Terrain) else terrains
    grounds: tuple[Terrain, ...] = checks.each(checks.instance(Terrain))(
        "terrains", listed
    )
    if not grounds:
        raise InputError("terrains", "none", "at least one terrain")
    if terrain_index is None:
        if len(grounds) not in (1, count):
            allowed = f"one, or {count}: one a walker; else give terrain_index"
            raise InputError("terrains", len(grounds), allowed)
        return grounds, np.arange(count, dtype=np.int32) % np.int32(len(grounds))
    index = checks.row_numbers("terrain_index", terrain_index, len(grounds))
    if len(index) != count:
        raise InputError(
            "terrain_index.shape", index.shape, f"[{count}] of whole numbers"
        )
    return grounds, index.astype(np.int32)


@dataclass(frozen=True, eq=False)
class Switch:
    """Other gains from some time on, to which those before go over on a straight line.

    Attributes:
        at_s: when they begin to go over.
        gains: [n, gain] or [gain], in the order of `parameters.GAINS`.
        low_level_gains: likewise, of `parameters.LOW_LEVEL_GAINS`; None: those of the
            start.
        over_s: how long they take; two seconds are about two strides (docs/speeds.md).
    """

    at_s: float
    gains: ArrayLike
    low_level_gains: ArrayLike | None = None
    over_s: float = 2.0


class Schedule:
    """The constants of a batch's walkers from tick to tick."""

    def __init__(
        self, batch: Batch, settings: Settings, switches: Sequence[Switch]
    ) -> None:
        """Refuses switches that are not one after another."""
        every: tuple[Switch, ...] = checks.each(checks.instance(Switch))(
            "switches", switches
        )
        # The knots of the line that constants follow; no rows where they stay.
        self._ticks = [0]
        self._rows = [constant_rows(batch, settings)] if every else []
        for number, switch in enumerate(every):
            field = f"switches[{number}]"
            before_s = self._ticks[-1] * CONTROL_TICK_S
            at_s = checks.number(before_s)(f"{field}.at_s", switch.at_s)
            over_s = checks.number(CONTROL_TICK_S)(f"{field}.over_s", switch.over_s)
            given = switch.low_level_gains
            low_level = _row_each(
                f"{field}.low_level_gains",
                batch.low_level if given is None else given,
                LOW_LEVEL_GAINS,
                len(batch),
            )
            gains = _row_each(f"{field}.gains", switch.gains, GAINS, len(batch))
            gains = np.broadcast_to(gains, batch.gains.shape)
            later = replace(batch, gains=gains, low_level=low_level)
            self._ticks += [
                round(knot_s / CONTROL_TICK_S) for knot_s in (at_s, at_s + over_s)
            ]
            self._rows += [self._rows[-1], constant_rows(later, settings)]

    @property
    def is_constant(self) -> bool:
        """Whether all constants stay as they are."""
        return len(self._ticks) == 1

    def set_constants(self, packs: Packs, tick: int) -> int:
        """Give the walkers that are up the constants of a tick; for how many ticks they hold."""
        if self.is_constant:
            return CHUNK_TICKS  # as they were packed
        rows, ticks = self.at(tick)
        packs.constants[...] = packs.fold(rows[packs.walkers])
        return ticks

    def at(self, tick: int) -> tuple[NDArray[np.float64], int]:
        """The constants of a tick, [n, Const.count], and for how many ticks they hold."""
        place = bisect_right(self._ticks, tick) - 1
        last = place == len(self._ticks) - 1
        before = self._rows[place]
        after = before if last else self._rows[place + 1]
        begin = self._ticks[place]
        end = tick + CHUNK_TICKS if last else self._ticks[place + 1]
        changes = after is not before
        share = (tick - begin) / (end - begin) if changes else 0.0
        rows = (1.0 - share) * before + share * after
        return rows, min(BLEND_TICKS if changes else CHUNK_TICKS, end - tick)


def leg_gains(batch: Batch, real: type[np.floating[Any]]) -> NDArray[Any]:
    """The gains of each walker's legs, [PER_WALKER, n]."""
    asymmetry = np.broadcast_to(
        batch.low_level[:, -len(ASYMMETRIES) :], batch.gains.shape
    )
    found = np.empty((len(ASYMMETRIES), LEGS, len(batch)), dtype=real)
    for first in range(0, len(batch), WALKERS_AT_ONCE):
        some = slice(first, first + WALKERS_AT_ONCE)
        for leg, sign in enumerate((1.0, -1.0)):
            factor = 1.0 + sign * asymmetry[some]
            found[:, leg, some] = (factor * batch.gains[some]).T
    return found.reshape(PER_WALKER, -1)


def kind_rows(batch: Batch, settings: Settings) -> NDArray[np.float64]:
    """The other rows of `layout.Const`, of each walker or of all, [n or 1, row]."""
    if batch.is_alike:
        index = batch.terrain_index[:1]
        batch = replace(batch, gains=batch.gains[:1], terrain_index=index)
    return constant_rows(batch, settings)[:, PER_WALKER:]


def start_rows(batch: Batch) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Rows at the start, [start, WalkerRows.count], and which of them each walker has, [n]."""
    rows = np.array([initial_rows(terrain) for terrain in batch.terrains])
    fibre, slack = batch.worlds.optimal_length, batch.worlds.slack_length
    if np.all((fibre == 1.0) & (slack == 1.0)):
        return rows, batch.terrain_index
    # Relaxed fibres of other lengths: a row a walker.
    rows = rows[batch.terrain_index]
    slack_m = np.tile(SLACK_LENGTH_M, LEGS)
    optimal_m = np.tile(OPTIMAL_LENGTH_M, LEGS)
    lengths = WalkerRows.of(rows.T).fibres.length.T
    lengths += (1.0 - slack) * slack_m / optimal_m
    lengths[:] = np.maximum(lengths / fibre, SHORTEST_FIBRE)
    return rows, np.arange(len(batch), dtype=np.int32)


def constant_rows(batch: Batch, settings: Settings) -> NDArray[np.float64]:
    """`layout.Const` of each walker, [n, Const.count]."""
    bodies, worlds = batch.bodies, batch.worlds
    mass, inertia, com = bodies.mass_kg, bodies.inertia_kgm2, bodies.com_m
    rows = np.zeros((len(batch), Const.count))
    const = Const.of(rows.T)
    rows[:, :PER_WALKER] = leg_gains(batch, np.float64).T
    rows[:, LOW_LEVEL : Const.total_mass] = batch.low_level[:, : -len(ASYMMETRIES)]
    const.leg_angle_blend[:] = 1.0 - np.exp(-const.w_filter * CONTROL_TICK_S)
    const.total_mass[:] = mass.sum(axis=1)
    nominal_n_per_m = mass.sum(axis=1) * GRAVITY_MPS2 / STATIC_DEFLECTION_M
    const.contact_stiffness[:] = nominal_n_per_m * worlds.contact_stiffness
    const.relaxation_speed[:] = (
        settings.contact_relaxation_speed_mps * worlds.relaxation_speed
    )
    const.friction[:] = worlds.friction
    _fill_muscles(const, worlds, settings.physics_step_s)
    with np.errstate(divide="ignore"):  # no lag: all of the way in a tick
        const.nerve_blend[:] = 1.0 - np.exp(-CONTROL_TICK_S / worlds.nerve_lag_s)
    const.sensing_noise[:] = worlds.sensing_noise
    const.noise_seed[:] = worlds.noise_seed
    const.catch_ns[:] = worlds.catch_ns
    push, slip = ticks_of(worlds.push), ticks_of(worlds.slip)
    const.push_begin[:], const.push_end[:] = push
    const.slip_begin[:], const.slip_end[:] = slip
    const.push_n[:], const.slip_friction[:] = worlds.push[:, 2], worlds.slip[:, 2]
    const.disturbed[:] = (worlds.catch_ns > 0.0) | (push[1] > 0.0) | (slip[1] > 0.0)
    stiffness, damping, rest = worlds.prosthesis.T
    const.ankle_stiffness[:] = stiffness
    const.ankle_damping[:] = damping
    const.ankle_rest[:] = rest
    const.exo_share[:] = worlds.exoskeleton[:, :, :3].reshape(len(worlds), -1).T
    const.exo_power[:] = worlds.exoskeleton[:, :, 3].T
    const.hat_weight[:] = mass[:, 0] * GRAVITY_MPS2
    # The HAT's centre of mass lies above the hip while D points down: hence the sign.
    const.a_hat[:] = -mass[:, 0] * com[:, 0]
    const.b_hat[:] = inertia[:, 0] + mass[:, 0] * com[:, 0] ** 2
    for leg in range(LEGS):
        links = slice(1 + 3 * leg, 4 + 3 * leg)
        const.leg_weight[leg] = mass[:, links].sum(axis=1) * GRAVITY_MPS2
        a, b = leg_coefficients(mass[:, links], inertia[:, links], com[:, links])
        const.a_leg[3 * leg : 3 * leg + 3] = a.T
        const.b_leg[6 * leg : 6 * leg + 6] = b.T
        _check_prosthesis(batch, leg, b[:, 2], settings.physics_step_s)
    return rows


def ticks_of(event: NDArray[np.float64]) -> NDArray[np.float64]:
    """First tick of a push or slip of `Worlds`, [n, 3], and the first after it; 0: none, [2, n]."""
    begins_s, lasts_s, _ = event.T
    ends_s = np.where(lasts_s > 0.0, begins_s + lasts_s, 0.0)
    return np.round(np.array([begins_s, ends_s]) / CONTROL_TICK_S)


def _fill_muscles(const: Any, worlds: Worlds, step_s: float) -> None:
    """Constants of each walker's muscles, in `const`, named rows [row, n]."""
    fibre, slack = worlds.optimal_length.T, worlds.slack_length.T
    slowness = worlds.activation_time.T
    nominal = np.tile(muscle_table(step_s)[:, T_STRAIN], LEGS)[:, None]
    const.strength[:] = worlds.strength.T
    const.activation_blend[:] = 1.0 - np.exp(-step_s / (ACTIVATION_TIME_S * slowness))
    const.stretch[:] = nominal * fibre / slack
    const.tightness[:] = 1.0 / slack
    own = (fibre != 1.0) | (slack != 1.0) | (slowness != 1.0)
    const.own_muscles[:] = own.any(axis=0)


def _check_prosthesis(
    batch: Batch, leg: int, inertia_kgm2: NDArray[np.float64], step_s: float
) -> None:
    """Refuse a foot that is too light for its damper, of this inertia about the ankle, [n].

    The torque of a step is that of its begin. Alone, the foot would gain energy where
    step (damping + stiffness step / 2) is more than twice its inertia; the shank halves
    this.
    """
    stiffness, damping, _ = batch.worlds.prosthesis[:, leg].T
    most = inertia_kgm2 / step_s - 0.5 * stiffness * step_s
    if np.any(damping > most):
        worst = int(np.argmax(damping - most))
        allowed = f"up to {max(most[worst], 0.0):.3g} with this stiffness, foot and physics step"
        raise InputError(
            "worlds.prosthesis.damping_nmsprad", float(damping[worst]), allowed
        )


def leg_coefficients(
    mass: NDArray[np.float64], inertia: NDArray[np.float64], com: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A1 A2 A3, [n, 3], and B11 B22 B33 B12 B13 B23, [n, 6], of legs.

    Args:
        mass: of thigh, shank and foot, kg, [n, 3].
        inertia: of these about their centres of mass, kg m2, [n, 3].
        com: from the proximal joint, m, [n, 3].
    """
    m1, m2, m3 = mass.T
    i1, i2, i3 = inertia.T
    c1, c2, c3 = com.T
    below_hip = m1 * c1 + (m2 + m3) * THIGH_LENGTH_M
    below_knee = m2 * c2 + m3 * SHANK_LENGTH_M
    below_ankle = m3 * c3
    a = np.column_stack([below_hip, below_knee, below_ankle])
    b = np.column_stack(
        [
            i1 + m1 * c1**2 + (m2 + m3) * THIGH_LENGTH_M**2,
            i2 + m2 * c2**2 + m3 * SHANK_LENGTH_M**2,
            i3 + m3 * c3**2,
            below_knee * THIGH_LENGTH_M,
            below_ankle * THIGH_LENGTH_M,
            below_ankle * SHANK_LENGTH_M,
        ]
    )
    return a, b


def blends(step_s: float) -> tuple[float, float]:
    """Blends of a physics step: to a new activation, and of the low pass of the loads, 0 to 1.

    Args:
        step_s: of the physics.
    """
    activation, load = 1.0 - np.exp(
        -step_s / np.array([ACTIVATION_TIME_S, LOAD_FILTER_S])
    )
    return float(activation), float(load)

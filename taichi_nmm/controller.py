"""`Controller`: muscles, delays, reflexes and swing-leg placement for a body of anybody's.

The body may live in any simulator, or in a room. Every physics step it says what it senses
(`Sensed`) and gets the torques of its six joints. docs/controller.md has an example on one page.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.constants import blends, constant_rows
from taichi_nmm.errors import InputError
from taichi_nmm.initial import filled_delays, first_signals, relaxed_fibres
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.controller import actuate
from taichi_nmm.kernel.layout import (
    FIRST_DELAY,
    FIRST_EVENT,
    FIRST_FIBRE,
    LEGS,
    MUSCLE_COUNT,
    WALKER_ROWS,
    Muscle,
    Sense,
    Signal,
    State,
)
from taichi_nmm.kernel.muscle_table import FMAX_N, muscle_table
from taichi_nmm.kernel.swing import HOLD
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import check_batch

JOINTS = 3 * LEGS


@dataclass(frozen=True, eq=False)
class Sensed:
    """What n bodies sense at the beginning of a physics step, left leg first.

    Forward is +x, up +z; a segment's angle is zero upright and positive clockwise, seen with +x to
    the right: a trunk that leans forward, a leg whose foot is behind the hip.

    Attributes:
        joint_rad: hip, knee, ankle of the left leg, then the right, [n, 6]: segment below less
            segment above, so extension, flexion and plantarflexion are positive. Zero is standing
            straight with the feet flat.
        joint_rate_radps: their rates, [n, 6].
        trunk_rad: lean of the trunk, forward positive, [n].
        trunk_rate_radps: its rate, [n].
        contact: whether a foot is on the ground, [n, 2].
        load_n: vertical ground force on each foot, [n, 2]: of the last physics step, 0 at first.
        leg_length_m: from hip to ankle, [n, 2].
        leg_angle_rad: of the line hip - ankle, [n, 2]; pi/2 is vertical, less is a foot in front.
        com_ahead_m: horizontal distance of the body's centre of mass ahead of each ankle, [n, 2].
        com_speed_mps: its forward velocity, [n].
    """

    joint_rad: ArrayLike
    joint_rate_radps: ArrayLike
    trunk_rad: ArrayLike
    trunk_rate_radps: ArrayLike
    contact: ArrayLike
    load_n: ArrayLike
    leg_length_m: ArrayLike
    leg_angle_rad: ArrayLike
    com_ahead_m: ArrayLike
    com_speed_mps: ArrayLike

    def checked(self, count: int) -> dict[str, NDArray[np.float64]]:
        """The arrays by name.

        Raises:
            InputError: an array of another shape, or one with NaN or infinity.
        """
        arrays = {name: np.asarray(getattr(self, name)) for name in WIDTHS}
        for (name, width), array in zip(WIDTHS.items(), arrays.values(), strict=True):
            shape = (count, width) if width else (count,)
            if array.shape != shape:
                raise InputError(f"sensed.{name}.shape", array.shape, f"{list(shape)}")
            if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
                raise InputError(f"sensed.{name}", "nan, inf or no number", "finite numbers")
        return arrays


WIDTHS = {
    "joint_rad": JOINTS, "joint_rate_radps": JOINTS, "trunk_rad": 0, "trunk_rate_radps": 0,
    "contact": LEGS, "load_n": LEGS, "leg_length_m": LEGS, "leg_angle_rad": LEGS,
    "com_ahead_m": LEGS, "com_speed_mps": 0,
}  # of `Sensed`'s arrays; 0: [n]  # fmt: skip
AS_SENSED = {
    "contact": Sense.contact, "load_n": Sense.load, "leg_length_m": Sense.leg_length,
    "leg_angle_rad": Sense.leg_angle, "com_ahead_m": Sense.com_ahead,
}  # rows of two legs  # fmt: skip


def sense_rows(arrays: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Rows of `layout.Sense`, [n, Sense.count]: angles of the segments in place of the joints'."""
    rows = np.empty((len(arrays["trunk_rad"]), Sense.count))
    for first, trunk, joints in (
        (Sense.angle, "trunk_rad", "joint_rad"),
        (Sense.rate, "trunk_rate_radps", "joint_rate_radps"),
    ):
        rows[:, first] = arrays[trunk]
        legs = np.cumsum(arrays[joints].reshape(-1, LEGS, 3), axis=2)
        rows[:, first + 1 : first + 1 + JOINTS] = legs.reshape(-1, JOINTS) + rows[:, first, None]
    for name, first in AS_SENSED.items():
        rows[:, first : first + LEGS] = arrays[name]
    rows[:, Sense.com_speed] = arrays["com_speed_mps"]
    return rows


@dataclass(frozen=True, eq=False)
class Muscles:
    """State of the muscles of n controllers, [n, 14]: `result.MUSCLES` left leg, then right.

    Attributes:
        activation: 0.01 to 1.
        stimulation: what the reflexes order, 0.01 to 1.
        length: of the contractile element, over its optimal length.
        force_n: of the muscle-tendon unit, N.
    """

    activation: NDArray[np.float64]
    stimulation: NDArray[np.float64]
    length: NDArray[np.float64]
    force_n: NDArray[np.float64]


class Controller:
    """n neuromuscular controllers, a batch; each walks a body that somebody else simulates.

    Call `step` once a physics step (`settings.physics_step_s`); new orders go to the muscles every
    1 ms. The first call begins the walk: muscles are relaxed, and nerves feel that moment.

    Args:
        gains: [n, gain] or [gain], in the order of `parameters.GAINS`.
        bodies: what the controllers take the bodies' weights to be, one for all or n; None is the
            nominal 80 kg. Loads are felt relative to the trunk's weight.
        low_level_gains: [n, gain] or [gain], in the order of `parameters.LOW_LEVEL_GAINS`.
        settings: precision and physics step; contact and engine are not used.

    Raises:
        InputError: a shape or a value that cannot be used.
    """

    def __init__(
        self,
        gains: ArrayLike,
        *,
        bodies: Bodies | None = None,
        low_level_gains: ArrayLike | None = None,
        settings: Settings | None = None,
    ) -> None:
        self._settings = (settings or Settings()).on_processor()
        batch = check_batch(gains, bodies, None, None, low_level_gains)
        self._constants = constant_rows(batch.gains, batch.low_level, batch.bodies)
        self._packs: Packs | None = None
        self._step = 0

    def __len__(self) -> int:
        return len(self._constants)

    def step(self, sensed: Sensed) -> NDArray[np.float64]:
        """Joint torques for the coming physics step, N m, [n, 6], in the order of `joint_rad`.

        They are those of muscles and swing control; stops of the joints are the body's own.

        Raises:
            InputError: an array of another shape, or one with NaN or infinity. Nothing has then
                happened: the step may be repeated.
        """
        arrays = sensed.checked(len(self))
        backend.start(self._settings)
        if self._packs is None:
            self._bind(self._begin(arrays))
        elif self._actuate.stale:
            self._bind(self._packs.unfold(self._packs.rows))
        tick, within = divmod(self._step, self._settings.substeps)
        self._senses[...] = self._packs.fold(sense_rows(arrays))
        self._actuate.launch(tick=tick, commands=int(within == 0))
        self._step += 1
        return self._packs.unfold(self._torques).astype(np.float64)

    def keep(self, rows: ArrayLike) -> None:
        """Go on with these controllers alone, in this order: the others' bodies have fallen.

        Raises:
            InputError: a row that is not there.
        """
        index = np.asarray(rows)
        if index.ndim != 1 or index.dtype.kind not in "iu":
            raise InputError("rows", rows, "whole numbers, [k]")
        if len(index) and not (index.min() >= 0 and index.max() < len(self)):
            raise InputError("rows", rows, f"0 to {len(self) - 1}")
        self._constants = self._constants[index]
        if self._packs is not None:
            self._bind(self._packs.unfold(self._packs.rows)[index])

    @property
    def muscles(self) -> Muscles:
        """The muscles after the last step.

        Raises:
            InputError: before the first.
        """
        if self._packs is None:
            raise InputError("controller.muscles", "no step yet", "a first step")
        rows = self._packs.unfold(self._packs.rows)[:, FIRST_FIBRE:].astype(np.float64)

        def block(first: int) -> NDArray[np.float64]:
            return rows[:, first : first + MUSCLE_COUNT]

        return Muscles(
            activation=block(Muscle.activation),
            stimulation=block(Muscle.stimulation),
            length=block(Muscle.length),
            force_n=block(Muscle.force) * np.tile(FMAX_N, LEGS),
        )

    def _begin(self, sensed: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """The controllers at the start: relaxed muscles, nerves that feel the first moment."""
        rows = np.zeros((len(self), WALKER_ROWS))
        rows[:, State.leg_angle_filter : State.leg_angle_filter + LEGS] = sensed["leg_angle_rad"]
        rows[:, State.stance_before : State.stance_before + LEGS] = sensed["contact"]
        rows[:, State.swing_phase : State.swing_phase + LEGS] = HOLD
        rows[:, State.active] = 1.0
        joints, rates = (
            sensed[name].reshape(-1, LEGS, 3) for name in ("joint_rad", "joint_rate_radps")
        )
        for n, row in enumerate(rows):
            fibres = relaxed_fibres(joints[n])
            signals = first_signals(fibres, joints[n, :, 1], sensed["contact"][n])
            signals[Signal.knee_rate : Signal.knee_rate + LEGS] = rates[n, :, 1]
            signals[Signal.trunk] = sensed["trunk_rad"][n]
            signals[Signal.trunk_rate] = sensed["trunk_rate_radps"][n]
            row[FIRST_FIBRE:FIRST_DELAY] = fibres
            row[FIRST_DELAY:FIRST_EVENT] = filled_delays(signals)
        return rows

    def _bind(self, rows: NDArray[np.floating]) -> None:
        """Pack the controllers' rows, and bind the kernel to them."""
        real, lanes, step_s = backend.real_dtype(), backend.lanes(), self._settings.physics_step_s
        nowhere = np.zeros(len(rows), dtype=np.int32)
        self._packs = Packs(rows, self._constants, nowhere, lanes, real)
        self._senses = np.zeros((len(self._packs.rows), Sense.count, lanes), dtype=real)
        self._torques = np.zeros((len(self._packs.rows), JOINTS, lanes), dtype=real)
        self._actuate = backend.BoundKernel(
            actuate, lanes, self._packs.rows, self._packs.constants,
            muscle_table(step_s).astype(real), self._senses, self._torques, 0, 1, *blends(step_s),
        )  # fmt: skip

"""`Observation`: the senses of bodies at a physics step, for a `Controller`; checked."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.kernel.layout import LEGS, Sense

JOINTS = 3 * LEGS

# Beyond, sines are of rounding errors, and squares leave float32: torques would be
# noise, or NaN.
LARGEST_ANGLE_RAD = 100.0  # 16 turns
LARGEST_SENSE = 1e6  # of any other number, in its unit


@dataclass(frozen=True, eq=False)
class Observation:
    """The senses of n bodies at the beginning of a physics step, left leg first.

    Forward is +x, up +z; a segment's angle is zero upright and positive clockwise, seen
    with +x to the right: a trunk that leans forward, a leg whose foot is behind the
    hip.

    Attributes:
        joint_rad: hip, knee, ankle of the left leg, then the right, [n, 6]: segment
            below less segment above, so extension, flexion and plantarflexion are
            positive. Zero is standing straight with the feet flat.
        joint_rate_radps: their rates, [n, 6].
        trunk_rad: lean of the trunk, forward positive, [n].
        trunk_rate_radps: its rate, [n].
        contact: whether a foot is on the ground, [n, 2].
        load_n: vertical ground force on each foot, [n, 2]: of the last physics step, 0
            at first.
        leg_length_m: from hip to ankle, [n, 2].
        leg_angle_rad: of the line hip - ankle, [n, 2]; pi/2 is vertical, less is a foot
            in front.
        com_ahead_m: horizontal distance of the body's centre of mass ahead of each
            ankle, [n, 2].
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
            InputError: an array of another shape, one with NaN, infinity or a number
                beyond all bodies, or a contact that is neither 0 nor 1.
        """
        checks.whole(0)("count", count)
        arrays = {}
        for name, width in WIDTHS.items():
            field = f"observation.{name}"
            shape = (count, width) if width else (count,)
            array = arrays[name] = checks.numbers(field, getattr(self, name))
            if array.shape != shape:
                raise InputError(f"{field}.shape", array.shape, f"{list(shape)}")
            largest = LARGEST_ANGLE_RAD if name.endswith("_rad") else LARGEST_SENSE
            require_within(field, array, largest)
        contact = arrays["contact"]
        if not np.all((contact == 0) | (contact == 1)):
            other = contact[(contact != 0) & (contact != 1)][0].item()
            raise InputError(
                "observation.contact",
                other,
                "0 or 1: whether, not how many or how much",
            )
        return arrays


def require_within(field: str, values: NDArray[np.float64], largest: float) -> None:
    """Refuse an array, of any shape, with a number that is not from -`largest` to `largest`.

    Raises:
        InputError: naming the first such number.
    """
    outside = values[~(np.abs(values) <= largest)]
    if outside.size:
        allowed = f"finite numbers, from {-largest:g} to {largest:g}"
        raise InputError(field, float(outside[0]), allowed)


# Columns of `Observation`'s arrays; 0 is one of [n].
WIDTHS = {
    "joint_rad": JOINTS,
    "joint_rate_radps": JOINTS,
    "trunk_rad": 0,
    "trunk_rate_radps": 0,
    "contact": LEGS,
    "load_n": LEGS,
    "leg_length_m": LEGS,
    "leg_angle_rad": LEGS,
    "com_ahead_m": LEGS,
    "com_speed_mps": 0,
}
# Senses of both legs, by their first rows.
AS_SENSED = {
    "contact": Sense.contact,
    "load_n": Sense.load,
    "leg_length_m": Sense.leg_length,
    "leg_angle_rad": Sense.leg_angle,
    "com_ahead_m": Sense.com_ahead,
}


def sense_rows(arrays: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Rows of `layout.Sense`, [n, Sense.count]: angles of the segments in place of the joints'."""
    rows = np.empty((len(arrays["trunk_rad"]), Sense.count))
    for first, trunk, joints in (
        (Sense.angle, "trunk_rad", "joint_rad"),
        (Sense.rate, "trunk_rate_radps", "joint_rate_radps"),
    ):
        rows[:, first] = arrays[trunk]
        legs = np.cumsum(arrays[joints].reshape(-1, LEGS, 3), axis=2)
        rows[:, first + 1 : first + 1 + JOINTS] = (
            legs.reshape(-1, JOINTS) + rows[:, first, None]
        )
    for name, first in AS_SENSED.items():
        rows[:, first : first + LEGS] = arrays[name]
    rows[:, Sense.com_speed] = arrays["com_speed_mps"]
    return rows

"""A fall in words: which way it went, and what came before it, read from the recorded walk.

Said are the bound that was passed, the foot that touched the ground last, what that
foot hit, a foot that slipped, and a knee that gave way. These are what was seen, not
what was the cause.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.pictures.stick_figure import LEFT, RIGHT, finite, leg
from taichi_nmm.result import (
    EVENT_KINDS,
    FALL_HEIGHT_M,
    FALL_LEAN_RAD,
    FELL,
    Trajectory,
)
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

Floats = NDArray[np.float64]

SIDES = {LEFT: "left", RIGHT: "right"}
TRUNK_MASS_M = (
    0.35  # centre of mass of head, arms and trunk, above the hip along the trunk
)
ABOVE_FOOT_M = (
    0.10  # the trunk's mass is this far from the foot in a fall forwards or backwards
)
LOOKED_AT_S = 1.5  # before the end
FEWEST_SAMPLES = 2  # of fewer, nothing is known
# Beyond these a walker was lost; what feet did then is a part of the fall.
LOST_LEAN_RAD, LOST_HEIGHT_M = math.radians(30.0), 0.75
TOUCHING_M = 0.003  # a point of a foot is as near to the ground, or in it
SLIPPING_MPS, LEAST_SLIP_M = (
    0.3,
    0.05,
)  # a foot that bears weight on dry ground slides 1 cm
STEEP = 0.3  # rise over run: ramps have 0.2, the risers of blocks 0.32 and more
WITHIN_M = 0.3  # of a riser, its foot and its top
LOADED_N, GAVE_WAY_RAD = (
    200.0,
    math.radians(60.0),
)  # people bend a loaded knee by 25 deg


@dataclass(frozen=True)
class Seen:
    """The end of a walk of t samples, and where each foot is.

    Attributes:
        walk: the whole walk, as far as its pose is finite, [t].
        terrain: the ground it walked on.
        since: the first sample that is looked at.
        lost: the first one from which on the walker is lost, at `since` or later; t: it
            never was.
    """

    walk: Trajectory
    terrain: Terrain
    since: int
    lost: int

    def points(self, side: int) -> Floats:
        """Heel and ball of a foot, [t, 2, 2] in metres."""
        joints = leg(self.walk.q, side)
        return np.stack([joints.heel, joints.ball], axis=1)

    def touching(self, side: int) -> NDArray[np.bool_]:
        """Whether heel and ball of a foot are on the ground, [t, 2]."""
        points = self.points(side)
        above = points[..., 1] - self.terrain.height(points[..., 0].ravel()).reshape(
            -1, 2
        )
        return np.asarray((above < TOUCHING_M) & self.walk.stance[:, side : side + 1])

    def before_end_s(self, sample: int) -> float:
        """How long before the end a sample was."""
        return float(self.walk.time_s[-1] - self.walk.time_s[sample])


def fall_text(row: np.void, trajectory: Trajectory, terrain: Terrain) -> str:
    """Which way a walker fell and what was seen before, from ": " on; "" of one that did not fall.

    Args:
        row: of the simulator's result.
        trajectory: the whole walk, at 100 samples a second or more.
        terrain: the ground it walked on.
    """
    samples = np.isfinite(trajectory.q).all(axis=1).sum()
    if row["end_reason"] != FELL or samples < FEWEST_SAMPLES:
        return ""
    walk = finite(trajectory)
    seen = Seen(walk, terrain, *_ends(walk, terrain))
    parts = [_way(seen), _bound(seen), _last_foot(seen)]
    parts += [_caught(seen, side) for side in SIDES]
    parts += [_slip(seen, side) for side in SIDES]
    parts += [_knee(seen)]
    return f": {'; '.join(part for part in parts if part)}"


def _ends(walk: Trajectory, terrain: Terrain) -> tuple[int, int]:
    """The first sample that is looked at, and the first from which on the walker is lost."""
    height_m = walk.q[:, 1] - terrain.height(walk.q[:, 0])
    held = (np.abs(walk.q[:, 2]) < LOST_LEAN_RAD) & (height_m > LOST_HEIGHT_M)
    lost = int(np.flatnonzero(held).max(initial=-1)) + 1
    since = int(np.searchsorted(walk.time_s, walk.time_s[-1] - LOOKED_AT_S))
    return since, max(lost, since)


def _way(seen: Seen) -> str:
    """By the trunk that leans, or by its mass ahead of or behind the foot that touched last."""
    x, _, lean = seen.walk.q[-1, :3]
    if abs(lean) >= LOST_LEAN_RAD:
        return "forwards" if lean > 0 else "backwards"
    strike = _last_strike(seen)
    side = LEFT if strike is None else strike[1]
    foot_m = float(seen.points(side)[-1, :, 0].mean())
    ahead_m = x + TRUNK_MASS_M * math.sin(lean) - foot_m
    if abs(ahead_m) < ABOVE_FOOT_M:
        return "straight down"
    return "forwards" if ahead_m > 0 else "backwards"


def _bound(seen: Seen) -> str:
    """The bound of a fall that the last pose exceeds, or comes nearest to."""
    x, z, lean = seen.walk.q[-1, :3]
    height_m = float(z - seen.terrain.height(x))
    degrees, way = abs(math.degrees(lean)), "forwards" if lean > 0 else "backwards"
    if abs(lean) / FALL_LEAN_RAD > FALL_HEIGHT_M / max(height_m, 1e-6):
        return f"the trunk leaned {degrees:.0f} deg {way}"
    return f"the hip sank to {FALL_HEIGHT_M:g} m over the ground, the trunk {degrees:.0f} deg {way}"


def _last_strike(seen: Seen) -> tuple[float, int] | None:
    """Time and side of the last foot that came down; None: each has stood since the start."""
    events = seen.walk.events
    strikes = events[events["kind"] == EVENT_KINDS.index("strike")]
    if not len(strikes):
        return None
    last = strikes[np.argmax(strikes["time_s"])]
    return float(last["time_s"]), int(last["side"])


def _last_foot(seen: Seen) -> str:
    """The last foot that came down, when and where, and the rise or drop that it came down on."""
    strike = _last_strike(seen)
    if strike is None:
        return "no foot had been set down again"
    time_s, side = strike
    sample = min(
        int(np.searchsorted(seen.walk.time_s, time_s)), len(seen.walk.time_s) - 1
    )
    points = seen.points(side)[sample]
    above = points[:, 1] - seen.terrain.height(points[:, 0])
    x = float(points[above.argmin(), 0])
    words = f"the {SIDES[side]} foot touched last, {seen.walk.time_s[-1] - time_s:.2f} s before"
    words += f" at {x:.2f} m"
    if abs(steepness(seen.terrain, x)) < STEEP:
        return words
    part = "toe" if above.argmin() else "heel"
    return f"{words}: its {part} on the edge of a step {_step(seen.terrain, x)}"


def steepness(terrain: Terrain, x_m: float) -> float:
    """Rise over run of the ground about a place."""
    low, high = terrain.height(np.array([x_m - GRID_SPACING_M, x_m + GRID_SPACING_M]))
    return float(high - low) / (2.0 * GRID_SPACING_M)


def _step(terrain: Terrain, x_m: float) -> str:
    """Which way the ground goes about a place, and how far."""
    around = terrain.height(np.linspace(x_m - WITHIN_M, x_m + WITHIN_M, 25))
    way = "up" if steepness(terrain, x_m) > 0 else "down"
    return f"{way} ({100 * np.ptp(around):.0f} cm)"


def _caught(seen: Seen, side: int) -> str:
    """Where a foot that swung forwards met the edge of a step, before the walker was lost."""
    points, touching = seen.points(side), seen.touching(side)
    speed = np.gradient(points[:, :, 0], seen.walk.time_s, axis=0)
    met = touching & (speed > SLIPPING_MPS)
    for sample in range(seen.since, seen.lost):
        for place, part in enumerate(("heel", "toe")):
            x = float(points[sample, place, 0])
            if met[sample, place] and steepness(seen.terrain, x) > STEEP:
                words = f"the {SIDES[side]} {part} caught the edge of a step"
                step = _step(seen.terrain, x)
                return f"{words} {step} at {x:.2f} m, {seen.before_end_s(sample):.2f} s before"
    return ""


def _slip(seen: Seen, side: int) -> str:
    """How far a foot slid without a stop while it bore weight and the walker was not yet lost."""
    walk = seen.walk
    speed = np.gradient(seen.points(side)[:, :, 0], walk.time_s, axis=0)
    loaded = walk.ground_force_n[:, 2 * side + 1] > LOADED_N
    slides = seen.touching(side) & loaded[:, None] & (np.abs(speed) > SLIPPING_MPS)
    step_s = np.diff(walk.time_s).mean()
    most_m, began = 0.0, seen.since
    for place in range(2):  # heel and ball
        slid_m, first = 0.0, seen.since
        for sample in range(seen.since, seen.lost):
            if not slides[sample, place]:
                slid_m, first = 0.0, sample + 1
                continue
            slid_m += float(speed[sample, place] * step_s)
            if abs(slid_m) > abs(most_m):
                most_m, began = slid_m, first
    if abs(most_m) < LEAST_SLIP_M:
        return ""
    way = "forwards" if most_m > 0 else "backwards"
    before = f"{seen.before_end_s(began):.2f} s before"
    return f"the {SIDES[side]} foot slipped {100 * abs(most_m):.0f} cm {way}, from {before}"


def _knee(seen: Seen) -> str:
    """The knee that bent most under load, if it bent as none does in a stance."""
    bent_rad = {}
    for side in SIDES:
        knee = seen.walk.joint_rad[seen.since :, 3 * side + 1]
        loaded = seen.walk.ground_force_n[seen.since :, 2 * side + 1] > LOADED_N
        bent_rad[side] = float(np.where(loaded, knee, 0.0).max(initial=0.0))
    side = max(bent_rad, key=bent_rad.__getitem__)
    if bent_rad[side] < GAVE_WAY_RAD:
        return ""
    return f"the {SIDES[side]} knee gave way: {math.degrees(bent_rad[side]):.0f} deg under load"

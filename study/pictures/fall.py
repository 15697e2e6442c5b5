"""A fall in words: which way it went, and what came before it, read from the recorded walk.

Said are the bound that was passed, the foot that touched the ground last, what that
foot hit, a foot that slipped, and a knee that gave way. These are what was seen, not
what was the cause.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from study.pictures.stick_figure import LEFT, RIGHT, finite, leg, of_side
from taichi_nmm.result import (
    EVENT_KINDS,
    FALL_HEIGHT_M,
    FALL_LEAN_RAD,
    FELL,
    Trajectory,
)
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

Floats = NDArray[np.float64]
Truths = NDArray[np.bool_]

SIDES = {LEFT: "left", RIGHT: "right"}
PARTS = ("heel", "toe")  # of a foot
TRUNK_MASS_M = 0.35  # of head, arms and trunk, above the hip along the trunk
ABOVE_FOOT_M = 0.10  # a fall forwards or backwards has this mass farther from the foot
LOOKED_AT_S = 1.5  # before the end
FEWEST_SAMPLES = 2  # of fewer, nothing is known
# Beyond these a walker was lost; what feet did then is a part of the fall.
LOST_LEAN_RAD, LOST_HEIGHT_M = math.radians(30.0), 0.75
TOUCHING_M = 0.003  # a point of a foot is as near to the ground, or in it
SLIPPING_MPS = 0.3
LEAST_SLIP_M = 0.05  # a foot that bears weight on dry ground slides 1 cm
STEEP = 0.3  # rise over run: ramps have 0.2, the risers of blocks 0.32 and more
WITHIN_M = 0.3  # of a riser, its foot and its top
LOADED_N = 200.0
GAVE_WAY_RAD = math.radians(60.0)  # people bend a loaded knee by 25 deg
ALONG_TIME = np.array([[0, 1, 0]] * 3)  # neighbours in [t, parts]: of the same part


@dataclass(frozen=True, eq=False)
class Foot:
    """What a foot did in a walk of t samples.

    Attributes:
        name: its side.
        points_m: heel and ball, x and z, [t, 2, 2].
        speed_mps: of both forwards, [t, 2].
        touching: whether each is on the ground, [t, 2].
        loaded: whether the foot bears weight, [t].
        knee_rad: flexion of the knee above, [t].
    """

    name: str
    points_m: Floats
    speed_mps: Floats
    touching: Truths
    loaded: Truths
    knee_rad: Floats


@dataclass(frozen=True, eq=False)
class Seen:
    """The end of a walk of t samples, and where each foot is.

    Attributes:
        walk: the whole walk, as far as its pose is finite, [t].
        terrain: the ground it walked on.
    """

    walk: Trajectory
    terrain: Terrain

    @cached_property
    def since(self) -> int:
        """The first sample that is looked at."""
        time_s = self.walk.time_s
        return int(np.searchsorted(time_s, time_s[-1] - LOOKED_AT_S))

    @cached_property
    def before_lost(self) -> Truths:
        """The samples that are looked at and before those from which on the walker is lost, [t]."""
        x, z, lean = self.walk.q[:, :3].T
        high = z - self.terrain.height(x) > LOST_HEIGHT_M
        held = (np.abs(lean) < LOST_LEAN_RAD) & high
        samples = np.arange(len(held))
        last_held = samples[held].max(initial=-1)
        return np.asarray((samples >= self.since) & (samples <= last_held))

    @cached_property
    def feet(self) -> list[Foot]:
        """The left one, then the right one."""
        return [self._foot(side) for side in SIDES]

    def _foot(self, side: int) -> Foot:
        joints = leg(self.walk.q, side)
        points_m = np.stack([joints.heel, joints.ball], axis=1)
        x, z = np.moveaxis(points_m, -1, 0)
        _, up_n = of_side(self.walk.ground_force_n, side).T
        _, knee_rad, _ = of_side(self.walk.joint_rad, side).T
        near = z - self.terrain.height(x) < TOUCHING_M
        return Foot(
            name=SIDES[side],
            points_m=points_m,
            speed_mps=np.gradient(x, self.walk.time_s, axis=0),
            touching=near & of_side(self.walk.stance, side),
            loaded=up_n > LOADED_N,
            knee_rad=knee_rad,
        )

    def before(self, time_s: float) -> str:
        """How long before the end a time was."""
        return f"{self.walk.time_s[-1] - time_s:.2f} s before"


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
    seen = Seen(finite(trajectory), terrain)
    parts = [
        _way(seen),
        _bound(seen),
        _pushed(seen),
        _last_foot(seen),
        *(_caught(seen, foot) for foot in seen.feet),
        *(_slip(seen, foot) for foot in seen.feet),
        _knee(seen),
    ]
    return f": {'; '.join(filter(None, parts))}"


def _towards(ahead: float) -> str:
    return "forwards" if ahead > 0 else "backwards"


def _way(seen: Seen) -> str:
    """By the trunk that leans, or by its mass ahead of or behind the foot that touched last."""
    x, _, lean = seen.walk.q[-1, :3]
    if abs(lean) >= LOST_LEAN_RAD:
        return _towards(lean)
    strike = _last_strike(seen)
    side = LEFT if strike is None else int(strike["side"])
    foot_m = seen.feet[side].points_m[-1, :, 0].mean()
    ahead_m = x + TRUNK_MASS_M * math.sin(lean) - foot_m
    return "straight down" if abs(ahead_m) < ABOVE_FOOT_M else _towards(ahead_m)


def _bound(seen: Seen) -> str:
    """The bound of a fall that the last pose exceeds, or comes nearest to."""
    x, z, lean = seen.walk.q[-1, :3]
    height_m = max(float(z - seen.terrain.height(x)), 1e-6)
    leaned = f"{abs(math.degrees(lean)):.0f} deg {_towards(lean)}"
    if abs(lean) / FALL_LEAN_RAD > FALL_HEIGHT_M / height_m:
        return f"the trunk leaned {leaned}"
    return f"the hip sank to {FALL_HEIGHT_M:g} m over the ground, the trunk {leaned}"


def _pushed(seen: Seen) -> str:
    """Which way the walker was pushed, how hard, and when that began."""
    push_n = seen.walk.push_n[:, 0]
    if not push_n.any():
        return ""
    most = push_n[np.abs(push_n).argmax()]
    began = seen.before(seen.walk.time_s[np.flatnonzero(push_n)[0]])
    return f"it was pushed {_towards(most)} by {abs(most):.0f} N, {began}"


def _last_strike(seen: Seen) -> np.void | None:
    """The event of the last foot that came down; None: each has stood since the start."""
    events = seen.walk.events
    strikes = events[events["kind"] == EVENT_KINDS.index("strike")]
    return strikes[strikes["time_s"].argmax()] if len(strikes) else None


def _last_foot(seen: Seen) -> str:
    """The last foot that came down, when and where, and the rise or drop that it came down on."""
    strike = _last_strike(seen)
    if strike is None:
        return "no foot had been set down again"
    foot = seen.feet[strike["side"]]
    after = np.searchsorted(seen.walk.time_s, strike["time_s"])
    x, z = foot.points_m[min(after, len(seen.walk.time_s) - 1)].T
    lowest = (z - seen.terrain.height(x)).argmin()
    words = f"the {foot.name} foot touched last, {seen.before(strike['time_s'])}"
    words += f" at {x[lowest]:.2f} m"
    if abs(steepness(seen.terrain, x[lowest])) < STEEP:
        return words
    step = _step(seen.terrain, x[lowest])
    return f"{words}: its {PARTS[lowest]} on the edge of a step {step}"


def steepness(terrain: Terrain, x_m: Floats) -> Floats:
    """Rise over run of the ground about some places, of their shape."""
    rise = terrain.height(x_m + GRID_SPACING_M) - terrain.height(x_m - GRID_SPACING_M)
    return np.asarray(rise / (2.0 * GRID_SPACING_M))


def _step(terrain: Terrain, x_m: Floats) -> str:
    """Which way the ground goes about a place, and how far."""
    around = terrain.height(np.linspace(x_m - WITHIN_M, x_m + WITHIN_M, 25))
    way = "up" if steepness(terrain, x_m) > 0 else "down"
    return f"{way} ({100 * np.ptp(around):.0f} cm)"


def _caught(seen: Seen, foot: Foot) -> str:
    """Where a foot that swung forwards met the edge of a step, before the walker was lost."""
    x = foot.points_m[..., 0]
    met = foot.touching & (foot.speed_mps > SLIPPING_MPS)
    met &= seen.before_lost[:, None] & (steepness(seen.terrain, x) > STEEP)
    if not met.any():
        return ""
    sample, part = np.argwhere(met)[0]
    at = x[sample, part]
    words = f"the {foot.name} {PARTS[part]} caught the edge of a step"
    before = seen.before(seen.walk.time_s[sample])
    return f"{words} {_step(seen.terrain, at)} at {at:.2f} m, {before}"


def _slip(seen: Seen, foot: Foot) -> str:
    """How far a foot slid without a stop while it bore weight and the walker was not yet lost."""
    slides = foot.touching & (np.abs(foot.speed_mps) > SLIPPING_MPS)
    slides &= (foot.loaded & seen.before_lost)[:, None]
    numbered, count = ndimage.label(slides, ALONG_TIME)
    moved_m = foot.speed_mps * np.diff(seen.walk.time_s).mean()
    slid_m = ndimage.sum_labels(moved_m, numbered, range(1, count + 1))
    if np.abs(slid_m).max(initial=0.0) < LEAST_SLIP_M:
        return ""
    longest = np.abs(slid_m).argmax()
    first, _ = np.argwhere(numbered == longest + 1)[0]
    far = f"{100 * abs(slid_m[longest]):.0f} cm {_towards(slid_m[longest])}"
    before = seen.before(seen.walk.time_s[first])
    return f"the {foot.name} foot slipped {far}, from {before}"


def _knee(seen: Seen) -> str:
    """The knee that bent most under load, if it bent as none does in a stance."""
    bent_rad = [np.where(foot.loaded, foot.knee_rad, 0.0) for foot in seen.feet]
    most_rad = [float(knee[seen.since :].max()) for knee in bent_rad]
    side = int(np.argmax(most_rad))
    if most_rad[side] < GAVE_WAY_RAD:
        return ""
    bent = f"{math.degrees(most_rad[side]):.0f} deg under load"
    return f"the {SIDES[side]} knee gave way: {bent}"

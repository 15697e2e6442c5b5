"""One recorded walk, simulated in a process beside the page's."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from study.experiment.trials import row_text
from study.explore.frames import Frames, frames_of
from study.explore.setting import Setting, chosen_setting
from study.gains import NamedGains, gains_of_source, recorded_walk
from study.pictures.window import finite
from taichi_nmm.body import GRAVITY_MPS2
from taichi_nmm.result import COMPLETED, DIVERGED, END_REASONS, Trajectory
from taichi_nmm.terrain import Terrain

SEEN_RATE_HZ = 100.0  # a sample costs as much as ten steps; enough for a gait cycle


@dataclass(frozen=True, eq=False)
class Walk:
    """What came of it.

    Attributes:
        gains: of the walker.
        setting: where it walked.
        row: of the simulator's result.
        trajectory: all of it.
        frames: what the page draws.
        ended: how it ended, and why, in words.
    """

    gains: NamedGains
    setting: Setting
    row: np.void
    trajectory: Trajectory
    frames: Frames
    ended: str

    @property
    def terrain(self) -> Terrain:
        """The ground."""
        return self.setting.experiment.terrain(self.setting.run)

    @property
    def weight_n(self) -> float:
        """Of the walker."""
        body = self.setting.experiment.body(self.setting.run)
        return float(body.mass_kg[0].sum() * GRAVITY_MPS2)


def walk(gains: NamedGains, setting: Setting, rate_hz: float = SEEN_RATE_HZ) -> Walk:
    """Simulate, with so many samples a second, and prepare what is drawn.

    Raises:
        InputError: what the simulator refuses.
    """
    experiment, run = setting.experiment.on_one_thread(), setting.run  # others walk beside it
    conditions = experiment.conditions
    on_cpu = replace(conditions, settings=replace(conditions.settings, arch="cpu"))
    result = recorded_walk(gains, replace(experiment, conditions=on_cpu), run, rate_hz)
    row, trajectory, terrain = result.rows[0], result.trajectories[0], experiment.terrain(run)
    ended = f"{row_text(row)}{_why(row, trajectory, terrain)}"
    return Walk(gains, setting, row, trajectory, frames_of(trajectory, terrain), ended)


def _why(row: np.void, trajectory: Trajectory, terrain: Terrain) -> str:
    """What ended a walk that was not completed: which bound of a fall its last pose is beyond."""
    if row["end_reason"] == COMPLETED:
        return ""
    if row["end_reason"] == DIVERGED:
        return f": the simulation {END_REASONS[DIVERGED]}"
    from taichi_nmm.kernel.walker import FALL_HEIGHT_M, FALL_LEAN_RAD  # needs Taichi

    last: NDArray[np.float64] = finite(trajectory).q[-1]
    lean, height_m = float(last[2]), float(last[1] - terrain.height(last[0]))
    if abs(lean) / FALL_LEAN_RAD > FALL_HEIGHT_M / max(height_m, 1e-6):
        way = "forward" if lean > 0 else "backward"
        return f": the trunk leaned {math.degrees(abs(lean)):.0f} deg {way}"
    return f": the hip sank to {height_m:.1f} m over the ground"


def warm_up() -> None:
    """Have the kernels ready before the first gait is asked for."""
    walk(
        gains_of_source("reference"), chosen_setting("flat", "nominal", 0, "nominal", "taichi", 0.1)
    )

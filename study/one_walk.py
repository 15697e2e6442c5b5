"""One controller on one run of an experiment, recorded: what `walk` and the explorer show."""

from collections.abc import Callable

import taichi_nmm
from study.experiment.experiment import Experiment
from study.gains import NamedGains


def recorded_walk(
    gains: NamedGains,
    experiment: Experiment,
    run: int,
    rate_hz: float,
    progress: Callable[[float, int], None] | None = None,
) -> taichi_nmm.Result:
    """The result of one walker, with its trajectory at so many samples a second.

    Args:
        gains: of the walker.
        experiment: whose conditions.
        run: whose body, world and ground.
        rate_hz: samples a second.
        progress: as `taichi_nmm.simulate` takes it.

    Raises:
        InputError: what the simulator refuses.
    """
    conditions = experiment.conditions
    return taichi_nmm.simulate(
        gains.gains,
        low_level_gains=gains.low_level,
        duration_s=conditions.duration_s,
        bodies=experiment.body(run),
        worlds=experiment.world(run),
        terrains=experiment.terrain(run),
        settings=conditions.settings,
        record=[0],
        record_rate_hz=rate_hz,
        progress=progress,
    )

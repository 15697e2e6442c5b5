"""Plants of somebody else's that do not fall: a battery, and a greenhouse of long days."""

from collections.abc import Mapping
from typing import Any

from optuna.distributions import FloatDistribution, IntDistribution

from storage import FunctionSimulator

PARAMETERS = {
    "current_a": FloatDistribution(1.0, 20.0),
    "pulses": IntDistribution(1, 9),
}
COLUMNS = ("survived_fraction", "loss_j", "finished_at_s")
STARTED_S = 1_700_000_000.0  # on the clock of the plant
CAPACITY_AS = 20_000.0
STEP_S = 60.0
HOTTEST_K = 380.0


def charge(
    point: Mapping[str, Any], world: Mapping[str, Any], seconds: float
) -> dict[str, float]:
    """Charge a battery until it is full; a slow charge takes longer than a store's run."""
    if world["heat_k"] + point["current_a"] > HOTTEST_K:
        raise ValueError("it burns")
    steps = int(seconds / STEP_S)
    if not steps:
        raise ValueError("shorter than a step")
    ohm = 0.1 + 0.001 * (world["heat_k"] - 300.0)
    needed = CAPACITY_AS / point["current_a"]
    full = needed <= seconds
    lasted = sum(1.0 / steps for _ in range(steps)) if full else 0.9
    loss_j = ohm * point["current_a"] ** 2 * needed + point["pulses"]
    return {
        "survived_fraction": lasted,
        "loss_j": loss_j,
        "finished_at_s": STARTED_S + needed,
    }


Battery = FunctionSimulator(
    charge, parameters=PARAMETERS, worlds={"heat_k": 300.0}, columns=COLUMNS
)


def explode(
    point: Mapping[str, Any], world: Mapping[str, Any], seconds: float
) -> dict[str, float]:
    """A loss of finite joules, of which float32 has no number for large currents."""
    loss_j = 1e39 if point["current_a"] > 10.0 else 1.0
    return {"survived_fraction": 1.0, "loss_j": loss_j, "finished_at_s": seconds}

"""How a batch is integrated: precision, step, contact law, machine."""

import os
from dataclasses import dataclass, field, fields
from typing import Any

from taichi_nmm.errors import InputError

CONTROL_TICK_S = 1e-3
PHYSICS_STEPS_S = (1e-3, 0.5e-3, 0.25e-3)
PRECISIONS = ("float32", "float64")
ARCHITECTURES = ("auto", "cpu", "cuda", "vulkan")

CONTACT_RELAXATION_SPEED_MPS = (
    0.10  # gaits converge with the step; at 0.03 (Geyer & Herr 2010) they do not
)
MACHINE = {"machine": True}  # metadata of a setting that no result depends on


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    Attributes:
        physics_step_s: 1, 0.5 or 0.25 ms; the controller ticks every 1 ms.
        contact_relaxation_speed_mps: outward speed at which a contact lets go.
        precision: "float32" or "float64".
        arch: "auto" (a GPU when there is one, else the CPU), "cpu", "cuda" or "vulkan".
        threads: CPU threads; None takes every core. Results do not depend on it.
    """

    physics_step_s: float = 1e-3
    contact_relaxation_speed_mps: float = CONTACT_RELAXATION_SPEED_MPS
    precision: str = "float32"
    arch: str = field(default="auto", metadata=MACHINE)
    threads: int | None = field(default=None, metadata=MACHINE)

    def __post_init__(self) -> None:
        if self.physics_step_s not in PHYSICS_STEPS_S:
            raise InputError("simulation.physics_step_s", self.physics_step_s, f"{PHYSICS_STEPS_S}")
        if not 0.01 <= self.contact_relaxation_speed_mps <= 10.0:
            raise InputError(
                "simulation.contact_relaxation_speed_mps",
                self.contact_relaxation_speed_mps,
                "0.01 to 10",
            )
        if self.precision not in PRECISIONS:
            raise InputError("simulation.precision", self.precision, " or ".join(PRECISIONS))
        if self.arch not in ARCHITECTURES:
            raise InputError("simulation.arch", self.arch, " or ".join(ARCHITECTURES))
        cores = os.cpu_count() or 1
        if self.threads is not None and not 1 <= self.threads <= cores:
            allowed = f"1 to {cores}, the cores of this machine"
            raise InputError("simulation.threads", self.threads, allowed)

    @property
    def substeps(self) -> int:
        """How many physics steps fit into a control tick: 1, 2 or 4."""
        return round(CONTROL_TICK_S / self.physics_step_s)

    def document(self) -> dict[str, Any]:
        """What decides a result, as JSON values by name: all settings but those of the machine."""
        return {
            setting.name: getattr(self, setting.name)
            for setting in fields(self)
            if "machine" not in setting.metadata
        }

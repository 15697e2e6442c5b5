"""How a batch is integrated: precision, step, contact law, machine."""

import os
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from taichi_nmm import checks
from taichi_nmm.errors import InputError

CONTROL_TICK_S = 1e-3
PHYSICS_STEPS_S = (1e-3, 0.5e-3, 0.25e-3)
PRECISIONS = ("float32", "float64")
GPUS = ("cuda", "vulkan")
ARCHITECTURES = ("auto", "cpu", *GPUS)

CONTACT_RELAXATION_SPEED_MPS = (
    0.10  # gaits converge with the step; at 0.03 (Geyer & Herr 2010) they do not
)
MACHINE = {"machine": True}  # metadata of a setting that no result depends on

OWN_ENGINE = "taichi"
ENGINES = (OWN_ENGINE, "mujoco")
LIMITS_AS_STOPS = "stops"
LIMITS = (LIMITS_AS_STOPS, "mujoco")
STEPS_PER_TIME_CONSTANT = 5  # a contact that is shorter than some steps is not what it says


@dataclass(frozen=True)
class MujocoSettings:
    """What is MuJoCo's own of a simulation on it: [simulation.mujoco].

    Attributes:
        time_constant_s: of a contact, the first number of MuJoCo's `solref`; its default is 0.02.
        damping_ratio: of a contact, the second one; 1 is critical.
        limits: of the joints: "stops" follow the law of this simulator's stops, "mujoco" have
            MuJoCo's default numbers.
    """

    time_constant_s: float = 0.02
    damping_ratio: float = 1.0
    limits: str = LIMITS_AS_STOPS

    def __post_init__(self) -> None:
        allowed = "a positive, finite number (MuJoCo's direct form is not taken)"
        positive = checks.number(checks.LEAST_POSITIVE, allowed=allowed)
        checks.check_fields(
            self,
            "simulation.mujoco.",
            time_constant_s=positive,
            damping_ratio=positive,
            limits=checks.word(*LIMITS),
        )


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    Attributes:
        physics_step_s: 1, 0.5 or 0.25 ms; the controller ticks every 1 ms.
        contact_relaxation_speed_mps: outward speed at which a contact lets go.
        precision: "float32" or "float64".
        arch: "auto" (a GPU when there is one, else the CPU), "cpu", "cuda" or "vulkan".
        threads: CPU threads; None takes every core. Results do not depend on it.
        engine: what moves the bodies: "taichi", this simulator's own, or "mujoco".
        mujoco: what is MuJoCo's own.
    """

    physics_step_s: float = 1e-3
    contact_relaxation_speed_mps: float = CONTACT_RELAXATION_SPEED_MPS
    precision: str = "float32"
    arch: str = field(default="auto", metadata=MACHINE)
    threads: int | None = field(default=None, metadata=MACHINE)
    engine: str = OWN_ENGINE
    mujoco: MujocoSettings = MujocoSettings()

    def __post_init__(self) -> None:
        cores = os.cpu_count() or 1
        checks.check_fields(
            self,
            "simulation.",
            physics_step_s=checks.number(),
            contact_relaxation_speed_mps=checks.number(0.01, 10.0, "0.01 to 10"),
            precision=checks.word(*PRECISIONS),
            arch=checks.word(*ARCHITECTURES),
            threads=checks.optional(checks.whole(1, cores)),
            engine=checks.word(*ENGINES),
            mujoco=checks.instance(MujocoSettings),
        )
        if self.physics_step_s not in PHYSICS_STEPS_S:
            raise InputError("simulation.physics_step_s", self.physics_step_s, f"{PHYSICS_STEPS_S}")
        if self.engine == "mujoco":
            self._check_mujoco()

    @property
    def substeps(self) -> int:
        """How many physics steps fit into a control tick: 1, 2 or 4."""
        return round(CONTROL_TICK_S / self.physics_step_s)

    def on_processor(self) -> "Settings":
        """The same on this machine's processor, where a launch costs microseconds."""
        return replace(self, arch="cpu")

    def _check_mujoco(self) -> None:
        shortest_s = STEPS_PER_TIME_CONSTANT * self.physics_step_s
        if self.mujoco.time_constant_s < shortest_s:
            allowed = (
                f"{shortest_s:g} or more, {STEPS_PER_TIME_CONSTANT} physics steps: "
                "else MuJoCo's contact is another than it says; make physics_step_s smaller"
            )
            raise InputError(
                "simulation.mujoco.time_constant_s", self.mujoco.time_constant_s, allowed
            )
        if self.arch not in ("auto", "cpu"):
            raise InputError("simulation.arch", self.arch, "auto or cpu with the engine mujoco")

    def document(self) -> dict[str, Any]:
        """What decides a result, as JSON values by name: all settings but those of the machine.

        What an engine does not ask for is left out, so that adding one changes no other's digest.
        """
        settings = {
            setting.name: getattr(self, setting.name)
            for setting in fields(self)
            if "machine" not in setting.metadata
        }
        engine, mujoco = settings.pop("engine"), settings.pop("mujoco")
        if engine == "mujoco":
            del settings["contact_relaxation_speed_mps"]
            settings |= {"engine": engine, "mujoco": asdict(mujoco)}
        return settings

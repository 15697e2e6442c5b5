"""How a batch is integrated: precision, step, contact law, machine."""

import os
from ctypes.util import find_library
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

from storage.inputs import checks
from storage.inputs.errors import InputError

CONTROL_TICK_S = 1e-3
PHYSICS_STEPS_S = (1e-3, 0.5e-3, 0.25e-3)
PRECISIONS = ("float32", "float64")
ARCHITECTURES = ("auto", "cpu", "cuda")

# Of 5 s on a GPU 1,024 walkers were slower than on 16 cores, 4,096 faster (docs/speed.md).
LEAST_ON_GPU = 2048

# Gaits converge with the step; at 0.03 (Geyer & Herr 2010) they do not.
CONTACT_RELAXATION_SPEED_MPS = 0.10

OWN_ENGINE = "taichi"
ENGINES = (OWN_ENGINE, "mujoco")
LIMITS_AS_STOPS = "stops"
LIMITS = (LIMITS_AS_STOPS, "mujoco")
# MuJoCo computes a shorter contact otherwise than it is given.
STEPS_PER_TIME_CONSTANT = 5


@dataclass(frozen=True)
class MujocoSettings:
    """MuJoCo's own settings: [simulation.mujoco].

    Attributes:
        time_constant_s: of a contact, the first number of MuJoCo's `solref`; its
            default is 0.02.
        damping_ratio: of a contact, the second one; 1 is critical.
        limits: of the joints: "stops" follow the law of this simulator's stops,
            "mujoco" have MuJoCo's default numbers.
    """

    time_constant_s: float = 0.02
    damping_ratio: float = 1.0
    limits: str = LIMITS_AS_STOPS

    def __post_init__(self) -> None:
        allowed = "a positive, finite number (MuJoCo's direct form is not taken)"
        positive = checks.number(checks.LEAST_POSITIVE, allowed=allowed)
        pair = {"time_constant_s": positive, "damping_ratio": positive}
        checks.check_fields(
            self, "simulation.mujoco.", **pair, limits=checks.word(*LIMITS)
        )


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    Attributes:
        physics_step_s: 1, 0.5 or 0.25 ms; the controller ticks every 1 ms.
        contact_relaxation_speed_mps: outward speed at which a contact lets go.
        precision: "float32" or "float64".
        arch: "cpu", "cuda", or "auto": CUDA for a batch that is large enough to gain by
            it, if there is a device. The two round differently.
        threads: CPU threads; None takes every core. Results do not depend on it.
        engine: the engine that moves the bodies: "taichi", this simulator's own, or
            "mujoco".
        mujoco: MuJoCo's own settings.
        wide_registers: whether a CPU may take as many walkers side by side as its
            registers hold. Results do not depend on it.
    """

    physics_step_s: float = 1e-3
    contact_relaxation_speed_mps: float = CONTACT_RELAXATION_SPEED_MPS
    precision: str = "float32"
    arch: str = "auto"
    threads: int | None = None
    engine: str = OWN_ENGINE
    mujoco: MujocoSettings = MujocoSettings()
    wide_registers: bool = True

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
            wide_registers=checks.instance(bool),
        )
        if self.physics_step_s not in PHYSICS_STEPS_S:
            raise InputError(
                "simulation.physics_step_s", self.physics_step_s, f"{PHYSICS_STEPS_S}"
            )
        if self.engine == OWN_ENGINE:
            return
        shortest_s = STEPS_PER_TIME_CONSTANT * self.physics_step_s
        if self.mujoco.time_constant_s < shortest_s:
            allowed = (
                f"{shortest_s:g} or more, {STEPS_PER_TIME_CONSTANT} physics steps: MuJoCo would "
                "compute another contact; make physics_step_s smaller"
            )
            field = "simulation.mujoco.time_constant_s"
            raise InputError(field, self.mujoco.time_constant_s, allowed)
        if self.arch not in ("auto", "cpu"):
            raise InputError(
                "simulation.arch", self.arch, "auto or cpu with the engine mujoco"
            )

    @property
    def substeps(self) -> int:
        """How many physics steps fit into a control tick: 1, 2 or 4."""
        return round(CONTROL_TICK_S / self.physics_step_s)

    def on_processor(self) -> "Settings":
        """The same on this machine's processor, where a launch costs microseconds."""
        return replace(self, arch="cpu")

    def document(self) -> dict[str, Any]:
        """The settings that decide a result, as JSON values by name; not those of the machine.

        Only settings of the chosen engine are there, so that adding an engine changes
        no digest.
        """
        document: dict[str, Any] = {
            "physics_step_s": self.physics_step_s,
            "contact_relaxation_speed_mps": self.contact_relaxation_speed_mps,
            "precision": self.precision,
        }
        if self.engine != OWN_ENGINE:
            del document["contact_relaxation_speed_mps"]
            document |= {"engine": self.engine, "mujoco": asdict(self.mujoco)}
        return document


def settings_of_batch(settings: Settings, walkers: int) -> Settings:
    """The same for so many walkers: where `arch` is "auto", few are no work for a GPU."""
    is_small = settings.arch == "auto" and walkers < LEAST_ON_GPU
    return settings.on_processor() if is_small else settings


@cache
def may_have_gpu() -> bool:
    """Whether a GPU's driver is installed, which is no proof of a GPU."""
    return find_library("cuda") is not None

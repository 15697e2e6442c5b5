"""The conditions of a walk, as configured: simulation, body, ground and world."""

from dataclasses import dataclass
from typing import Any

from storage.inputs.config import Table
from taichi_nmm.body import Build, read_body
from taichi_nmm.settings import ENGINES, OWN_ENGINE, MujocoSettings, Settings
from taichi_nmm.terrain import Ground, read_ground
from taichi_nmm.world import NOMINAL, WorldRanges, read_world, require_begun

SHORTEST_TRIAL_S = 0.1
LONGEST_TRIAL_S = 1000.0
TRIAL_S = 100.0  # where a configuration names none


@dataclass(frozen=True)
class Conditions:
    """The tables [simulation], [body], [terrain] and [world] of a configuration; hashable.

    Attributes:
        duration_s: how long a walker may walk.
        settings: how the simulation is integrated, and on which machine.
        build: what bodies are drawn around.
        ground: kind of terrain, with its options.
        world_ranges: the ranges that a walker's world is drawn from.
    """

    duration_s: float
    settings: Settings
    build: Build
    ground: Ground
    world_ranges: WorldRanges = NOMINAL

    def as_written(self) -> dict[str, Any]:
        """The tables as a configuration has them, less the machine's settings.

        They are hashed, so a new setting is one more key at the end of its table.
        """
        world = self.world_ranges.document()
        return {
            "simulation": {"duration_s": self.duration_s, **self.settings.document()},
            "body": self.build.document(),
            "terrain": {"kind": self.ground.kind, **self.ground.options},
            **({"world": world} if world else {}),
        }


def read_conditions(table: Table, arch: str | None = None) -> Conditions:
    """The conditions in a configuration's top table; `arch` overrides the file's architecture.

    Reads every key of their four tables.

    Raises:
        InputError: an unknown key, a wrong type or a value out of range.
    """
    simulation = table.table("simulation")
    duration_s = simulation.number(
        "duration_s", TRIAL_S, SHORTEST_TRIAL_S, LONGEST_TRIAL_S
    )
    settings = read_settings(simulation, arch)
    simulation.done()
    world_ranges = read_world(table.table("world"), settings.engine)
    require_begun(world_ranges.draw([0]), duration_s)
    return Conditions(
        duration_s=duration_s,
        settings=settings,
        build=read_body(table.table("body")),
        ground=read_ground(table.table("terrain")),
        world_ranges=world_ranges,
    )


def read_settings(table: Table, arch: str | None = None) -> Settings:
    """`Settings` from the table [simulation], less its other keys; `arch` overrides the file's."""
    default = Settings()
    configured = table.text("arch", default.arch)
    engine = table.text("engine", default.engine, ENGINES)
    own: dict[str, Any] = {}
    if engine == OWN_ENGINE:
        name = "contact_relaxation_speed_mps"
        own[name] = table.number(name, getattr(default, name))
    else:
        own["mujoco"] = _read_mujoco(table.table("mujoco"))
    return Settings(
        physics_step_s=table.number("physics_step_s", default.physics_step_s),
        precision=table.text("precision", default.precision),
        engine=engine,
        arch=arch or configured,
        **own,
    )


def _read_mujoco(table: Table) -> MujocoSettings:
    default = MujocoSettings()
    settings = MujocoSettings(
        time_constant_s=table.number("time_constant_s", default.time_constant_s),
        damping_ratio=table.number("damping_ratio", default.damping_ratio),
        limits=table.text("limits", default.limits),
    )
    table.done()
    return settings

"""The walker as the simulator of a store: its parameters, its worlds, and runs of points in them.

`storage.simulator.Simulator` documents each of these. Neither module imports the other.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

import taichi_nmm
from storage.inputs.config import Table
from taichi_nmm.body import Bodies, Build, read_body
from taichi_nmm.conditions import read_settings
from taichi_nmm.kernel_cache import COMPILER, require_kernel_cache
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.parameters import (
    FIXED,
    GAIN_NAMES,
    GAINS,
    LOW_LEVEL_GAINS,
    PUBLISHED_GAINS,
    Parameter,
    lower_bounds,
    read_fixed,
    searched_parameters,
    split_points,
    upper_bounds,
)
from taichi_nmm.result import (
    DIVERGED,
    END_REASONS,
    ENERGY,
    FURTHER_FIELDS,
    OF_MUSCLES,
    RESULT_DTYPE,
    SCORE_FIELDS,
    Result,
)
from taichi_nmm.settings import OWN_ENGINE, Settings, may_have_gpu
from taichi_nmm.terrain import Ground, Terrain, read_ground, rough
from taichi_nmm.world import (
    EVENT_LIMITS,
    MUSCLE_LIMITS,
    NOMINAL,
    WorldRanges,
    Worlds,
    read_world,
    require_begun,
)

# By the purpose of a world's seed: the purposes of the streams that draw its body, its
# ground, and its contact, muscles and nerves.
STREAMS = {101: (101, 102, 105), 103: (103, 104, 106)}
DIGEST_DECIMALS = 9  # nanometres: more than the last bits that differ between machines

# Columns that tell gaits apart, with the ranges that a search covers: speed, length of
# steps, and how much feet are lifted.
MEASURES = {
    "mean_speed_mps": (0.4, 2.0),
    "step_length_mean_m": (0.3, 1.0),
    "knee_peak_swing_rad": (0.5, 1.8),
}
# With the horizon these give both costs (`result.smooth_cost`, `result.walking_cost`).
# The energy of muscles and motors is what speeds and fronts take the least of.
OUTCOMES = ("survived_fraction", "mean_speed_mps", OF_MUSCLES, ENERGY)
KEPT = tuple(
    each for each in RESULT_DTYPE.names or () if each not in ("end_reason", *OUTCOMES)
)
SLOWEST_MPS = 0.4  # a slower gait may be about to stand, which survives any ground

POINTS_ON_GPU = 131_072  # half a second of an H200 (docs/speed.md), which a stop loses
CANARY_WALKERS = 16
CANARY_S = 1.0
CANARY_SEED = 1


@dataclass(frozen=True, eq=False)
class DrawnWorlds:
    """World k is body k on terrain k, with contact, muscles and nerves k.

    Attributes:
        bodies: one a world, w of them.
        terrains: likewise.
        surroundings: contact, muscles and nerves, likewise.
    """

    bodies: Bodies
    terrains: tuple[Terrain, ...]
    surroundings: Worlds


@dataclass(frozen=True)
class WalkerWorlds:
    """The tables [body], [terrain] and [world], from which worlds are drawn.

    Attributes:
        build: what bodies are drawn around.
        ground: kind of terrain, with its options.
        ranges: of contact, muscles and nerves.
    """

    build: Build
    ground: Ground
    ranges: WorldRanges

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> DrawnWorlds:
        """One world a seed, whose spawn key is (purpose, index) with a purpose of `STREAMS`."""

        def streams(place: int) -> list[np.random.SeedSequence]:
            """Seeds of all bodies, grounds or surroundings."""
            found = []
            for seed in seeds:
                purpose, *index = seed.spawn_key
                key = (STREAMS[purpose][place], *index)
                found.append(np.random.SeedSequence(seed.entropy, spawn_key=key))
            return found

        return DrawnWorlds(
            bodies=self.build.draw(streams(0)),
            terrains=tuple(self.ground.draw(seed) for seed in streams(1)),
            surroundings=self.ranges.draw(streams(2)),
        )

    def document(self, worlds: DrawnWorlds) -> dict[str, Any]:
        """Names for people, and digests of all numbers that were drawn."""
        numbers = dict(vars(worlds.surroundings))
        # Newer than many stores, as is the key "world" below.
        named = ("catch_ns", "prosthesis", "exoskeleton")
        for newer in (*named, *EVENT_LIMITS, *MUSCLE_LIMITS):
            if getattr(self.ranges, newer) == getattr(NOMINAL, newer):
                del numbers[newer]
        bodies = array_digest(*vars(worlds.bodies).values())
        document: dict[str, Any] = {
            "terrain": terrain_document(worlds.terrains),
            "body": self.build.document() | {"sha256": bodies},
        }
        if ranges := self.ranges.document():  # else no key
            document["world"] = ranges | {"sha256": array_digest(*numbers.values())}
        return document


@dataclass(frozen=True)
class Walker:
    """The neuromuscular walker, on its own engine or on MuJoCo.

    Attributes:
        settings: how the simulation is integrated, and on which machine.
        searched: low-level gains that points have after the 16 gains.
        fixed: the 16 gains where points do not have them; () where they do.
        kept: columns of each world beside `OUTCOMES`.
    """

    settings: Settings
    searched: tuple[Parameter, ...] = ()
    fixed: tuple[float, ...] = ()
    kept: tuple[str, ...] = ()

    name: ClassVar[str] = "walker"
    code_version: ClassVar[str] = "0.4.0"  # the release that first gave these columns
    packages: ClassVar[tuple[str, ...]] = (COMPILER, "numpy")
    survived: ClassVar[str] = "survived_fraction"
    words: ClassVar[Mapping[str, Sequence[str]]] = {"end_reason": END_REASONS}
    scores: ClassVar[tuple[str, ...]] = tuple(name for name, _ in SCORE_FIELDS)
    outcome_type: ClassVar[type[np.float32]] = np.float32
    objective: ClassVar[str] = "walked_fraction"
    measures: ClassVar[Mapping[str, tuple[float, float]]] = MEASURES

    @classmethod
    def read(cls, table: Table, arch: str | None) -> Self:
        """From [simulation], `searched` and `fixed_gains`; `arch` overrides the file's."""
        settings = read_settings(table.table("simulation"), arch)
        fixed = read_fixed(table)
        named = table.texts("kept", (*KEPT, ENERGY))
        return cls(
            settings=settings,
            searched=searched_parameters(table.texts("searched")),
            fixed=fixed,
            # Once the energy had to be named.
            kept=tuple(name for name in named if name != ENERGY),
        )

    @property
    def columns(self) -> np.dtype[np.void]:
        """Those of results; of `FURTHER_FIELDS` those that are kept."""
        left_out = {name for name, _ in FURTHER_FIELDS if name not in self.kept}
        names = [name for name in RESULT_DTYPE.names or () if name not in left_out]
        return np.dtype([(name, RESULT_DTYPE[name]) for name in names])

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Of each world."""
        return (*OUTCOMES, *self.kept)

    @classmethod
    def parameters_of(cls, names: Sequence[str]) -> tuple[Parameter, ...]:
        """The 16 gains, unless none is among these names, and the low-level gains of the names."""
        low_level = tuple(each for each in LOW_LEVEL_GAINS if each.name in names)
        return (
            low_level
            if low_level and not set(GAIN_NAMES) & set(names)
            else (*GAINS, *low_level)
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The 16 gains, unless they are fixed, and the low-level gains that are searched."""
        return self.searched if self.fixed else (*GAINS, *self.searched)

    def document(self) -> dict[str, Any]:
        """Fixed gains that are not searched, and the settings less those of the machine.

        What else is not searched is not there: no device, no asymmetry.
        """
        fixed = {
            gain.name: float(gain.default)
            for gain in FIXED
            if gain not in self.searched
        }
        document: dict[str, Any] = {
            "low_level_gains": fixed,
            "simulation": self.settings.document(),
        }
        if self.fixed:
            document["fixed_gains"] = dict(zip(GAIN_NAMES, self.fixed, strict=True))
        if self.kept:
            document["kept"] = list(self.kept)
        return document

    def versions(self) -> dict[str, str]:
        """The version of another engine than our own."""
        if self.settings.engine == OWN_ENGINE:
            return {}
        require_mujoco()
        return {"engine_version": version(self.settings.engine)}

    def read_worlds(self, table: Table) -> WalkerWorlds:
        """The tables [body], [terrain] and [world]. Reads every key of them."""
        build = read_body(table.table("body"))
        ground = read_ground(table.table("terrain"))
        ranges = read_world(table.table("world"), self.settings.engine)
        return WalkerWorlds(build, ground, ranges)

    def run(
        self,
        points: NDArray[np.float64],
        worlds: DrawnWorlds,
        horizon_s: float,
        report: Callable[[float], None],
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        """Walk all points in all worlds as one batch, [n, w]."""
        require_begun(worlds.surroundings, horizon_s)
        count = len(worlds.terrains)
        world = np.tile(np.arange(count), len(points))
        gains, low_level = split_points(
            np.repeat(points, count, axis=0), self.searched, self.fixed
        )
        result = taichi_nmm.simulate(  # as an attribute: importing it would load Taichi
            gains,
            duration_s=horizon_s,
            bodies=worlds.bodies.take(world),
            terrains=worlds.terrains,
            terrain_index=world,
            worlds=worlds.surroundings.take(world),
            low_level_gains=low_level if self.searched else None,
            settings=self._one_machine(),
            progress=lambda now_s, _: report(now_s / horizon_s),
        )
        return self._columns_of(result).reshape(len(points), count), result.metadata

    def judge(
        self, rows: NDArray[np.void], horizon_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Share of the horizon that is walked, and `MEASURES`, on average over the worlds.

        The share is the survived fraction of a gait that walks, and the distance of one
        that hardly does. Distance alone found gaits that climb stairs on fewer bodies.
        A measure is weighted by how long a world was walked.
        """
        distance_m = np.where(rows["end_reason"] == DIVERGED, 0.0, rows["distance_m"])
        walked_s = np.minimum(
            rows["duration_s"], np.maximum(distance_m, 0.0) / SLOWEST_MPS
        )
        lasted_s = np.maximum(rows["duration_s"], 1e-3)  # a walker may diverge at once
        weight = lasted_s / lasted_s.sum(axis=1, keepdims=True)
        finite = (
            np.nan_to_num(rows[name], posinf=0.0, neginf=0.0) for name in MEASURES
        )
        measures = np.column_stack([(values * weight).sum(axis=1) for values in finite])
        return walked_s.mean(axis=1) / horizon_s, measures

    def lasting(self, horizon_s: float) -> Self:
        """Itself."""
        return self

    def canary(self) -> NDArray[np.void]:
        """Sixteen disturbed walkers on rough ground for a second, the same for all stores."""
        from scipy.stats import qmc  # it takes long to import

        # The key is that of a store's points.
        stream = np.random.SeedSequence(CANARY_SEED, spawn_key=(100, 0))
        sequence = qmc.Sobol(
            d=len(GAINS), scramble=True, rng=np.random.default_rng(stream)
        )
        low, high = lower_bounds(), upper_bounds()
        gains = low + sequence.random(CANARY_WALKERS)[: CANARY_WALKERS - 1] * (
            high - low
        )
        result = taichi_nmm.simulate(
            np.vstack([PUBLISHED_GAINS, gains]),
            duration_s=CANARY_S,
            bodies=Bodies.disturbed(list(range(CANARY_WALKERS))),
            terrains=rough(seed=CANARY_SEED),
            settings=self._one_machine(),
        )
        return self._columns_of(result)

    def _one_machine(self) -> Settings:
        """The settings with one architecture for all batches, however large."""
        arch = "cuda" if takes_gpu(self.settings) else "cpu"
        return replace(self.settings, arch=arch)

    def _columns_of(self, result: Result) -> NDArray[np.void]:
        """The rows of a result with `columns` alone."""
        return np.asarray(
            result.rows[list(self.columns.names or ())].astype(self.columns)
        )

    def on_one_thread(self) -> "Walker":
        """The same for one of several processes of a machine; no result depends on it."""
        return replace(self, settings=replace(self.settings, threads=1))

    def require_machine(self) -> None:
        """As `require_engine`; a GPU walks a second, for which its kernels are compiled."""
        require_engine(self.settings)
        if takes_gpu(self.settings):
            taichi_nmm.simulate(
                PUBLISHED_GAINS, duration_s=CANARY_S, settings=self._one_machine()
            )

    def processes(self, cores: int) -> int:
        """One a core; one where a GPU computes.

        Raises:
            InputError: no such GPU.
        """
        return 1 if takes_gpu(self.settings) else cores

    @property
    def points_at_once(self) -> int:
        """On a GPU so many that its queue is long."""
        return POINTS_ON_GPU if takes_gpu(self.settings) else 0


def require_engine(settings: Settings) -> None:
    """Refuse a machine on which the walker cannot be simulated, before any file is touched.

    Raises:
        InputError: there is no place for compiled kernels, no such GPU, or no MuJoCo.
    """
    require_kernel_cache()
    if settings.engine == "mujoco":
        require_mujoco()
    if settings.arch == "cuda":
        started_arch(settings)


@cache
def takes_gpu(settings: Settings) -> bool:
    """Whether a GPU computes; it is started then.

    Raises:
        InputError: no such GPU.
    """
    if settings.arch == "cpu" or settings.engine != OWN_ENGINE:
        return False
    if settings.arch == "auto" and not may_have_gpu():
        return False
    return started_arch(settings) != "cpu"


def started_arch(settings: Settings) -> str:
    """The backend that computes; it is started, which takes a second."""
    from taichi_nmm.kernel import backend

    backend.start(settings)
    return str(backend.metadata()["arch"])


def array_digest(*arrays: NDArray[np.float64]) -> str:
    """SHA-256 of the arrays' numbers, one after the other, rounded; -0.0 counts as 0.0."""
    digest = sha256()
    for values in arrays:
        digest.update((np.round(values, DIGEST_DECIMALS) + 0.0).tobytes())
    return digest.hexdigest()


def terrain_document(terrains: Sequence[Terrain]) -> dict[str, str]:
    """The grounds of one kind: the first one's name, and the digest of all heights."""
    heights = array_digest(*(terrain.height_m for terrain in terrains))
    return {"name": terrains[0].name, "sha256": heights}

"""What a machine computes with: the digest of a small fixed batch, its processor, its versions.

Bits are the same at any number of threads, but not on any processor. Machines of one kind may fill
a folder together; of two kinds they would mix two walkers.
"""

import hashlib
import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np

import taichi_nmm
from storage.sobol import sobol_gains
from taichi_nmm import K_T, __version__, terrain
from taichi_nmm.body import Bodies
from taichi_nmm.settings import Settings

Kind = dict[str, str]
"""Of each part what it is: "canary", "processor", "taichi-nmm", and packages by their names."""

KIND_NAME = "kind.json"  # in a folder: the kind of the workers that fill it
CANARY_WALKERS = 16
CANARY_S = 1.0
CANARY_SEED = 1
PACKAGES = ("taichi", "numpy")  # that decide what a walk is


def own_kind(settings: Settings, packages: tuple[str, ...]) -> Kind:
    """The kind of this machine, by walking.

    Args:
        settings: of the simulator.
        packages: that decide results.
    """
    return {
        "canary": canary(settings),
        "processor": processor(),
        "taichi-nmm": __version__,
        **{name: version(name) for name in packages},
    }


def canary(settings: Settings) -> str:
    """SHA-256 of what becomes of sixteen disturbed walkers on rough ground in a second."""
    gains = sobol_gains(CANARY_SEED, 0, CANARY_WALKERS - 1)
    rows = taichi_nmm.simulate(  # imported where it is called
        np.vstack([K_T, gains]),
        duration_s=CANARY_S,
        bodies=Bodies.disturbed(list(range(CANARY_WALKERS))),
        terrains=terrain.rough(seed=CANARY_SEED),
        settings=settings,
    ).rows
    digest = hashlib.sha256()
    for name in rows.dtype.names or ():
        digest.update(rows[name].tobytes())
    return digest.hexdigest()


def processor(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """What the processor calls itself; where nobody says, its architecture."""
    try:
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()


def differences(kind: Kind, reference: Kind) -> str:
    """In what a kind differs from another, in a line; empty: in nothing."""
    names = dict.fromkeys([*reference, *kind])
    return ", ".join(
        f"{name} {_shown(kind.get(name))}, not {_shown(reference.get(name))}"
        for name in names
        if kind.get(name) != reference.get(name)
    )


def _shown(value: str | None) -> str:
    """A digest by its beginning."""
    if value is None:
        return "none"
    return value[:12] if len(value) == hashlib.sha256().digest_size * 2 else value

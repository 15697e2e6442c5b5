"""Films of candidates in their simulator, to look at before the machine tries them."""

import hashlib
import json
import tempfile
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

from storage.simulator import WALKER
from storage.store import open_store
from study.bench.bench import Bench
from study.experiment.experiment import experiment_of
from study.experiment.gains import named_gains, recorded_walk
from study.pictures.movie import filmable, filmed, write_movie
from study.pictures.scene import SMALL
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError

Filming = Callable[[Mapping[str, Any]], bytes]
"""An MP4 of parameters by name; pickles."""

SECONDS = 8.0


def filming_of(bench: Bench, simulator: str | None) -> Filming | None:
    """What films a bench's candidates; None where nothing can.

    Args:
        bench: whose candidates may be a store of our walker, which walks on level ground.
        simulator: of MuJoCo, as `FILE:NAME`; its base setting is filmed.

    Raises:
        InputError: no such simulator, or one of other parameters.
    """
    if simulator is not None:
        space = bench.space
        if set(space) != set(filmable(simulator).space):
            raise InputError("simulator", simulator, f"one with the parameters {', '.join(space)}")
        numbers = {name: each.to_internal_repr for name, each in space.items()}
        return partial(_of_robot, simulator, numbers)
    candidates = bench.plan.candidates
    if "store" not in candidates.unread:
        return None
    store = open_store(candidates.folder / candidates.unread["store"])
    fixed = store.specification.get("fixed_gains", {})
    return partial(of_walker, fixed) if store.simulator == WALKER else None


def _of_robot(
    simulator: str, numbers: Mapping[str, Callable[[Any], float]], params: Mapping[str, Any]
) -> bytes:
    point = {name: number(params[name]) for name, number in numbers.items()}
    return filmed(simulator, point, {}, SECONDS)


def of_walker(fixed: Mapping[str, float], params: Mapping[str, Any]) -> bytes:
    """An MP4 of our walker on level ground, with the nominal body; `fixed` gains count too."""
    level = {"seed": 0, "simulation": {"duration_s": SECONDS}, "terrain": {"kind": "flat"}}
    experiment = experiment_of(Table(level), "candidate")
    walk = recorded_walk(
        named_gains("candidate", {**fixed, **params}), experiment, 0, SMALL.rate_hz
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.mp4"
        write_movie(path, walk.trajectories[0], experiment.terrain(0), SECONDS, film=SMALL)
        return path.read_bytes()


class Films:
    """Films in a folder, each made in a process beside this one when it is first asked for."""

    def __init__(self, filming: Filming, makers: Executor, folder: Path) -> None:
        self._filming, self._makers, self._folder = filming, makers, folder
        self._turn = threading.Lock()

    def of(self, params: Mapping[str, Any]) -> Path:
        """The film of parameters.

        Raises:
            InputError: what the simulator or the film's encoder refuses.
        """
        key = hashlib.sha256(json.dumps(params, sort_keys=True).encode()).hexdigest()
        path = self._folder / f"{key}.mp4"
        with self._turn:
            if not path.exists():
                path.write_bytes(self._makers.submit(self._filming, params).result())
        return path

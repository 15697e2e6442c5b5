"""Every public callable with wrong values for each argument: success or one line, nothing else.

A TypeError for a wrong number of arguments or an unknown keyword is Python's own, and not tried.
"""

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
from optuna.distributions import FloatDistribution
from optuna.samplers import BaseSampler

import storage
import study
import taichi_nmm
from storage.precompute import precompute
from taichi_nmm import terrain
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.result import RESULT_DTYPE
from tests.storage import fake

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

Call = tuple[Callable[..., Any], dict[str, Any]]
PACKAGES = (taichi_nmm, storage, study)
CONTAINERS = {
    "InputError",
    "Muscles",
    "Result",
    "Store",
    "Trajectory",
}  # made by us, of what they are given
SEED = 14


class Hostile:
    """An object that is nothing, and does not even say what it is."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


def wrong_values() -> list[Any]:
    rng = np.random.default_rng(SEED)
    shapes = [tuple(rng.integers(0, 4, size)) for size in (0, 1, 2, 3, 3)]
    return [
        None, "a", "", "nul\0", "\ud800", "x" * 300, b"a", True, -1, 0, 1.5, 1e300, -0.0, np.nan,
        np.inf, 10**400, 2 + 1j, [], [[]], {}, {"a": 1}, (), object(), Hostile(), print,
        ["a"], [None], [1.5], [10**400], [np.nan], [[1], [2, 3]], {1: 2}, {"a": None},
        iter([]), np.array("a"), np.datetime64("2026-01-01"), *(rng.normal(size=s) for s in shapes),
        rng.integers(-9, 9, (2, 16)), np.zeros(3, dtype=object), np.zeros(2, dtype=RESULT_DTYPE),
        pd.DataFrame({"a": ["x"]}), FloatDistribution(0, 1), {"a": FloatDistribution(0, 1)},
        Path("no/such/file"), taichi_nmm.Settings, taichi_nmm.InputError("field", 1, "2"),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("doors") / "store"
    families = {name: fake.family(kind="flat") for name in ("rough", "blocks", "up", "down")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        precompute(fake.specification(samples=30, families=families), path)
    return path


def calls(store: Path, folder: Path) -> dict[str, Call]:
    """A call that succeeds of every public callable, by its name."""
    cpu = taichi_nmm.Settings(arch="cpu")
    observation = {
        "joint_rad": np.zeros((1, 6)), "joint_rate_radps": np.zeros((1, 6)), "trunk_rad": [0.0],
        "trunk_rate_radps": [0.0], "contact": [[True, False]], "load_n": [[800.0, 0.0]],
        "leg_length_m": [[1.0, 1.0]], "leg_angle_rad": [[1.5, 1.5]], "com_ahead_m": [[0.0, 0.0]],
        "com_speed_mps": [1.3],
    }  # fmt: skip
    rows = np.zeros(2, RESULT_DTYPE)
    result = taichi_nmm.Result(rows)
    bodies, worlds = taichi_nmm.Bodies.nominal(2), taichi_nmm.Worlds.nominal(2)
    opened = storage.open_store(store)
    table = study.FeatureTable.from_arrays({"x": np.linspace(0, 1, 20)}, np.linspace(0, 1, 20))
    sampler = study.FeatureKernelSampler(table, seed=1)
    options: dict[str, Any] = {
        "seed": 1, "prior": "-feature_0", "kernel": "rbf", "feature_function": np.sin,
        "off_grid": 2, "space": None, "strict": True, "extra_parameters": ("y",),
        "independent_sampler": optuna.samplers.RandomSampler(seed=1), "nearest": None,
        "constraints_func": None,
    }  # fmt: skip
    frame = pd.DataFrame({"x": [0.0, 1.0], "f": [1.0, 2.0]})
    ranged = {"bounds": {"x": (0, 1)}, "space": None}
    named = {"parameters": ["x"], "features": ["f"]}
    frame.to_parquet(folder / "frame.parquet")

    def stepped(**arrays: Any) -> Any:
        controller = taichi_nmm.Controller(PUBLISHED_GAINS, settings=cpu)
        return controller.step(taichi_nmm.Observation(**arrays)), controller.muscles

    return {
        "Bodies": (taichi_nmm.Bodies, dict(vars(bodies))),
        "Bodies.disturbed": (taichi_nmm.Bodies.disturbed, {"seeds": [1], "fraction": 0.1}),
        "Bodies.nominal": (taichi_nmm.Bodies.nominal, {"count": 1}),
        "Bodies.take": (bodies.take, {"index": [1, 0]}),
        "Controller": (
            taichi_nmm.Controller,
            {"gains": PUBLISHED_GAINS, "bodies": None, "low_level_gains": None, "settings": cpu},
        ),
        "Controller.keep": (
            lambda rows: taichi_nmm.Controller(PUBLISHED_GAINS, settings=cpu).keep(rows),
            {"rows": [0]},
        ),
        "Controller.step": (
            lambda observation: taichi_nmm.Controller(PUBLISHED_GAINS, settings=cpu).step(
                observation
            ),
            {"observation": taichi_nmm.Observation(**observation)},
        ),
        "Result.__getitem__": (result.__getitem__, {"name": "duration_s"}),
        "Observation": (stepped, observation),
        "Observation.checked": (taichi_nmm.Observation(**observation).checked, {"count": 1}),
        "Settings": (taichi_nmm.Settings, dict(vars(cpu))),
        "Settings.document": (cpu.document, {}),
        "Settings.on_processor": (cpu.on_processor, {}),
        "Terrain": (taichi_nmm.Terrain, dict(vars(terrain.flat()))),
        "Terrain.height": (terrain.flat().height, {"x_m": [1.0]}),
        "WorldRanges": (
            lambda **ranges: taichi_nmm.WorldRanges(**ranges).draw([1]),
            dict(vars(taichi_nmm.WorldRanges())),
        ),
        "WorldRanges.document": (taichi_nmm.WorldRanges().document, {}),
        "WorldRanges.draw": (taichi_nmm.WorldRanges().draw, {"seeds": [1, 2]}),
        "Worlds": (taichi_nmm.Worlds, dict(vars(worlds))),
        "Worlds.nominal": (taichi_nmm.Worlds.nominal, {"count": 1}),
        "Worlds.stacked": (taichi_nmm.Worlds.stacked, {"worlds": [worlds]}),
        "Worlds.take": (worlds.take, {"index": [1, 0]}),
        "forward_dynamics": (
            taichi_nmm.forward_dynamics,
            {
                "q": np.zeros((1, 9)),
                "qdot": np.zeros((1, 9)),
                "joint_torque": np.zeros((1, 6)),
                "bodies": None,
            },
        ),
        "load_all_gains": (taichi_nmm.load_all_gains, {"source": "published"}),
        "load_gains": (taichi_nmm.load_gains, {"source": "published"}),
        "simulate": (
            taichi_nmm.simulate,
            {
                "gains": PUBLISHED_GAINS,
                "duration_s": 0.002,
                "bodies": None,
                "terrains": terrain.flat(),
                "terrain_index": [0],
                "low_level_gains": None,
                "worlds": None,
                "settings": cpu,
                "record": [0],
                "record_rate_hz": 100,
                "progress": None,
            },
        ),
        "smooth_cost": (taichi_nmm.smooth_cost, {"rows": rows, "target_speed_mps": 1.3}),
        "walking_cost": (taichi_nmm.walking_cost, {"rows": rows, "target_speed_mps": 1.3}),
        "merge": (storage.merge, {"source": store, "target": folder / "merged.parquet"}),
        "open_store": (storage.open_store, {"path": store, "verify": False}),
        "Store.gains": (opened.gains, {}),
        "Store.numpy": (opened.numpy, {"columns": ["row"]}),
        "Store.pandas": (opened.pandas, {"columns": ["row"]}),
        "Store.require_bounds": (opened.require_bounds, {}),
        "Store.table": (opened.table, {"columns": ["row"]}),
        "Store.tables": (opened.tables, {"columns": ["row"]}),
        "DoGSampler": (tried(study.DoGSampler), {"table": table} | options),
        "FeatureKernelSampler": (tried(study.FeatureKernelSampler), {"features": table} | options),
        "FeatureKernelSampler, no table": (
            tried(study.FeatureKernelSampler),
            {"features": None, "space": {"x": FloatDistribution(0, 1)}, "seed": 1},
        ),
        "FeatureKernelSampler.worth": (sampler.worth, {"study": tried(lambda: sampler)()}),
        "FeatureTable": (study.FeatureTable, {"rows": table.rows, "file": None}),
        "FeatureTable.from_arrays": (
            study.FeatureTable.from_arrays,
            {"parameters": {"x": [0.0, 1.0]}, "features": [1, 2], "feature_names": ["f"]} | ranged,
        ),
        "FeatureTable.from_arrays, columns": (
            lambda **columns: study.FeatureTable.from_arrays(columns, [1, 2]),
            {"x": [0.0, 1.0]},
        ),
        "FeatureTable.from_arrays, bounds": (
            lambda **bounds: study.FeatureTable.from_arrays({"x": [0, 1]}, [1, 2], bounds=bounds),
            {"x": (0, 1)},
        ),
        "FeatureTable.from_arrays, low": (
            lambda low: study.FeatureTable.from_arrays(
                {"x": [0, 1]}, [1, 2], bounds={"x": (low, 1)}
            ),
            {"low": 0},
        ),
        "FeatureTable.from_arrays, space": (
            lambda **space: study.FeatureTable.from_arrays({"x": [0, 1]}, [1, 2], space=space),
            {"x": FloatDistribution(0, 1)},
        ),
        "FeatureTable.from_dataframe": (
            study.FeatureTable.from_dataframe,
            {"frame": frame} | named | ranged,
        ),
        "FeatureTable.from_parquet": (
            study.FeatureTable.from_parquet,
            {"path": folder / "frame.parquet"} | named | ranged,
        ),
        "FeatureTable.from_parquet, store": (
            study.FeatureTable.from_parquet,
            {"path": store, "features": ["phi_printed"]},
        ),
        "SurvivalSampler": (tried(study.SurvivalSampler), {"table": table} | options),
        "covered_table": (study.covered_table, {"path": store, "grounds": ()}),
        "survival_table": (study.survival_table, {"path": store, "families": ("up", "down")}),
        "terrain.blocks": (
            terrain.blocks,
            {
                "seed": 1,
                "amplitude_m": 0.1,
                "spacing_m": 1.0,
                "riser_m": 0.1,
                "flat_start_m": 9.0,
                "slope": 0.0,
            },
        ),
        "terrain.from_file": (terrain.from_file, {"path": hill(folder)}),
        "terrain.ramp": (
            terrain.ramp,
            {"increment": 0.1, "segment_m": 20.0, "largest_slope": 0.2, "direction": "up"},
        ),
        "terrain.rough": (
            terrain.rough,
            {"seed": 1, "amplitude_m": 0.1, "spacing_m": 1.0, "flat_start_m": 9.0, "slope": 0.0},
        ),
        "terrain.stairs": (
            terrain.stairs,
            {"rise_m": 0.1, "run_m": 0.3, "flat_start_m": 9.0, "direction": "down"},
        ),
    }


def hill(folder: Path) -> Path:
    (folder / "hill.csv").write_text("0,0\n1,1\n")
    return folder / "hill.csv"


def tried(make: Callable[..., Any]) -> Callable[..., optuna.Study]:
    """What a sampler accepts when it is made, no trial stumbles over."""

    def run(**options: Any) -> optuna.Study:
        found = optuna.create_study(sampler=make(**options))
        found.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=4)
        return found

    return run


@pytest.fixture(scope="module")
def doors(store: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Call]:
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    return calls(store, tmp_path_factory.mktemp("doors"))


def public_names() -> Iterator[str]:
    """Public functions and classes, and what their users call of the classes."""
    for package in PACKAGES:
        for name in package.__all__:
            value = getattr(package, name)
            if not callable(value):
                continue
            if name not in CONTAINERS:
                yield name
            if not inspect.isclass(value):
                continue
            for member, what in inspect.getmembers(value):
                module = str(getattr(what, "__module__", ""))
                ours = module.startswith(("taichi_nmm", "storage", "study"))
                hook = issubclass(value, BaseSampler) and hasattr(BaseSampler, member)
                inherited = member not in vars(value) and member != "from_arrays"
                if callable(what) and ours and not (member.startswith("_") or hook or inherited):
                    yield f"{name}.{member}"


def test_no_public_callable_is_forgotten(doors: dict[str, Call]) -> None:
    assert set(public_names()) <= doors.keys()


def test_wrong_values_end_in_one_line(
    doors: dict[str, Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # "a" may be the name of a file to write
    tried_calls, wrong = 0, []
    for name, (call, arguments) in doors.items():
        if name not in ("SurvivalSampler", "covered_table"):  # which want another table
            call(**arguments)
        for argument in arguments:
            for place, value in enumerate(wrong_values()):
                tried_calls += 1
                try:
                    call(**arguments | {argument: value})
                except InputError as error:
                    assert str(error).isprintable()
                except Exception as error:
                    shown = f"{type(value).__name__} number {place}"
                    wrong.append(
                        f"{name}({argument}={shown}): {type(error).__name__}: {error}"[:250]
                    )
    assert tried_calls > 5000
    assert not wrong, f"{len(wrong)} of {tried_calls}:\n" + "\n".join(wrong)

"""Every public callable with wrong values for each argument: success or one line, nothing else.

A TypeError for a wrong number of arguments or an unknown keyword is Python's own, and
not tried.
"""

import inspect
from collections.abc import Callable, Iterator
from functools import partial
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
from storage.inputs.errors import InputError
from storage.precompute import precompute
from storage.simulator import Simulator
from study.experiment.objective import Objective
from taichi_nmm import terrain
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.result import RESULT_DTYPE
from tests.storage import fake, robot
from tests.storage.inputs.test_errors import Unspeakable

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

Call = tuple[Callable[..., Any], dict[str, Any]]
PACKAGES = (taichi_nmm, storage, study)
# Made by us, of values that were checked.
CONTAINERS = {"InputError", "Muscles", "Result", "Store", "Trajectory"}
HOOKS = (BaseSampler, Simulator)  # whose members Optuna and stores call


def wrong_values() -> list[Any]:
    rng = np.random.default_rng(14)
    shapes = [tuple(rng.integers(0, 4, size)) for size in (0, 1, 2, 3, 3)]
    return [
        None,
        "a",
        "",
        "nul\0",
        "\ud800",
        "x" * 300,
        b"a",
        True,
        -1,
        0,
        1.5,
        1e300,
        -0.0,
        np.nan,
        np.inf,
        10**400,
        2 + 1j,
        [],
        [[]],
        {},
        {"a": 1},
        (),
        object(),
        Unspeakable(),
        print,
        ["a"],
        [None],
        [1.5],
        [10**400],
        [np.nan],
        [[1], [2, 3]],
        {1: 2},
        {"a": None},
        iter([]),
        np.array("a"),
        np.datetime64("2026-01-01"),
        *(rng.normal(size=s) for s in shapes),
        rng.integers(-9, 9, (2, 16)),
        np.zeros(3, dtype=object),
        np.zeros(2, dtype=RESULT_DTYPE),
        pd.DataFrame({"a": ["x"]}),
        FloatDistribution(0, 1),
        {"a": FloatDistribution(0, 1)},
        Path("no/such/file"),
        taichi_nmm.Settings,
        taichi_nmm.InputError("field", 1, "2"),
    ]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("doors") / "store"
    families = {
        name: fake.family(kind="flat") for name in ("rough", "blocks", "up", "down")
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        precompute(fake.specification(samples=30, families=families), path)
    return path


def calls(store: Path, folder: Path) -> dict[str, Call]:
    """A call that succeeds of every public callable, by its name."""
    cpu = taichi_nmm.Settings(arch="cpu")
    observation = {
        "joint_rad": np.zeros((1, 6)),
        "joint_rate_radps": np.zeros((1, 6)),
        "trunk_rad": [0.0],
        "trunk_rate_radps": [0.0],
        "contact": [[True, False]],
        "load_n": [[800.0, 0.0]],
        "leg_length_m": [[1.0, 1.0]],
        "leg_angle_rad": [[1.5, 1.5]],
        "com_ahead_m": [[0.0, 0.0]],
        "com_speed_mps": [1.3],
    }
    rows = np.zeros(2, RESULT_DTYPE)
    bodies, worlds = taichi_nmm.Bodies.nominal(2), taichi_nmm.Worlds.nominal(2)
    opened = storage.open_store(store)
    table = study.FeatureTable.from_arrays(
        {"x": np.linspace(0, 1, 20)}, np.linspace(0, 1, 20)
    )
    sampler = study.FeatureKernelSampler(table, seed=1)
    options: dict[str, Any] = {
        "seed": 1,
        "kernel": "rbf",
        "feature_function": np.sin,
        "off_grid": 2,
        "space": None,
        "strict": True,
        "extra_parameters": ("y",),
        "independent_sampler": optuna.samplers.RandomSampler(seed=1),
        "success": 0.5,
        "allowed": None,
    }
    frame = pd.DataFrame({"x": [0.0, 1.0], "f": [1.0, 2.0]})
    named = {
        "parameters": ["x"],
        "features": ["f"],
        "bounds": {"x": (0, 1)},
        "space": None,
    }
    frame.to_parquet(folder / "frame.parquet")
    (folder / "hill.csv").write_text("0,0\n1,1\n")
    from_arrays = study.FeatureTable.from_arrays
    of_x = partial(from_arrays, {"x": [0, 1]}, [1, 2])
    box = {"x": FloatDistribution(0, 1)}
    rough = {
        "seed": 1,
        "amplitude_m": 0.1,
        "spacing_m": 1.0,
        "flat_start_m": 9.0,
        "slope": 0.0,
    }

    def controller() -> taichi_nmm.Controller:
        return taichi_nmm.Controller(PUBLISHED_GAINS, settings=cpu)

    def stepped(**arrays: Any) -> Any:
        stepping = controller()
        return stepping.step(taichi_nmm.Observation(**arrays)), stepping.muscles

    by_their_names: list[Call] = [
        (taichi_nmm.Bodies, dict(vars(bodies))),
        (taichi_nmm.Bodies.disturbed, {"seeds": [1], "fraction": 0.1}),
        (taichi_nmm.Bodies.nominal, {"count": 1}),
        (bodies.take, {"index": [1, 0]}),
        (
            taichi_nmm.Controller,
            {
                "gains": PUBLISHED_GAINS,
                "bodies": None,
                "low_level_gains": None,
                "settings": cpu,
            },
        ),
        (
            taichi_nmm.Prosthesis,
            {
                "side": "left",
                "stiffness_nmprad": 300.0,
                "damping_nmsprad": 1.0,
                "rest_rad": 0.0,
            },
        ),
        (taichi_nmm.Exoskeleton, dict(vars(taichi_nmm.Exoskeleton()))),
        (taichi_nmm.Result(rows).__getitem__, {"name": "duration_s"}),
        (taichi_nmm.Observation(**observation).checked, {"count": 1}),
        (taichi_nmm.Settings, dict(vars(cpu))),
        (cpu.document, {}),
        (cpu.on_processor, {}),
        (taichi_nmm.Terrain, dict(vars(terrain.flat()))),
        (terrain.flat().height, {"x_m": [1.0]}),
        (taichi_nmm.WorldRanges().document, {}),
        (taichi_nmm.WorldRanges().draw, {"seeds": [1, 2]}),
        (taichi_nmm.Worlds, dict(vars(worlds))),
        (taichi_nmm.Worlds.nominal, {"count": 1}),
        (taichi_nmm.Worlds.stacked, {"worlds": [worlds]}),
        (worlds.take, {"index": [1, 0]}),
        (
            taichi_nmm.forward_dynamics,
            {
                "q": np.zeros((1, 9)),
                "qdot": np.zeros((1, 9)),
                "joint_torque": np.zeros((1, 6)),
                "bodies": None,
            },
        ),
        (taichi_nmm.load_all_gains, {"source": "published"}),
        (taichi_nmm.load_gains, {"source": "published"}),
        (
            taichi_nmm.simulate,
            dict.fromkeys(("bodies", "low_level_gains", "worlds", "progress"))
            | {
                "gains": PUBLISHED_GAINS,
                "duration_s": 0.002,
                "terrains": terrain.flat(),
                "terrain_index": [0],
                "settings": cpu,
                "record": [0],
                "record_rate_hz": 100,
                "switches": [taichi_nmm.Switch(0.001, PUBLISHED_GAINS)],
            },
        ),
        (taichi_nmm.smooth_cost, {"rows": rows, "target_speed_mps": 1.3}),
        (taichi_nmm.walking_cost, {"rows": rows, "target_speed_mps": 1.3}),
        (storage.merge, {"source": store, "target": folder / "merged.parquet"}),
        (storage.open_store, {"path": store, "verify": False}),
        (opened.gains, {}),
        (opened.require_bounds, {}),
        *(
            (read, {"columns": ["row"]})
            for read in (opened.numpy, opened.table, opened.tables)
        ),
        (sampler.worth, {"study": tried(lambda: sampler)()}),
        (sampler.best, {"study": tried(lambda: sampler)()}),
        (sampler.predict, {"study": tried(lambda: sampler)(), "params": [{"x": 0.5}]}),
        (study.FeatureTable, {"rows": table.rows, "file": None}),
        (
            from_arrays,
            {
                "parameters": {"x": [0.0, 1.0]},
                "features": [1, 2],
                "feature_names": ["f"],
                "bounds": {"x": (0, 1)},
                "space": None,
            },
        ),
        (study.FeatureTable.from_dataframe, {"frame": frame} | named),
        (
            study.FeatureTable.from_kernel,
            {"gram": np.eye(2), "parameters": {"x": [0.0, 1.0]}},
        ),
        (
            study.FeatureTable.from_graph,
            {"weights": np.ones((2, 2)), "parameters": None, "hops": 2.0},
        ),
        (study.FeatureTable.from_parquet, {"path": folder / "frame.parquet"} | named),
        (study.world_table, {"path": store, "cost": Objective().in_worlds}),
        (terrain.blocks, rough | {"riser_m": 0.1}),
        (terrain.from_file, {"path": folder / "hill.csv"}),
        (
            terrain.ramp,
            {
                "increment": 0.1,
                "segment_m": 20.0,
                "largest_slope": 0.2,
                "direction": "up",
            },
        ),
        (terrain.rough, rough),
        (
            terrain.stairs,
            {"rise_m": 0.1, "run_m": 0.3, "flat_start_m": 9.0, "direction": "down"},
        ),
    ]
    return {
        call.__qualname__: (call, arguments) for call, arguments in by_their_names
    } | {
        "FunctionSimulator": (
            storage.FunctionSimulator,
            {
                "function": robot.drive,
                "parameters": robot.PARAMETERS,
                "columns": robot.COLUMNS,
                "worlds": robot.WORLDS,
                "measures": {"speed_mps": (0, 1)},
                "batch": False,
            },
        ),
        "make_store": (
            partial(storage.make_store, samples=2),
            {
                "simulator": robot.Cart,
                "out": folder / "made",
                "workers": 1,
                "fresh": True,
            },
        ),
        "Store.settings_of": (opened.settings_of, {"family": "up"}),
        "Store.kept": (opened.kept, {"family": "up"}),
        "Store.outcomes": (
            opened.outcomes,
            {"family": "up", "column": "survived_fraction"},
        ),
        "Store.all_outcomes": (
            opened.all_outcomes,
            {"column": "survived_fraction", "families": ("up",)},
        ),
        "Controller.keep": (lambda rows: controller().keep(rows), {"rows": [0]}),
        "Controller.step": (
            lambda observation: controller().step(observation),
            {"observation": taichi_nmm.Observation(**observation)},
        ),
        "Observation": (stepped, observation),
        "Switch": (
            lambda **switch: taichi_nmm.simulate(
                PUBLISHED_GAINS,
                duration_s=0.002,
                switches=[taichi_nmm.Switch(**switch)],
                settings=cpu,
            ),
            {
                "at_s": 0.001,
                "gains": PUBLISHED_GAINS,
                "low_level_gains": None,
                "over_s": 1.0,
            },
        ),
        "WorldRanges": (
            lambda **ranges: taichi_nmm.WorldRanges(**ranges).draw([1]),
            dict(vars(taichi_nmm.WorldRanges())),
        ),
        "DoGSampler": (tried(study.DoGSampler), {"table": table} | options),
        "FeatureKernelSampler": (
            tried(study.FeatureKernelSampler),
            {"features": table} | options,
        ),
        "FeatureKernelSampler, no table": (
            tried(study.FeatureKernelSampler),
            {"features": None, "space": box, "seed": 1},
        ),
        "FeatureTable.from_arrays, columns": (
            lambda **columns: from_arrays(columns, [1, 2]),
            {"x": [0.0, 1.0]},
        ),
        "FeatureTable.from_arrays, outcomes": (
            lambda outcomes: from_arrays({"x": [0.0, 1.0]}, outcomes=outcomes),
            {"outcomes": np.eye(2)},
        ),
        "FeatureTable.from_arrays, bounds": (
            lambda **bounds: of_x(bounds=bounds),
            {"x": (0, 1)},
        ),
        "FeatureTable.from_arrays, low": (
            lambda low: of_x(bounds={"x": (low, 1)}),
            {"low": 0},
        ),
        "FeatureTable.from_arrays, space": (lambda **space: of_x(space=space), box),
        "FeatureTable.from_parquet, store": (
            study.FeatureTable.from_parquet,
            {"path": store, "features": ["phi_printed"]},
        ),
    }


def tried(make: Callable[..., Any]) -> Callable[..., optuna.Study]:
    """Makes a sampler and runs trials: options that pass the first must pass the second."""

    def run(**options: Any) -> optuna.Study:
        found = optuna.create_study(sampler=make(**options))
        found.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=4)
        return found

    return run


def public_names() -> Iterator[str]:
    """Public functions and classes, and what their users call of the classes."""
    for package in PACKAGES:
        for name in package.__all__:
            value = getattr(package, name)
            if callable(value) and name not in CONTAINERS:
                yield name
            for member, what in (
                inspect.getmembers(value) if inspect.isclass(value) else ()
            ):
                module = str(getattr(what, "__module__", ""))
                ours = module.startswith(("taichi_nmm", "storage", "study"))
                mro = getattr(value, "__mro__", ())
                hook = any(kind in mro and hasattr(kind, member) for kind in HOOKS)
                inherited = member not in vars(value) and member != "from_arrays"
                if (
                    callable(what)
                    and ours
                    and not (member.startswith("_") or hook or inherited)
                ):
                    yield f"{name}.{member}"


def test_one_line_or_success(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    doors = calls(store, tmp_path)
    assert set(public_names()) <= doors.keys()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")  # "a" may be the name of a file to write
    tried_calls, wrong = 0, []
    for name, (call, arguments) in doors.items():
        call(**arguments)
        for argument in arguments:
            for place, value in enumerate(wrong_values()):
                tried_calls += 1
                try:
                    call(**arguments | {argument: value})
                except InputError as error:
                    assert str(error).isprintable()
                except Exception as error:
                    shown = f"{name}({argument}={type(value).__name__} number {place})"
                    wrong.append(f"{shown}: {type(error).__name__}: {error}"[:250])
    assert tried_calls > 5000
    assert not wrong, f"{len(wrong)} of {tried_calls}:\n" + "\n".join(wrong)

"""Every public callable with wrong values for each argument: success or one line, nothing else.

A TypeError for a wrong number of arguments or an unknown keyword is Python's own, and
not tried.
"""

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

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
from storage.simulator import Simulator, check_simulator
from study.experiment.objective import Objective
from taichi_nmm import terrain
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.result import RESULT_DTYPE
from tests.storage import fake, robot, toy
from tests.storage.inputs.test_errors import Unspeakable
from tests.study.bench import robot as bench_robot

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


class Door(NamedTuple):
    """A public callable, with arguments on which it succeeds."""

    name: str
    call: Callable[..., Any]
    arguments: dict[str, Any]


ASSETS = Path(__file__).parent / "assets"
PACKAGES = (taichi_nmm, storage, study)
# Made by us, of values that were checked; or made by nobody.
CONTAINERS = {
    "Best",
    "Forecast",
    "InputError",
    "Muscles",
    "Prediction",
    "Result",
    "Simulator",
    "Store",
    "TableExhaustedError",
    "Trajectory",
}
HOOKS = (BaseSampler, Simulator)  # whose members Optuna and stores call
BOX = {"x": FloatDistribution(0, 1)}


def wrong_values():
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
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("doors") / "store"
    families = {
        name: fake.family(kind="flat") for name in ("rough", "blocks", "up", "down")
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        precompute(fake.specification(samples=30, families=families), path)
    return path


def door(call, use=None, /, **given):
    """A call that succeeds: on `given`, and on the defaults of all other arguments.

    `use` goes on with what the call returns, where only this looks at the arguments.
    """
    parameters = inspect.signature(call).parameters.values()
    defaults = {p.name: p.default for p in parameters if p.default is not p.empty}

    def run(**arguments):
        made = call(**arguments)
        return made if use is None else use(made)

    return Door(call.__qualname__, run, defaults | given)


def walker_doors():
    cpu = taichi_nmm.Settings(arch="cpu")
    rows = np.zeros(2, RESULT_DTYPE)
    bodies, worlds = taichi_nmm.Bodies.nominal(2), taichi_nmm.Worlds.nominal(2)
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
    sensed = taichi_nmm.Observation(**observation)
    walk = {"gains": PUBLISHED_GAINS, "duration_s": 0.002, "settings": cpu}

    def controller():
        return taichi_nmm.Controller(PUBLISHED_GAINS, settings=cpu)

    def step(sensed):
        stepping = controller()
        return stepping.step(sensed), stepping.muscles

    def switched(switch):
        return taichi_nmm.simulate(**walk, switches=[switch])

    return [
        door(taichi_nmm.Bodies, **vars(bodies)),
        door(taichi_nmm.Bodies.disturbed, seeds=[1]),
        door(taichi_nmm.Bodies.nominal, count=1),
        door(bodies.take, index=[1, 0]),
        door(taichi_nmm.Controller, gains=PUBLISHED_GAINS, settings=cpu),
        door(controller().keep, rows=[0]),
        door(controller().step, observation=sensed),
        door(
            taichi_nmm.Prosthesis,
            side="left",
            stiffness_nmprad=300.0,
            damping_nmsprad=1.0,
        ),
        door(taichi_nmm.Exoskeleton),
        door(taichi_nmm.Push, time_s=1.0, duration_s=0.1, force_n=100.0),
        door(taichi_nmm.Slip, time_s=1.0, duration_s=0.1, friction=0.1),
        door(taichi_nmm.Result(rows).__getitem__, name="duration_s"),
        door(taichi_nmm.Observation, step, **observation),
        door(sensed.checked, count=1),
        door(taichi_nmm.Settings, arch="cpu"),
        door(cpu.document),
        door(cpu.on_processor),
        door(taichi_nmm.Terrain, **vars(terrain.flat())),
        door(terrain.flat().height, x_m=[1.0]),
        door(taichi_nmm.WorldRanges, lambda ranges: ranges.draw([1])),
        door(taichi_nmm.WorldRanges().document),
        door(taichi_nmm.WorldRanges().draw, seeds=[1, 2]),
        door(taichi_nmm.Worlds, **vars(worlds)),
        door(taichi_nmm.Worlds.nominal, count=1),
        door(taichi_nmm.Worlds.stacked, worlds=[worlds]),
        door(worlds.take, index=[1, 0]),
        door(
            taichi_nmm.forward_dynamics,
            q=np.zeros((1, 9)),
            qdot=np.zeros((1, 9)),
            joint_torque=np.zeros((1, 6)),
        ),
        door(taichi_nmm.load_all_gains, source="published"),
        door(taichi_nmm.load_gains, source="published"),
        door(taichi_nmm.simulate, **walk, terrains=terrain.flat(), record=[0]),
        door(taichi_nmm.Switch, switched, at_s=0.001, gains=PUBLISHED_GAINS),
        door(taichi_nmm.smooth_cost, rows=rows, target_speed_mps=1.3),
        door(taichi_nmm.walking_cost, rows=rows, target_speed_mps=1.3),
    ]


def ground_doors(folder):
    (folder / "hill.csv").write_text("0,0\n1,1\n")
    return [
        door(terrain.from_file, path=folder / "hill.csv"),
        door(terrain.blocks, seed=1),
        door(terrain.rough, seed=1),
        door(terrain.ramp),
        door(terrain.stairs),
    ]


def store_doors(store, folder):
    opened = storage.open_store(store)
    settings = "samples = 4\nseed = 1\nfamilies.gale.settings = 2\n"
    carts, config = robot.written_store(folder, "door_carts", settings)
    return [
        door(
            storage.FunctionSimulator,
            function=robot.drive,
            parameters=robot.PARAMETERS,
            columns=robot.COLUMNS,
            worlds=robot.WORLDS,
            measures={"speed_mps": (0, 1)},
        ),
        door(
            storage.make_store,
            simulator=robot.Cart,
            out=folder / "made",
            workers=1,
            fresh=True,
            samples=2,
        ),
        door(storage.merge, source=store, target=folder / "merged.parquet"),
        door(storage.open_store, path=store),
        door(opened.points),
        door(opened.require_bounds),
        door(opened.numpy),
        door(opened.table),
        door(opened.tables),
        door(opened.settings_of, family="up"),
        door(opened.kept, family="up"),
        door(opened.outcomes, family="up", column="survived_fraction"),
        door(opened.all_outcomes, column="survived_fraction", families=("rough", "up")),
        door(study.world_table, path=store, cost=Objective().in_worlds),
        door(
            study.worlds_function,
            path=carts,
            config=config,
            cost=lambda given, horizon_s: given["speed_mps"],
        ),
        door(study.FeatureTable.from_parquet, path=store, features=["phi_printed"]),
    ]


def robot_doors():
    robots = {
        "model": ASSETS / "cart.xml",
        "controller": still,
        "parameters": BOX,
        "fallen": never,
    }
    herd = storage.MujocoSimulator(**robots)

    # How long a run lasts is the caller's to choose, be it for ever.
    def states(point, world):
        return herd.states(point, world, 0.01)

    def trial(point, world):
        return herd.trial(point, world, 0.01)

    one_run = {"point": {"x": 0.5}, "world": {}}
    return [
        door(storage.MujocoSimulator, **robots),
        door(states, **one_run)._replace(name="MujocoSimulator.states"),
        door(trial, **one_run)._replace(name="MujocoSimulator.trial"),
        door(parameter, name="x", low=1.0, high=2.0)._replace(name="Uniform"),
    ]


def still(point, sensed, memory):
    return np.zeros((len(sensed.x_m), 1))


def never(sensed):
    return np.zeros(len(sensed.x_m), dtype=bool)


def parameter(name, low, high, log=False, step=0.5):
    """A store checks the parameters of a simulator before it draws any."""

    class Cart(toy.Cart):
        parameters = (storage.Uniform(name, low, high, log, step),)

    check_simulator(Cart())


def bench_doors(folder):
    path = bench_robot.write(folder)
    bench = study.Bench.new(path, "me")
    params = {"stiffness": 100.0, "damping": 1.0}
    bench.add([(params, 1.0)])
    pending = bench.next()[0].number
    told = {"value": 1.0, "columns": {"torque": 1.0}}

    def undone(entry):
        """The trial is pending again, for the next call."""
        bench.undo()

    return [
        door(study.Bench, path=path),
        door(study.Bench.new, path=path),
        door(bench.abort, undone, number=pending),
        door(bench.add, rows=[(params, 1.0)]),
        door(bench.add_new, rows=[]),
        door(bench.best),
        door(bench.context, undone, name="snow"),
        door(bench.correct, number=0, **told),
        door(bench.doubts),
        door(bench.expected, params=[params]),
        door(bench.look),
        door(bench.next),
        door(bench.pending),
        door(bench.record, undone, number=pending, **told),
        door(bench.repeat),
        door(bench.shown),
        door(bench.simulated),
        door(bench.undo),
        door(bench.worth),
    ]


def table_doors(folder):
    frame = pd.DataFrame({"x": [0.0, 1.0], "f": [1.0, 2.0]})
    frame.to_parquet(folder / "frame.parquet")
    named = {"parameters": ["x"], "features": ["f"], "bounds": {"x": (0, 1)}}
    from_arrays = study.FeatureTable.from_arrays
    of_x = partial(from_arrays, {"x": [0, 1]}, [1, 2])
    return [
        door(study.FeatureTable, rows=table().rows),
        door(
            from_arrays,
            parameters={"x": [0.0, 1.0]},
            features=[1, 2],
            feature_names=["f"],
            bounds={"x": (0, 1)},
        ),
        door(from_arrays, parameters={"x": [0.0, 1.0]}, outcomes=np.eye(2)),
        door(lambda x: from_arrays({"x": x}, [1, 2]), x=[0.0, 1.0]),
        door(lambda x: of_x(bounds={"x": x}), x=(0, 1)),
        door(lambda low: of_x(bounds={"x": (low, 1)}), low=0),
        door(lambda x: of_x(space={"x": x}), x=BOX["x"]),
        door(study.FeatureTable.from_dataframe, frame=frame, **named),
        door(study.FeatureTable.from_parquet, path=folder / "frame.parquet", **named),
        door(
            study.FeatureTable.from_kernel, gram=np.eye(2), parameters={"x": [0.0, 1.0]}
        ),
        door(
            study.forecast,
            table=from_arrays({"x": [0.0, 1.0]}, outcomes=np.eye(2)),
            success=0.5,
            maximise=False,
            allowed_risk={},
            seed=1,
            robots=1,
        ),
        door(study.FeatureTable.from_graph, weights=np.ones((2, 2)), hops=2.0),
    ]


def sampler_doors():
    sampler = study.FeatureKernelSampler(table(), seed=1)
    finished = tried(sampler)
    options = {
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
    return [
        door(sampler.worth, study=finished),
        door(sampler.best, study=finished),
        door(sampler.predict, study=finished, params=[{"x": 0.5}]),
        door(study.DoGSampler, tried, table=table(), **options),
        door(study.FeatureKernelSampler, tried, features=table(), **options),
        door(study.FeatureKernelSampler, tried, features=None, space=BOX, seed=1),
    ]


def table():
    column = np.linspace(0, 1, 20)
    return study.FeatureTable.from_arrays({"x": column}, column)


def tried(sampler):
    """Trials of a sampler: options that make one must pass them."""
    found = optuna.create_study(sampler=sampler)
    found.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=4)
    return found


def public_names():
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


def test_one_line_or_success(store, tmp_path, monkeypatch):
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    doors = [
        *walker_doors(),
        *ground_doors(tmp_path),
        *store_doors(store, tmp_path),
        *robot_doors(),
        *bench_doors(tmp_path),
        *table_doors(tmp_path),
        *sampler_doors(),
    ]
    assert set(public_names()) <= {door.name for door in doors}
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")  # "a" may be the name of a file to write
    tried_calls, wrong = 0, []
    for name, call, arguments in doors:
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

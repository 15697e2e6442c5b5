"""A function as a simulator: stores from Python and of the command, and what is refused."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage import FunctionSimulator, make_store, open_store
from storage.inputs.config import Table
from storage.points import in_unit_cube, sobol_points, within_bounds
from storage.simulator import Uniform, import_object, run_points
from storage.specification import read_specification
from study import FeatureTable
from study.experiment.gains import gains_of_row
from study.sampler.columns import store_parameters
from tests.cases import ASSETS, asset, refused
from tests.processes import printed, python
from tests.storage import plants, robot
from tests.storage.fake import content

CONFIGURATION = asset("function-cart.toml")
CONFIGURATION.pop("simulator")  # which is given itself
GALE = CONFIGURATION["families"]["gale"]


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("stores") / "cart"
    make_store(robot.Cart, path, workers=1, **CONFIGURATION)
    return path


def changed(function, **changes):
    given = {
        "parameters": robot.PARAMETERS,
        "worlds": robot.WORLDS,
        "columns": robot.COLUMNS,
    }
    return FunctionSimulator(function, **(given | changes))


def runs(simulator):
    """Eight points in two worlds."""
    worlds = simulator.read_worlds(Table(GALE | {})).draw(
        list(map(np.random.SeedSequence, (1, 2)))
    )
    points = sobol_points(1, 0, 8, simulator.parameters)
    return run_points(simulator, points, worlds, 2, 5.0)[0]


def test_rows_are_what_the_function_returns(store):
    opened = open_store(store, verify=True)
    rows, gains = opened.numpy(), opened.points()
    assert opened.simulator == "robot:drive" and opened.parameter_names == tuple(
        robot.PARAMETERS
    )
    modes = [robot.PARAMETERS["mode"].choices[int(mode)] for mode in gains[:, 3]]
    points = [
        dict(zip(robot.PARAMETERS, (*row[:3], mode), strict=True))
        for row, mode in zip(gains.tolist(), modes, strict=True)
    ]
    base = [robot.drive(point, robot.WORLDS, 5.0) for point in points]
    for column in robot.COLUMNS:
        assert rows[column].tolist() == [each[column] for each in base]
    drawn = opened.specification["families"]["gale"]["drawn"]
    assert drawn["mass_kg"] == [0.8] * 3 and len(set(drawn["seed"])) == 3
    assert (
        all(1.0 <= wind <= 3.0 for wind in drawn["wind"])
        and len(set(drawn["wind"])) == 3
    )
    outcomes = opened.outcomes("gale", "survived_fraction")
    for point, found, ran in zip(points, outcomes, rows["gale_evaluated"], strict=True):
        worlds = [{"wind": wind, "mass_kg": 0.8} for wind in drawn["wind"]]
        expected = [
            robot.drive(point, world, 8.0)["survived_fraction"] for world in worlds
        ]
        np.testing.assert_allclose(found, expected if ran else np.nan, rtol=1e-6)
    assert set(rows["run_ended"]) == {"ran"}


@pytest.mark.slow
def test_the_command_makes_the_same_bytes_until_a_file_changes(store, tmp_path):
    shutil.copy(robot.__file__, tmp_path / "my_robot.py")
    shutil.copy(ASSETS / "function-cart.toml", tmp_path / "cart.toml")
    words = (
        "-m",
        "taichi_nmm",
        "precompute",
        "--config",
        tmp_path / "cart.toml",
        "--out",
        "out",
    )
    printed(*words, "--workers", "2", cwd=tmp_path)
    code = "import my_robot, storage; storage.make_store(my_robot.Cart, 'python', workers=1, **{})"
    printed("-c", code.replace("{}", repr(CONFIGURATION)), cwd=tmp_path)
    assert content(tmp_path / "python") == content(tmp_path / "out")
    assert open_store(tmp_path / "out").table().equals(open_store(store).table())
    with (tmp_path / "my_robot.py").open("a") as file:
        file.write("# another version\n")
    done = python(*words, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("error: code_version: ")
    assert len(open_store(tmp_path / "out")) == 60


@pytest.mark.parametrize(
    ("file", "text", "match"),
    [
        ("json.py", "", "a file whose name is not that of another module .*json"),
        ("broken_robot.py", "1 / 0", "module:Class .division by zero"),
        (
            "odd.py",
            "import storage; storage.FunctionSimulator(3, parameters={}, columns=())",
            "^fun",
        ),
    ],
)
def test_a_file_that_has_no_simulator(file, text, match, tmp_path):
    (tmp_path / file).write_text(text + "\nloads = 1\n")
    table = Table({"simulator": f"{file}:loads", "samples": 8}, folder=tmp_path)
    with refused(match):
        read_specification(table)


def test_many_runs_at_a_time_are_the_same_rows():
    one, many = runs(robot.Cart), runs(robot.Carts)
    for column in robot.COLUMNS:
        np.testing.assert_allclose(one[column], many[column], rtol=1e-14)
    report = []
    worlds = robot.Cart.read_worlds(Table({})).draw([np.random.SeedSequence(1)])
    drawn = {name: values.item() for name, values in worlds.items()}
    assert drawn == robot.WORLDS | {"seed": drawn["seed"]}
    robot.Cart.run(
        sobol_points(1, 0, 4, robot.Cart.parameters), worlds, 5.0, report.append
    )
    assert report == [0.25, 0.5, 0.75, 1.0]


def test_points_fill_their_distributions():
    parameters = (
        *robot.Cart.parameters,
        Uniform("count", 1.0, 100.0, log=True, step=1.0),
    )
    points = sobol_points(1, 0, 4096, parameters)
    assert points[:, 0].min() >= 0.1 and points[:, 0].max() <= 10.0
    # of its logarithm
    assert np.mean(points[:, 0] < 1.0) == pytest.approx(0.5, abs=0.01)
    assert np.mean(points[:, 1] < 0.5) == pytest.approx(0.75, abs=0.01)
    for place, values in ((2, range(1, 6)), (3, range(2))):
        found, counts = np.unique(points[:, place], return_counts=True)
        assert found.tolist() == list(values)
        np.testing.assert_allclose(counts / 4096, 1 / len(values), atol=0.01)
    counts = points[:, 4]
    assert np.all(counts == np.rint(counts))
    assert np.mean(counts < 10) == pytest.approx(0.56, abs=0.02)
    unit = in_unit_cube(points, parameters)
    assert np.all((unit >= 0.0) & (unit <= 1.0))
    np.testing.assert_allclose(within_bounds(unit, parameters), points, rtol=1e-12)


def test_tables_have_the_parameters_that_studies_suggest(store):
    table = FeatureTable.from_parquet(store, features=["gale_survived_fraction_mean"])
    distributions = table.rows.space.as_dict()
    assert isinstance(distributions["mode"], CategoricalDistribution)
    assert distributions["mode"].choices == ("slow", "fast")
    assert isinstance(distributions["gear"], IntDistribution)
    assert distributions["thrust_n"] == FloatDistribution(0.1, 10.0, log=True)
    assert distributions["steer"] == FloatDistribution(-1.0, 1.0)
    with refused(r"^store\.simulator: 'robot:drive' .* walker"):
        gains_of_row(store, 3)


def test_a_choice_that_is_none_of_its_parameters_is_refused():
    """A store comes from anybody; -1 would be the last choice."""
    ranges = {
        "mode": {"distribution": json.loads(robot.Cart.parameters[3].distribution)}
    }
    for number in (-1.0, 0.5, 2.0, np.nan):
        with refused(r"^store\.gains\.mode: .*none of its choices"):
            store_parameters(ranges, np.array([[0.0], [number]]))


def sometimes(point, world, seconds):
    if point["mode"] == "fast" and point["gear"] > 3:
        raise ZeroDivisionError("gear box")
    found = robot.drive(point, world, seconds)
    return found | ({"speed_mps": np.nan} if point["gear"] == 1 else {})


def test_a_run_that_fails_is_a_coded_row_and_stops_no_other():
    rows, whole = runs(changed(sometimes)), runs(robot.Cart)
    failed = rows["run_ended"] == 1
    assert 0 < failed.sum() < failed.size
    assert (runs(changed(never))["run_ended"] == 1).all()  # no row depends on its batch
    assert not any(rows[column][failed].any() for column in robot.COLUMNS)
    assert np.array_equal(rows[~failed], whole[~failed])


def never(point, world, seconds):
    raise ValueError("no\nmodel")


def random_drive(point, world, seconds):
    found = robot.drive(point, world, seconds)
    return found | {"speed_mps": float(np.random.default_rng().normal())}


def returns(value):
    def function(point, world, seconds):
        return value

    function.__qualname__ = "returns"
    return function


@pytest.mark.parametrize(
    ("function", "allowed"),
    [
        (returns(3), "returns survived_fraction, speed_mps by name, not int"),
        (returns({"survived_fraction": 1.0}), r"by name, not \['survived_fraction'\]"),
        (
            returns({"survived_fraction": [1.0, 1.0], "speed_mps": 1}),
            r"broadcast to \[1, 1\]",
        ),
        (
            returns({"survived_fraction": 1.5, "speed_mps": 1}),
            "survived_fraction from 0 to 1, not 1.5",
        ),
    ],
)
def test_a_function_that_does_not_keep_to_it(function, allowed):
    with refused(f"^simulator: .*{allowed}"):
        runs(changed(function))


@pytest.mark.parametrize(
    ("function", "changes", "field"),
    [
        (lambda *_: {}, {}, "function"),
        (print, {}, "function"),
        (3, {}, "function"),
        (robot.drive, {"columns": ("speed_mps",)}, "columns"),
        (robot.drive, {"columns": ("survived_fraction", "run_ended")}, "columns"),
        (robot.drive, {"worlds": {"seed": 1.0}}, "worlds"),
        (robot.drive, {"worlds": {"wind": "much"}}, "worlds.wind"),
        (robot.drive, {"parameters": {"a": (0.0, 1.0)}}, "parameters.a"),
        (robot.drive, {"parameters": {}}, "parameters"),
    ],
)
def test_what_makes_no_simulator(function, changes, field):
    with refused(rf"^{field}: "):
        changed(function, **changes)


@pytest.mark.parametrize(
    ("simulator", "changes", "match"),
    [
        (changed(random_drive), {}, r"random_drive.* runs repeat; .*world\['seed'\]"),
        (
            changed(never),
            {},
            r"that runs, not ValueError: no.*model, at \{'thrust_n'.* in \{'wind'",
        ),
        (
            changed(never, batch=True),
            {},
            r"a function that runs, not ValueError: no.*model$",
        ),
        (
            robot.Cart,
            {"families": {"gale": GALE | {"world": {"winds": 1.0}}}},
            r"^families\.gale\.world\.winds: ",
        ),
        (
            robot.Cart,
            {"families": {"gale": GALE | {"world": {"wind": [3.0, 1.0]}}}},
            r"^families\.gale\.world\.wind: ",
        ),
        (robot.Cart, {"world": {"wind": "much"}}, r"^world\.wind: "),
        (robot.Cart, {"samples": 0}, "^samples: "),
    ],
)
def test_what_is_refused_at_once(simulator, changes, match, tmp_path):
    with refused(match):
        make_store(
            simulator, tmp_path / "store", workers=1, **(CONFIGURATION | changes)
        )
    assert not (tmp_path / "store").exists()


def test_a_family_is_like_another_one_for_callers_too(tmp_path):
    families = {"gale": GALE, "storm": {"like": "gale"}}
    made = make_store(
        robot.Cart, tmp_path, workers=1, **(CONFIGURATION | {"families": families})
    )
    assert made.settings_of("storm") == made.settings_of("gale")


def hangs(point, world, seconds):
    while point["gear"] == 2:
        pass
    return robot.drive(point, world, seconds)


def test_a_run_that_hangs_is_stopped_and_has_failed():
    rows, free = runs(changed(hangs, longest_run_s=0.02)), runs(robot.Cart)
    gears = sobol_points(1, 0, 8, robot.Cart.parameters)[:, 2]
    assert (
        rows["run_ended"][:, 0].tolist() == (gears == 2).tolist() and (gears == 2).any()
    )
    assert rows[gears != 2].tobytes() == free[gears != 2].tobytes()
    with refused(r"^longest_run_s: .* none with batch"):
        changed(robot.drive_all, batch=True, longest_run_s=1.0)


def plant(duration_s, samples=8, **changes):
    """The battery's store with a family that says no times."""
    table = {
        "simulation": {"duration_s": duration_s},
        "families": {"hot": {"settings": 2}},
    }
    return read_specification(
        Table({"samples": samples} | table | changes), simulator=plants.Battery
    )


@pytest.mark.parametrize("duration_s", [1e-6, 2.0, 5.0, 5400.0, 3.2e9])
def test_families_run_as_long_as_the_store(duration_s):
    """A circuit, a robot, a plant of 90 minutes, a forest of a century, each in true units."""
    (hot,) = plant(duration_s).families
    assert (hot.horizon_s, hot.min_survival_s) == (duration_s, 0.6 * duration_s)
    for wrong in (0.0, 1e13, float("nan")):
        with refused(r"^simulation\.duration_s: .* from 1e-09 to 1e\+12"):
            plant(wrong)


def test_each_world_keeps_what_kept_names():
    assert plant(5.0).outcomes == plants.COLUMNS
    assert plant(5.0, kept=["loss_j"]).outcomes == ("survived_fraction", "loss_j")
    assert plant(5.0, kept=["survived_fraction"]).outcomes == ("survived_fraction",)
    assert (
        plant(5.0, kept=[]).document["columns"][-1]
        == "hot_survived_fraction_worlds: double[2]"
    )
    for wrong in (["loss"], "loss_j", ["loss_j", "loss_j"], ["run_ended"]):
        with refused(r"^kept: .* survived_fraction, loss_j, finished_at_s"):
            plant(5.0, kept=wrong)


@pytest.mark.parametrize(
    ("columns", "families", "twice"),
    [
        (("origin",), {"hot": {"settings": 1}}, "origin"),
        (
            ("late_x", "x"),
            {"hot": {"settings": 1}, "hot_late": {"settings": 1}},
            "hot_late_x_mean",
        ),
    ],
)
def test_no_two_columns_of_a_store_have_one_name(columns, families, twice):
    own = changed(
        robot.drive,
        columns=("survived_fraction", *columns),
        measures={columns[0]: (0.0, 1.0)},
    )
    search = {"evaluations": 10_000, "candidates": 20}
    with refused(f"^simulator: '{twice}' .* another name"):
        table = Table({"samples": 8, "families": families, "repertoire": search})
        read_specification(table, simulator=own)


def test_a_store_of_many_columns_says_which_it_keeps():
    """Else it would have 6 numbers a row for each of them, hundreds of gigabytes."""
    columns = ("survived_fraction", *(f"cell_{number}_v" for number in range(500)))
    pack = FunctionSimulator(
        plants.charge, parameters=plants.PARAMETERS, columns=columns
    )
    table = {"samples": 10**6, "families": {"hot": {"settings": 64}}}
    with refused(r"^kept: 'missing' .* all would take 257 GB"):
        read_specification(Table(table), simulator=pack)
    chosen = read_specification(Table(table | {"kept": ["cell_3_v"]}), simulator=pack)
    assert chosen.outcomes == ("survived_fraction", "cell_3_v")
    assert (
        read_specification(Table(table | {"samples": 100}), simulator=pack).outcomes
        == columns
    )


def test_a_run_that_all_but_lasted_has_lasted():
    """Ninety steps of a minute add up to a little less than 1; some sums to a little more."""
    point, world = {"current_a": 10.0, "pulses": 1}, {"heat_k": 300.0, "seed": 0}
    assert 0.999 < plants.charge(point, world, 5400.0)["survived_fraction"] < 1.0
    for share, kept in ((1.0 - 1e-9, 1.0), (1.0 + 1e-9, 1.0), (0.9999, 0.9999)):
        one = changed(returns({"survived_fraction": share, "speed_mps": 1.0}))
        assert set(runs(one)["survived_fraction"].ravel()) == {kept}
    with refused(r"from 0 to 1, not 1\.01"):
        runs(changed(returns({"survived_fraction": 1.01, "speed_mps": 1.0})))


@pytest.mark.parametrize(
    ("statement", "changed_file"),
    [
        ("from helper import loss", "helper.py"),
        ("import helper", "helper.py"),
        ("from parts.deep import loss", "parts/deep.py"),
        ("from helper import loss", "further.py"),
        ("from . import helper", "helper.py"),
        ("from .parts import deep", "parts/deep.py"),
    ],
)
def test_files_that_a_function_imports_are_in_its_version(
    statement, changed_file, tmp_path
):
    """Half a store of a function goes on with its own physics, or not at all."""
    (tmp_path / "parts").mkdir()
    for name in (
        "parts/__init__.py",
        "parts/deep.py",
        "further.py",
        "other.py",
        "storage.py",
    ):
        (tmp_path / name).write_text("G = 9.81")
    (tmp_path / "helper.py").write_text("from further import G")
    name = tmp_path.name  # of a module that no other test has imported
    (tmp_path / f"{name}.py").write_text(
        f"def run(point, world, seconds):\n    {statement}\n    import storage\n"
    )
    simulator = changed(
        import_object("simulator", f"{name}.py:run", tmp_path, "a function")
    )
    first = simulator.code_version
    for unused in ("other.py", "storage.py"):
        (tmp_path / unused).write_text("G = 1.62")
    assert simulator.code_version == first
    (tmp_path / changed_file).write_text("G = 1.62")
    assert simulator.code_version != first


def test_a_file_that_imports_none_of_its_folder_has_the_version_of_before():
    file = Path(robot.__file__).read_bytes()
    assert robot.Cart.code_version == hashlib.sha256(file).hexdigest()[:16]


def by_mode(point, world, seconds):
    return {
        "survived_fraction": 1.0,
        "speed_mps": np.where(point["mode"] == 1, 2.0, 3.0),
    }


@pytest.mark.parametrize("batch", [False, True])
def test_choices_keep_their_types_in_any_company(batch):
    """NumPy makes words of a 1 beside "fast", so that no run of a batch would have a 1."""
    simulator = FunctionSimulator(
        by_mode,
        parameters={"mode": CategoricalDistribution([1, "fast"])},
        columns=robot.COLUMNS,
        batch=batch,
    )
    worlds = simulator.read_worlds(Table({})).draw([np.random.SeedSequence(0)])
    rows = run_points(simulator, np.array([[0.0], [1.0]]), worlds, 1, 5.0)[0]
    assert rows["speed_mps"].ravel().tolist() == [2.0, 3.0]


def of_dates(point, world, seconds):
    return {"survived_fraction": 1.0, "speed_mps": np.timedelta64(5, "ms")}


def of_phasors(point, world, seconds):
    return {"survived_fraction": 1.0, "speed_mps": np.array([[1.0 + 2.0j]])}


def of_gaps(point, world, seconds):
    return {
        "survived_fraction": 1.0,
        "speed_mps": np.ma.masked_array([[5.0]], [[True]]),
    }


def test_columns_of_another_kind_are_no_numbers():
    """NumPy would take 5 of 5 ms, the real part of a phasor, what a mask hides."""
    for function in (of_dates, of_phasors):
        with refused("speed_mps as numbers"):
            runs(changed(function))
    assert (runs(changed(of_gaps))["run_ended"] == 1).all()


@pytest.mark.parametrize("batch", [False, True])
def test_steps_may_be_longer_than_a_second(batch):
    """The check before the work takes as long as the store's runs where a second is too short."""
    simulator = changed(hourly, batch=batch)
    with refused("a function that runs, not ValueError: no step"):
        simulator.lasting(1800.0).require_machine()
    simulator.lasting(7200.0).require_machine()
    longest = []
    changed(recording(longest)).lasting(1e-6).require_machine()
    assert max(longest) == 1e-6  # a circuit's second would be a million runs


def hourly(point, world, seconds):
    if seconds < 3600.0:
        raise ValueError("no step")
    return {"survived_fraction": 1.0, "speed_mps": 1.0}


def recording(longest):
    def function(point, world, seconds):
        longest.append(seconds)
        return {"survived_fraction": 1.0, "speed_mps": 1.0}

    function.__qualname__ = "recording"
    return function


def test_a_store_in_which_nothing_came_to_the_end_says_so(tmp_path):
    late = {"settings": 2, "min_survival_s": 600.0}
    families = {
        "hot": late,
        "never": late | {"after": "hot", "min_survived_fraction": 1.0},
    }
    table = {"samples": 16, "simulation": {"duration_s": 600.0}, "families": families}
    with pytest.warns(UserWarning) as found:
        make_store(plants.Battery, tmp_path / "store", workers=1, **table)
    lines = [str(each.message) for each in found]
    assert {each.filename for each in found} == {__file__}
    for line, expected in zip(
        lines,
        (
            r"simulation\.duration_s: 0 of 16 rows lasted 600 s; the longest 0\.9 of it",
            r"families\.hot\.min_survival_s: 0 of 16 rows reached 600",
            r"families\.never\.min_survived_fraction: 0 of 16 rows reached 1",
        ),
        strict=True,
    ):
        assert re.search(expected, line)


@pytest.mark.parametrize(
    ("share", "shown"), [(0.99997, "0.9999"), (0.5, "0.5"), (0.0, "0")]
)
def test_a_share_below_1_is_not_said_to_be_1(share, shown, tmp_path):
    almost = changed(returns({"survived_fraction": share, "speed_mps": 1.0}))
    with pytest.warns(
        UserWarning, match=rf"rows lasted 5 s; the longest {re.escape(shown)} of it$"
    ):
        make_store(almost, tmp_path / "store", workers=1, samples=4)

"""A comparison on robots of somebody else's simulator: its trials, its folder, its report."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow as pa
import pytest

from storage import make_store, open_store
from storage.inputs.errors import InputError
from storage.pool import IN_PROCESS, local_pool
from storage.simulator import run_points
from study.commands.compare import main
from study.commands.study import main as study_command
from study.experiment import robots
from study.experiment.robots import RobotExperiment, compare_robots, read_robots
from study.options import parser_of
from study.report.markdown import RobotResults
from study.report.runs import read_results
from study.sampler.draws import Purpose, stream
from tests.storage import robot
from tests.storage.fake import stopping
from tests.study.conftest import refused

GALE = {"settings": 3, "min_survival_s": 3.0, "world": {"wind": [1.0, 3.0]}}
TOML = """
simulator = "carts.py:Cart"
store = "{store}"
seed = 5
runs = 4
trials = 6
arms = ["worlds", "ranking", "tpe-ranking", "random"]
simulation.duration_s = 9.0
objective = {{cost = "speed_mps", fell_cost = 4.0, noise = 0.1}}
world = {{wind = [0.0, 0.001], mass_kg = [1.0, 2.0]}}
"""
SILENT = lambda done, total: None  # noqa: E731


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robots")
    make_store(
        robot.Cart,
        folder / "cart",
        workers=1,
        samples=60,
        seed=3,
        families={"gale": GALE},
    )
    shutil.copy(robot.__file__, folder / "carts.py")
    (folder / "carts.toml").write_text(TOML.format(store=folder / "cart"))
    return folder / "carts.toml"


@pytest.fixture(scope="module")
def experiment(config: Path) -> RobotExperiment:
    return read_robots(config)


@pytest.fixture(scope="module")
def trials(
    experiment: RobotExperiment, tmp_path_factory: pytest.TempPathFactory
) -> pa.Table:
    return compare_robots(
        experiment, tmp_path_factory.mktemp("out"), IN_PROCESS, SILENT
    )


def test_a_trial_is_a_run_in_the_robots_world(
    experiment: RobotExperiment, trials: Any
) -> None:
    assert len(trials) == 4 * 4 * 6 and trials["trial"].to_pylist()[:6] == list(
        range(6)
    )
    rows = trials.to_pandas()
    for run, own in rows.groupby("run"):
        world = experiment.rule.draw([stream(5, Purpose.WORLD, run)])
        points = own[list(robot.PARAMETERS)].to_numpy()
        found, _ = run_points(experiment.simulator, points, world, 1, 9.0)
        speed, lasted = found[:, 0]["speed_mps"], found[:, 0]["survived_fraction"]
        cost = np.where(lasted < 1.0, 4.0 * (2.0 - lasted), np.minimum(speed, 4.0))
        assert own["cost"].tolist() == cost.tolist()
    factor = rows["measured"] / rows["cost"]
    assert 0.05 < np.log(factor).std() < 0.2
    assert (
        rows.assign(f=factor.round(9)).groupby(["run", "trial"])["f"].nunique().max()
        == 1
    )


@pytest.mark.parametrize(
    ("before", "after", "match"),
    [
        (
            '["slow", "fast"]',
            '["fast", "slow"]',
            r"^store\.gains\.mode: .*slow.* allowed: .*fast",
        ),
        (
            "IntDistribution(1, 5)",
            "FloatDistribution(1, 5)",
            r"^store\.gains\.gear: .*Int.* allowed",
        ),
        (
            "FloatDistribution(-1.0, 1.0)",
            "FloatDistribution(-1.0, 0.5)",
            r"^store\.gains\.steer: ",
        ),
    ],
)
def test_a_store_that_means_something_else_to_the_simulator_is_refused(
    before: str, after: str, match: str, config: Path, tmp_path: Path
) -> None:
    """Names and order are the same; choices go by their numbers, whole numbers cut a float."""
    text = Path(robot.__file__).read_text()
    assert before in text
    name = tmp_path.name  # of a module that no other test has imported
    (tmp_path / f"{name}.py").write_text(text.replace(before, after))
    toml = config.read_text().replace("carts.py", f"{name}.py")
    (tmp_path / "carts.toml").write_text(toml)
    with pytest.raises(InputError, match=match):
        read_robots(tmp_path / "carts.toml")


def test_the_ranking_is_by_the_mean_over_worlds(
    experiment: RobotExperiment, trials: Any
) -> None:
    store = open_store(experiment.store)
    lasted, speed = (
        store.outcomes("gale", name) for name in ("survived_fraction", "speed_mps")
    )
    cost = np.where(lasted < 1.0, 4.0 * (2.0 - lasted), np.minimum(speed, 4.0))
    ran = ~np.isnan(lasted).any(axis=1)
    mean = np.log1p((cost / cost[ran].min() - 1.0) / 0.3).mean(axis=1)
    best = store.gains()[np.argsort(np.where(ran, mean, np.inf), kind="stable")]
    rows = trials.to_pandas().set_index(["arm", "run"])[list(robot.PARAMETERS)]
    for run in range(4):
        assert np.array_equal(rows.loc["ranking", run], best[:6])
        assert np.array_equal(rows.loc["tpe-ranking", run][:3], best[:3])
    assert rows.loc["random"].nunique()["steer"] == 24


def test_a_stopped_comparison_goes_on_and_grows_to_the_same_trials(
    config: Path, trials: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(robots, "try_robot", stopping(2, robots.try_robot))
        compare_robots(read_robots(config), tmp_path, IN_PROCESS, SILENT)
    shown: list[tuple[int, int]] = []
    again = compare_robots(
        read_robots(config, arms="random,worlds"),
        tmp_path,
        IN_PROCESS,
        lambda done, total: shown.append((done, total)),
    )
    assert shown[0] == (4, 8) and shown[-1] == (8, 8) and len(again) == (8 + 4) * 6
    with local_pool(2) as pool:
        whole = compare_robots(read_robots(config), tmp_path, pool, SILENT)
    assert whole.equals(trials)
    longer = compare_robots(
        read_robots(config, trials=7, runs=1), tmp_path, IN_PROCESS, SILENT
    )
    kept = longer.filter(pa.compute.less(longer["trial"], 6))
    assert len(longer) == len(trials) + 4
    assert kept.select(["arm", "run"]).equals(trials.select(["arm", "run"]))
    with refused(r"^seed: 6 .* 5, as .*robots\.json says; or another"):
        compare_robots(read_robots(config, seed=6), tmp_path, IN_PROCESS, SILENT)


def test_the_command_writes_a_report(
    config: Path, trials: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--config", str(config), "--out", str(tmp_path / "out"), "--workers", "1"]
    main(parser_of("compare").parse_args(words))
    printed = capsys.readouterr().out
    assert printed.startswith((tmp_path / "out" / "report.md").read_text())
    results = RobotResults.of(read_robots(config), trials)
    lasted = trials.to_pandas().query("arm == 'ranking' and survived >= 1.0")
    assert results.arms["ranking"].walkers == lasted["run"].nunique()
    at_once = results.arms["ranking"].has_walker[:, 0].sum()
    assert f"| ranking | the ranking | {at_once} |" in printed
    with refused(r"^folder: .* a comparison of the walker; on robots"):
        read_results(tmp_path / "out")
    for option, value in (
        ("--storage", "sqlite:///x.db"),
        ("--arch", "cpu"),
        ("--store", "x"),
    ):
        with refused(f"^{option[2:]}: .* none: "):
            main(parser_of("compare").parse_args([*words, option, value]))


@pytest.mark.parametrize("arm", ["worlds", "ranking"])
def test_a_live_study_has_these_trials(
    arm: str, config: Path, trials: Any, tmp_path: Path
) -> None:
    url = f"sqlite:///{tmp_path / 'live.db'}"
    words = [
        "--config",
        str(config),
        "--storage",
        url,
        "--run",
        "2",
        "--out",
        str(tmp_path),
    ]
    for count in ("3", "6"):
        study_command(
            parser_of("study").parse_args([*words, "--arm", arm, "--trials", count])
        )
    study = optuna.load_study(study_name=f"carts/{arm}/run-002", storage=url)
    known = trials.to_pandas().query(f"arm == '{arm}' and run == 2")
    assert [trial.values[0] for trial in study.trials] == known["measured"].tolist()
    assert (
        json.loads((tmp_path / f"{arm}-run-002-best.json").read_text())
        == study.best_params
    )
    for more, match in (
        ("--arm cmaes", "^arm: "),
        ("--run 9", "^run: 9 .* 0 to 3"),
        ("--seed 7", "^seed: 7 .* 5, as the study carts/"),
    ):
        asked = [*words, "--arm", arm, *more.split()]
        with refused(match):
            study_command(parser_of("study").parse_args(asked))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"speed_mps"', '"lift"', r"^objective\.cost: 'lift' .* speed_mps"),
        ("fell_cost = 4.0", "fell_cost = 0.0", r"^objective\.fell_cost: 0\.0"),
        ('"worlds",', '"dog",', "^arm.*: 'dog' .* worlds, ranking"),
        ("wind =", "rain =", r"^world\.rain: .* only the keys wind"),
        ("seed = 5", 'seed = 5\nname = "../up"', "^name: "),
        ("runs = 4", "runs = 0", "^runs: 0"),
        ("runs", "robots", "^robots: 4"),
        ('cart"', 'no"', "^store: "),
        ("carts.py:Cart", "carts.py:Boat", "^simulator"),
    ],
)
def test_configurations_that_are_refused(
    config: Path, old: str, new: str, match: str
) -> None:
    bad = config.with_name("bad.toml")
    bad.write_text(config.read_text().replace(old, new, 1))
    with refused(match):
        read_robots(bad)


def test_arms_that_need_pytorch_are_left_out_where_it_is_missing(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(robots, "find_spec", lambda name: None)
    every = config.with_name("every.toml")
    every.write_text(re.sub("arms = .*", "", config.read_text()))
    assert {*robots.ARMS} - {*read_robots(every).arms} == {*robots.NEED_TORCH}
    assert capsys.readouterr().err.startswith("GPSampler is left out: it needs PyTorch")
    with refused(r"^arm: 'gp' .* PyTorch installed"):
        read_robots(config, arms="gp")

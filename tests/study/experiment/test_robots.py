"""A comparison on robots of somebody else's simulator: its trials, its folder, its report."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import optuna
import pyarrow.parquet as pq
import pytest

from storage import make_store, open_store
from storage.simulator import run_points
from study.commands.compare import main
from study.commands.report import main as report_command
from study.commands.study import main as study_command
from study.experiment import arms, compare
from study.experiment.folder import LIVE_ATTRIBUTE
from study.experiment.robots import ARMS, read_robots
from study.options import parser_of
from study.report.runs import read_results
from study.sampler.draws import Purpose, stream
from tests.cases import refused
from tests.storage import robot
from tests.storage.fake import stopping

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


@pytest.fixture(scope="module")
def config(tmp_path_factory):
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
def experiment(config):
    return read_robots(config)


def run_command(config, out, *more):
    """`taichi-nmm compare` in this process."""
    words = ["--config", config, "--out", out, "--workers", 1, *more]
    main(parser_of("compare").parse_args([str(word) for word in words]))


@pytest.fixture(scope="module")
def folder(config, tmp_path_factory):
    """A finished comparison."""
    out = tmp_path_factory.mktemp("out") / "carts"
    run_command(config, out)
    return out


@pytest.fixture
def trials(folder):
    return pq.read_table(folder / "trials.parquet").to_pandas()


def test_a_trial_is_a_run_in_the_robots_world(experiment, trials):
    assert len(trials) == 4 * 4 * 6 and trials["trial"].tolist()[:6] == list(range(6))
    for run, own in trials.groupby("run"):
        world = experiment.rule.draw([stream(5, Purpose.WORLD, run)])
        points = own[list(robot.PARAMETERS)].to_numpy()
        found, _ = run_points(experiment.simulator, points, world, 1, 9.0)
        speed, lasted = found[:, 0]["speed_mps"], found[:, 0]["survived_fraction"]
        cost = np.where(lasted < 1.0, 4.0 * (2.0 - lasted), np.minimum(speed, 4.0))
        assert own["cost"].tolist() == cost.tolist()
        assert own["walked"].tolist() == (lasted >= 1.0).tolist()
        assert own["speed_mps"].tolist() == speed.tolist()
    best = trials.groupby(["arm", "run"])["cost"].cummin()
    assert trials["best_cost"].tolist() == best.tolist()  # without the noise
    factor = trials["measured"] / trials["cost"]
    assert 0.05 < np.log(factor).std() < 0.2
    assert (
        trials.assign(f=factor.round(9)).groupby(["run", "trial"])["f"].nunique().max()
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
    before, after, match, config, tmp_path
):
    """Names and order are the same; choices go by their numbers, whole numbers cut a float."""
    text = Path(robot.__file__).read_text()
    assert before in text
    name = tmp_path.name  # of a module that no other test has imported
    (tmp_path / f"{name}.py").write_text(text.replace(before, after))
    toml = config.read_text().replace("carts.py", f"{name}.py")
    (tmp_path / "carts.toml").write_text(toml)
    with refused(match):
        read_robots(tmp_path / "carts.toml")


def test_the_ranking_is_by_the_mean_over_worlds(experiment, trials):
    store = open_store(experiment.stores["worlds"])
    lasted, speed = (
        store.outcomes("gale", name) for name in ("survived_fraction", "speed_mps")
    )
    cost = np.where(lasted < 1.0, 4.0 * (2.0 - lasted), np.minimum(speed, 4.0))
    ran = ~np.isnan(lasted).any(axis=1)
    mean = np.log1p((cost / cost[ran].min() - 1.0) / 0.3).mean(axis=1)
    best = store.points()[np.argsort(np.where(ran, mean, np.inf), kind="stable")]
    rows = trials.set_index(["arm", "run"])[list(robot.PARAMETERS)]
    for run in range(4):
        assert np.array_equal(rows.loc["ranking", run], best[:6])
        assert np.array_equal(rows.loc["tpe-ranking", run][:3], best[:3])
    assert rows.loc["random"].nunique()["steer"] == 24


def test_a_stopped_comparison_goes_on_and_grows_to_the_same_trials(
    config, folder, tmp_path, monkeypatch
):
    """Also arms whose samplers keep a state: they are handed on, and asked again."""
    out, whole = tmp_path / "out", (folder / "trials.parquet").read_bytes()
    monkeypatch.setattr(compare, "STRETCH_TRIALS", 2)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(compare, "advance", stopping(2, compare.advance))
        run_command(config, out)
    begun = pq.read_table(out / "arms" / "tpe-ranking.parquet")
    assert 0 < len(begun) < 4 * 6
    run_command(config, out, "--arms", "random,tpe-ranking", "--runs", 2)
    run_command(config, out, "--workers", 2)
    assert (out / "trials.parquet").read_bytes() == whole
    run_command(config, out, "--trials", 7, "--runs", 1)
    longer = pq.read_table(out / "trials.parquet").to_pandas()
    kept = longer[longer["trial"] < 6].reset_index(drop=True)
    assert len(longer) == len(kept) + 4
    assert kept.equals(pq.read_table(folder / "trials.parquet").to_pandas())
    with refused(r"^seed: 6 .* 5, as .*experiment\.json says; or another"):
        run_command(config, out, "--seed", 6)


def test_the_report_and_the_database_are_as_of_any_comparison(folder, trials, capsys):
    report_command(parser_of("report").parse_args([str(folder)]))
    text = (folder / "report" / "report.md").read_text()
    walkers = trials[trials["walked"]].groupby("arm")["run"].nunique()
    assert f"| ranking | 4 | {walkers.get('ranking', 0)} |" in text
    assert "- simulator: " in text and "TPE after 3" in text
    assert read_results(folder).arms["worlds"].walkers == walkers.get("worlds", 0)
    url = f"sqlite:///{folder / 'studies.db'}"
    study = optuna.load_study(study_name="carts/worlds/run-002", storage=url)
    own = trials.query("arm == 'worlds' and run == 2")
    assert [trial.values[0] for trial in study.trials] == own["measured"].tolist()
    assert [trial.user_attrs["cost"] for trial in study.trials] == own["cost"].tolist()
    old = folder.with_name("of 0.4")
    old.mkdir()
    (old / "robots.json").write_text("{}")
    with refused("^folder: .* a comparison of version 0.5; .* report.md"):
        read_results(old)


def test_a_store_by_option_takes_the_place_of_the_configurations(config, tmp_path):
    """The configuration's own is not even looked for."""
    known, folder = str(read_robots(config).stores["worlds"]), str(tmp_path / "out")
    moved = config.with_name("moved.toml")
    moved.write_text(config.read_text().replace(known, "nowhere"))
    words = f"--config {moved} --arms ranking --runs 1 --trials 2 --workers 1"
    asked = [*words.split(), "--out", folder]
    with refused("^store: .*nowhere"):
        main(parser_of("compare").parse_args(asked))
    main(parser_of("compare").parse_args([*asked, "--store", known]))
    assert read_results(folder).trials == 2


@pytest.mark.parametrize("arm", ["worlds", "ranking", "tpe-ranking"])
def test_a_live_study_has_these_trials(arm, config, trials, tmp_path):
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
    known = trials.query(f"arm == '{arm}' and run == 2")
    assert [trial.values[0] for trial in study.trials] == known["measured"].tolist()
    assert (
        json.loads((tmp_path / f"{arm}-run-002-best.json").read_text())
        == study.best_params
    )
    for more, match in (
        ("--arm cmaes", "^arm: 'cmaes' .* cmaes-cold, in its place since"),
        ("--arm dog", r"^stores\.flat: "),
        ("--arch cpu", "^arch: "),
        ("--run 9", "^run: 9 .* 0 to 3"),
        ("--seed 7", "^study carts/.*: seed: 7 .* 5, with which it was made"),
    ):
        asked = [*words, "--arm", arm, *more.split()]
        with refused(match):
            study_command(parser_of("study").parse_args(asked))

    # As 0.4.0 wrote it: the version is what a reader is told of.
    document = study.user_attrs[LIVE_ATTRIBUTE]
    older = document["versions"] | {"taichi-nmm": "0.4.0"}
    del document["format"]
    study.set_user_attr(LIVE_ATTRIBUTE, document | {"versions": older})
    line = (
        r"^study carts/.*: versions\.taichi-nmm: .* '0\.4\.0', with which it was made"
    )
    with refused(line):
        study_command(parser_of("study").parse_args([*words, "--arm", arm]))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"speed_mps"', '"lift"', r"^objective\.cost: 'lift' .* speed_mps"),
        ("fell_cost = 4.0", "fell_cost = 0.0", r"^objective\.fell_cost: 0\.0"),
        ("wind =", "rain =", r"^world\.rain: .* only the keys wind"),
        ("seed = 5", 'seed = 5\nname = "../up"', "^name: "),
        ("runs = 4", "runs = 0", "^runs: 0"),
        ("runs", "robots", "^robots: 4"),
        ('cart"', 'no"', "^store: "),
        ("carts.py:Cart", "carts.py:Boat", "^simulator"),
    ],
)
def test_configurations_that_are_refused(config, old, new, match):
    bad = config.with_name("bad.toml")
    bad.write_text(config.read_text().replace(old, new, 1))
    with refused(match):
        read_robots(bad)


def test_arms_that_need_pytorch_are_left_out_where_it_is_missing(
    config, monkeypatch, capsys
):
    monkeypatch.setattr(arms, "find_spec", lambda name: None)
    every = config.with_name("every.toml")
    every.write_text(re.sub("arms = .*", "", config.read_text()))
    assert {*ARMS} - {*read_robots(every).arms} == {"gp-ranking"}
    none = config.with_name("none")
    with refused("^arm: 'nobody'"):
        run_command(every, none, "--arms", "nobody")
    assert "left out" not in capsys.readouterr().err
    with refused("^trials: "):
        run_command(every, none, "--trials", 1000)
    said = [line for line in capsys.readouterr().err.splitlines() if "left out" in line]
    assert said == ["gp-ranking is left out: it needs torch (pip install torch)"]
    with refused(r"^arm: 'gp-ranking' .* another: it needs torch \(pip install torch"):
        run_command(config, none, "--arms", "gp-ranking")

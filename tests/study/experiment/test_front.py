"""Experiments with two goals: configured, compared, resumed, live, reported, and refused."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose

from storage.databases.studies import open_studies
from study.experiment.arms import ARMS, find_arm
from study.experiment.compare import Request, compare
from study.experiment.experiment import candidates
from study.experiment.features import WORLDS, front_of
from study.experiment.live_study import run_study
from study.experiment.trials import best_trial, progress_line, study_facts, study_line
from study.experiment.walker import read_experiment
from study.pictures import style
from study.report.figures import write_front, write_report
from study.report.markdown import dashboard_summary
from study.report.numbers import label_of
from study.report.runs import read_results
from tests.cases import refused
from tests.study import fake_walker

GOALS = """
objective.cost = "front"
[objective.goals]
slow = {cost = "weighted", fell_cost = 2.5, terms.mean_speed_mps = {weight = 1.0, target = 3.0}}
effort = {cost = "weighted", fell_cost = 4.0, terms.m1_mean = {weight = 2.0, target = -1.5}}
"""
TAKES = tuple(name for name, arm in ARMS.items() if arm.takes_goals)


def front(folder, old="", new=""):
    """The toy experiment with two goals, and one thing changed."""
    kept = folder / "kept" / "store"
    if not kept.exists():
        fake_walker.write_store(kept, kept=["m1_mean"])
    path = fake_walker.write_config(kept.parent)
    text = path.read_text().replace('objective.cost = "smooth"\n', "") + GOALS
    path.write_text(text.replace(old, new, 1))
    return read_experiment(path)


def area(values):
    """What points dominate, in strips from each to the next."""
    effort, slow = np.minimum(values, (4.0, 2.5)).T  # goals in the order of their names
    ends = np.unique([*effort, 4.0])
    return float(
        np.dot(np.diff(ends), [2.5 - slow[effort <= end].min() for end in ends[:-1]])
    )


def test_a_comparison_has_each_goal_and_the_front(comparisons):
    experiment = front(comparisons.folder)
    for arms, whole in ((TAKES, 5), (("nsga2",), 60)):  # beyond a generation of 50
        for out, trials in (("parts", 2), ("parts", whole), ("whole", whole)):
            comparisons.run(
                out, experiment=experiment, arms=arms, runs=1, trials=trials
            )
    assert comparisons.content("parts") == comparisons.content("whole")
    table = comparisons.table("whole").to_pandas()
    slow = np.where(
        table.walked, 3.0 - table.mean_speed_mps, 2.5 * (2.0 - table.survived_fraction)
    )
    assert_allclose(table.goal_slow, slow)
    for _, study in table.groupby("arm"):
        values = study[["goal_effort", "goal_slow"]].to_numpy()
        assert_allclose(study.cost, [-area(one) for one in values[:, None]], atol=1e-9)
        so_far = [-area(values[:n]) for n in range(1, len(values) + 1)]
        assert_allclose(study.best_cost, so_far, atol=1e-9)
    reported = write_report(read_results(comparisons.folder / "whole"), {})
    found = {arm.arm: arm for arm in reported.arms}
    assert (
        found["worlds"].best_cost.value
        == table.best_cost[table.arm == "worlds"].min()
        < 0.0
    )
    report = (comparisons.folder / "whole" / "report" / "report.md").read_text()
    assert "median best front cost after" in report and "minus the area" in report
    assert "](front.png)" in report


def test_the_front_is_drawn_as_half_of_the_runs_reach_it(comparisons, monkeypatch):
    experiment = front(comparisons.folder)
    comparisons.run("out", experiment=experiment, arms=("random", "worlds"), runs=3)
    results = read_results(comparisons.folder / "out")
    table = comparisons.table("out").to_pandas()
    drawn = []
    monkeypatch.setattr(style, "save_png", lambda figure, _: drawn.append(figure))
    write_front(comparisons.folder / "front.png", results)
    (axes,) = drawn[0].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "effort (m1_mean)",
        "slow (mean_speed_mps)",
    )
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    for arm in results.arms:
        walks = table[(table.arm == arm) & table.walked]
        runs = [walks[walks.run == run] for run in range(3)]
        for effort, slow in lines[label_of(arm)]:
            reached = [run.goal_slow[run.goal_effort <= effort].min() for run in runs]
            assert np.median(np.nan_to_num(reached, nan=np.inf)) == slow
        assert len(lines[label_of(arm)]) > 1 or arm == "random"


@pytest.mark.parametrize("arm", ["worlds", "nsga2"])
def test_a_live_study_is_a_compared_one(fake_simulator, tmp_path, arm):
    experiment = front(tmp_path)
    urls = [f"sqlite:///{tmp_path / name}.db" for name in ("live", "compared")]
    for trials in (2, 4):
        live = run_study(experiment, find_arm(arm), 0, trials, open_studies(urls[0]))
    request = Request(tmp_path / "out", urls[1], (arm,), runs=1, trials=4)
    compare(experiment, request, lambda progress: None, dashboard_summary)
    compared, summary = (
        optuna.load_study(study_name=name, storage=urls[1])
        for name in (live.study_name, "toy/summary")
    )
    for study in (live, compared, summary):
        assert study.metric_names == ["effort", "slow"]
        assert [direction.name for direction in study.directions] == ["MINIMIZE"] * 2
    values = np.array([trial.values for trial in live.trials])
    assert values.tolist() == [trial.values for trial in compared.trials]
    best, known = (
        best_trial(experiment.objective, live),
        study_facts(experiment, live),
    )
    assert best.number == np.argmax([area(one) for one in values[:, None]])
    assert known["goals"] == {"effort": best.values[0], "slow": best.values[1]}
    reached = f"front cost {0.0 - area(values):.4f}"
    line = progress_line(experiment, live, live.trials[3], 4)
    assert reached in study_line(experiment, live) and reached in line
    assert f"slow {values[3, 1]:8.4f}" in line


def test_the_front_of_a_store_has_the_rows_that_none_beats(fake_simulator, tmp_path):
    table = candidates(front(tmp_path), "worlds", WORLDS)
    worlds, numbers = table.rows.worlds, table.rows.numbers
    means = {row: worlds.weights @ worlds.costs[row] for row in numbers.tolist()}
    best = [
        row
        for row, mean in means.items()
        if not any(
            (other <= mean).all() and (other < mean).any() for other in means.values()
        )
    ]
    found = front_of(table)
    assert sorted(row for row, *_ in found) == sorted(best) and len(best) > 2
    assert_allclose(
        [costs for _, *costs in found], sorted(means[row].tolist() for row in best)
    )


@pytest.mark.parametrize(
    "case",
    [
        ("slow =", "effort =", "^config: .* readable TOML"),
        (
            "fell_cost = 4.0",
            "fell_cost = 4.0, aim = 1",
            r"^objective\.goals\.effort\.aim: 1 .* only",
        ),
        ("trials = 8", "until_walker = true", "^until_walker: 'true' .* two goals"),
        ("trials = 8", "success = 1.0", r"^success: 1\.0 .* only the keys"),
    ],
)
def test_bad_goals_are_refused(fake_simulator, tmp_path, case):
    *changed, message = case
    with refused(message):
        front(tmp_path, *changed)


def test_an_arm_of_one_cost_is_refused(comparisons):
    experiment = front(comparisons.folder)
    for name in set(fake_walker.ABLE) - set(TAKES):
        with refused(f"^arm: '{name}' .* with two goals one of random, .*worlds"):
            comparisons.run("out", experiment=experiment, arms=("random", name))
    assert not (comparisons.folder / "out").exists()

"""A study as rows of a store: anybody's, and the walker's, whose trials walk as they did."""

from concurrent.futures import Executor, Future

import numpy as np
import optuna
import pytest
from bokeh.document import Document
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from storage.databases.studies import open_studies
from storage.store import open_store
from study.experiment import folder
from study.experiment.arms import check_arms
from study.experiment.gains import gains_at, gains_of_source
from study.experiment.live_study import run_study
from study.experiment.repair import repair_of
from study.experiment.walker import read_experiment
from study.explore.page import page_of
from study.explore.store_view import first_columns, numeric_columns
from study.explore.trials import Trials, open_rows
from study.explore.walk import OWN, chosen_setting, walk
from study.options import config_path
from taichi_nmm import InputError
from tests.browser import opened_page
from tests.cases import asset
from tests.study import fake_walker
from tests.study.explore.serving import change, opened
from tests.study.explore.test_walk import LEVEL

PAID = ("mean_speed_mps", "m1_mean")


def test_the_study_of_anybody_in_a_journal_and_in_a_database(tmp_path):
    journal = optuna.storages.JournalStorage(
        JournalFileBackend(str(tmp_path / "mine.log"))
    )
    mine = optuna.create_study(storage=journal, directions=["maximize", "minimize"])
    space = {
        "value": FloatDistribution(0, 1),
        "leg-kind": CategoricalDistribution(["soft"]),
    }
    for number in range(4):
        trial = mine.ask(space)
        trial.set_user_attr("score", number)
        trial.set_user_attr("note", "no number")
        state = TrialState.FAIL if number == 3 else TrialState.COMPLETE
        mine.tell(trial, None if number == 3 else (number, 0.5), state)
    url, name = f"sqlite:///{tmp_path / 'mine.db'}", mine.study_name
    optuna.copy_study(from_study_name=name, from_storage=journal, to_storage=url)
    for file in ("mine.log", "mine.db"):
        rows = open_rows(tmp_path / file)
        assert isinstance(rows, Trials) and rows.best == 2
        assert rows.simulator == f"study {name}"
        named = ("trial", "state", "value", "value_1", "value_", "leg_kind", "score")
        assert rows.columns == named and rows.parameter_names == named[4:6]
        assert first_columns(rows, numeric_columns(rows)) == [
            "value",
            "value_1",
            "trial",
            "score",
            "value_",
        ]
        assert rows.front == [2]  # of the most and the least
        table = rows.table()
        assert table["state"].to_pylist() == ["complete"] * 3 + ["fail"]
        np.testing.assert_equal(table["value"].to_numpy(), [0.0, 1.0, 2.0, np.nan])
    one = optuna.create_study(storage=f"sqlite:///{tmp_path / 'one.db'}")
    document = Document()
    one.tell(one.ask(space), 0.5)
    page_of(tmp_path / "one.db", tmp_path)(Executor(), Executor(), Executor(), document)
    assert document.title.endswith(f"one.db: 1 trial of {one.study_name}")


def test_a_front_of_two_goals_is_drawn_between_its_axes(tmp_path):
    names, url = ["slowness", "energy"], f"sqlite:///{tmp_path / 'two.db'}"
    study = optuna.create_study(
        study_name="two/worlds/run-000", storage=url, directions=["minimize"] * 2
    )
    study.set_metric_names(names)
    goals = {
        name: {"terms": {column: 1.0}} for name, column in zip(names, PAID, strict=True)
    }
    walker = {"seed": 1, "simulation": {}, "body": {}, "ground": {}}
    objective = {"cost": "front", "goals": goals}
    study.set_user_attr("experiment", walker | {"objective": objective})
    for costs in ((3.0, 1.0), (1.0, 4.0), (2.0, 2.0), (2.5, 2.5)):
        study.tell(study.ask({"gain": FloatDistribution(0, 1)}), costs)
    document = Document()
    page_of(tmp_path / "two.db", tmp_path)(*[Executor()] * 3, document)
    assert document.title.endswith(
        "4 trials of two/worlds/run-000"
    )  # as `walk --trial`
    cloud, front = (document.get_model_by_name(name) for name in ("cloud", "front"))
    axes = [axis.axis_label.text for axis in (*cloud.below[:1], *cloud.left)]
    assert axes == ["slowness: mean_speed_mps", "energy: m1_mean"]
    assert np.transpose([*front.data.values()]).tolist() == [[1, 4], [2, 2], [3, 1]]
    for slot, name in ((0, "value_1"), (1, "trial")):
        document.get_model_by_name(f"column-{slot}").value = name
    assert len(front.data["x"]) == 0
    document.get_model_by_name("column-1").value = "value"
    assert np.transpose([*front.data.values()]).tolist() == [[1, 3], [2, 2], [4, 1]]


def test_controls_show_the_world_of_a_repair(tmp_path):
    """What was changed before it was repaired; a control that changes it has a line."""
    weak = {"world": {"muscles": {"SOL_left": 0.5}}}
    fake_walker.write_store(tmp_path / "store")
    setting = chosen_setting(**LEVEL, changes=weak)
    repair, _ = repair_of(setting, open_store(tmp_path / "store"))
    url = f"sqlite:///{tmp_path / 'repair.db'}"
    study = optuna.create_study(study_name="repair/dog/run-000", storage=url)
    study.set_user_attr("experiment", folder.document(repair, ()))
    gains = gains_of_source("published").by_name()
    spans = {name: FloatDistribution(-999.0, 999.0) for name in gains}
    study.add_trial(optuna.create_trial(params=gains, distributions=spans, value=1.0))
    page = Document()
    idle = Executor()
    idle.submit = lambda *_: Future()
    page_of(tmp_path / "repair.db", tmp_path)(*[idle] * 3, page)
    page.get_model_by_name("part").active = 1  # what if
    soleus, lines, worlds = (
        page.get_model_by_name(name)
        for name in ("world.muscles.SOL_left", "lines", "world")
    )
    assert (soleus.value, lines.value) == (0.5, "")
    soleus.value = 1.0
    assert lines.value == "[world.muscles]\nSOL_left = 1.0"
    soleus.value = 0.5
    assert lines.value == ""
    worlds.value = "nominal"
    assert soleus.value == 1.0


def test_what_is_no_study_of_one_name_with_values(tmp_path):
    for name in ("toy/dog/run-000", "toy/tpe/run-000"):
        study = optuna.create_study(
            study_name=name, storage=f"sqlite:///{tmp_path / 'two.db'}"
        )
        study.tell(study.ask(), state=TrialState.FAIL)
    (tmp_path / "empty.db").touch()
    (tmp_path / "broken.log").write_text('{"op_code": 77}\n')
    fake_walker.write_plain_store(tmp_path / "store", samples=8)
    for said, (file, *asked) in asset("no-studies.toml").items():
        with pytest.raises(InputError, match=said):
            open_rows(tmp_path / file, *asked)


@pytest.mark.slow
def test_the_walk_of_a_trial_with_a_prosthesis_is_that_of_the_trial(
    tmp_path,
):
    (tmp_path / "own.toml").write_text(
        config_path("prosthesis").read_text().replace("100.", "1.")
    )
    experiment = read_experiment(tmp_path / "own.toml")
    (arm,) = check_arms(experiment, ("random",), 2)
    run_study(experiment, arm, 1, 2, open_studies(f"sqlite:///{tmp_path / 'own.db'}"))
    rows = open_rows(tmp_path / "own.db")
    assert isinstance(rows, Trials)
    setting = chosen_setting(
        ground=OWN,
        disturbance=OWN,
        seed=experiment.seed,
        world=OWN,
        engine="taichi",
        duration_s=1.0,
        own=rows.document,
    )
    walked = walk(gains_at(rows, 1, 1), setting)
    assert walked.gains.name == "prosthesis-random-run-001-trial-1" and walked.run == 1
    assert setting.world(1).prosthesis.any()
    for name in ("distance_m", "duration_s", "phi_corrected"):
        assert walked.row[name] == rows.table()[name][1].as_py()
    with opened_page(1280, 1100) as page, opened(page, tmp_path / "own.db"):
        for number in (rows.best, 1 - rows.best):
            page.get_by_text(f"prosthesis-random-run-001-trial-{number}").wait_for()
            change(page, "row", "value", 1 - number)
        assert page.evaluate("named('world').value") == OWN
        assert page.locator(".slick-column-name").all_inner_texts().count("trial") == 1

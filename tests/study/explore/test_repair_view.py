"""A repair on the page: it runs beside it, and goes on after the server and the tab were killed."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import optuna
import pytest
from bokeh.document import Document
from optuna.trial import TrialState

from storage.store import open_store
from study.experiment.arms import find_arm
from study.experiment.gains import NamedGains, gains_of_source
from study.experiment.live_study import run_study
from study.experiment.repair import Repair, repair_of
from study.explore.repair_view import RepairView
from study.explore.walk import chosen_setting
from tests.browser import opened_page
from tests.processes import ROOT
from tests.study import fake_walker
from tests.study.explore.serving import change, opened, walks
from tests.study.explore.test_walk import LEVEL

pytestmark = pytest.mark.slow

WEAK = {"world": {"muscles": {"SOL_left": 0.5}}}
KILLED_AFTER, LOOKED_AT = 2, 4  # trials
REPAIR = "repair it: 30 trials"
LONG_MS = 600_000  # three processes start and compile, on a busy machine


def click(page, button):
    page.get_by_role("button", name=button, exact=True).click()


def done(page, trials):
    """Wait until so many trials are told."""
    told = "parseInt(document.querySelector('body') && named('repair')?.text)"
    page.wait_for_function(f"{told} >= {trials}")


def repair_half_a_soleus(page, address):
    """Begin, and wait for some trials; a second click is answered."""
    page.goto(address)
    page.wait_for_function("window.walk_player?.shown > 0")
    click(page, "what if")
    page.wait_for_function("named('lines') !== null")
    walks(page, lambda: change(page, "world.muscles.SOL_left", "value", 0.5))
    click(page, REPAIR)
    page.wait_for_function("named('repair').text.includes('begins')")
    click(page, REPAIR)
    refused = "named('repair-message').text.startsWith('this repair runs')"
    page.wait_for_function(refused)
    done(page, KILLED_AFTER)
    page.get_by_text("repair, trial").first.wait_for()  # it walks


def test_a_repair_goes_on_where_the_server_was_killed(tmp_path):
    store, out = tmp_path / "store", tmp_path / "repairs"
    fake_walker.write_store(store)
    words = ("explore", store, "--port", "0", "--no-browser", "--out", out)
    command = [sys.executable, "-m", "taichi_nmm", *map(str, words)]
    with opened_page(1280, 1000) as page:
        page.set_default_timeout(LONG_MS)
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, cwd=ROOT
        ) as server:
            try:
                assert server.stdout is not None
                repair_half_a_soleus(page, server.stdout.readline().split()[1])
            finally:
                server.kill()
        page.goto("about:blank")
        with opened(page, store):
            click(page, "what if")
            done(page, LOOKED_AT)
            click(page, "score")
            score = "named('score')?.text"
            page.wait_for_function(f"{score}?.includes('repair, trial')")
            heads = page.evaluate(f"{score}.split('<tr>')[1]")
            # The gait before the repair is the start.
            assert heads.count("repair, trial") == 1 and "start" not in heads
            click(page, "what if")
            assert (
                page.evaluate("named('lines').value")
                == "[world.muscles]\nSOL_left = 0.5"
            )
            click(page, "none of this")
            page.wait_for_function("named('repair').text.startsWith('stopped')")
            assert list(out.glob("*.json")) == []  # no later tab goes on with it
    (database,) = out.glob("repair-*/study.db")
    storage = f"sqlite:///{database}"
    (name,) = optuna.get_all_study_names(storage)
    study = optuna.load_study(study_name=name, storage=storage)
    trials = study.get_trials(states=(TrialState.COMPLETE,))
    assert len(trials) >= LOOKED_AT
    setting = chosen_setting(**LEVEL, changes=WEAK)
    experiment, arm = repair_of(setting, open_store(store))
    plain = optuna.storages.InMemoryStorage()
    alone = run_study(experiment, find_arm(arm), 0, len(trials), plain)
    for found, expected in zip(trials, alone.trials, strict=True):
        assert found.params == expected.params
        assert found.values == expected.values


def test_a_finished_repair_says_nothing_of_another_walker(tmp_path):
    fake_walker.write_store(tmp_path / "store")
    shown: list[NamedGains] = []
    with ThreadPoolExecutor(1) as menders:
        view = RepairView(
            document=Document(),
            menders=menders,
            noted=tmp_path / "left.json",
            store=open_store(tmp_path / "store"),
            show=shown.append,
            page=dict,
        )
        told = view.layout.select_one({"name": "repair"})
        weak = chosen_setting(**LEVEL, changes=WEAK)
        view.take(weak)
        view._told_of, view._runs = view._now, True
        gains = gains_of_source("published")
        view._tried(Repair(trials=30, best=3, gains=gains, words="walked"))
        assert told.text == "30 of 30 trials; best: trial number 3, walked"
        view.take(weak)  # other gains of the same walker
        assert told.text.startswith("30 of 30") and shown == [gains]
        view.take(chosen_setting(**LEVEL))
        assert told.text == ""


def test_what_cannot_be_repaired_is_said(tmp_path):
    """The page goes on, and another click may do."""
    store = tmp_path / "store"
    fake_walker.write_plain_store(store, samples=20)
    with opened_page(1280, 1000) as page, opened(page, store):
        page.set_default_timeout(LONG_MS)
        click(page, "what if")
        page.wait_for_function("named('lines') !== null")
        click(page, REPAIR)
        said = "named('repair-message').text.includes('trials: 30')"
        page.wait_for_function(said)
        assert page.evaluate("named('repair').text") == ""
        walks(page, lambda: change(page, "world.friction", "value", 0.5))

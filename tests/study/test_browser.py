"""The dashboard as a person sees it: a headless Chromium on a small experiment."""

import json
import urllib.request

import numpy as np
import optuna
import pytest

from study.experiment import artifacts
from study.experiment.artifacts import draw_best
from study.experiment.database import export
from study.report.markdown import dashboard_summary
from taichi_nmm.result import Result
from tests.browser import save
from tests.processes import serving
from tests.study import synthetic_gait
from tests.study.experiment.fake_results import experiment, results

pytestmark = pytest.mark.slow

# whoever writes to a database names its studies
SCRIPT = "<img src=x onerror=window.ran=1>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two arms, two runs; one study has a picture, of a walk that was never simulated."""
    out = tmp_path_factory.mktemp("browser") / "tiny"
    tiny, url = experiment(), f"sqlite:///{out}/studies.db"
    walk = synthetic_gait.walk(2.0, 50.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            artifacts, "recorded_walk", lambda *_: Result(np.zeros(0), (walk,))
        )
        export(tiny, results(tiny), url, dashboard_summary, final=True)
        draw_best(
            tiny,
            0,
            optuna.load_study(study_name="tiny/dog/run-000", storage=url),
            url,
            out,
        )
    optuna.create_study(storage=url, study_name=SCRIPT)
    return out


@pytest.fixture(scope="module")
def address(folder):
    """Of the command's server."""
    with serving("-m", "taichi_nmm", "dashboard", folder, "--port", 0) as said:
        lines = dict(said.readline().split(maxsplit=1) for _ in range(3))
        yield lines["dashboard"].split()[0].removesuffix("/dashboard")


@pytest.fixture(scope="module")
def studies(address):
    """Ids of the studies by name."""
    with urllib.request.urlopen(f"{address}/api/studies", timeout=30) as answer:
        listed = json.load(answer)["study_summaries"]
    return {study["study_name"]: study["study_id"] for study in listed}


def test_the_list_shows_the_studies(page, address):
    page.goto(f"{address}/dashboard")
    for name in ("tiny/dog/run-000", "tiny/random/run-001", "tiny/summary"):
        page.get_by_text(name).first.wait_for()
    page.get_by_text(SCRIPT).first.wait_for()  # as text
    assert page.evaluate("window.ran") is None
    save(page, "list")
    page.get_by_placeholder("Search study").fill("random")
    page.get_by_text("tiny/dog/run-000").wait_for(state="detached")
    assert page.get_by_text("tiny/random/run-001").is_visible()


def test_a_best_trial_shows_its_picture(page, address, studies):
    page.goto(
        f"{address}/dashboard/studies/{studies['tiny/dog/run-000']}/trials?numbers=1"
    )
    page.get_by_text("Best Trial").first.wait_for()
    page.get_by_text("strip.png").wait_for()
    page.wait_for_function(
        "document.querySelector('img[src*=artifacts]')?.naturalWidth > 500"
    )
    save(page, "trial")


def test_the_summary_leads_to_studies(page, address, studies):
    page.goto(f"{address}/dashboard/studies/{studies['tiny/summary']}/note")
    row = page.locator("tr", has_text="dog").first
    row.wait_for()
    assert row.inner_text().split("\t") == ["dog", "2", "1", "50", "> 3", "185"]
    save(page, "note")
    page.get_by_role("link", name="90", exact=True).click()  # the best of run 0 of dog
    page.get_by_text("tiny/dog/run-000").first.wait_for()
    page.get_by_text("smooth_cost").first.wait_for()
    page.go_back()
    page.get_by_role("link", name="compare").first.click()
    page.get_by_text("Best Value of tiny/random/run-000").first.wait_for()

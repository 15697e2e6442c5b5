"""The page with forms: entries by hand on a phone, one line for what is wrong, the token."""

import re
import threading
import urllib.error
import urllib.parse
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from unittest.mock import Mock

import bottle
import pytest

from storage import make_store
from storage.inputs.errors import InputError
from storage.processes import Processes
from study.bench.bench import Bench
from study.bench.form import Films, application, filming_of, of_walker
from study.bench.plan import read_plan
from study.loopback import HOST, wsgi_server
from study.pictures.movie import film_run
from taichi_nmm.parameters import GAIN_NAMES, load_gains
from tests.browser import opened_page, save
from tests.cases import refused
from tests.storage import rail
from tests.storage import robot as own
from tests.study.bench import robot


class Served:
    """A page that is served as if on this address, with what it asks for and its bench."""

    def __init__(self, folder, address):
        self.bench = Bench.new(robot.write(folder), "me")
        self.filmed = []
        films = Films(self.film, ThreadPoolExecutor(1), folder)
        app, self.token = application(self.bench, address, films)
        self.server = wsgi_server(app, HOST, 0)
        self.url = f"http://{HOST}:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever).start()

    def film(self, params):
        """A film of a simulator that refuses every second trial."""
        self.filmed.append(params)
        if len(self.filmed) == 2:
            raise InputError("film", "OpenGL", "a screen")
        return b"a film of a walker"

    def ask(self, place, form=None, **headers):
        """Status and text of an answer, redirections followed; {}: an empty form."""
        data = None if form is None else urllib.parse.urlencode(form).encode()
        request = urllib.request.Request(f"{self.url}/{place}", data, headers)
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        try:
            with opener.open(request, timeout=30) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def said(self, place, form=None):
        """The text of an answer without an error."""
        status, text = self.ask(place, form)
        assert status == 200
        return text


@pytest.fixture
def serve(tmp_path):
    """Serves a page."""
    all_served = []

    def start(address):
        all_served.append(Served(tmp_path, address))
        return all_served[-1]

    yield start
    for served in all_served:
        served.server.shutdown()
        served.server.server_close()


@pytest.fixture
def page(serve):
    """Of this machine alone, with one trial that was asked for."""
    served = serve(HOST)
    served.said("next", {"batch": 1})
    return served


@pytest.mark.parametrize(
    ("form", "line"),
    [
        ({"trial": 0, "value": "1,234"}, "value: '1,234'"),
        ({"trial": 7, "value": 1}, "trial: 7"),
        ({"trial": "x"}, "trial: 'x'"),
        ({"trial": 0}, "value: None"),
        ({"trial": 0, "value": 1, "seconds": 2}, "seconds: 2.0"),
        ({"trial": 0, "value": 1, "column torque": "<b>"}, "column torque: '<b>'"),
    ],
)
def test_what_is_wrong_is_one_line(page, form, line):
    status, text = page.ask("record", form)
    assert status == 400 and f'<p role="alert">{bottle.html_escape(line)}' in text
    assert page.bench.look().trials and page.bench.entries[-1].kind == "next"


def test_entries_by_hand(page):
    for place, form, said in (
        ("record", {"value": -31, "column torque": 95}, "far from all"),
        ("correct", {"value": "0,9", "column torque": 81}, "0: 0.9, torque 81"),
        ("correct", {"seconds": 21}, "correct 0: failed after 21 s, 3.9"),
        ("correct", {"value": 0.5}, "correct 0: 0.5, no longer a failure"),
        ("next", {"batch": 1}, "next 1"),
        ("record", {"trial": 1, "seconds": 2.1, "note": "<i>"}, "&lt;i&gt;"),
        ("context", {"name": "gravel"}, "context gravel"),
        ("undo", {"entry": 8}, "undo entry 8"),
    ):
        text = page.said(place, {"trial": 0} | form)
        assert said in text and "<i>" not in text
    state = page.bench.look()
    assert (state.trials[0].value, state.context) == (0.5, "")
    assert state.trials[0].columns == {"torque": 81.0}
    assert state.trials[1].failed and not state.trials[0].failed
    assert page.ask("next", {"batch": 10**8})[0] == 400
    assert page.ask("correct", {"trial": 0})[0] == 400
    assert page.ask("drop", {})[0] == 404
    assert page.ask("", Host="evil.example")[0] == 403
    assert page.ask("undo", {"entry": 1}, Origin="http://evil.example")[0] == 403


def test_candidates_are_filmed_once_when_they_are_asked_for(page):
    assert '<video src="/film/1"' in page.said("next", {"batch": 2})
    assert not page.filmed
    assert page.said("film/0") == page.said("film/0") == "a film of a walker"
    assert page.ask("film/0", Range="bytes=2-5") == (206, "film")  # as a phone asks
    assert [page.bench.look().trials[0].params] == page.filmed
    status, text = page.ask("film/1")
    assert status == 503 and "film: &#039;OpenGL&#039;" in text
    assert page.ask("film/1")[0] == 200 and page.ask("film/2")[0] == 404


def test_a_database_that_cannot_be_read_is_one_line(page, monkeypatch):
    locked = InputError("storage", "walk.db", "a database that no other program holds")
    monkeypatch.setattr(page.bench, "look", Mock(side_effect=locked))
    status, text = page.ask("")
    assert status == 503 and "storage: &#039;walk.db&#039;" in text


def test_a_database_that_is_gone_is_one_line_whatever_is_asked(page):
    file = page.bench.plan.path.with_suffix(".db")
    for ending in ("", "-wal", "-shm"):
        file.with_name(file.name + ending).unlink(missing_ok=True)
    form = {"trial": 0, "value": 1, "batch": 1, "entry": 1}
    posted = [(place, form) for place in ("record", "next", "undo", "correct")]
    for place, given in (*posted, ("", None), ("film/0", None)):
        status, text = page.ask(place, given)
        assert status == 503 and text.count("\n") == 0, (place, status, text)
        assert "storage: " in text and "removed" in text
    assert not file.exists()


def test_strangers_on_the_network_see_nothing(serve):
    served = serve("0.0.0.0")
    for place in ("", "?token=x", "?token=", f"next?token={served.token}"):
        status, text = served.ask(place)
        assert status == 403 and "walk" not in text
    assert served.ask("next", {"batch": 1})[0] == 403
    assert len(served.bench.entries) == 1
    assert "walk" in served.said(f"?token={served.token}")
    app, _ = application(served.bench, "203.0.113.1")
    with refused(r"^listen: '203.0.113.1'.* an address of this machine"):
        wsgi_server(app, "203.0.113.1", 0)


def bench_of(store):
    """A bench over the rows of a store."""
    path = store.with_name("stored.toml")
    path.write_text(
        f'[candidates]\nstore = "{store.name}"\nfeatures = ["survived_fraction"]\n'
    )
    return Bench.new(path)


def test_what_can_be_filmed(store, tmp_path):
    own = Bench.new(robot.write(tmp_path))
    assert filming_of(own, None) is None
    filming = filming_of(bench_of(store), None)
    assert isinstance(filming, partial) and filming.func is of_walker
    for simulator, allowed in (
        ("robot.py:Cart", "a MujocoSimulator"),
        ("rail.py:Rail", "damping"),
    ):
        with refused(f"^simulator: .*{allowed}"):
            filming_of(own, f"tests/storage/{simulator}")


@pytest.mark.slow
def test_films_of_both_engines(tmp_path):
    reference = dict(zip(GAIN_NAMES, load_gains("reference").tolist(), strict=True))
    assert of_walker(reference, {"exo_torque": 30.0})[4:8] == b"ftyp"
    store = make_store(rail.Rail, tmp_path / "rail", workers=1, samples=8)
    bench = bench_of(store.path)
    filming = filming_of(bench, "tests/storage/rail.py:Rail")
    (trial,) = bench.next()
    with Processes(1) as makers:
        try:
            film = makers.submit(filming, trial.params).result()
            made = makers.submit(
                film_run, tmp_path / "run.mp4", rail.Rail, trial.params, {}, 0.5
            )
        except InputError as error:
            assert "OpenGL" in str(error)
        else:
            assert film[4:8] == made.result().read_bytes()[4:8] == b"ftyp"


@pytest.mark.slow
def test_a_phone_beside_the_machine(serve):
    served = serve("0.0.0.0")
    with opened_page(390, 780) as page:
        page.goto(f"{served.url}/?token={served.token}")
        page.get_by_label("Operator").fill("Zoë")
        page.get_by_text("This is me").click()
        page.get_by_role("button", name="Next").click()
        form = page.get_by_label("Trial 0")
        form.get_by_label("J/m").fill("0.42")
        form.get_by_label("torque, N m").fill("81")
        save(page, "bench-form")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        form.get_by_role("button", name="Record").click()
        page.get_by_text("Zoë: record 0").first.wait_for()
    assert served.bench.look().trials[0].value == 0.42
    assert served.bench.entries[-1].operator == "Zoë"


@pytest.mark.slow
def test_the_page_prints_a_sheet_for_each_pending_trial(serve):
    served = serve(HOST)
    robot.run(served.bench, 6)
    served.bench.next(batch=3)
    with opened_page(1000, 800) as page:
        page.goto(served.url)
        assert len(re.findall(rb"/Type /Page\b", page.pdf(format="A4"))) == 3
        page.emulate_media(media="print")
        assert page.get_by_role("heading", name="Trial 7").is_visible()
        for hidden in ("Trials to run", "Operator", "In the simulator"):
            assert not page.get_by_text(hidden).first.is_visible()


CANDIDATES = '[candidates]\nstore = "cart"\n{}\n[goal]\n{}\n'
RUN = "Simulated runs last 8 s{}: what is simulated is the cost of such a run."


@pytest.mark.parametrize(
    ("known", "goal", "said"),
    [
        ('cost = "speed_mps"', "", RUN.format("")),
        ('cost = "speed_mps"', "duration_s = 30", RUN.format(", a trial 30 s")),
        ('cost = "speed_mps"', "duration_s = 8", ""),
        ('features = ["survived_fraction"]', "duration_s = 30", ""),
    ],
)
@pytest.mark.filterwarnings("ignore:.* rows lasted")
def test_a_store_of_shorter_runs_is_said_on_the_sheet(tmp_path, known, goal, said):
    """Unless they are as long as a trial, or only features are read."""
    gale = {"settings": 2, "seed": 1, "horizon_s": 8.0}
    store = tmp_path / "cart"
    make_store(own.Cart, store, workers=1, samples=9, seed=3, families={"gale": gale})
    path = tmp_path / "bench.toml"
    path.write_text(CANDIDATES.format(known, goal))
    assert read_plan(path).horizon_note() == said

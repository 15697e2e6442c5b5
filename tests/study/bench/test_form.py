"""The page with forms: entries by hand on a phone, one line for what is wrong, the token."""

import re
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
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
from tests.storage import rail
from tests.storage import robot as own
from tests.study.bench import robot

Serve = Callable[[str], tuple[str, str, Bench]]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Address, token and bench of a page that is served as if on this address."""
    servers = []

    def start(address: str) -> tuple[str, str, Bench]:
        bench = Bench.new(robot.write(tmp_path), "me")
        films = Films(filmed, ThreadPoolExecutor(1), tmp_path)
        app, token = application(bench, address, films)
        servers.append(wsgi_server(app, HOST, 0))
        threading.Thread(target=servers[-1].serve_forever).start()
        return f"http://{HOST}:{servers[-1].server_port}", token, bench

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def filmed(params: Mapping[str, Any]) -> bytes:
    """A film of a simulator that refuses every second trial."""
    FILMED.append(params)
    if len(FILMED) == 2:
        raise InputError("film", "OpenGL", "a screen")
    return b"a film of a walker"


FILMED: list[Mapping[str, Any]] = []


def ask(
    url: str, form: dict[str, Any] | None = None, **headers: str
) -> tuple[int, str]:
    """Status and text of an answer, redirections followed."""
    data = None if form is None else urllib.parse.urlencode(form).encode()
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    try:
        with opener.open(
            urllib.request.Request(url, data, headers), timeout=30
        ) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_entries_by_hand_and_one_line_for_what_is_wrong(serve: Serve) -> None:
    address, token, bench = serve(HOST)
    assert token == "" and ask(f"{address}/next", {"batch": 2})[0] == 200
    for form, line in (
        ({"trial": 0, "value": "1,234"}, "value: '1,234'"),
        ({"trial": 7, "value": 1}, "trial: 7"),
        ({"trial": "x"}, "trial: 'x'"),
        ({"trial": 0}, "value: None"),
        ({"trial": 0, "value": 1, "seconds": 2}, "seconds: 2.0"),
        ({"trial": 0, "value": 1, "column torque": "<b>"}, "column torque: '<b>'"),
    ):
        status, text = ask(f"{address}/record", form)
        assert status == 400 and f'<p role="alert">{bottle.html_escape(line)}' in text
    assert len(bench.look().trials) == 2 and bench.entries[-1].kind == "next"
    assert "far from all" in ask(f"{address}/record", {"trial": 0, "value": -31})[1]
    ask(f"{address}/correct", {"trial": 0, "value": "0,9", "column torque": 81})
    ask(f"{address}/record", {"trial": 1, "seconds": 2.1, "note": "<i>"})
    ask(f"{address}/context", {"name": "gravel"})
    ask(f"{address}/undo", {"entry": 5})
    trials, state = bench.look().trials, bench.state
    assert (trials[0].value, trials[0].columns, state.context) == (
        0.9,
        {"torque": 81.0},
        "",
    )
    assert (
        trials[1].failed
        and "&lt;i&gt;" in ask(address)[1]
        and "<i>" not in ask(address)[1]
    )
    assert ask(f"{address}/next", {"batch": 10**8})[0] == 400
    assert (
        ask(f"{address}/drop", {})[0] == 404
        and ask(address, Host="evil.example")[0] == 403
    )
    assert ask(f"{address}/undo", {"entry": 1}, Origin="http://evil.example")[0] == 403


def test_candidates_are_filmed_once_when_they_are_asked_for(serve: Serve) -> None:
    address, _, bench = serve(HOST)
    FILMED.clear()
    ask(f"{address}/next", {"batch": 2})
    assert '<video src="/film/1"' in ask(address)[1] and not FILMED
    film = f"{address}/film/0"
    assert ask(film) == ask(film) == (200, "a film of a walker") and len(FILMED) == 1
    assert ask(film, Range="bytes=2-5") == (206, "film")  # as a phone asks
    assert [bench.look().trials[0].params] == FILMED
    status, text = ask(f"{address}/film/1")
    assert status == 503 and "film: &#039;OpenGL&#039;" in text
    assert ask(f"{address}/film/1")[0] == 200 and ask(f"{address}/film/2")[0] == 404


def test_a_database_that_cannot_be_read_is_one_line(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    address, _, bench = serve(HOST)
    locked = InputError("storage", "walk.db", "a database that no other program holds")
    monkeypatch.setattr(bench, "look", Mock(side_effect=locked))
    status, text = ask(address)
    assert status == 503 and "storage: &#039;walk.db&#039;" in text


def test_a_database_that_is_gone_is_one_line_whatever_is_asked(serve: Serve) -> None:
    address, _, bench = serve(HOST)
    ask(f"{address}/next", {"batch": 1})
    file = bench.plan.path.with_suffix(".db")
    for ending in ("", "-wal", "-shm"):
        file.with_name(file.name + ending).unlink(missing_ok=True)
    for place, form in (
        ("record", {"trial": 0, "value": 1}),
        ("next", {"batch": 1}),
        ("undo", {"entry": 1}),
        ("correct", {"trial": 0, "value": 1}),
        ("", None),
        ("film/0", None),
    ):
        status, text = ask(f"{address}/{place}", form)
        assert status == 503 and text.count("\n") == 0, (place, status, text)
        assert "storage: " in text and "removed" in text
    assert not file.exists()


def test_what_was_entered_is_said_and_a_time_is_corrected(serve: Serve) -> None:
    address, _, bench = serve(HOST)
    ask(f"{address}/next", {"batch": 1})
    form = {"trial": 0, "value": 0.92, "column torque": 81}
    assert "record 0: 0.92, torque 81" in ask(f"{address}/record", form)[1]
    said = ask(f"{address}/correct", {"trial": 0, "seconds": 21})[1]
    assert "correct 0: failed after 21 s, 3.9" in said and bench.look().trials[0].failed
    said = ask(f"{address}/correct", {"trial": 0, "value": 0.5})[1]
    assert "correct 0: 0.5, no longer a failure" in said
    assert ask(f"{address}/correct", {"trial": 0, "value": 1, "seconds": 2})[0] == 400
    assert ask(f"{address}/correct", {"trial": 0})[0] == 400


def test_strangers_on_the_network_see_nothing(serve: Serve) -> None:
    address, token, bench = serve("0.0.0.0")
    for end in ("", "/?token=x", "/?token=", f"/next?token={token}"):
        url = f"{address}{end}"
        assert ask(url)[0] == 403 and "walk" not in ask(url)[1]
    assert ask(f"{address}/next", {"batch": 1})[0] == 403 and len(bench.entries) == 1
    assert ask(f"{address}/?token={token}")[0] == 200
    with pytest.raises(
        InputError, match=r"^listen: '203.0.113.1'.* an address of this machine"
    ):
        wsgi_server(application(bench, "203.0.113.1")[0], "203.0.113.1", 0)


def bench_of(store: Path) -> Bench:
    """A bench over the rows of a store."""
    path = store.with_name("stored.toml")
    path.write_text(
        f'[candidates]\nstore = "{store.name}"\nfeatures = ["survived_fraction"]\n'
    )
    return Bench.new(path)


def test_what_can_be_filmed(store: Path, tmp_path: Path) -> None:
    own = Bench.new(robot.write(tmp_path))
    assert filming_of(own, None) is None
    filming = filming_of(bench_of(store), None)
    assert isinstance(filming, partial) and filming.func is of_walker
    for simulator, allowed in (
        ("robot.py:Cart", "a MujocoSimulator"),
        ("rail.py:Rail", "damping"),
    ):
        with pytest.raises(InputError, match=f"^simulator: .*{allowed}"):
            filming_of(own, f"tests/storage/{simulator}")


@pytest.mark.slow
def test_films_of_both_engines(tmp_path: Path) -> None:
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
def test_a_phone_beside_the_machine(serve: Serve) -> None:
    address, token, bench = serve("0.0.0.0")
    with opened_page(390, 780) as page:
        page.goto(f"{address}/?token={token}")
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
        assert (
            bench.look().trials[0].value == 0.42 and bench.entries[-1].operator == "Zoë"
        )


@pytest.mark.slow
def test_the_page_prints_a_sheet_for_each_pending_trial(serve: Serve) -> None:
    address, _, bench = serve(HOST)
    robot.run(bench, 6)
    bench.next(batch=3)
    with opened_page(1000, 800) as page:
        page.goto(address)
        assert len(re.findall(rb"/Type /Page\b", page.pdf(format="A4"))) == 3
        page.emulate_media(media="print")
        assert page.get_by_role("heading", name="Trial 7").is_visible()
        for hidden in ("Trials to run", "Operator", "In the simulator"):
            assert not page.get_by_text(hidden).first.is_visible()


def test_a_store_of_shorter_runs_is_said_on_the_sheet(tmp_path: Path) -> None:
    """Unless they are as long as a trial, or only features are read."""
    make_store(
        own.Cart,
        tmp_path / "cart",
        workers=1,
        samples=60,
        seed=3,
        families={"gale": {"settings": 2, "seed": 1, "horizon_s": 8.0}},
    )
    said = []
    for more in ("", "[goal]\nduration_s = 30\n", "[goal]\nduration_s = 8\n"):
        path = tmp_path / f"bench{len(said)}.toml"
        path.write_text(f'[candidates]\nstore = "cart"\ncost = "speed_mps"\n{more}')
        said.append(read_plan(path).horizon_note())
    assert said == [
        "Simulated runs last 8 s: what is simulated is the cost of such a run.",
        "Simulated runs last 8 s, a trial 30 s: what is simulated is the cost of such a run.",
        "",
    ]
    path.write_text('[candidates]\nstore = "cart"\nfeatures = ["survived_fraction"]\n')
    assert read_plan(path).horizon_note() == ""

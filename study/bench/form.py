"""The bench as a page with forms, for a phone beside the machine.

A page of HTML without a script, made anew for each request. On the loopback it answers
this machine alone, as the dashboard does; on any other address only a browser that has
opened the link with the token, which is printed once. Requests take turns. Candidates
are filmed in their simulator when a film is first asked for, to look at before the
machine tries them.
"""

import secrets
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import bottle

from storage.inputs import typed
from storage.inputs.config import Table
from storage.inputs.errors import InputError
from storage.simulator import WALKER
from storage.store import open_store
from study.bench.bench import Bench
from study.bench.journal import MOST_DIGITS, Trial
from study.bench.words import shown, times
from study.experiment.experiment import experiment_of
from study.experiment.gains import named_gains, recorded_walk
from study.loopback import HOST, Application, guarded
from study.pictures.movie import encoded, filmable, filmed
from study.pictures.scene import SMALL, frames

PAGE = bottle.SimpleTemplate(
    Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
)
PROTECTION = [
    (
        "Content-Security-Policy",
        "default-src 'none'; style-src 'unsafe-inline'; media-src 'self'; "
        "form-action 'self'; frame-ancestors 'none'",
    ),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "same-origin"),
    ("Cache-Control", "no-store"),
]
OPERATOR, COOKIE_S = "bench_operator", 30 * 24 * 3600
SHOWN_ENTRIES, LONGEST_NAME = 20, 60
Fields = Mapping[str, str]
Filming = Callable[[Mapping[str, Any]], bytes]
"""An MP4 of parameters by name; pickles."""

SECONDS = 8.0


def filming_of(bench: Bench, simulator: str | None) -> Filming | None:
    """What films a bench's candidates; None where nothing can.

    Args:
        bench: whose candidates may be a store of our walker, which walks on level
            ground.
        simulator: of MuJoCo, as `FILE:NAME`; its base setting is filmed.

    Raises:
        InputError: no such simulator, or one of other parameters.
    """
    if simulator is not None:
        filmable(simulator, bench.space)
        return partial(filmed, simulator, {}, SECONDS)
    candidates = bench.plan.candidates
    if "store" not in candidates.unread:
        return None
    store = open_store(candidates.folder / candidates.unread["store"])
    fixed = store.specification.get("fixed_gains", {})
    return partial(of_walker, fixed) if store.simulator == WALKER else None


def of_walker(fixed: Mapping[str, float], params: Mapping[str, Any]) -> bytes:
    """An MP4 of our walker on level ground, with the nominal body; `fixed` gains count too."""
    level = {
        "seed": 0,
        "simulation": {"duration_s": SECONDS},
        "terrain": {"kind": "flat"},
    }
    experiment = experiment_of(Table(level), "candidate")
    walk = recorded_walk(
        named_gains("candidate", {**fixed, **params}), experiment, 0, SMALL.rate_hz
    )
    pictures = frames(walk.trajectories[0], experiment.terrain(0), SECONDS, "", SMALL)
    return encoded(pictures, SMALL)


class Films:
    """Films in a folder, each made in a process beside this one when it is first asked for."""

    def __init__(self, filming: Filming, makers: Executor, folder: Path) -> None:
        self._filming, self._makers, self._folder = filming, makers, folder
        self._turn = threading.Lock()

    def of(self, trial: Trial) -> Path:
        """The film of a trial.

        Raises:
            InputError: what the simulator or the film's encoder refuses.
        """
        path = (
            self._folder / f"{trial.number}.mp4"
        )  # a number is given to one trial for ever
        with self._turn:
            if not path.exists():
                path.write_bytes(
                    self._makers.submit(self._filming, trial.params).result()
                )
        return path


def application(
    bench: Bench, address: str = HOST, films: Films | None = None
) -> tuple[Application, str]:
    """A WSGI application with a bench's page, and the token that it asks for ("": none).

    Args:
        bench: that was begun.
        address: where it is served.
        films: of its candidates; None: they cannot be filmed.
    """
    app, turn, own = bottle.Bottle(), threading.Lock(), bench.operator
    token = "" if address == HOST else secrets.token_urlsafe(16)
    cookie = f"bench_{secrets.token_hex(4)}"  # servers on other ports of a machine have others
    kept = {"path": "/", "httponly": True, "samesite": "lax", "maxage": COOKIE_S}

    def require_token() -> None:
        request = bottle.request
        given = (
            request.get_cookie(cookie)
            or (request.path == "/" and request.query.token)
            or ""
        )
        if not secrets.compare_digest(given.encode() if token else b"", token.encode()):
            bottle.abort(403, "open the link that the command has printed")
        host, origin = request.get_header("Host"), request.get_header("Origin")
        if (
            origin is not None and origin.partition("://")[2] != host
        ):  # https behind a proxy
            bottle.abort(403, "only the page itself may make entries")

    @contextmanager
    def operated() -> Iterator[None]:
        """The bench in the hands of the person who asks."""
        with turn:
            bench.operator = unquote(bottle.request.get_cookie(OPERATOR) or "") or own
            yield

    def show() -> Any:
        if token and bottle.request.query.token:
            bottle.response.set_cookie(cookie, token, **kept)
            return bottle.redirect("/")
        with operated():
            return page_or_line(bench, bottle.request.query.entry)

    def page_or_line(bench: Bench, entry: str = "", **told: Any) -> str:
        """The page; or one line, where the database cannot be read now."""
        try:
            return page(bench, entry, filmed=films is not None, **told)
        except InputError as error:
            raise bottle.HTTPError(503, told.get("error") or str(error)) from None

    def film(trial: int) -> Any:
        with operated():
            try:
                known = bench.look().trials
            except InputError as error:
                return bottle.abort(503, str(error))
        if films is None or trial not in known:
            return bottle.abort(404, "no such film")
        try:
            path = films.of(known[trial])
        except (InputError, BrokenExecutor) as error:
            return bottle.abort(503, str(error))
        return bottle.static_file(path.name, str(path.parent), mimetype="video/mp4")

    def name_operator() -> Any:
        name = bottle.request.forms.getunicode("operator", "").strip()[:LONGEST_NAME]
        bottle.response.set_cookie(OPERATOR, quote(name), **kept)
        return bottle.redirect("/")

    def enter(action: str) -> Any:
        if action not in ENTRIES:
            bottle.abort(404, "no such entry")
        try:
            given = dict(bottle.request.forms.decode())
        except UnicodeError:
            bottle.abort(400, "this is no text")
        with operated():
            try:
                ENTRIES[action](bench, given)
            except InputError as error:
                bottle.response.status = 400
                return page_or_line(bench, error=str(error), given=given)
            return bottle.redirect(f"/?entry={bench.entries[-1].number}")

    app.default_error_handler = error_page
    app.add_hook("before_request", require_token)
    app.get("/", callback=show)
    app.get("/film/<trial:int>", callback=film)
    app.post("/operator", callback=name_operator)
    app.post("/<action>", callback=enter)

    answer = protected(app)
    return (answer if token else guarded(answer, None)), token


def error_page(error: Any) -> str:
    """An error as one line."""
    line = bottle.html_escape(str(error.body))
    return f'<!DOCTYPE html><title>bench</title><p role="alert">{line}'


def protected(app: Application) -> Application:
    """An application whose answers tell browsers what the page may do."""

    def answer(
        environment: dict[str, Any], start: Callable[..., Any]
    ) -> Iterable[bytes]:
        def begin(status: str, headers: list[tuple[str, str]], *error: Any) -> Any:
            return start(status, [*headers, *PROTECTION], *error)

        return app(environment, begin)

    return answer


def page(
    bench: Bench,
    entry: str = "",
    error: str = "",
    given: Fields | None = None,
    filmed: bool = False,
) -> str:
    """The page after an entry of this number, or with an error and what was typed."""
    state = bench.look()
    told = list[str]()
    if entry.isdecimal() and int(entry[:MOST_DIGITS]) < len(bench.entries):
        made = bench.entries[int(entry[:MOST_DIGITS])]
        value = made.data.get("value")
        odd = "" if value is None else bench.odd(value)
        doubts = bench.doubts(made.data["trial"]) if "trial" in made.data else []
        told = [str(made).strip(), *([odd] if odd else doubts)]
    trials = list(state.trials.values())
    return str(
        PAGE.render(
            plan=bench.plan,
            context=state.context,
            operator=bench.operator,
            told=" ".join(told),
            error=error,
            given=given or {},
            shown=shown,
            undone=state.undone,
            filmed=filmed,
            times=times,
            remark=bench.plan.horizon_note(),
            pending=bench.pending(),
            finished=[trial for trial in reversed(trials) if trial.value is not None],
            entries=bench.entries[: -SHOWN_ENTRIES - 1 : -1],
        )
    )


def number(given: Fields, name: str) -> float | None:
    """A number that was typed; None where nothing was.

    Raises:
        InputError: something else.
    """
    word = given.get(name, "").strip()
    return typed.number(name, word) if word else None


def trial_of(given: Fields, name: str = "trial") -> int:
    """The number of a trial, or of an entry, that a form is about."""
    word = given.get(name, "")
    if not word.isdecimal() or len(word) > MOST_DIGITS:
        raise InputError(name, word, "a number")
    return int(word)


def rest(bench: Bench, given: Fields) -> dict[str, Any]:
    """Columns and note of a result."""
    named = {name: number(given, f"column {name}") for name in bench.plan.columns}
    columns = {name: value for name, value in named.items() if value is not None}
    return {"columns": columns, "note": given.get("note", "")}


def result(bench: Bench, given: Fields) -> dict[str, Any]:
    """The value of a trial, or after how long it failed, with the rest."""
    value = number(given, "value")
    return {"value": value, "failed_s": number(given, "seconds"), **rest(bench, given)}


ENTRIES: dict[str, Callable[[Bench, Fields], Any]] = {
    "next": lambda bench, given: bench.next(trial_of(given, "batch")),
    "record": lambda bench, given: bench.record(
        trial_of(given), **result(bench, given)
    ),
    "abort": lambda bench, given: bench.abort(trial_of(given), given.get("note", "")),
    "correct": lambda bench, given: bench.correct(
        trial_of(given), **result(bench, given)
    ),
    "undo": lambda bench, given: bench.undo(trial_of(given, "entry")),
    "context": lambda bench, given: bench.context(given.get("name", "").strip()),
}

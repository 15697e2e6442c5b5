"""The bench as a page with forms, for a phone beside the machine.

A page of HTML without a script, made anew for each request. On the loopback it answers
this machine alone, as the dashboard does; on any other address only a browser that has
opened the link with the token, which is printed once. Requests take turns. Candidates
are filmed in their simulator when a film is first asked for, to look at before the
machine tries them.
"""

import secrets
import threading
from collections.abc import Callable, Iterator, Mapping
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
from study.bench.journal import Trial
from study.bench.words import MOST_DIGITS, number_of, shown, times
from study.experiment.gains import named_gains, recorded_walk
from study.experiment.walker import experiment_of
from study.loopback import HOST, Application, guarded
from study.pictures.movie import encoded, filmable, filmed
from study.pictures.scene import SMALL, frames

PAGE = bottle.SimpleTemplate(
    Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
)
# What browsers may do with an answer.
PROTECTION = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; "
    "media-src 'self'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}
OPERATOR = "bench_operator"  # a cookie
KEPT = {
    "path": "/",
    "httponly": True,
    "samesite": "lax",
    "maxage": 30 * 24 * 3600,
}
COLUMN = "column "  # before the name of one, in a form
SHOWN_ENTRIES = 20
LONGEST_NAME = 60
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
    if bench.plan.store is None:
        return None
    store = open_store(bench.plan.store)
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
        self._filming = filming
        self._makers = makers
        self._folder = folder
        self._turn = threading.Lock()

    def of(self, trial: Trial) -> Path:
        """The film of a trial.

        Raises:
            InputError: what the simulator or the film's encoder refuses.
        """
        # A number is given to one trial for ever.
        path = self._folder / f"{trial.number}.mp4"
        with self._turn:
            if not path.exists():
                film = self._makers.submit(self._filming, trial.params)
                path.write_bytes(film.result())
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
    pages = Pages(bench, address, films)
    app = bottle.Bottle()
    app.default_error_handler = error_page
    app.add_hook("before_request", pages.require_token)
    app.add_hook("after_request", lambda: bottle.response.headers.update(PROTECTION))
    app.install(or_one_line)
    app.get("/", callback=pages.show)
    app.get("/film/<trial:int>", callback=pages.film)
    app.post("/operator", callback=pages.name_operator)
    app.post("/<action>", callback=pages.enter)
    return (app if pages.token else guarded(app, None)), pages.token


def error_page(error: Any) -> str:
    """An error as one line."""
    line = bottle.html_escape(str(error.body))
    return f'<!DOCTYPE html><title>bench</title><p role="alert">{line}'


def or_one_line(answer: Callable[..., Any]) -> Callable[..., Any]:
    """The answer; or one line, where the database cannot be read now, or no film made."""

    def answered(**given: Any) -> Any:
        try:
            return answer(**given)
        except (InputError, BrokenExecutor) as error:
            return bottle.HTTPError(503, str(error))

    return answered


class Pages:
    """The answers of an `application`, whose arguments these are.

    Attributes:
        token: that a browser must show, or have shown; "": none.
    """

    def __init__(self, bench: Bench, address: str, films: Films | None) -> None:
        self._bench = bench
        self._films = films
        self._own = bench.operator
        self._turn = threading.Lock()
        # Servers on other ports of a machine have cookies of other names.
        self._cookie = f"bench_{secrets.token_hex(4)}"
        self.token = "" if address == HOST else secrets.token_urlsafe(16)

    def require_token(self) -> None:
        """Refuse who has not opened the link, and what pages of other sites send."""
        request = bottle.request
        given = request.get_cookie(self._cookie)
        if not given and request.path == "/":
            given = request.query.token
        if self.token and not secrets.compare_digest(
            (given or "").encode(), self.token.encode()
        ):
            bottle.abort(403, "open the link that the command has printed")
        origin = request.get_header("Origin")
        # The page's own is of https where a proxy stands before it.
        if origin is not None and origin.partition("://")[2] != request.get_header(
            "Host"
        ):
            bottle.abort(403, "only the page itself may make entries")

    @contextmanager
    def _operated(self) -> Iterator[Bench]:
        """The bench, alone, in the hands of the person who asks."""
        with self._turn:
            named = unquote(bottle.request.get_cookie(OPERATOR) or "")
            self._bench.operator = named or self._own
            yield self._bench

    def show(self) -> Any:
        """The page, after an entry if the address says so."""
        if self.token and bottle.request.query.token:
            bottle.response.set_cookie(self._cookie, self.token, **KEPT)
            return bottle.redirect("/")
        with self._operated() as bench:
            bench.look()
            return self._page(told=told_of(bench, bottle.request.query.entry))

    def film(self, trial: int) -> Any:
        """The film of a trial."""
        with self._operated() as bench:
            known = bench.look().trials
        if self._films is None or trial not in known:
            return bottle.abort(404, "no such film")
        path = self._films.of(known[trial])
        return bottle.static_file(path.name, str(path.parent), mimetype="video/mp4")

    def name_operator(self) -> Any:
        """Keep the name of the person who asks, in the browser."""
        name = bottle.request.forms.getunicode("operator", "").strip()[:LONGEST_NAME]
        bottle.response.set_cookie(OPERATOR, quote(name), **KEPT)
        return bottle.redirect("/")

    def enter(self, action: str) -> Any:
        """Make an entry, and show it; or the page with what is wrong and what was typed."""
        if action not in ENTRIES:
            bottle.abort(404, "no such entry")
        try:
            given = dict(bottle.request.forms.decode())
        except UnicodeError:
            bottle.abort(400, "this is no text")
        with self._operated() as bench:
            try:
                ENTRIES[action](bench, given)
            except InputError as error:
                bench.look()
                bottle.response.status = 400
                return self._page(error=str(error), given=given)
            return bottle.redirect(f"/?entry={bench.entries[-1].number}")

    def _page(
        self, told: str = "", error: str = "", given: Fields | None = None
    ) -> str:
        bench = self._bench
        page: str = PAGE.render(
            plan=bench.plan,
            context=bench.state.context,
            operator=bench.operator,
            told=told,
            error=error,
            given=given or {},
            shown=shown,
            undone=bench.state.undone,
            filmed=self._films is not None,
            times=times,
            remark=bench.plan.horizon_note(),
            pending=bench.pending(),
            finished=reversed(bench.state.finished),
            entries=bench.entries[: -SHOWN_ENTRIES - 1 : -1],
        )
        return page


def told_of(bench: Bench, entry: str) -> str:
    """What is to be said of the entry of this number; "" where there is none."""
    if not entry.isdecimal() or int(entry[:MOST_DIGITS]) >= len(bench.entries):
        return ""
    made = bench.entries[int(entry[:MOST_DIGITS])]
    about = made.data.get("trial")
    doubts = [] if about is None else bench.doubts(about)
    return " ".join([str(made).strip(), *doubts])


def trial_of(given: Fields, name: str = "trial") -> int:
    """The number of a trial, or of an entry, that a form is about."""
    return number_of(name, given.get(name, ""))


def result(given: Fields) -> dict[str, Any]:
    """What was typed of a result: the value, or after how long it failed, columns and the note.

    Raises:
        InputError: something that is no number.
    """
    numbers = {
        name: typed.number(name, word)
        for name, word in given.items()
        if word.strip() and (name in ("value", "seconds") or name.startswith(COLUMN))
    }
    return {
        "value": numbers.pop("value", None),
        "failed_s": numbers.pop("seconds", None),
        "columns": {name.removeprefix(COLUMN): n for name, n in numbers.items()},
        "note": given.get("note", ""),
    }


ENTRIES: dict[str, Callable[[Bench, Fields], Any]] = {
    "next": lambda bench, given: bench.next(trial_of(given, "batch")),
    "record": lambda bench, given: bench.record(trial_of(given), **result(given)),
    "abort": lambda bench, given: bench.abort(trial_of(given), given.get("note", "")),
    "correct": lambda bench, given: bench.correct(trial_of(given), **result(given)),
    "undo": lambda bench, given: bench.undo(trial_of(given, "entry")),
    "context": lambda bench, given: bench.context(given.get("name", "")),
}

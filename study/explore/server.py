"""The page's server, calls of other processes of which the latest counts, and what views share.

Requests of other names than the loopback's (`study/loopback.py`) find nothing, and
sockets of other pages are refused. What Bokeh serves for other sites to embed is not
found either.
"""

import html
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import Button, ColumnDataSource, CustomJS, Div, Row
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.themes import Theme
from bokeh.util.token import get_session_id, get_token_payload
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest, ResponseStartLine
from tornado.ioloop import IOLoop
from tornado.routing import HostMatches, Matcher, PathMatches, Rule, RuleRouter

from storage.inputs.errors import InputError
from study.cli import what_is_missing
from study.loopback import HOST, LOOPBACK

OPENS, PAGE = "/", "/page"
# Not /page/metadata, nor /page/autoload.js, which any site may embed.
SERVED = rf"(?:{PAGE}|/favicon\.ico|/static/.*)"


# A sign at once: the page itself takes seconds, in which a browser would show nothing.
OPENING = b"""<!doctype html><html lang="en"><meta charset="utf-8"><title>opening</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>:root { color-scheme: light dark; font: 14px/1.4 system-ui, sans-serif }</style>
<p role="status">The page opens ...</p><script>location.replace("/page")</script>"""


def show_opening(request: HTTPServerRequest) -> None:
    """Answer with the sign."""
    headers = {"Content-Type": "text/html", "Content-Length": str(len(OPENING))}
    start = ResponseStartLine("HTTP/1.1", 200, "OK")
    request.connection.write_headers(start, HTTPHeaders(headers), OPENING)
    request.connection.finish()


class TokenMatches(Matcher):  # type: ignore[misc]  # Tornado may lack types
    """Whether a request for a socket has a page's token, as that of Bokeh's own script has.

    Bokeh would print a traceback for any other request; here such a request finds
    nothing.
    """

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        """An empty dict where the token can be read and has not expired."""
        words = request.headers.get("Sec-WebSocket-Protocol", "").split(",")
        if (
            len(words) != 2
            or request.path != f"{PAGE}/ws"
            or words[0].strip() != "bokeh"
        ):
            return None
        token = words[1].strip()
        try:
            get_session_id(token)
            expiry_s = get_token_payload(token)["session_expiry"]
            return {} if time.time() < expiry_s else None
        except Exception:  # of base64, JSON or zlib: the words are no token
            return None


def serve(page: Callable[[Document], None], taken: socket.socket) -> tuple[IOLoop, str]:
    """A loop that serves once it is started, and the page's address, that of a bound socket."""
    taken.setblocking(False)
    port = taken.getsockname()[1]
    origins = [f"{name}:{port}" for name in (HOST, "localhost")]
    application = BokehTornado({PAGE: page}, extra_websocket_origins=origins)
    asked = [
        Rule(PathMatches(OPENS), show_opening),
        Rule(PathMatches(SERVED), application),
        Rule(TokenMatches(), application),
    ]
    http = HTTPServer(RuleRouter([Rule(HostMatches(LOOPBACK), RuleRouter(asked))]))
    http.add_sockets([taken])
    server = BaseServer(IOLoop.current(), application, http)
    server.start()
    return server.io_loop, f"http://{HOST}:{port}/"


class Latest:
    """Calls of another process: one at a time, and only the newest of those that wait.

    `done` is called with each result, in the page's own loop, `failed` with what was
    raised. Once the tab of the document is closed, results are dropped.
    """

    def __init__(
        self,
        document: Document,
        executor: Executor,
        done: Callable[[Any], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        self._document = document
        self._executor = executor
        self._done = done
        self._failed = failed
        self._waits: Callable[[], Future[Any]] | None = None
        self._busy = False
        self._closed = False
        document.on_session_destroyed(self._close)

    def ask(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function of an importable module; its result comes to `done`."""
        self._waits = partial(self._executor.submit, function, *arguments)
        if not self._busy:
            self._start()

    def _start(self) -> None:
        if self._waits is None or self._closed:
            return
        submit, self._waits, self._busy = self._waits, None, True
        submit().add_done_callback(self._hand_over)

    def _hand_over(self, future: Future[Any]) -> None:
        """In a thread of the executor: the page's loop does the rest."""
        if not self._closed and not future.cancelled():
            self._document.add_next_tick_callback(partial(self._finish, future))

    def _finish(self, future: Future[Any]) -> None:
        self._busy = False
        error = future.exception()
        try:
            if error is None:
                self._done(future.result())
            else:
                self._failed(error)
        finally:
            self._start()

    def _close(self, _: object) -> None:
        self._closed = True
        self._waits = None


Call = Callable[[], None]
SCRIPTS = Path(__file__).parent / "scripts"
WARNING = "#B3261E"
# Widgets are drawn for a light page: at night they are inverted, and their hues turned
# back. Figures are no widgets: the colours of data are never changed. Long words of menus
# and heads of tables are small, or go to a second line.
NIGHT = """select.bk-input { font-size: 12px; padding-left: 8px }
.slick-header-column {
  height: 48px !important; font-size: 11px; line-height: 1.15; white-space: normal !important }
@media (max-width: 500px) { .slick-header-column { height: 62px !important } }
@media (prefers-color-scheme: dark) {
:host { filter: invert(0.92) hue-rotate(180deg); color: #22262B } }"""
WRAPS = (
    ".bk-slider-title { white-space: normal } .bk-btn-group { flex-wrap: wrap }" + NIGHT
)
# Of a figure Bokeh does not clear the outermost pixels: it paints half a pixel further.
# What an earlier size left there is hidden.
EDGE = ":host { clip-path: inset(1px 1px 0 2px) }"
WIDE = {"sizing_mode": "stretch_width"}  # as its place
LOOKS = {
    **dict.fromkeys(
        ("Column", "Row", "DataTable", "GridPlot", "MultiChoice", "TextAreaInput"), WIDE
    ),
    "Widget": {"stylesheets": [NIGHT]},
    "RadioButtonGroup": {"stylesheets": [WRAPS]},
    "Slider": WIDE | {"stylesheets": [WRAPS]},
    # Right of the axes there is room for half of the last number.
    "Plot": WIDE | {"stylesheets": [EDGE], "min_border_right": 12},
    "Div": WIDE | {"disable_math": True},
}
THEME = Theme(json={"attrs": LOOKS})
OURS = "this did not work; the error is printed where the command was started"


def flow(*children: Any, least_px: int = 120) -> Row:
    """Models beside one another, as wide as fits; those without `least_px` go to the next line."""
    for child in children:
        child.update(**WIDE, styles={"flex": f"1 1 {least_px}px"})
    return Row(*children, styles={"flex-wrap": "wrap"})


class Message:
    """One line of the page: refusals of the calls that its models make."""

    def __init__(self, name: str) -> None:
        self.layout = Div(name=name, styles={"color": WARNING}, margin=(0, 5))

    def tell(self, text: str) -> None:
        """Show this in place of the text before."""
        self.layout.text = html.escape(text)

    def failed(self, error: BaseException) -> None:
        """Show an error of a call: the line of bad input, or that the mistake is ours."""
        told = str(error) if isinstance(error, InputError) else None
        if isinstance(error, ImportError):
            told = what_is_missing(error)
        if told is None:
            traceback.print_exception(error, file=sys.stderr)
        self.tell(told or OURS)

    def safely(self, call: Call) -> Call:
        """The same call, whose errors are shown."""

        def answer() -> None:
            try:
                call()
            except Exception as error:
                self.failed(error)

        return answer

    def button(self, label: str, call: Call, **words: Any) -> Button:
        """A button that calls; `words` are Bokeh's."""
        button = Button(label=label, **words)
        button.on_click(self.safely(call))
        return button

    def watch(self, model: Any, attribute: str, call: Call) -> None:
        """Call when an attribute of a model has changed."""
        answer = self.safely(call)
        model.on_change(attribute, lambda attr, old, new: answer())


class Saver:
    """Files that are made in another process, and saved by the browser."""

    def __init__(self, document: Document, makers: Executor, message: Message) -> None:
        self._message = message
        self._files = Latest(document, makers, self._made, message.failed)
        self.source = ColumnDataSource(
            {"name": [""], "content": [np.zeros(0, np.uint8)]}, name="save"
        )  # a model of the layout has it among its `tags`: Bokeh sends no others
        script = CustomJS.from_file(SCRIPTS / "save.mjs", source=self.source)
        self.source.js_on_change("data", script)

    def save(self, function: Callable[..., tuple[str, bytes]], *arguments: Any) -> None:
        """Make a file, of this name and content; then the browser saves it."""
        self._message.tell("making the file ...")
        self._files.ask(function, *arguments)

    def _made(self, file: tuple[str, bytes]) -> None:
        name, content = file
        self._message.tell("")
        self.source.data = {
            "name": [name],
            "content": [np.frombuffer(content, np.uint8)],
        }


def run(loop: IOLoop) -> None:
    """Serve until Ctrl-C, which the loop itself sees.

    Raised as an exception it may be lost: Python drops what is raised while it frees an
    object, such as a connection that has just been closed.
    """
    with suppress(KeyboardInterrupt):
        try:
            loop.asyncio_loop.add_signal_handler(signal.SIGINT, loop.stop)
            loop.start()
        finally:
            loop.asyncio_loop.remove_signal_handler(signal.SIGINT)

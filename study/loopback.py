"""Servers that answer this machine alone: dashboard, explorer, bench, which have no passwords.

A page of any site may send a browser to the loopback address, by a name of its own that
it lets point there. So requests of other names are refused, and requests that another
page's script makes.
"""

import errno
import re
import socket
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from storage.inputs.errors import InputError

Environment = dict[str, Any]
Headers = list[tuple[str, str]]
Application = Callable[[Environment, Callable[..., Any]], Iterable[bytes]]

HOST = "127.0.0.1"
LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?\Z", re.IGNORECASE)
ARTIFACTS = "/artifacts/"
KINDS = (
    "image/png",
    "image/jpeg",
    "image/gif",
    "image/webp",
    "video/mp4",
    "video/webm",
)
NO_SNIFFING = ("X-Content-Type-Options", "nosniff")


class Server(ThreadingMixIn, WSGIServer):
    """A thread for each request: a picture must not hold up the page."""

    daemon_threads = True


class QuietHandler(WSGIRequestHandler):
    """Logs no requests."""

    def log_message(self, format: str, *args: object) -> None:
        """Drop the line."""


def wsgi_server(application: Application, address: str, port: int) -> WSGIServer:
    """A server of an application, which listens already.

    Raises:
        InputError: the port is in use, or not ours to take; or no address of this
            machine.
    """
    with listening(port, address):
        return make_server(address, port, application, Server, QuietHandler)


def bound(port: int) -> socket.socket:
    """A socket of this machine alone that takes requests: they wait until something serves them.

    Port 0 takes a free one.

    Raises:
        InputError: the port is in use, or not ours to take.
    """
    with listening(port):
        return socket.create_server((HOST, port))


@contextmanager
def listening(port: int, address: str = HOST) -> Iterator[None]:
    """Turn the system's refusal of a port or an address into one line."""
    try:
        yield
    except OSError as error:
        if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
            raise InputError("listen", address, "an address of this machine") from None
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise InputError(
            "port", port, f"a free port, or 0 ({error.strerror})"
        ) from None


def guarded(application: Application, artifacts: Path | None) -> Application:
    """A WSGI application that answers loopback names alone, and serves only images and films.

    A database may give its artifacts any type, so files of other types than pictures
    and films are refused. No answer may be read by pages of other sites. The
    application's paths below /artifacts/ are files of the folder, in which links are
    not followed; None: there are none.
    """

    def answer(environment: Environment, start: Callable[..., Any]) -> Iterable[bytes]:
        if not _is_ours(environment):
            return _refuse(
                start, "403 Forbidden", "only 127.0.0.1 and localhost are served here"
            )
        path = environment.get("PATH_INFO", "").rstrip("/")
        if not path.startswith(ARTIFACTS):
            return application(environment, _without_cors(start))
        if artifacts is None or not _is_file(artifacts / path.rpartition("/")[2]):
            return _refuse(start, "404 Not Found", "no such file")
        given: list[tuple[str, Headers]] = []
        content = application(
            environment, lambda *told: given.append((told[0], told[1]))
        )
        if not given or not _is_shown(*given[-1]):
            close: Callable[[], None] = getattr(content, "close", lambda: None)
            close()
            return _refuse(start, "403 Forbidden", "neither an image nor a film")
        status, headers = given[-1]
        _without_cors(start)(status, [*headers, NO_SNIFFING])
        return content

    return answer


def _is_ours(environment: Environment) -> bool:
    """Whether a request names the loopback, and comes from a page of it, if from any."""
    origin = environment.get("HTTP_ORIGIN")
    named = LOOPBACK.match(environment.get("HTTP_HOST", ""))
    return bool(named) and (
        origin is None or bool(LOOPBACK.match(origin.removeprefix("http://")))
    )


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


def _is_shown(status: str, headers: Headers) -> bool:
    kinds = [value for name, value in headers if name.lower() == "content-type"]
    return not status.startswith("200") or (len(kinds) == 1 and kinds[0] in KINDS)


def _without_cors(start: Callable[..., Any]) -> Callable[..., Any]:
    def begin(status: str, headers: Headers, *error: Any) -> Any:
        kept = [
            each
            for each in headers
            if not each[0].lower().startswith("access-control-")
        ]
        return start(status, kept, *error)

    return begin


def _refuse(start: Callable[..., Any], status: str, why: str) -> Iterable[bytes]:
    start(status, [("Content-Type", "text/plain; charset=utf-8"), NO_SNIFFING])
    return [f"{why}\n".encode()]

"""Servers that answer this machine alone: explorer and bench, which have no passwords.

A page of any site may send a browser to the loopback address, by a name of its own that
it lets point there. So requests of other names are refused, and requests that another
page's script makes.
"""

import errno
import re
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from storage.inputs.errors import InputError

Environment = dict[str, Any]
Application = Callable[[Environment, Callable[..., Any]], Iterable[bytes]]

HOST = "127.0.0.1"
LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?\Z", re.IGNORECASE)


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

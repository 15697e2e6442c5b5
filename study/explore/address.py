"""Bokeh's server on the loopback address, which answers loopback names alone.

A page of any site may send a browser to the loopback address by a name of its own that it lets
point there; so requests of other names find nothing, and sockets of other pages are refused.
"""

import errno
import re
from collections.abc import Callable

from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.routing import HostMatches, Rule, RuleRouter

from taichi_nmm.errors import InputError

HOST = "127.0.0.1"  # the page asks nobody who they are
NAMES = (HOST, "localhost")


def serve(page: Callable[[Document], None], port: int) -> tuple[IOLoop, str]:
    """A loop that serves once it is started, and the page's address.

    Args:
        page: fills the document of each tab.
        port: 0 takes a free one.

    Raises:
        InputError: the port is in use, or not ours to take.
    """
    try:
        sockets, port = bind_sockets(HOST, port)
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise InputError("port", port, f"a free port, or 0 ({error.strerror})") from None
    origins = [f"{name}:{port}" for name in NAMES]
    application = BokehTornado(page, extra_websocket_origins=origins)
    names = "|".join(map(re.escape, NAMES))
    http = HTTPServer(RuleRouter([Rule(HostMatches(f"(?:{names})"), application)]))
    http.add_sockets(sockets)
    server = BaseServer(IOLoop.current(), application, http)
    server.start()
    return server.io_loop, f"http://{HOST}:{port}/"

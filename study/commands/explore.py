"""Look into a store or a comparison in the browser, and let any of its gaits walk.

    taichi-nmm explore out/store
    taichi-nmm explore out/compare/rough8-smooth

opens a page of this machine only (127.0.0.1), until Ctrl-C, and prints its address. Nothing is
written into the folder. It needs the extra `explore`. Exit codes: 0, 2 bad input.
"""

import os
import sys
import webbrowser
from argparse import Namespace
from contextlib import suppress
from functools import partial
from pathlib import Path

from storage.processes import Processes
from study.command_options import Options
from taichi_nmm.kernel_cache import require_kernel_cache

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def parse() -> Namespace:
    """The options of this process."""
    parser = Options(__file__)
    parser.add_argument("folder", type=Path, metavar="DIR", help="of a store or a comparison")
    parser.whole("--port", 0, 65535, default=5006, help="%(default)s; 0: a free one")
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    return parser.parse_args()


def has_display() -> bool:
    """Whether a browser would have a window: one of a terminal would take the terminal."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in DISPLAYS)


def main() -> None:
    """Serve until Ctrl-C."""
    args = parse()
    from study.explore.address import serve  # after the options: Bokeh takes a second
    from study.explore.page import page_of
    from study.explore.walk import warm_up

    require_kernel_cache()
    page = page_of(args.folder)
    with Processes(1) as walkers, Processes(1) as makers:  # who walks does not wait for a film
        loop, address = serve(partial(page, walkers, makers), args.port)
        walkers.submit(warm_up)
        print(f"explore     {address}", flush=True)
        if has_display() and not args.no_browser:
            with suppress(webbrowser.Error):
                webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            loop.start()

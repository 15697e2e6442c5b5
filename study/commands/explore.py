"""Explore a store or a study in the browser, where a click lets any gait walk."""

import os
import sys
import webbrowser
from argparse import Namespace
from contextlib import suppress
from functools import partial

from storage.processes import Processes
from study.explore.page import page_of
from study.explore.server import serve
from study.explore.walk import warm_up
from taichi_nmm.kernel_cache import require_kernel_cache

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def has_display() -> bool:
    """Whether a browser would open a window; a text browser would take over the terminal."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in DISPLAYS)


def main(args: Namespace) -> None:
    """Serve until Ctrl-C."""
    require_kernel_cache()
    page = page_of(args.folder, args.study, args.simulator)
    with Processes(1) as walkers, Processes(1) as makers:  # a walk does not wait for a film
        loop, address = serve(partial(page, walkers, makers), args.port)
        walkers.submit(warm_up)
        print(f"explore     {address}", flush=True)
        if has_display() and not args.no_browser:
            with suppress(webbrowser.Error):
                webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            loop.start()

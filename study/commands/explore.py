"""Explore a store or a study in the browser, where a click lets any gait walk."""

import os
import sys
import webbrowser
from argparse import Namespace
from contextlib import suppress
from functools import partial
from pathlib import Path

from storage.commit import require_folder
from study.cli import guarded_imports
from study.loopback import bound

REPAIRS = Path("out", "explore")  # where these are kept, unless a folder is given
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def has_display() -> bool:
    """Whether a browser would open a window; a text browser would take over the terminal."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in DISPLAYS)


def main(args: Namespace) -> None:
    """Serve until Ctrl-C. Requests wait for the page from the first moment on."""
    if args.out is not None:
        require_folder(args.out)
    with bound(args.port) as taken:
        with guarded_imports():  # which take seconds, on a busy machine many
            from storage.processes import Processes
            from study.explore.page import page_of
            from study.explore.server import run, serve
            from study.explore.walk import warm_up
            from taichi_nmm.kernel_cache import require_kernel_cache
        require_kernel_cache()
        page = page_of(args.folder, args.out or REPAIRS, args.study, args.simulator)
        with (
            Processes(1) as walkers,
            Processes(1) as makers,
            Processes(1) as menders,
        ):  # a walk does not wait for a film, nor for a trial
            loop, address = serve(partial(page, walkers, makers, menders), taken)
            walkers.submit(warm_up)
            print(f"explore     {address}", flush=True)
            if has_display() and not args.no_browser:
                with suppress(webbrowser.Error):
                    webbrowser.open(address)
            run(loop)

"""Draw a store: which gaits survive which family of disturbances, and at which speed.

    taichi-nmm draw-store out/store-stairs --out out/store-stairs.png

Grey dots are points of the grid; red dots are candidates that a search has bred. Exit codes: 0, 2
bad input.
"""

from argparse import Namespace

from storage.store import open_store
from study.pictures.store_map import draw_store
from study.pictures.style import save_png


def main(args: Namespace) -> None:
    """Draw it and say where."""
    path = save_png(draw_store(open_store(args.store)), args.out or args.store.with_suffix(".png"))
    print(path)

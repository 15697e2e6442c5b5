"""A picture of a store: what survives which family of settings, at which speed.

    taichi-nmm draw-store out/store-stairs --out out/store-stairs.png

Grey dots are points of the grid, red ones candidates that a search bred.
"""

from argparse import Namespace
from pathlib import Path

from storage.store import open_store
from study.command_options import Options
from study.pictures.store_map import draw_store
from study.pictures.style import save_png


def main() -> None:
    """Draw it and say where."""
    args = parse()
    path = save_png(draw_store(open_store(args.store)), args.out or args.store.with_suffix(".png"))
    print(path)


def parse() -> Namespace:
    """The options of this process."""
    parser = Options(__file__)
    parser.add_argument("store", type=Path, metavar="STORE", help="a store's folder or file")
    parser.add_argument("--out", type=Path, metavar="PNG", help="default: beside the store")
    return parser.parse_args()

"""A picture of a store: what survives which family of settings, at which speed.

    python tools/draw_store.py out/store-stairs --out out/store-stairs.png

Grey dots are points of the grid, red ones candidates that a search bred.
"""

import argparse
import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from storage.store import open_store
from study.command import run_command
from study.pictures.store_map import draw_store
from study.pictures.style import save_png


def main() -> None:
    args = parse()
    path = save_png(draw_store(open_store(args.store)), args.out or args.store.with_suffix(".png"))
    print(path)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("store", type=Path, metavar="STORE", help="a store's folder or file")
    parser.add_argument("--out", type=Path, metavar="PNG", help="default: beside the store")
    return parser.parse_args()


if __name__ == "__main__":
    run_command(main)

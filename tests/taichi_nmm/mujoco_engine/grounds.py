"""Grounds of each kind, those with the steepest pieces that experiments have among them."""

from pathlib import Path

from taichi_nmm import terrain
from taichi_nmm.terrain import Terrain

TABLE = "0, 0\n1, 0.5\n1.31, 0.2\n7, 0.21\n40, -3\n"


def grounds_of(kind: str, folder: Path) -> list[Terrain]:
    """Grounds of a kind; a file of one is written to the folder."""
    file = folder / "table.csv"
    file.write_text(TABLE)
    return {
        "flat": [terrain.flat()],
        "rough": [terrain.rough(1), terrain.rough(2, amplitude_m=0.3, flat_start_m=0.0)],
        "blocks": [terrain.blocks(2), terrain.blocks(3, amplitude_m=0.2, riser_m=0.05)],
        "ramp": [terrain.ramp(), terrain.ramp(direction="down")],
        "stairs": [
            terrain.stairs(rise_m=0.05),
            terrain.stairs(direction="down", rise_m=0.15),
            terrain.stairs(rise_m=0.2, run_m=0.1),
        ],
        "file": [terrain.from_file(file)],
    }[kind]

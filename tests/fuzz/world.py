"""The sound files that are damaged: one of every format, made once with a formula for a simulator.

Nothing in them is of the day, so that a case is the same wherever and whenever it is made.
"""

import bz2
import gzip
import json
import lzma
import shutil
import sqlite3
import sys
from contextlib import chdir, closing, redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from unittest import mock

import pyarrow as pa
import pyarrow.parquet as pq

import taichi_nmm
from storage.tables import DIGEST_KEY, FOOTER_KEY, write_stamped, write_table
from study.bench import Bench, journal
from study.cli import main
from study.experiment.folder import TIME_COLUMNS, in_order
from study.options import CONFIGS
from tests.study import fake_walker
from tests.study.bench import robot

Words = tuple[str, ...]

ONE = ("--workers", "1")
COMPARE = ("compare", "--config", "toy.toml", "--out", "compared", *ONE)
PRECOMPUTE = ("precompute", "--config", "grid.toml", "--out", "grid", *ONE)
STUDY = ("study", "--config", "toy.toml", "--arm", "dog", "--out", "best", "--storage",
         "sqlite:///live.db")  # fmt: skip
STILL = ("--movie-seconds", "0", "--out", "walked")

# Every command, on files of the world, from within their folder.
COMMANDS: dict[str, Words] = {
    "compare": COMPARE,
    "precompute": PRECOMPUTE,
    "study": STUDY,
    "report": ("report", "compared"),
    "report of two": ("report", "compared", "compared", "--out", "overview"),
    "dashboard": ("dashboard", "compared", "--port", "0"),
    "explore": ("explore", "store", "--port", "0", "--no-browser"),
    "bench": ("bench", "next", "--bench", "walk.toml"),
    "bench of forms": ("bench", "serve", "--bench", "walk.toml", "--port", "0"),
    "bench of trials": ("bench", "import", "trials.csv", "--bench", "walk.toml"),
    "walk": ("walk", "--config", "toy.toml", *STILL),
    "walk on a table": ("walk", "--config", "hill.csv.toml", *STILL),
    "walk of gains": ("walk", "--gains", "gains.json", *STILL),
    "walk of a row": ("walk", "--store", "store", "--row", "7", *STILL),
    "walk of a trial": ("walk", "--trial", "toy/dog/run-001/1", "--storage", "compared", *STILL),
    "walk of a live trial": ("walk", "--trial", "toy/dog/run-000/1", "--storage",
                             "sqlite:///live.db", *STILL),
    "walk of an exported trial": ("walk", "--trial", "toy/dog/run-001/1", "--storage",
                                  "sqlite:///compared/studies.db", *STILL),
    "quickstart": ("quickstart", "--out", "quick"),
    "validate": ("validate", "--samples", "100"),
}  # fmt: skip

TOY = """\
name = "toy"
seed = 5
runs = 2
trials = 2
arms = ["random", "dog"]
objective.cost = "smooth"
simulation.duration_s = 20.0
body.disturbance = 0.15
world.friction = [0.6, 1.0]
[terrain]
kind = "rough"
amplitude_m = 0.08
[stores]
flat = "store"
"""
ON_A_TABLE = 'seed = 1\n[terrain]\nkind = "file"\nfile = "{}"\n'
GRID = """\
samples = 12
shard_rows = 8
seed = 3
simulation.duration_s = 5.0
[families.up]
settings = 2
seed = 4
terrain = {kind = "ramp", direction = "up"}
body.disturbance = 0.1
"""


HILL = "x_m,height_m\n" + "".join(f"{x},{0.01 * (x % 3)}\n" for x in range(0, 60, 2))
PACKERS = {".gz": partial(gzip.compress, mtime=0), ".bz2": bz2.compress, ".xz": lzma.compress}
UNPACKERS = {".gz": gzip.decompress, ".bz2": bz2.decompress, ".xz": lzma.decompress}
DAY = "2026-01-01 00:00:00.000000"


def make_world(folder: Path) -> None:
    """Fill a new folder; some seconds."""
    folder.mkdir(parents=True)
    for name, text in {"toy": TOY, "grid": GRID}.items():
        (folder / f"{name}.toml").write_text(text)
    for name in ("store-worlds", "mujoco-rough8"):
        shutil.copy(CONFIGS / f"{name}.toml", folder)
    for ending, pack in {"": bytes, **PACKERS}.items():
        name = f"hill.csv{ending}"
        (folder / name).write_bytes(pack(HILL.encode()))
        (folder / f"{name}.toml").write_text(ON_A_TABLE.format(name))
    gains = dict(zip(taichi_nmm.GAIN_NAMES, taichi_nmm.PUBLISHED_GAINS.tolist(), strict=True))
    (folder / "gains.json").write_text(json.dumps(gains | {"theta_ref": 0.1}, indent=1))
    with mock.patch.object(journal, "datetime") as clock:
        clock.now().isoformat.return_value = DAY
        bench = Bench.new(robot.write(folder), "me")
        robot.run(bench, 3)
        bench._journal.storage.engine.dispose()
    (folder / "trials.csv").write_text("stiffness,damping,value,torque\n50,1,0.9,80\n60,1,1.2,\n")
    simulator = mock.patch.dict(vars(taichi_nmm), simulate=fake_walker.simulate)
    shown = StringIO()
    with chdir(folder), simulator, redirect_stdout(shown), redirect_stderr(shown):
        families = {"up": {"settings": 1, "terrain": {"kind": "ramp"}}}
        fake_walker.write_store(Path("store"), robust={}, families=families)
        for words in (PRECOMPUTE, COMPARE, (*STUDY, "--trials", "2")):
            with mock.patch.object(sys, "argv", []):
                main(words)
    settle(folder)


def settle(folder: Path) -> None:
    """Put one day and one duration in place of those of this making."""
    for path in folder.rglob("arms/*.parquet"):
        table = pq.read_table(path)
        footer = json.loads(table.schema.metadata[FOOTER_KEY])
        footer.pop(DIGEST_KEY)
        place = table.schema.get_field_index("proposal_s")
        same = pa.array([0.001] * len(table))
        write_stamped(path, table.set_column(place, table.schema.field(place), same), footer)
    for path in folder.rglob("proposal_times.parquet"):
        arms = [pq.read_table(arm) for arm in sorted(path.parent.glob("arms/*.parquet"))]
        footer = json.loads(pq.read_schema(path).metadata[FOOTER_KEY])
        write_table(path, in_order(arms).select(TIME_COLUMNS), footer)
    for path in folder.rglob("run.json"):
        document = json.loads(path.read_text())
        for session in document["sessions"]:
            session |= {"started": f"{DAY}+00:00", "wall_s": 1.5}
        path.write_text(json.dumps(document, indent=2))
    for path in folder.rglob("*.db"):
        with closing(sqlite3.connect(path)) as connection:
            day = "UPDATE trials SET datetime_start = ?, datetime_complete = ?"
            connection.execute(day, (DAY, DAY))
            connection.commit()
            connection.execute("VACUUM")
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for path in [*folder.rglob("*-wal"), *folder.rglob("*-shm")]:
        path.unlink()

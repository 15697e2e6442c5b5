"""The sound files that are damaged: one of every format, made once with a formula for a simulator.

Nothing in them is of the day, so that a case is the same wherever and whenever it is
made.
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
from tests.cases import ASSETS, asset
from tests.study import fake_walker
from tests.study.bench import robot

Words = tuple[str, ...]

# Every command, on files of the world, from within their folder.
COMMANDS = {
    name: tuple(line.split()) for name, line in asset("fuzz/commands.toml").items()
}
COMPARE, PRECOMPUTE, STUDY = (
    COMMANDS[name] for name in ("compare", "precompute", "study")
)
ON_A_TABLE = 'seed = 1\n[terrain]\nkind = "file"\nfile = "{}"\n'
HILL = "x_m,height_m\n" + "".join(f"{x},{0.01 * (x % 3)}\n" for x in range(0, 60, 2))
PACKERS = {
    ".gz": partial(gzip.compress, mtime=0),
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
}
UNPACKERS = {".gz": gzip.decompress, ".bz2": bz2.decompress, ".xz": lzma.decompress}
DAY = "2026-01-01 00:00:00.000000"


def make_world(folder):
    """Fill a new folder; some seconds."""
    folder.mkdir(parents=True)
    ours = [ASSETS / "fuzz" / f"{name}.toml" for name in ("toy", "grid")]
    shipped = [CONFIGS / f"{name}.toml" for name in ("store-worlds", "mujoco-rough8")]
    for file in (*ours, *shipped):
        shutil.copy(file, folder)
    for ending, pack in {"": bytes, **PACKERS}.items():
        name = f"hill.csv{ending}"
        (folder / name).write_bytes(pack(HILL.encode()))
        (folder / f"{name}.toml").write_text(ON_A_TABLE.format(name))
    gains = dict(
        zip(taichi_nmm.GAIN_NAMES, taichi_nmm.PUBLISHED_GAINS.tolist(), strict=True)
    )
    (folder / "gains.json").write_text(json.dumps(gains | {"theta_ref": 0.1}, indent=1))
    with mock.patch.object(journal, "datetime") as clock:
        clock.now().isoformat.return_value = DAY
        bench = Bench.new(robot.write(folder), "me")
        robot.run(bench, 3)
        bench.next()  # trial 3, whose log is read
        bench.journal.writer.close()
    (folder / "trials.csv").write_text(
        "stiffness,damping,value,torque\n50,1,0.9,80\n60,1,1.2,\n"
    )
    write_fresh_bench(folder)
    simulator = mock.patch.dict(vars(taichi_nmm), simulate=fake_walker.simulate)
    shown = StringIO()
    with chdir(folder), simulator, redirect_stdout(shown), redirect_stderr(shown):
        families = {"up": {"settings": 1, "terrain": {"kind": "ramp"}}}
        fake_walker.write_store(Path("store"), robust={}, families=families)
        for words in (PRECOMPUTE, COMPARE, (*STUDY, "--trials", "2")):
            with mock.patch.object(sys, "argv", []):
                main(words)
    settle(folder)


def write_fresh_bench(folder):
    """Candidates, as CSV and as Parquet, of benches that have not begun; and a log of a walk."""
    known = (folder / "candidates.csv").read_text().splitlines()[:40]
    (folder / "fresh.csv").write_text("\n".join([*known, ""]))
    cells = [line.split(",") for line in known]
    columns = {
        name: [float(cell) for cell in column]
        for name, *column in zip(*cells, strict=True)
    }
    pq.write_table(pa.table(columns), folder / "fresh.parquet")
    for name, file in (("fresh", "fresh.csv"), ("fresh-parquet", "fresh.parquet")):
        text = robot.TOML.format(
            known=robot.WORLDS + "\nbounds = {damping = [0.0, 3.0]}"
        )
        text = text.replace("candidates.csv", file).replace('"walk"', f'"{name}"')
        (folder / f"{name}.toml").write_text(text)
    log = [f"{0.1 * step:.1f},{0.12 * step:.2f}\n" for step in range(301)]
    (folder / "log.csv").write_text("".join(["time,position\n", *log]))


def settle(folder):
    """Put one day and one duration in place of those of this making."""
    for path in folder.rglob("arms/*.parquet"):
        table = pq.read_table(path)
        footer = json.loads(table.schema.metadata[FOOTER_KEY])
        footer.pop(DIGEST_KEY)
        place = table.schema.get_field_index("proposal_s")
        same = pa.array([0.001] * len(table))
        write_stamped(
            path, table.set_column(place, table.schema.field(place), same), footer
        )
    for path in folder.rglob("proposal_times.parquet"):
        arms = [
            pq.read_table(arm) for arm in sorted(path.parent.glob("arms/*.parquet"))
        ]
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

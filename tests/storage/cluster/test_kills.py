"""Ten kills, of workers, schedulers and clients, at random moments."""

import random
import shutil
import subprocess
import sys
from contextlib import suppress
from functools import partial

import pytest

from tests.cases import ASSETS
from tests.processes import ROOT, children, until
from tests.storage.cluster.conftest import kill

pytestmark = pytest.mark.campaign

SEED = 15
VICTIMS = ("worker", "scheduler", "client", "worker", "client")  # of each command


def started(folder, tool, out, *options):
    """A command on the configuration of its own name."""
    words = ["--config", f"{tool}.toml", "--out", out, *options]
    words = [sys.executable, str(ROOT / "tools" / f"{tool}.py"), *words]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(words, cwd=folder, **quiet)


@pytest.mark.parametrize("tool", ["precompute", "compare"])
def test_five_kills_and_the_same_bytes(tool, cluster, tmp_path):
    for name in ("precompute", "compare"):
        shutil.copy(
            ASSETS / "cluster" / f"killed-{name}.toml", tmp_path / f"{name}.toml"
        )
    start = partial(started, tmp_path)

    for name in dict.fromkeys(("precompute", tool)):
        assert start(name, f"whole-{name}", "--workers", "2").wait() == 0
    dice, codes = random.Random(SEED), []
    for victim in VICTIMS:
        client = start(tool, "killed", "--cluster", cluster.address)
        until(lambda: (tmp_path / "killed" / "kind.json").exists())
        with suppress(subprocess.TimeoutExpired):
            client.wait(dice.uniform(0.2, 1.5))
        if victim == "worker":
            kill(children(cluster.processes[1].pid)[0])
        elif victim == "scheduler":
            kill(cluster.scheduler.pid)
        else:
            client.kill()
        codes.append(client.wait())
        if victim == "scheduler":
            cluster.close()
            cluster.processes.clear()
            cluster.start_scheduler()
            for _ in range(2):
                cluster.start_worker()
    assert start(tool, "killed", "--cluster", cluster.address).wait() == 0
    table = "trials.parquet" if tool == "compare" else "part-*.parquet"
    whole = {f.name: f.read_bytes() for f in (tmp_path / f"whole-{tool}").glob(table)}
    assert whole == {f.name: f.read_bytes() for f in (tmp_path / "killed").glob(table)}
    assert [codes[number] for number in (1, 2, 4)] == [2, -9, -9]  # all in the middle

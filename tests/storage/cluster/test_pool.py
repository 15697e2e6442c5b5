"""Calls on a real scheduler's real workers, any of which may be killed."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from storage.cluster import open_pool
from storage.pool import Cluster as Asked
from storage.precompute import precompute
from taichi_nmm import InputError, Settings
from taichi_nmm.walker_simulator import Walker
from tests.cases import refused
from tests.processes import ROOT, children, until
from tests.storage import fake
from tests.storage.cluster import units
from tests.storage.cluster.conftest import kill

pytestmark = pytest.mark.slow

WALKER = Walker(Settings(arch="cpu"))


@pytest.fixture(autouse=True)
def kinds(monkeypatch):
    """Workers send at once of what kind they are."""
    monkeypatch.setattr("storage.dask_session.own_kind", units.own_kind)


@contextmanager
def pool_of(cluster, out, mixed=False, stores=()):
    """A pool of a cluster's two workers."""
    with open_pool(
        1, Asked(cluster.address, mixed), out, WALKER, stores=stores
    ) as pool:
        until(lambda: pool.room() == 4)  # a unit a worker, and one that waits there
        yield pool


@pytest.fixture
def opened(cluster, tmp_path):
    """A pool of a cluster that is this test's own."""
    return partial(pool_of, cluster, tmp_path / "out")


@pytest.fixture
def lent(shared_cluster, tmp_path):
    """A pool of a cluster that other tests use, too."""
    return partial(pool_of, shared_cluster, tmp_path / "out")


def results(pool, function, asked):
    return dict(pool.results(function, deque(asked)))


def test_calls_are_made_on_workers_and_what_fails_is_one_line(lent, tmp_path):
    with lent() as pool:
        assert results(pool, units.square, list(range(20))) == {
            n: n**2 for n in range(20)
        }
        assert not pool.in_process and pool.shares_machine
        for function, line in (
            (units.refuse, "samples: 3 cannot be used; allowed: none"),
            (units.fail, "calls that do not fail there (ArithmeticError: of 3)"),
            (
                units.die,
                "calls that do not fail there (BrokenExecutor: a process was killed)",
            ),
        ):
            with pytest.raises(InputError) as caught:
                results(pool, function, [3])
            assert line in str(caught.value) and str(caught.value).isprintable()
        mark = tmp_path / "mark"
        assert results(pool, units.die_once, [mark]) == {mark: "lives"}


def test_nothing_is_lost_with_a_killed_worker(lent, shared_cluster):
    with lent() as pool:
        found, killed = {}, []
        for number, (square, _) in pool.results(units.slow_square, deque(range(30))):
            found[number] = square
            if len(found) == 5:
                worker, *killed = children(shared_cluster.processes[1].pid)
                kill(worker)
        assert found == {n: n**2 for n in range(30)} and killed
        until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in killed))


def test_they_come_and_go(cluster, opened, monkeypatch):
    """One that joins late gets work; after the last one has gone there is one line."""
    monkeypatch.setattr("storage.dask_session.WORKERLESS_S", 1.0)
    monkeypatch.setattr("storage.dask_session.WATCH_S", 0.2)
    line = r"cluster: 'tcp.* not without a worker for 1 s; the same command goes on"
    with refused(line), opened() as pool:
        before = {
            pid for _, pid in results(pool, units.slow_square, list(range(8))).values()
        }
        assert len(before) == 2
        cluster.start_worker()
        until(lambda: pool.room() == 6)
        after = {
            pid for _, pid in results(pool, units.slow_square, list(range(12))).values()
        }
        assert len(after) == 3
        for _ in pool.results(units.slow_square, deque(range(100))):
            for worker in cluster.processes[1:]:
                with suppress(ProcessLookupError):
                    os.killpg(worker.pid, signal.SIGKILL)


def test_a_connection_that_breaks_under_an_answer_is_the_schedulers(lent):
    comm = pytest.importorskip("distributed.comm")

    async def broken():
        raise comm.CommClosedError("Connection reset by peer")

    with lent() as pool:
        executor = pool.executor
        loop = executor._client.loop.asyncio_loop
        future = asyncio.run_coroutine_threadsafe(executor._outcome(broken()), loop)
        with refused("a scheduler that stays; the same command"):
            future.result(60.0)


@pytest.fixture
def stall():
    """Stops a process, whose connections stay open; it goes on when the test is over."""
    stopped = []

    def stop(pid):
        os.kill(pid, signal.SIGSTOP)
        stopped.append(pid)

    yield stop
    for pid in stopped:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def test_a_scheduler_that_stalls_or_dies_is_one_line(
    cluster, opened, stall, monkeypatch
):
    line = (
        r"cluster: 'tcp.* a scheduler that answers within 2 s; the same command goes on"
    )
    began_s = time.monotonic()
    with monkeypatch.context() as patch:
        patch.setattr("storage.dask_session.ANSWER_S", 2.0)
        patch.setattr("storage.dask_session.CLOSE_S", 1.0)
        with refused(line), opened() as pool:
            for _ in pool.results(units.slow_square, deque(range(100))):
                stall(cluster.scheduler.pid)
    assert time.monotonic() - began_s < 30.0
    os.kill(cluster.scheduler.pid, signal.SIGCONT)
    monkeypatch.setattr("storage.dask_session.CONNECT_S", 3.0)
    line = r"cluster: 'tcp.* a scheduler that stays; the same command"
    with refused(line), opened() as pool:
        for _ in pool.results(units.slow_square, deque(range(100))):
            kill(cluster.scheduler.pid)


@pytest.mark.parametrize("who", ["scheduler", "worker"])
def test_what_stalls_and_goes_on_loses_nothing(shared_cluster, lent, stall, who):
    with lent() as pool:
        found = {}
        for number, (square, _) in pool.results(units.slow_square, deque(range(20))):
            found[number] = square
            if len(found) == 5:
                worker = children(shared_cluster.processes[1].pid)[0]
                pid = shared_cluster.scheduler.pid if who == "scheduler" else worker
                stall(pid)
                threading.Timer(1.5, os.kill, (pid, signal.SIGCONT)).start()
        assert found == {n: n**2 for n in range(20)}


def test_calls_longer_than_workerless_time(lent, monkeypatch):
    monkeypatch.setattr("storage.dask_session.WORKERLESS_S", 1.0)
    monkeypatch.setattr("storage.dask_session.WATCH_S", 0.2)
    with lent() as pool:
        assert results(pool, units.asleep, [4.0]) == {4.0: "awake"}


CLIENT = """
import sys
from collections import deque
from pathlib import Path
import storage.dask_session as connection
from storage.pool import Cluster
from taichi_nmm.settings import Settings
from taichi_nmm.walker_simulator import Walker
from tests.storage import fake
from tests.storage.cluster import units
connection.own_kind = units.own_kind
asked = Cluster(sys.argv[1])
with connection.cluster_pool(asked, Path(sys.argv[2], "out"), Walker(Settings(arch="cpu"))) as pool:
    list(pool.results(units.wait_for, deque([Path(sys.argv[2], name) for name in "abcdef"])))
"""


def test_calls_of_the_dead_are_dropped(shared_cluster, lent, tmp_path):
    words = [sys.executable, "-c", CLIENT, shared_cluster.address, str(tmp_path)]
    client = subprocess.Popen(words, cwd=ROOT)
    until(lambda: len(list(tmp_path.glob("*.begun"))) == 2)
    kill(client.pid)
    client.wait()
    with lent() as pool:  # what the killed one left on the workers goes
        assert results(pool, units.square, [1, 2]) == {1: 1, 2: 4}
    assert len(list(tmp_path.glob("*.begun"))) == 2  # the other four were never begun


def test_workers_unlike_ours(lent, tmp_path, capfd):
    folder = tmp_path / "out"
    folder.mkdir()
    other = units.KIND | {"canary": "1" * 64}
    (folder / "kind.json").write_text(json.dumps(other))
    reason = "canary 000000000000, not 111111111111"
    line = f"workers like the folder's .{reason}.; or --mixed"
    with refused(line), lent():
        pass
    assert f"gets no work: {reason}" in capfd.readouterr().err
    with lent(mixed=True) as pool:
        pool.agree(folder)
        assert pool.kinds == [units.KIND] and pool.mixed
        assert results(pool, units.square, [2]) == {2: 4}
    assert json.loads((folder / "kind.json").read_text()) == other


def test_a_new_folder_is_of_the_first_workers_kind(lent, tmp_path):
    folder = tmp_path / "out"
    with lent() as pool:
        folder.mkdir()
        pool.agree(folder)
        pool.agree(folder)
    assert json.loads((folder / "kind.json").read_text()) == units.KIND
    with lent() as pool:
        pool.agree(folder)


def test_stores_travel(lent, tmp_path):
    store = tmp_path / "store"
    precompute(fake.specification(), store)
    with lent(stores=(store,)) as pool:
        place = pool.there(store)
        assert results(pool, units.rows_of, [place]) == {place: (50, False)}
        assert pool.there(tmp_path) == tmp_path


def assert_unheard(address, out):
    """Nobody answers at an address, or not to us: one line, and nothing is made."""
    opening = open_pool(1, Asked(address), out, WALKER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("storage.dask_session.CONNECT_S", 3.0)
        with (
            refused(rf"'{address}' .* a scheduler that answers"),
            opening,
        ):
            pass
    assert not out.exists()


def test_nobody_there(tmp_path):
    assert_unheard("127.0.0.1:9", tmp_path / "out")


def test_a_cluster_of_this_machine_is_heard_by_nobody_else(tmp_path):
    psutil = pytest.importorskip("psutil")
    me = psutil.Process()
    before = {child.pid for child in me.children(recursive=True)}
    with open_pool(1, Asked("local:2"), tmp_path / "out", WALKER) as pool:
        assert results(pool, units.square, [1, 2]) == {1: 1, 2: 4}
        ours = [
            me,
            *(
                child
                for child in me.children(recursive=True)
                if child.pid not in before
            ),
        ]
        sockets = [
            socket for process in ours for socket in process.net_connections("inet")
        ]
        heard = [one.laddr.ip for one in sockets if one.status == psutil.CONN_LISTEN]
        assert set(heard) == {"127.0.0.1"} and len(heard) >= 3
        address = pool.executor._client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        assert_unheard(address, tmp_path / "other")
    trackers = [
        one for one in me.children() if "resource_tracker" in " ".join(one.cmdline())
    ]
    left = {child.pid for child in me.children(recursive=True)}
    assert left <= before | {child.pid for child in trackers}

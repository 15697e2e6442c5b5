"""Who can reach a cluster: the sockets of what the lines of docs/cluster.md start."""

import json
import re
import shlex
import shutil
import socket
import ssl
import subprocess
import sys
from collections import deque

import pytest

from storage.cluster import open_pool
from storage.pool import Cluster
from taichi_nmm.settings import Settings
from taichi_nmm.walker_simulator import Walker
from tests.processes import ROOT, WAIT_S, until
from tests.storage.cluster import units

psutil = pytest.importorskip(
    "psutil", reason="psutil is not installed: the extra cluster"
)
pytest.importorskip(
    "distributed", reason="distributed is not installed: the extra cluster"
)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        sys.platform != "linux",
        reason="only Linux has all of 127.0.0.0/8 without asking",
    ),
]

PAGE = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
# the page's machines, on this one
HERE = {"10.0.0.1": "127.0.0.21", "10.0.0.2": "127.0.0.22"}
LINES = re.findall(
    r"^dask (?:scheduler|worker) .*$", PAGE.replace("\\\n", " "), re.MULTILINE
)
# of the command's own machine
EXPORTS = re.findall(r"DASK_(DISTRIBUTED\w+)=(\w+\.pem)", PAGE)


@pytest.fixture
def processes():
    started = []
    yield started
    for process in started:
        for child in [*psutil.Process(process.pid).children(recursive=True), process]:
            child.kill()
        process.wait()


def test_the_page_starts_a_scheduler_and_a_worker_without_and_with_certificates():
    assert [line.split()[1] for line in LINES] == ["scheduler", "worker"] * 2
    assert ["tls" in line for line in LINES] == [False, False, True, True]


@pytest.mark.parametrize("first", [0, 2], ids=["tcp", "tls"])
def test_what_the_page_starts_is_reached_by_the_given_address_alone(
    first, processes, tmp_path, monkeypatch
):
    """Nothing listens on all interfaces, which would let anybody run code in a worker."""
    certificates(tmp_path)
    scheduler, worker = (here(line) for line in LINES[first : first + 2])
    file = tmp_path / "scheduler.json"
    start(
        processes, tmp_path, [*scheduler, "--port", "0", "--scheduler-file", str(file)]
    )
    until(lambda: file.exists() and file.read_text().endswith("}"))
    document = json.loads(file.read_text())
    worker = [document["address"] if "8786" in word else word for word in worker]
    start(processes, tmp_path, ["1" if word == "16" else word for word in worker])
    found = [set(), set()]
    # a page of its own comes last
    for addresses, process in zip(found, processes, strict=True):
        until(
            lambda seen=addresses, pid=process.pid: (
                sockets(seen, pid) and len(seen) >= 2
            )
        )
    assert found[0] == {"127.0.0.1", HERE["10.0.0.1"]}
    assert found[1] == {"127.0.0.1", HERE["10.0.0.2"]}
    if first:
        assert answers(document["address"], tmp_path, "cert.pem")
        assert not answers(document["address"], tmp_path, None)
    dask = pytest.importorskip("dask")
    ours = {
        name.lower().replace("__", "."): str(tmp_path / file) for name, file in EXPORTS
    }
    monkeypatch.setattr("storage.dask_session.own_kind", units.own_kind)
    opening = open_pool(
        1, Cluster(document["address"]), tmp_path / "out", Walker(Settings())
    )
    with dask.config.set(ours), opening as pool:
        assert dict(pool.results(units.square, deque([6, 7]))) == {6: 36, 7: 49}


def answers(address, folder, certificate):
    """Whether a scheduler greets a client that shows this certificate."""
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    context.check_hostname = False
    if certificate is not None:
        context.load_cert_chain(folder / certificate, folder / "key.pem")
    host, port = address.removeprefix("tls://").rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=WAIT_S) as plain:
        try:
            with context.wrap_socket(plain) as encrypted:
                return encrypted.recv(1) != b""
        except OSError:
            return False


def certificates(folder):
    """The files that the page names: one key signs itself, and is its own authority."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("no openssl here")
    subprocess.run(
        [
            program,
            "req",
            "-x509",
            "-newkey",
            "rsa:2048",
            "-nodes",
            "-days",
            "1",
            "-subj",
            "/CN=test",
            "-keyout",
            "key.pem",
            "-out",
            "cert.pem",
        ],
        cwd=folder,
        check=True,
        capture_output=True,
    )
    shutil.copy(folder / "cert.pem", folder / "ca.pem")


def here(line):
    """The words of a line of the page, with addresses of this machine."""
    for theirs, ours in HERE.items():
        line = line.replace(theirs, ours)
    return shlex.split(line, comments=True)


def start(processes, folder, words):
    log = (folder / f"{len(processes)}.log").open("wb")
    program = [sys.executable, "-m", *words]
    processes.append(subprocess.Popen(program, cwd=folder, stdout=log, stderr=log))


def sockets(found, process):
    """Where a process and its children listen; the addresses are added to `found`."""
    listening = set()
    for each in [
        psutil.Process(process),
        *psutil.Process(process).children(recursive=True),
    ]:
        for one in each.net_connections("inet"):
            if one.status == psutil.CONN_LISTEN and one.type == socket.SOCK_STREAM:
                listening.add((one.laddr.ip, one.laddr.port))
    found.update(address for address, _ in listening)
    return listening

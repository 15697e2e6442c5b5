"""A scheduler and workers in processes of their own, as on a cluster."""

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.processes import until


@dataclass
class Cluster:
    """Processes of `dask scheduler` and `dask worker`, and where they may write."""

    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_scheduler(self):
        """Its address."""
        file = self.folder / "scheduler.json"
        file.unlink(missing_ok=True)
        options = ("--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        self.scheduler = self._dask("scheduler", *options)
        until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = str(json.loads(file.read_text())["address"])
        return self.address

    def start_worker(self):
        """With a thread, and a nanny that starts it again."""
        scratch = (
            "--local-directory",
            str(self.folder / f"worker-{len(self.processes)}"),
        )
        options = ("--nthreads", "1", "--no-dashboard", *scratch)
        return self._dask("worker", self.address, *options)

    def close(self):
        for process in self.processes:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def _dask(self, *words):
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self.processes.append(process)
        return process


@contextmanager
def running(folder):
    """A scheduler and two workers."""
    pytest.importorskip(
        "distributed", reason="distributed is not installed: the extra cluster"
    )
    made = Cluster(folder)
    made.folder.mkdir()
    try:
        made.start_scheduler()
        for _ in range(2):
            made.start_worker()
        yield made
    finally:
        made.close()


@pytest.fixture
def cluster(tmp_path):
    """A cluster of one test, which may kill any of its processes."""
    with running(tmp_path / "cluster") as made:
        yield made


@pytest.fixture(scope="module")
def shared_cluster(tmp_path_factory):
    """A cluster that each test leaves with two workers, which a nanny may have started again."""
    with running(tmp_path_factory.mktemp("shared") / "cluster") as made:
        yield made


def kill(pid):
    os.kill(pid, signal.SIGKILL)

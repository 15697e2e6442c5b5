"""Units of work in this process and in others: results, errors, kills, and a prompt end."""

import atexit
import os
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

import storage
from storage.inputs.errors import InputError
from storage.pool import IN_PROCESS, Pool, cores, local_pool
from storage.processes import Processes
from tests.cases import refused
from tests.processes import ROOT, until
from tests.storage.cluster import units

pytestmark = pytest.mark.slow

LONG_S = 60.0
PROMPT_S = 5.0


def halves(number):
    whole = np.arange(float(number))
    return whole[: number // 2], whole[::2]  # one of which lies in one piece


def whoami(pause_s):
    time.sleep(pause_s)
    ignored = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    return os.getpid(), os.environ.get("OMP_NUM_THREADS", ""), ignored


def die(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_while_answering(number):
    """Half of the answer is on its way when the process is killed."""

    def send(pipe, answer):
        half = struct.pack("!i", len(answer)) + answer[: len(answer) // 2]
        os.write(pipe.fileno(), half)
        os.kill(os.getpid(), signal.SIGKILL)

    Connection.send_bytes = send
    return number


def linger(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(LONG_S)


def alive(pid):
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        )
    except OSError:
        return False


def wait_for(folder, count):
    until(lambda: len(list(folder.iterdir())) >= count, LONG_S)
    return [int(file.name) for file in folder.iterdir()]


@pytest.mark.parametrize("workers", [1, 2])
def test_every_unit_is_done_once(workers):
    with local_pool(workers) as pool:
        assert (pool.in_process, pool.shares_machine) == (workers == 1, workers > 1)
        found = sorted(pool.results(units.square, deque(range(20))))
        assert found == [(n, n**2) for n in range(20)]
        assert list(pool.results(units.square, deque())) == []
        assert dict(pool.results(bytes, deque([3_000_000]))) == {
            3_000_000: bytes(3_000_000)
        }
        numbers, seen = deque([1, 10]), []
        for number, _ in pool.results(units.square, numbers):
            seen.append(number)
            if number % 10 < 4:
                numbers.append(number + 1)  # on the way
        assert sorted(seen) == [1, 2, 3, 4, 10, 11, 12, 13, 14]


@pytest.mark.parametrize("number", [0, 2_000_000])
def test_arrays_may_be_written_to(number):
    with local_pool(2) as pool:
        ((_, (first, even)),) = pool.results(halves, deque([number]))
    np.testing.assert_array_equal(first, np.arange(number // 2))
    np.testing.assert_array_equal(even, 2 * np.arange(number // 2))
    assert first.flags.writeable and even.flags.writeable


def test_processes_are_quiet_and_no_more_than_units():
    before = dict(os.environ)
    with local_pool(8) as pool:
        answers = [answer for _, answer in pool.results(whoami, deque([0.5, 0.5]))]
    pids = {pid for pid, _, _ in answers}
    assert len(pids) == 2 and os.getpid() not in pids
    assert {answer[1:] for answer in answers} == {("1", True)}
    assert dict(os.environ) == before
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert not any(map(alive, pids))
    with ThreadPoolExecutor(3) as executor:
        results = dict(Pool(executor, 3).results(units.square, deque(range(9))))
    assert results == {number: number**2 for number in range(9)}


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_unit_is_raised_here(workers):
    with local_pool(workers) as pool:
        with refused("samples: 7 cannot be used"):
            list(pool.results(units.refuse, deque([7])))
        with pytest.raises(ArithmeticError) as caught:
            list(pool.results(units.fail, deque([0])))
        assert workers == 1 or "in fail" in caught.value.__notes__[0]
        # the pool goes on
        assert dict(pool.results(units.square, deque([3]))) == {3: 9}


@pytest.mark.parametrize("accident", [die, die_while_answering])
def test_a_killed_process_is_one_line(accident):
    with local_pool(2) as pool, pytest.raises(InputError) as caught:
        list(pool.results(accident, deque(range(9))))
    assert str(caught.value).startswith("workers: 'one was killed' cannot be used")


def test_leaving_in_the_middle_of_a_unit_is_prompt(tmp_path):
    with pytest.raises(KeyboardInterrupt), local_pool(2) as pool:
        for _ in range(2):
            pool.executor.submit(linger, str(tmp_path))
        pids = wait_for(tmp_path, 2)
        start_s = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - start_s < PROMPT_S
    assert not any(map(alive, pids))


PARENT = """
import sys
from collections import deque
from storage.pool import local_pool
from tests.storage.test_pool import linger
if __name__ == "__main__":
    with local_pool(2) as pool:
        list(pool.results(linger, deque(sys.argv[1:] * 2)))
"""


def test_no_process_outlives_a_killed_parent(tmp_path):
    script, folder = tmp_path / "parent.py", tmp_path / "pids"
    script.write_text(PARENT)
    folder.mkdir()
    with subprocess.Popen([sys.executable, script, folder]) as parent:
        pids = wait_for(folder, 2)
        assert all(map(alive, pids))
        parent.kill()
    until(lambda: not any(map(alive, pids)), PROMPT_S)


@pytest.mark.parametrize("workers", [0, -2])
def test_no_processes_are_refused(workers):
    with refused(f"workers: {workers} "), local_pool(workers):
        pytest.fail("there is no such pool")
    assert 1 <= cores() <= (os.cpu_count() or 1)
    assert not IN_PROCESS.shares_machine


def leave_a_note_at_the_end(path):
    atexit.register(path.write_text, "ended by itself")


def test_idle_processes_end_by_themselves(tmp_path):
    """Taichi writes what it has compiled at the end of a process: a killed one compiles in vain."""
    notes = [tmp_path / "one", tmp_path / "two"]
    with local_pool(2) as pool:
        list(pool.results(leave_a_note_at_the_end, deque(notes)))
    assert [note.read_text() for note in notes] == ["ended by itself"] * 2


def test_processes_import_our_packages(tmp_path, monkeypatch):
    """A worker of Dask has such a folder among its paths; an editable install comes after it."""
    (tmp_path / "storage").mkdir()
    paths = [
        str(tmp_path),
        *(path for path in sys.path if Path(path).resolve() != ROOT),
    ]
    monkeypatch.setattr(sys, "path", paths)
    monkeypatch.chdir(tmp_path)
    with Processes(1) as processes:
        found = processes.submit(eval, "__import__('storage').__file__").result()
    assert found == storage.__file__ and sys.path == paths

"""A real PostgreSQL server, which the tests start themselves."""

import getpass
import os
import shutil
import signal
import subprocess
import tempfile
from itertools import count
from pathlib import Path

import pytest
import sqlalchemy as sql

from tests.processes import until

START_TIMEOUT_S = 30.0
UNPRIVILEGED = "nobody"  # PostgreSQL refuses to run as root


def find_programs():
    """Folder of initdb and postgres: Debian keeps them out of the PATH."""
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    on_path = shutil.which("initdb")
    folders = [*([Path(on_path).parent] if on_path else []), *debian]
    return next((folder for folder in folders if (folder / "postgres").exists()), None)


class Server:
    """A server that listens on a socket file in a folder of its own."""

    def __init__(self, folder, programs):
        self.folder, self._programs = folder, programs
        self._user = UNPRIVILEGED if os.geteuid() == 0 else None
        if self._user:
            shutil.chown(folder, self._user)
        self.owner = self._user or getpass.getuser()
        self._numbers = count()
        subprocess.run(
            [programs / "initdb", "-D", folder / "data", "-A", "trust", "--no-sync"],
            user=self._user,
            cwd=folder,
            check=True,
            capture_output=True,
        )
        self.start()

    def start(self):
        options = ["-k", str(self.folder), "-c", "listen_addresses=", "-c", "fsync=off"]
        self._process = subprocess.Popen(
            [self._programs / "postgres", "-D", self.folder / "data", *options],
            user=self._user,
            cwd=self.folder,
            stderr=subprocess.DEVNULL,
        )
        until(self._answers, START_TIMEOUT_S)

    def stop(self):
        self._process.send_signal(signal.SIGINT)  # fast: sends its clients away
        self._process.wait(START_TIMEOUT_S)

    def url(self, database):
        return (
            f"postgresql+psycopg://{self.owner}:secret@/{database}?host={self.folder}"
        )

    def new_database(self):
        name = f"studies{next(self._numbers)}"
        self._execute(f"CREATE DATABASE {name}")
        return self.url(name)

    def require_password(self, role, password):
        """Make a role that may do anything, by this password alone."""
        rules = self.folder / "data" / "pg_hba.conf"
        rules.write_text(f"local all {role} scram-sha-256\n{rules.read_text()}")
        self._execute(f"CREATE ROLE {role} SUPERUSER LOGIN PASSWORD '{password}'")
        self._execute("SELECT pg_reload_conf()")

    def _execute(self, statement):
        with self._engine().connect() as connection:
            connection.execution_options(isolation_level="AUTOCOMMIT")
            connection.execute(sql.text(statement))

    def _engine(self):
        return sql.create_engine(self.url("postgres"), poolclass=sql.NullPool)

    def _answers(self):
        assert self._process.poll() is None, "the server did not start"
        try:
            self._engine().connect().close()
        except sql.exc.OperationalError:
            return False
        return True


@pytest.fixture(scope="module")
def server():
    pytest.importorskip(
        "psycopg", reason="no psycopg: pip install 'taichi-nmm[postgres]'"
    )
    programs = find_programs()
    if programs is None:
        pytest.skip("no PostgreSQL server here: apt-get install postgresql")
    # Not pytest's folder: other users may not enter it, and a socket's path has 107
    # characters.
    folder = Path(tempfile.mkdtemp(prefix="nmm-pg-"))
    try:
        server = Server(folder, programs)
        yield server
        server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def url(server):
    return server.new_database()


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def any_url(request, tmp_path):
    """A database of each kind; on PostgreSQL, keys are drawn from sequences of the server."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/studies.db"
    return str(request.getfixturevalue("url"))

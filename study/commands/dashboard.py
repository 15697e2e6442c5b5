"""Show the studies of an experiment in optuna-dashboard, with their pictures and films.

    taichi-nmm dashboard                         # the newest folder in out/compare
    taichi-nmm dashboard out/compare/rough8-smooth
    taichi-nmm dashboard --storage postgresql+psycopg://me@host/walker --artifacts DIR

The server answers this machine only (127.0.0.1), until Ctrl-C. Exit codes: 0, 2 bad input.
"""

# optuna-dashboard asks for no password and trusts its database, and a page of any site may send a
# browser to the loopback address, by a name of its own that it lets point there. So only loopback
# names are answered; and pictures and films are served as such or not at all, whatever type the
# database gives them, and to our pages alone.

import errno
import re
import stat
from argparse import Namespace
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import optuna
import optuna_dashboard
from optuna.artifacts import FileSystemArtifactStore
from optuna.storages import BaseStorage, RDBStorage

from storage.databases.bulk import study_ids
from storage.databases.studies import URL_PREFIX as SQLITE
from storage.databases.studies import open_studies, read_studies, shown_url, studies_path
from storage.databases.urls import file_url
from study.comparison.folder import ARTIFACTS_NAME, DATABASE_NAME
from study.experiment.experiment import SUMMARY
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_file, is_folder

Environment = dict[str, Any]
Application = Callable[[Environment, Callable[..., Any]], Iterable[bytes]]

EXPERIMENTS = Path("out") / "compare"
HOST = "127.0.0.1"  # the dashboard knows no passwords
LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?", re.IGNORECASE)
ARTIFACTS = "/artifacts/"
KINDS = (
    "image/png", "image/jpeg", "image/gif", "image/webp", "video/mp4", "video/webm",
)  # fmt: skip
CORS = "access-control-"
TEXT = "text/plain; charset=utf-8"


class Server(ThreadingMixIn, WSGIServer):
    """A thread for each request: a film must not hold up the page."""

    daemon_threads = True


class QuietHandler(WSGIRequestHandler):
    """Logs no requests."""

    def log_message(self, format: str, *args: object) -> None:
        """Drop the line."""


def find_database(folder: Path | None, storage: str | None) -> str:
    """URL of the database; one that does not exist is refused, not created."""
    if storage is None:
        folder = folder or newest()
        if not is_file(folder / DATABASE_NAME):
            raise InputError("folder", str(folder), f"an experiment's folder, with {DATABASE_NAME}")
        return file_url(folder / DATABASE_NAME)
    shown = shown_url(storage)  # refuses any other text
    if storage.startswith(SQLITE) and not studies_path(storage).is_file():
        raise InputError("storage", shown, "a database that is there")
    return storage


def newest() -> Path:
    """The experiment whose database was written last."""
    databases = sorted(EXPERIMENTS.glob(f"*/{DATABASE_NAME}"), key=lambda db: db.stat().st_mtime)
    if not databases:
        raise InputError("folder", str(EXPERIMENTS), "a folder with experiments; or give one")
    return databases[-1].parent


def find_artifacts(folder: Path | None, url: str, artifacts: Path | None) -> Path | None:
    """The folder of pictures and films; None where an experiment has none yet."""
    if artifacts is not None:
        if not is_folder(artifacts):
            raise InputError("artifacts", str(artifacts), "a folder that is there")
        return artifacts
    if folder is None and url.startswith(SQLITE):
        folder = studies_path(url).parent
    if folder is None or not (folder / ARTIFACTS_NAME).is_dir():
        return None
    return folder / ARTIFACTS_NAME


def make(storage: RDBStorage, artifacts: Path | None, port: int) -> WSGIServer:
    """The server, listening but not serving yet."""
    try:
        return make_server(HOST, port, guarded_dashboard(storage, artifacts), Server, QuietHandler)
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise InputError("port", port, f"a free port ({error.strerror})") from None


def guarded_dashboard(storage: BaseStorage, artifacts: Path | None) -> Application:
    """The dashboard's WSGI application, behind the guard.

    Args:
        storage: of its studies.
        artifacts: folder of pictures and films; None: there are none.
    """
    store = None if artifacts is None else FileSystemArtifactStore(artifacts)
    return guarded(optuna_dashboard.wsgi(storage, artifact_store=store), artifacts)


def guarded(application: Application, artifacts: Path | None) -> Application:
    """An application that answers loopback names alone, and serves only images and films.

    Args:
        application: whose paths below /artifacts/ are files of the folder.
        artifacts: the folder; links in it are not followed.
    """

    def answer(environment: Environment, start: Callable[..., Any]) -> Iterable[bytes]:
        if not _is_ours(environment):
            return _refuse(start, "403 Forbidden", "only 127.0.0.1 and localhost are served here")
        path = environment.get("PATH_INFO", "").rstrip("/")
        if not path.startswith(ARTIFACTS):
            return application(environment, _without_cors(start))
        if artifacts is None or not _is_file(artifacts / path.rpartition("/")[2]):
            return _refuse(start, "404 Not Found", "no such file")
        given: list[tuple[str, list[tuple[str, str]]]] = []
        content = application(
            environment, lambda status, headers, *_: given.append((status, headers))
        )
        if not given or not _is_shown(*given[-1]):
            close: Callable[[], None] = getattr(content, "close", lambda: None)
            close()
            return _refuse(start, "403 Forbidden", "neither an image nor a film")
        status, headers = given[-1]
        _without_cors(start)(status, [*headers, ("X-Content-Type-Options", "nosniff")])
        return content

    return answer


def _is_ours(environment: Environment) -> bool:
    """Whether a request names the loopback, and comes from a page of it, if from any."""
    origin = environment.get("HTTP_ORIGIN")
    named = LOOPBACK.fullmatch(environment.get("HTTP_HOST", ""))
    return bool(named) and (origin is None or _of_loopback(origin))


def _of_loopback(origin: str) -> bool:
    return bool(LOOPBACK.fullmatch(origin.removeprefix("http://")))


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


def _is_shown(status: str, headers: list[tuple[str, str]]) -> bool:
    kinds = [value for name, value in headers if name.lower() == "content-type"]
    return not status.startswith("200") or (len(kinds) == 1 and kinds[0] in KINDS)


def _without_cors(start: Callable[..., Any]) -> Callable[..., Any]:
    def begin(status: str, headers: list[tuple[str, str]], *error: Any) -> Any:
        kept = [(name, value) for name, value in headers if not name.lower().startswith(CORS)]
        return start(status, kept, *error)

    return begin


def _refuse(start: Callable[..., Any], status: str, why: str) -> Iterable[bytes]:
    start(status, [("Content-Type", TEXT), ("X-Content-Type-Options", "nosniff")])
    return [f"{why}\n".encode()]


def main(args: Namespace) -> None:
    """Serve until Ctrl-C."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    url = find_database(args.folder, args.storage)
    artifacts = find_artifacts(args.folder, url, args.artifacts)
    with read_studies(url) as known:  # a database that is refused is not changed
        numbers = study_ids(known) if known is not None else {}
    storage = open_studies(url)
    with make(storage, artifacts, args.port) as server:
        address = f"http://{HOST}:{server.server_port}/dashboard"
        print(f"studies    {shown_url(url)}")
        print(f"artifacts  {artifacts or 'none'}")
        print(f"dashboard  {address}  (Ctrl-C ends it)", flush=True)
        for name, number in numbers.items():
            if name.endswith(SUMMARY):
                print(f"summary    {address}/studies/{number}/note  ({name})", flush=True)
        with suppress(KeyboardInterrupt):
            server.serve_forever()

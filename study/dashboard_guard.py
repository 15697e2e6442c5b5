"""What stands before optuna-dashboard, which asks nobody who they are and believes its database.

A page of any site may send a browser to the loopback address, by a name of its own that it lets
point there; so only loopback names are answered. Pictures and films are served as such or not at
all, whatever the database calls them, and to our pages alone.
"""

import re
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import optuna_dashboard
from optuna.artifacts import FileSystemArtifactStore
from optuna.storages import BaseStorage

Environment = dict[str, Any]
Application = Callable[[Environment, Callable[..., Any]], Iterable[bytes]]

LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d+)?", re.IGNORECASE)
ARTIFACTS = "/artifacts/"
KINDS = (
    "image/png", "image/jpeg", "image/gif", "image/webp", "video/mp4", "video/webm",
)  # fmt: skip
CORS = "access-control-"
TEXT = "text/plain; charset=utf-8"


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

"""Show the studies of an experiment in optuna-dashboard, with their pictures."""

from argparse import Namespace
from contextlib import suppress
from pathlib import Path

import optuna
import optuna_dashboard
from optuna.artifacts import FileSystemArtifactStore
from optuna.storages import BaseStorage

from storage.databases.bulk import study_ids
from storage.databases.studies import (
    open_studies,
    read_studies,
    shown_url,
    studies_path,
)
from storage.databases.urls import SQLITE, file_url
from storage.inputs.errors import InputError
from storage.inputs.reading import is_file, is_folder
from study.experiment.experiment import SUMMARY
from study.experiment.folder import ARTIFACTS_NAME, DATABASE_NAME
from study.loopback import HOST, Application, guarded, wsgi_server
from study.options import require_used

EXPERIMENTS = Path("out") / "compare"


def find_database(folder: Path | None, storage: str | None) -> str:
    """URL of the database; one that does not exist is refused, not created."""
    if storage is None:
        folder = folder or newest()
        if not is_file(folder / DATABASE_NAME):
            raise InputError(
                "folder", str(folder), f"an experiment's folder, with {DATABASE_NAME}"
            )
        return file_url(folder / DATABASE_NAME)
    shown = shown_url(storage)  # refuses any other text
    if storage.startswith(SQLITE) and not studies_path(storage).is_file():
        raise InputError("storage", shown, "a database that is there")
    return storage


def newest() -> Path:
    """The experiment whose database was written last."""
    databases = sorted(
        EXPERIMENTS.glob(f"*/{DATABASE_NAME}"), key=lambda db: db.stat().st_mtime
    )
    if not databases:
        raise InputError(
            "folder", str(EXPERIMENTS), "a folder with experiments; or give one"
        )
    return databases[-1].parent


def find_artifacts(
    folder: Path | None, url: str, artifacts: Path | None
) -> Path | None:
    """The folder of pictures; None where an experiment has none yet."""
    if artifacts is not None:
        if not is_folder(artifacts):
            raise InputError("artifacts", str(artifacts), "a folder that is there")
        return artifacts
    if folder is None and url.startswith(SQLITE):
        folder = studies_path(url).parent
    if folder is None or not (folder / ARTIFACTS_NAME).is_dir():
        return None
    return folder / ARTIFACTS_NAME


def guarded_dashboard(storage: BaseStorage, artifacts: Path | None) -> Application:
    """The dashboard's WSGI application, behind the guard; without a folder there are no files."""
    store = None if artifacts is None else FileSystemArtifactStore(artifacts)
    return guarded(optuna_dashboard.wsgi(storage, artifact_store=store), artifacts)


def main(args: Namespace) -> None:
    """Serve until Ctrl-C."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if args.storage is not None and args.artifacts is not None:
        require_used(
            args, ("--storage", "--artifacts", "--port"), "--storage with --artifacts"
        )
    url = find_database(args.folder, args.storage)
    artifacts = find_artifacts(args.folder, url, args.artifacts)
    with read_studies(url) as known:  # a database that is refused is not changed
        numbers = study_ids(known) if known is not None else {}
    application = guarded_dashboard(open_studies(url), artifacts)
    with wsgi_server(application, HOST, args.port) as server:
        address = f"http://{HOST}:{server.server_port}/dashboard"
        print(f"studies    {shown_url(url)}")
        print(f"artifacts  {artifacts or 'none'}")
        print(f"dashboard  {address}  (Ctrl-C ends it)", flush=True)
        for name, number in numbers.items():
            if str(name).endswith(SUMMARY):  # a damaged database may have bytes for it
                print(
                    f"summary    {address}/studies/{number}/note  ({name})", flush=True
                )
        with suppress(KeyboardInterrupt):
            server.serve_forever()

"""The URLs of study databases: their forms, the parts that may be shown, and errors of them."""

import re
from pathlib import Path

from storage.inputs.errors import InputError

SQLITE = "sqlite:///"
POSTGRESQL = "postgresql+psycopg://"
POSTGRESQL_FORM = f"{POSTGRESQL}USER:PASSWORD@HOST:PORT/DATABASE"
FORMS = f"{SQLITE}FILE or {POSTGRESQL_FORM}"
HIDDEN = "***"

# Who, where, and options. An "@" among the options may as well be the end of a password
# with a "?".
_SERVER = re.compile(
    r"(?P<who>[^?]*@)?(?P<where>(\[[^@?\]]*\]|[^@:/?\[]*)(:\d*)?(/[^@?]*)?)(?P<options>\?[^@]*)?",
    re.DOTALL,
)
_FILE = re.compile(
    r"(?P<who>[^?]*:[^?]*@)?(?P<where>[^?]*)(?P<options>\?.*)?", re.DOTALL
)
_FORM_OF = {SQLITE: _FILE, POSTGRESQL: _SERVER}


def is_postgresql(url: str) -> bool:
    """Whether the URL names a PostgreSQL database."""
    return url.startswith(POSTGRESQL)


def file_url(path: Path) -> str:
    """The URL of a SQLite file, whose "%" and "?" would mean something else."""
    return SQLITE + str(path).replace("%", "%25").replace("?", "%3F")


def public_url(url: str) -> str:
    """A URL, or any text given as one, without anything that may be a password.

    Nothing after "?" is shown, nothing before the last "@", and no URL of another kind.
    In a file's name an "@" is shown, unless it looks like USER:PASSWORD@.
    """
    for kind, form in _FORM_OF.items():
        if url.startswith(kind):
            found = form.fullmatch(url.removeprefix(kind))
            if found is None:
                return f"{kind}{HIDDEN}"
            who = f"{HIDDEN}@" if found["who"] else ""
            return (
                f"{kind}{who}{found['where']}{f'?{HIDDEN}' if found['options'] else ''}"
            )
    return HIDDEN


def unusable(shown: str, error: Exception) -> InputError:
    """The error of a database, in one line for its user."""
    cause = error.__cause__ or error
    words = str(getattr(cause, "orig", cause)).strip().splitlines()
    reason = words[0] if words else type(cause).__name__
    return InputError(
        "storage", shown, f"a study database that can be written ({reason})"
    )

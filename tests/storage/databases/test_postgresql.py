"""Study databases on a real PostgreSQL server, which the tests start themselves."""

from dataclasses import replace

import optuna
import pytest
import sqlalchemy as sql

from storage.databases.bulk import trial_counts, write_studies
from storage.databases.studies import open_studies, storage_errors
from storage.inputs.errors import InputError
from tests.cases import refused
from tests.storage.databases.test_bulk import STUDY

pytestmark = pytest.mark.slow


def test_what_the_server_refuses_is_told_in_one_line(url):
    storage = open_studies(url)
    too_long = replace(STUDY, name="x" * 600)
    with (
        refused(r"storage: .*too long") as caught,
        storage_errors(url),
    ):
        write_studies(storage, [STUDY, too_long])
    assert "secret" not in str(caught.value)
    assert trial_counts(storage) == {}


def refusal(url):
    with pytest.raises(InputError) as caught:
        open_studies(url)
    text = str(caught.value)
    assert text.startswith("storage: ") and "secret" not in text
    return text


def test_a_hidden_password(server, url, monkeypatch):
    """A URL on a command line is shown by `ps`."""
    server.require_password("guest", "secret")
    guest = url.replace(f"{server.owner}:secret@", "guest@")
    with refused("password"):
        open_studies(guest)
    monkeypatch.setenv("PGPASSWORD", "secret")
    optuna.create_study(storage=open_studies(guest), study_name="shared")
    assert "shared" in optuna.get_all_study_names(url)


def test_no_server_no_database_or_one_of_somebody_else(server, url):
    assert "refused" in refusal("postgresql+psycopg://me:secret@127.0.0.1:1/db")
    assert '"nowhere" does not exist' in refusal(server.url("nowhere"))
    engine = sql.create_engine(url)
    with engine.begin() as connection:
        connection.execute(sql.text("CREATE TABLE birds (name TEXT)"))
    assert "an Optuna database, or an empty one" in refusal(url)
    assert sql.inspect(engine).get_table_names() == ["birds"]
    engine.dispose()


@pytest.mark.parametrize("revision", ["v2.6.0.a", "v99.0.0"])
def test_a_database_of_another_optuna(url, revision):
    storage = open_studies(url)
    with storage.engine.begin() as connection:
        connection.execute(
            sql.text(f"UPDATE alembic_version SET version_num = '{revision}'")
        )
    storage.engine.dispose()
    assert "no longer compatible" in refusal(url)


def test_a_server_that_goes_away_and_comes_back(server, url):
    storage = open_studies(url)
    study = optuna.create_study(storage=storage, study_name="a")
    server.stop()
    with refused("storage: ") as caught, storage_errors(url):
        study.set_user_attr("key", 1)
    assert "secret" not in str(caught.value)
    server.start()
    with storage_errors(url):
        study.set_user_attr("key", 2)
    assert study.user_attrs == {"key": 2}

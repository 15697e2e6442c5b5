"""The schema of Optuna's database that `storage.databases.bulk` knows how to write."""

import sqlalchemy as sql
from optuna.storages import RDBStorage

from taichi_nmm.errors import InputError

SCHEMA_VERSION = 12  # Optuna 3.0 to 5.0, with the column types of revision v3.2.0.a and later
TABLES: dict[str, set[str]] = {  # with their columns
    "studies": {"study_id", "study_name"},
    "study_directions": {"study_direction_id", "direction", "study_id", "objective"},
    "study_user_attributes": {"study_user_attribute_id", "study_id", "key", "value_json"},
    "study_system_attributes": {"study_system_attribute_id", "study_id", "key", "value_json"},
    "trials": {"trial_id", "number", "study_id", "state", "datetime_start", "datetime_complete"},
    "trial_values": {"trial_value_id", "trial_id", "objective", "value", "value_type"},
    "trial_params": {"param_id", "trial_id", "param_name", "param_value", "distribution_json"},
    "trial_user_attributes": {"trial_user_attribute_id", "trial_id", "key", "value_json"},
    "trial_system_attributes": {"trial_system_attribute_id", "trial_id", "key", "value_json"},
    "trial_intermediate_values": {
        "trial_intermediate_value_id", "trial_id", "step", "intermediate_value",
        "intermediate_value_type",
    },
    "trial_heartbeats": {"trial_heartbeat_id", "trial_id", "heartbeat"},
    "version_info": {"version_info_id", "schema_version", "library_version"},
}  # fmt: skip


def known_tables(storage: RDBStorage) -> dict[str, sql.Table]:
    """The database's tables by name, as they are there.

    Raises:
        InputError: the schema is of another version of Optuna.
    """
    metadata = sql.MetaData()
    metadata.reflect(storage.engine, only=lambda name, _: name in TABLES)
    version = metadata.tables.get("version_info")
    if version is None or len(metadata.tables) < len(TABLES):
        raise _refusal("an unknown schema")
    with storage.engine.connect() as connection:
        found = connection.execute(sql.select(version.c.schema_version)).scalar()
    if found != SCHEMA_VERSION:
        raise _refusal(f"schema {found}")
    return dict(metadata.tables)


def _refusal(found: str) -> InputError:
    allowed = f"a database with Optuna's schema {SCHEMA_VERSION} (Optuna 5.0 makes such)"
    return InputError("storage", found, allowed)

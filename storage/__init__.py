"""The Parquet store of gait scores, and Optuna's study databases.

Importing this package loads neither Taichi nor Optuna; `storage.precompute` fills a store, and
`storage.studies` opens a database.
"""

from storage.store import Store, merge, open_store

__all__ = ["Store", "merge", "open_store"]

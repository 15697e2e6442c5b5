"""The Parquet store of gait scores, and Optuna's study databases.

Importing this package loads neither Taichi nor Optuna; `storage.precompute` fills a store,
`storage.databases` has the databases, and `storage.pool` spreads work over processes.
"""

from storage.store import Store, merge, open_store

__all__ = ["Store", "merge", "open_store"]

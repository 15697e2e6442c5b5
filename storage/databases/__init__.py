"""Optuna's study databases, SQLite files and PostgreSQL servers; the Parquet store needs none."""

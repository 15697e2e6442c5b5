"""Tests of Optuna's study databases."""

"""Figures and tables of finished (or unfinished) comparisons: `taichi-nmm report`.

Everything is derived from `trials.parquet` and `experiment.json` of an output folder; nothing here
runs a sampler. Only the strips of stick figures simulate again what they show.
"""

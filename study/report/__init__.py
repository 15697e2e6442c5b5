"""Figures and tables of finished (or unfinished) comparisons: `taichi-nmm report`.

Everything is derived from `trials.parquet` and `experiment.json` of an output folder;
nothing here runs a sampler or the simulator.
"""

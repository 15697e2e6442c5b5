"""Tuning problems from outside: pools of candidates whose costly objective was computed once.

Nobody here invented them: they are what users of public packages tune. `definition` says what a
problem is, one file each (`digits_network`, ...) is a problem, `making` computes its Parquet file
in `data/` (`tools/make_outside.py`), and `outside_problem` reads that file, which is all that a
comparison needs.
"""

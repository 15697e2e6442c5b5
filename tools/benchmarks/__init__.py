"""Problems on which samplers are compared: made up (`synthetic`), or tuned by others (`outside`).

`tools/compare_peers.py` and `tools/compare_outside.py` run them, with the cache of `runs`.

The Parquet files in `data/` are pools of candidates whose costly objective was computed once, by
`tools/make_outside.py` of version 0.2.0: its tag keeps the code that made them.
"""

"""Problems on which samplers are compared: made up (`synthetic`), or tuned by others (`outside`).

`arms` has the compared samplers, `runs` the cache, `documents` the pages. `tools/compare_peers.py`
and `tools/compare_outside.py` run them.

The Parquet files in `data/` are pools of candidates whose costly objective was computed once, by
`tools/make_outside.py` of version 0.2.0: its tag keeps the code that made them.
"""

"""Trials on a real machine, over days, by hand: what to try next, and what came of it.

`plan` reads the file that describes a bench, `journal` keeps every entry, and `bench`
answers from both. Nothing here knows the walker: candidates come from any table or
store.
"""

from study.bench.bench import Bench

__all__ = ["Bench"]

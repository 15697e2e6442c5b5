"""Studies of the walker: an arm that proposes trials, in a run of an experiment.

A run is a body and a ground. `one_study` and `live_study` are of one study; `block` and
`compare` are of many, side by side and resumable.
"""

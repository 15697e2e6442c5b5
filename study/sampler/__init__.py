"""The feature-kernel sampler: any study's, nothing in it knows what a leg is.

`feature_sampler` is the contract with Optuna, `candidate_table` what is chosen from; `table_source`
and `space_source` make proposals; `history` reads the study, `model` is the Gaussian process with
its acquisition.
"""

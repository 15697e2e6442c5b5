"""The feature-kernel sampler: for any study, nothing in it knows what a leg is.

`feature_sampler` is the contract with Optuna, `candidate_table` the rows to choose from;
`table_source` and `space_source` make proposals; `history` reads the study; `gp` is the Gaussian
process, `acquisition` compares candidates by it, `transforms` puts features and costs on its
scales, and `diagnostics` reports what features are worth.
"""

"""The feature-kernel sampler, for any study: it contains nothing about legs.

`sampler` is the contract with Optuna, `table` what users choose from, `rows` its
content, which `columns` checks. `table_policy` and `space_policy` make proposals,
`policy` is what they have in common; `history` reads the study. `gp` is the Gaussian
process, `acquisition` compares candidates by it, `transforms` and `goals` put features
and costs on its scales. `worlds` and `similarity` are what may be known of rows beside
features. `diagnostics` and `prediction` report what trials have shown, and what to
expect.
"""

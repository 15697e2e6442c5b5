"""The feature-kernel sampler, for any study: it contains nothing about legs.

`sampler` is the contract with Optuna, `table` what users choose from, `rows` its
content, which `columns` checks. `table_policy` and `space_policy` make proposals,
`off_table` those between rows, `policy` is what they have in common; `history` reads the
study. `evidence` is what its trials have shown, and all that this decides. `gp` is the
Gaussian process, `covariance` its kernels, `acquisition` compares candidates by it,
`transforms` and `goals` put features and costs on its scales. `worlds` and `similarity`
are what may be known of rows beside features, `between` what rows tell of other points,
`asking` what a simulator says of these; `unlike` says that a machine is like no world.
`prediction` says what to expect, by `calibration` as sure as past trials allow; `risk`
keeps to small ones; `forecast` lets worlds take the machine's place; `diagnostics` reports
what features and worlds were worth.
"""

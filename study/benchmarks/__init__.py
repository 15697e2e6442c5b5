"""How the sampler does on synthetic problems beside Optuna's own, and how fast it is."""

"""An experiment and a table of its results as the engine would write it, without simulating."""

import numpy as np
import pyarrow as pa

from study.experiment.folder import results_of, state_schema
from study.experiment.objective import Objective
from study.experiment.walker import WalkerExperiment
from taichi_nmm.body import Build
from taichi_nmm.conditions import Conditions
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Ground

ARMS = ("dog", "random")
STATE_SCHEMA = state_schema({"searched": (), "objective": {}})


def experiment(**changes):
    """Rough ground, disturbed bodies, two runs of three trials; `changes` may be of conditions."""
    conditions = {
        "duration_s": 2.0,
        "settings": Settings(arch="cpu"),
        "build": Build(0.1),
        "ground": Ground("rough", {"amplitude_m": 0.02}),
    }
    conditions |= {name: changes.pop(name) for name in conditions if name in changes}
    fields = {
        "name": "tiny",
        "seed": 7,
        "searched": (),
        "objective": Objective(),
        "conditions": Conditions(**conditions),
        "runs": 2,
        "trials": 3,
        "arms": ARMS,
    }
    return WalkerExperiment(**(fields | changes))


def results(of, runs=2, trials=3, arms=ARMS):
    """Rows of the results table, in its order; the numbers follow from their places."""
    rows = [
        _row(of, arm, run, trial)
        for arm in sorted(arms)
        for run in range(runs)
        for trial in range(trials)
    ]
    schema = results_of(STATE_SCHEMA.empty_table()).schema
    numbers = dict.fromkeys(schema.names, 0)  # of what no test looks at
    return pa.Table.from_pylist([numbers | row for row in rows], schema=schema)


def _row(of, arm, run, trial):
    rng = np.random.default_rng([len(arm), run, trial])
    gains = {gain.name: float(rng.uniform(gain.low, gain.high)) for gain in GAINS}
    # The arm dog gets below 100, and so walks, at trial 1 of run 0 only.
    costs = [300.0 - 10 * ((before + run) % 3) for before in range(trial + 1)]
    if (arm, run) == ("dog", 0) and trial > 0:
        costs[1] = 90.0
    (theta_ref,) = (
        gain.default for gain in LOW_LEVEL_GAINS if gain.name == "theta_ref"
    )
    walked = costs[-1] < 100
    return {
        "experiment": of.name,
        "arm": arm,
        "run": run,
        "trial": trial,
        **gains,
        "theta_ref": theta_ref + 0.01 * trial
        if "theta_ref" in of.searched
        else theta_ref,
        "row": 10 * run + trial,
        "cost": costs[-1],
        "best_cost": min(costs),
        "walked": walked,
        "duration_s": 2.0,
        "distance_m": 1.0 + trial,
        "mean_speed_mps": 0.5,
        "cost_of_transport_jpkgpm": 4.0,
        "end_reason": "completed" if walked else "fell",
        "survived_fraction": 0.5,
        "step_count": 3,
        "phi_printed": 1.5,
        "phi_corrected": 2.5,
    }

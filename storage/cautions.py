"""What makes a store a poor guide: worlds that no row ran, or ran to the end."""

import math

import numpy as np

from storage.inputs.errors import shortened
from storage.store import Store, evaluated_name, outcome_name


def cautions(store: Store, survived: str) -> list[str]:
    """A line for each family, and for the base setting, in which no row came to the end.

    Each names the key that changes it. `survived` is the column with how far a run
    came. Of a family that an older version made, without outcomes, nothing is said.
    """
    names = {}
    for family in store.families:
        if (outcome := outcome_name(family, survived)) in store.columns:
            names[family] = evaluated_name(family), outcome
    rows = store.numpy([survived, *(name for both in names.values() for name in both)])
    lines = []
    if not np.any(rows[survived] >= 1.0):
        horizon_s = store.specification["simulation"]["duration_s"]
        longest = f"the longest {_below(rows[survived].max())} of it"
        lines.append(
            f"simulation.duration_s: 0 of {len(rows)} rows lasted {horizon_s:g} s; {longest}"
        )
    for family, (evaluated, outcome) in names.items():
        settings, ran = store.settings_of(family), rows[evaluated]
        path = family if family == "robust" else f"families.{family}"
        lasted = rows[outcome][ran]
        if not len(lasted):
            key = "min_survived_fraction" if "after" in settings else "min_survival_s"
            lines.append(
                f"{path}.{key}: 0 of {len(rows)} rows reached {settings[key]:g}"
            )
        elif not np.any(lasted >= 1.0):
            share = f"0 of {len(lasted)} rows lasted {settings['horizon_s']:g} s in any world"
            longest = f"the longest {_below(np.nanmax(lasted))} of it"
            lines.append(f"{path}.horizon_s: {share}; {longest}")
    return [f"{shortened(str(store.path))}: {line}" for line in lines]


def _below(share: float) -> str:
    """A share below 1, as a number that is below 1, too."""
    return f"{math.floor(10_000 * share) / 10_000:g}"

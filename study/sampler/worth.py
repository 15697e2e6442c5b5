"""The place of `Worth` in 0.2.0, for one version: it is in `study.sampler.diagnostics` now."""

import warnings

from study.sampler.diagnostics import Worth

__all__ = ["Worth"]

warnings.warn(
    "study.sampler.worth is study.sampler.diagnostics now", DeprecationWarning, stacklevel=2
)

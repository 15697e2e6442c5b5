"""The two kinds of sources, and which of them what was given asks for."""

from optuna.samplers import BaseSampler

from study.sampler.candidate_table import CandidateTable
from study.sampler.feature_function import Features
from study.sampler.options import Options
from study.sampler.source import Source
from study.sampler.space_source import SpaceSource
from study.sampler.table_source import TableSource
from taichi_nmm.errors import InputError


def new_source(
    features: CandidateTable | Features | None,
    function: Features | None,
    options: Options,
    seed: int,
    independent: BaseSampler,
) -> Source:
    """The source for what the sampler was given.

    Args:
        features: a table, a function of points [n, d], or None.
        function: beside a table: of points off it.
        options: of the sampler.
        seed: of the sampler.
        independent: sampler for what the source does not propose.

    Raises:
        InputError: options and features that do not go together.
    """
    if isinstance(features, CandidateTable):
        return TableSource(features, function, options, seed, independent)
    if function is not None:
        raise InputError(
            "feature_function", "given", "none: only a table needs it beside `features`"
        )
    if options.nearest is not None:
        raise InputError("nearest", options.nearest, "none without a table: it has no rows")
    if features is not None and not callable(features):
        raise InputError("features", type(features).__name__, "a FeatureTable, a function, or None")
    return SpaceSource(features, options, seed, independent)

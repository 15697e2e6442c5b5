"""`FeatureKernelSampler` of taichi-nmm as an OptunaHub package.

The sampler itself is taichi-nmm's installed package `study`. No code is copied here:
there is one sampler to test and to fix, and a sampler that is pickled to a worker can
be read there, which a class of a package that OptunaHub has loaded cannot before that
worker has loaded it too.
"""

try:
    from study import FeatureKernelSampler
    from study import FeatureTable
except ImportError as error:
    raise ImportError(
        "samplers/feature_kernel needs taichi-nmm-sampler: install it as its README says, and see "
        "that no file or folder of yours is called `study`"
    ) from error


__all__ = ["FeatureKernelSampler", "FeatureTable"]

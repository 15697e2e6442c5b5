"""The walker as Taichi kernels: many walkers side by side, one file a part of the physics.

Taichi aborts the process of whoever has no home when it is imported, so a place for compiled
kernels is looked for first.
"""

from taichi_nmm.kernel_cache import require_kernel_cache

require_kernel_cache()

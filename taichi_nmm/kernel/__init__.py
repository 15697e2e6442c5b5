"""The walker as Taichi kernels: many walkers side by side, one file a part of the physics.

Without a home Taichi aborts the process when it is imported, so the place for compiled
kernels is checked first.
"""

from taichi_nmm.kernel_cache import require_kernel_cache

require_kernel_cache()

"""The walker as Taichi kernels: many walkers side by side, one file a part of the physics."""

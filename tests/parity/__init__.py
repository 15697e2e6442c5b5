"""The walker against other engines: MuJoCo, and a dense NumPy dynamics."""

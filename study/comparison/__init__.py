"""Many studies of an experiment side by side, resumable: arms on the same bodies and grounds."""

"""Experiments: many samplers on the same bodies and grounds, in lock-step, resumable."""

"""Damaged input for every command: what makes it, what runs it, and what is allowed to happen."""

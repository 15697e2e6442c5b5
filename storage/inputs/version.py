"""The version of the project, which both of its distributions read from this file."""

__version__ = "0.5.0"

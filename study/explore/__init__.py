"""A page that shows stores and comparisons, and lets any of their gaits walk: `explore`."""

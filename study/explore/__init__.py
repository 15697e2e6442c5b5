"""A page that shows a store, and lets any of its gaits walk: `explore`."""

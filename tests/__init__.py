"""Tests; a package, so that helpers import by one name and file names may repeat."""

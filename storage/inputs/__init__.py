"""What people give: read, checked, and refused in one line that says what is allowed.

The floor of the house: it knows no store, no sampler and no walker, and imports neither.
"""

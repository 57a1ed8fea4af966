"""Checks of a single object: its program's compile checks and its behaviour in simulation."""

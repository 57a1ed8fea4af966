"""The type checker that jaxtyping runs annotations with in tests (`--jaxtyping-packages`)."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""Beartype, with an int valid where a float is annotated, as type checkers have it."""

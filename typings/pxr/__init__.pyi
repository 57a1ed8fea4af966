# USD's bindings are compiled and carry no types; without this a checker knows none of their names.
from typing import Any

def __getattr__(name: str) -> Any: ...

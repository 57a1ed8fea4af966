# MuJoCo's bindings are compiled and carry no types; this file declares their names to checkers.
from typing import Any

def __getattr__(name: str) -> Any: ...

"""Step 2: object programs, the SDK that programs call, the sandbox that runs them, and the checks.

`build` and `BuildResult` are imported on first use. A program that imports
`neoworld_mjx.program.sdk` in plain Python therefore does not load the sandbox.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .building import BuildResult, build

__all__ = ["BuildResult", "build"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import building

    return getattr(building, name)

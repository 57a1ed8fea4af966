"""One RGB photograph in, a simulation-ready scene out, on JAX and MuJoCo MJX.

Names are resolved on first use, so that importing the package loads neither JAX nor MuJoCo.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import measure as measure
    from . import refine as refine
    from . import sweep as sweep
    from .physics.engine import rollout as rollout
    from .physics.layout import Layout as Layout
    from .physics.model import SceneModel as SceneModel
    from .physics.model import load_scene as load_scene
    from .pipeline import reconstruct as reconstruct
    from .refine import rewards as rewards
    from .refine.cem import CEM as CEM

__version__ = "0.1.0"

_HOMES = {
    "CEM": "refine.cem",
    "Layout": "physics.layout",
    "SceneModel": "physics.model",
    "load_scene": "physics.model",
    "reconstruct": "pipeline",
    "rollout": "physics.engine",
}
_MODULES = {
    "measure": "measure",
    "refine": "refine",
    "rewards": "refine.rewards",
    "sweep": "sweep",
}

__all__ = [
    "CEM",
    "Layout",
    "SceneModel",
    "load_scene",
    "measure",
    "reconstruct",
    "refine",
    "rewards",
    "rollout",
    "sweep",
]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _MODULES:
        return import_module(f"{__name__}.{_MODULES[name]}")
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])

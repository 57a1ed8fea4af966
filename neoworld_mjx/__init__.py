"""Reconstruction of a simulation-ready scene from one RGB photograph, on JAX and MuJoCo MJX.

Attributes are imported on first use, so importing the package loads neither JAX nor MuJoCo.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from .engines import share_gpu_memory

if TYPE_CHECKING:
    from . import measure as measure
    from .environments import task as tasks  # noqa: F401
    from .environments.controlled_scene import controlled_scene as controlled_scene
    from .environments.gym_environment import gym_env as gym_env
    from .environments.mjx_environment import mjx_env as mjx_env
    from .environments.randomization import ResetNoise as ResetNoise
    from .environments.reach import propose_mount as propose_mount
    from .environments.reach import reachable as reachable
    from .environments.robots import Mount as Mount
    from .environments.robots import Robot as Robot
    from .environments.samples import sample as sample
    from .environments.task import Task as Task
    from .environments.task_words import task_of as task_of
    from .evidence.depth_image import DepthImage as DepthImage
    from .evidence.evidence import Evidence as Evidence
    from .evidence.further_photo import FurtherPhoto as FurtherPhoto
    from .evidence.known_camera import KnownCamera as KnownCamera
    from .evidence.known_objects import KnownObjects as KnownObjects
    from .evidence.known_objects import KnownSize as KnownSize
    from .evidence.masks import Masks as Masks
    from .physics.engine import rollout as rollout
    from .physics.gripper import Gripper as Gripper
    from .physics.layout import Layout as Layout
    from .physics.mjx_model import mjx_batch as mjx_batch
    from .physics.mjx_model import mjx_step as mjx_step
    from .physics.model import SceneModel as SceneModel
    from .physics.model import load_scene as load_scene
    from .pipeline import reconstruct as reconstruct
    from .pipeline.given_evidence import read_evidence as read_evidence
    from .search import algorithm as algorithm
    from .search import rewards as rewards
    from .search.algorithm import Problem as Problem
    from .search.cem import CEM as CEM
    from .search.cem import CEMState as CEMState
    from .search.rewards import Term as Term
    from .search.scene_refinement import refine as refine
    from .sweeps.run import ablate as ablate
    from .sweeps.run import sweep as sweep

__version__ = "0.3.0"

if "gymnasium" in sys.modules:
    import_module(f"{__name__}.environments")  # registers neoworld/Scene-v0

share_gpu_memory()  # Must precede the initialization of JAX.

_LOCATIONS = {
    "CEM": "search.cem",
    "CEMState": "search.cem",
    "DepthImage": "evidence.depth_image",
    "Evidence": "evidence.evidence",
    "FurtherPhoto": "evidence.further_photo",
    "Gripper": "physics.gripper",
    "KnownCamera": "evidence.known_camera",
    "KnownObjects": "evidence.known_objects",
    "KnownSize": "evidence.known_objects",
    "Layout": "physics.layout",
    "Masks": "evidence.masks",
    "Mount": "environments.robots",
    "Problem": "search.algorithm",
    "ResetNoise": "environments.randomization",
    "Robot": "environments.robots",
    "SceneModel": "physics.model",
    "Task": "environments.task",
    "Term": "search.rewards",
    "ablate": "sweeps.run",
    "controlled_scene": "environments.controlled_scene",
    "gym_env": "environments.gym_environment",
    "load_scene": "physics.model",
    "mjx_batch": "physics.mjx_model",
    "mjx_env": "environments.mjx_environment",
    "mjx_step": "physics.mjx_model",
    "propose_mount": "environments.reach",
    "reachable": "environments.reach",
    "read_evidence": "pipeline.given_evidence",
    "reconstruct": "pipeline",
    "refine": "search.scene_refinement",
    "rollout": "physics.engine",
    "sample": "environments.samples",
    "sweep": "sweeps.run",
    "task_of": "environments.task_words",
}
_MODULES = {
    "algorithm": "search.algorithm",
    "measure": "measure",
    "rewards": "search.rewards",
    "tasks": "environments.task",
}

__all__ = [*_LOCATIONS, *_MODULES]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{_MODULES[name]}")
    if name in _LOCATIONS:
        return getattr(import_module(f"{__name__}.{_LOCATIONS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])

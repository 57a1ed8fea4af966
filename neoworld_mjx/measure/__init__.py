"""The metrics of the paper's tables; each says over how many things it was taken."""

from .scene import SceneMeasure, scene_measure

__all__ = ["SceneMeasure", "scene_measure"]

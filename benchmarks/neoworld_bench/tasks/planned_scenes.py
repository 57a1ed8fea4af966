"""Scenes in which a model plans a task: the true one, displaced, or a method's reconstruction."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.render import View, render
from neoworld_mjx.spec import SceneSpec
from neoworld_mjx.spec.pose import rotate

from ..fidelity.rendered_scenes import photograph
from ..methods.method_runs import MethodJob, RunSettings
from ..methods.scene_methods import outcomes_of
from ..noise.parse_noise import NoiseLog
from .predicates import named_objects
from .task import ManipulationTask
from .task_photo import TaskPhoto, photographed_task

Sees = Literal["numbers", "picture", "both"]
TRUTH, DISPLACED = "truth", "displaced"
"""Names of the scenes that no method reconstructed."""


@dataclass(frozen=True)
class PlannedScene:
    """A scene of a task, as a model gets to know it."""

    method: str
    """TRUTH, DISPLACED, or the method that reconstructed it."""
    start: int
    """Number of the initial scene."""
    scene: SceneSpec
    """At the place of the task's true scene."""
    picture: UInt8[np.ndarray, "row column 3"] | None
    """Rendered through `view`; None if the model sees numbers alone."""
    view: View | None
    """Camera of the picture, in the world of the scene."""
    in_numbers: bool
    """True if the model gets poses and boxes as numbers."""

    @property
    def view_in_words(self) -> str:
        """Pose and field of view of the picture's camera, for the prompt."""
        assert self.view is not None
        right, down, ahead = self.view.axes.T
        fovy = self.view.fovy
        fovx = 2 * np.arctan(np.tan(fovy / 2) * self.view.width / self.view.height)
        words = ", ".join(
            f"{name} ({', '.join(f'{v + 0.0:.3f}' for v in np.round(value, 3))})"
            for name, value in (
                ("position", self.view.eye),
                ("right", right),
                ("down", down),
                ("ahead", ahead),
            )
        )
        return (
            f"The picture 'scene' shows it through a camera, in the world's axes: {words}; fields "
            f"of view {np.degrees(fovx):.1f} degrees across and {np.degrees(fovy):.1f} upright."
        )


def true_scene(task: ManipulationTask, offset_m: float, seed: int, sees: Sees) -> PlannedScene:
    """Return the true scene of a task, or with an offset [m] the displaced one."""
    scene = displaced_layout(task, offset_m, seed)
    photo = None if sees == "numbers" else photographed_task(task.scene)
    return _pictured(DISPLACED if offset_m else TRUTH, 0, scene, photo, sees)


def reconstructed_scene(
    task: ManipulationTask, method: str, start: int, settings: RunSettings, sees: Sees
) -> PlannedScene:
    """Reconstruct a task's scene from a noisy response, as `run_successes` does.

    Args:
        task: the task.
        method: of METHODS.
        start: number of the initial scene.
        settings: noise and options.
        sees: what the model sees.
    """
    photo = photographed_task(task.scene)
    job = MethodJob(task.name, start, (method,), settings, threads=1, fingerprint="")
    composed = job.composed(photo.scene, f"task/{task.name}", NoiseLog())
    outcomes = dict(
        outcomes_of(
            (method,),
            composed,
            settings.refine,
            NativeEngine(threads=1),
            lambda: photograph(photo.scene),
            align=settings.compose.align,
            seed=settings.seed,
            warm=False,
        )
    )
    reconstructed = photo.back(outcomes[method].scene)
    return _pictured(method, start, reconstructed, photo, sees)


def _pictured(
    method: str, start: int, scene: SceneSpec, photo: TaskPhoto | None, sees: Sees
) -> PlannedScene:
    if photo is None or sees == "numbers":
        return PlannedScene(method, start, scene, None, None, in_numbers=True)
    assert photo.scene.camera is not None
    photo_view, photo_to_world = View.of(photo.scene.camera), photo.scene_transform.inverse()
    view = photo_view._replace(
        eye=photo_to_world.apply(photo_view.eye),
        axes=rotate(photo_to_world.quat, photo_view.axes.T).T,
    )
    picture = render(scene, view).color
    return PlannedScene(method, start, scene, picture, view, in_numbers=sees == "both")


def displaced_layout(task: ManipulationTask, offset_m: float, seed: int) -> SceneSpec:
    """Return a task's scene with the objects of its predicate displaced in random directions.

    Args:
        task: the task.
        offset_m: distance [m]; 0 is the true scene.
        seed: of the directions.
    """
    random = np.random.default_rng([seed, *task.name.encode()])
    named = named_objects(task.predicate)
    objects = []
    for item in task.scene.objects:
        angle = float(random.uniform(0, 2 * np.pi))
        if item.name in named and not item.environment and offset_m:
            x, y = item.xy
            xy = (x + offset_m * float(np.cos(angle)), y + offset_m * float(np.sin(angle)))
            item = item.model_copy(update={"xy": xy})
        objects.append(item)
    return task.scene.model_copy(update={"objects": tuple(objects)})

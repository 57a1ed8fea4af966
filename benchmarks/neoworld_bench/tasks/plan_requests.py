"""Requests for plans: what a model is told of a task's scene (Section 4.4 of the paper)."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from jaxtyping import UInt8
from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.mllm import Picture, Request, package_text
from neoworld_mjx.render import View, render
from neoworld_mjx.spec import SceneSpec, bounds, joint_position, link_poses, world_poses
from neoworld_mjx.spec.kinematics import welded
from neoworld_mjx.spec.pose import rotate

from .plan_format import TaskPlan
from .task import ManipulationTask
from .task_photo import TaskPhoto

MOST_JOINTS = 12
"""Maximum number of listed joints of an object."""


class PlannedTask(BaseModel):
    """A model's answer: the reasons first, so that the plan follows from them."""

    model_config = ConfigDict(extra="forbid")

    reasoning: Annotated[str, Field(max_length=2000)] = ""
    plan: TaskPlan


def plan_request(
    task: ManipulationTask, scene: SceneSpec, photo: TaskPhoto
) -> Request[PlannedTask]:
    """Return the request for a plan, with a picture of the scene and its numbers.

    Args:
        task: gives the instruction; its ground truth is not part of the request.
        scene: the scene to plan in, such as a reconstruction.
        photo: photograph of the task, whose camera the picture is rendered through.
    """
    picture, view = _pictured(scene, photo)
    parts = [
        _view_in_words(view),
        f"The scene:\n{scene_in_numbers(scene)}",
        f"The instruction: {task.instruction}",
    ]
    system = package_text(__package__, "planner").removesuffix("\n")
    pictures = [Picture.of("scene", picture)]
    prompt = "\n\n".join(parts)
    return Request("reasoner", f"plan:{task.name}", system, prompt, PlannedTask, pictures)


def _pictured(scene: SceneSpec, photo: TaskPhoto) -> tuple[UInt8[np.ndarray, "row column 3"], View]:
    """Return a picture of a scene, and its camera in the world of the scene."""
    assert photo.scene.camera is not None
    view, to_world = View.of(photo.scene.camera), photo.scene_transform.inverse()
    view = view._replace(eye=to_world.apply(view.eye), axes=rotate(to_world.quat, view.axes.T).T)
    return render(scene, view).color, view


def _view_in_words(view: View) -> str:
    right, down, ahead = view.axes.T
    fovx = 2 * np.arctan(np.tan(view.fovy / 2) * view.width / view.height)
    named = (("position", view.eye), ("right", right), ("down", down), ("ahead", ahead))
    words = ", ".join(f"{name} {_vector(value)}" for name, value in named)
    return (
        f"The picture 'scene' shows it through a camera, in the world's axes: {words}; fields "
        f"of view {np.degrees(fovx):.1f} degrees across and {np.degrees(view.fovy):.1f} upright."
    )


def scene_in_numbers(scene: SceneSpec) -> str:
    """Return each object's pose and box in the world, and its joints, as text."""
    lines = []
    poses = world_poses(scene)
    for item in scene.objects:
        object_pose = poses[item.name]
        low, high = bounds(item.spec, item.joint_state)
        edges, middle = high - low, object_pose.apply((low + high) / 2)
        axes = ", ".join(
            f"{name} {_vector(rotate(object_pose.quat, row))}" for name, row in _axes()
        )
        support = f", carried by {item.parent}" if item.parent else ""
        immobile = ", cannot move" if item.static else ""
        lines.append(
            f"- {item.name} ({item.spec.label or item.spec.name}{support}{immobile}): box of edges "
            f"{_vector(edges)} along its axes {axes}; middle of the box {_vector(middle)}, origin "
            f"{_vector(object_pose.pos)}"
        )
        part_poses = link_poses(item.spec, item.joint_state)
        group = welded(item.spec)
        for joint in [j for j in item.spec.joints if j.type != "fixed"][:MOST_JOINTS]:
            value = joint_position(item.spec, joint, item.joint_state)
            base = object_pose.then(part_poses[joint.parent])
            now = "a ball" if isinstance(value, tuple) else f"now {value:.2f}"
            limits = (
                f", {joint.lower:.2f} to {joint.upper:.2f}" if joint.upper > joint.lower else ""
            )
            parts = [
                part.name for part in item.spec.parts if group[part.name] == group[joint.child]
            ]
            lines.append(
                f"  - joint {joint.name} ({joint.type}) of {' and '.join(parts)}: {now}{limits}; "
                f"axis {_vector(rotate(base.quat, joint.axis))} through "
                f"{_vector(base.apply(np.array(joint.pos)))}"
            )
    return "\n".join(lines)


def _axes() -> list[tuple[str, tuple[float, float, float]]]:
    return [("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0))]


def _vector(values: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{float(v) + 0.0:.3f}" for v in np.round(values, 3)) + ")"

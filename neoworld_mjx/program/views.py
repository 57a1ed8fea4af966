"""Pictures of a made object for the critic, from where the photo was taken."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..mllm import Picture
from ..render import View, render_object, to_png
from ..render.scene_images import visible_vertices
from ..spec import Camera, ObjectSpec, TreeNode
from ..spec.opening import with_prerequisites
from ..spec.pose import conjugate, from_yaw, quat_mul, rotate

WIDTH, HEIGHT = 448, 384
OPENED = 0.8
"""Share of their range by which joints stand open in the second picture."""


@dataclass(frozen=True)
class DescribedPicture(Picture):
    """A picture that tapes know by a description of its content, not by its pixels.

    Cast rays round differently from one processor to the next, and a tape that knew this picture by
    its pixels would not be found again elsewhere.
    """

    shows: str = ""
    """Description of the object, its state and the view."""

    @property
    def pixels(self) -> str:
        """The sha256 of what is shown."""
        return hashlib.sha256(self.shows.encode()).hexdigest()


def draw(
    spec: ObjectSpec, node: TreeNode, camera: Camera | None, *, opened: bool = False
) -> DescribedPicture:
    """Draw an object as the photo's camera would see it, filling the picture.

    Args:
        spec: the object.
        node: where it stands in the scene.
        camera: the photo's; None looks at the front from the right and above.
        opened: whether joints stand open.
    """
    state = opened_state(spec) if opened else {}
    view = view_from(spec, state, node, camera)
    seen = render_object(spec, state, view, width=WIDTH, height=HEIGHT)
    # Rounded, as the view's numbers carry rounding of their own.
    place = np.round(np.concatenate([view.eye, view.axes.ravel()]), 4).tolist()
    shows = f"{spec.to_json()}{sorted(state.items())}{place}{WIDTH}x{HEIGHT}"
    return DescribedPicture("opened" if opened else "made", to_png(seen), shows)


def view_from(
    spec: ObjectSpec, state: Mapping[str, float], node: TreeNode, camera: Camera | None
) -> View:
    """Return a view of an object at its own origin, from the direction of the camera."""
    points = visible_vertices(spec, state)
    if camera is None:
        return View.framing(points, width=WIDTH, height=HEIGHT)
    turn = conjugate(quat_mul(from_yaw(node.box3d.yaw), np.array(node.base_tilt)))
    middle = np.array(node.box3d.position) + [0, 0, node.box3d.size[2] / 2]
    away = rotate(turn, camera.position() - middle)
    away = away / np.linalg.norm(away)
    return View.framing(
        points,
        width=WIDTH,
        height=HEIGHT,
        azimuth=float(np.arctan2(away[1], away[0])),
        # From below nothing but the floor would be seen.
        elevation=float(np.clip(np.arcsin(away[2]), np.radians(5), np.radians(85))),
    )


def opened_state(spec: ObjectSpec) -> dict[str, float]:
    """Return every joint that moves by itself, opened [rad or m]."""
    state = {}
    for joint in spec.joints:
        if joint.type == "fixed" or joint.mimic is not None:
            continue
        if joint.type == "ball":
            # Nodding towards the front shows best that it moves.
            state[f"{joint.name}.y"] = OPENED * min(joint.upper or 1.0, 1.0)
            continue
        turns = joint.type == "continuous"
        far = joint.upper if abs(joint.upper) >= abs(joint.lower) else joint.lower
        state[joint.name] = 0.8 if turns else OPENED * far
    # What a rack waits for stands wide open.
    return with_prerequisites(spec, state, opening=True)

"""Standard deviations that the photograph leaves to the objects of an aligned scene."""

import math

import numpy as np
from jaxtyping import Float

from ..spec import SceneSpec, support_frame, world_poses
from ..spec.pose import yaw_of


def photo_deviations(
    scene: SceneSpec,
) -> tuple[Float[np.ndarray, "object 2 2"], Float[np.ndarray, "object 2"]]:
    """Return the deviations of every object's place; zero for objects that were not aligned.

    Returns:
        Columns are the deviations of the position along and across the view [m], in the frame of
        the object's support; and the deviations of the yaw [rad] and of the log scale.
    """
    poses = world_poses(scene)
    axes, others = np.zeros((len(scene.objects), 2, 2)), np.zeros((len(scene.objects), 2))
    for k, item in enumerate(scene.objects):
        known = item.uncertainty
        if known is None or item.parent is None:
            continue
        frame = support_frame(scene.object(item.parent), poses[item.parent], item.parent_link)
        # The camera is above the origin.
        along = math.atan2(*poses[item.name].pos[1::-1]) - yaw_of(frame.quat)
        c, s = math.cos(along), math.sin(along)
        axes[k] = np.array([[c, -s], [s, c]]) * [known.along, known.across]
        others[k] = known.yaw, known.log_scale
    return axes, others

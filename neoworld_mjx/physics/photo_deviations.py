"""Standard deviations of the objects of a scene that is aligned with the photograph."""

import math

import numpy as np
from jaxtyping import Float

from ..spec import SceneSpec, support_frame, world_poses
from ..spec.pose import yaw_of


def photo_deviations(
    scene: SceneSpec,
) -> tuple[Float[np.ndarray, "object 2 2"], Float[np.ndarray, "object 2"]]:
    """Return the standard deviations of every object; zeros for objects that were not aligned.

    Returns:
        Deviations of the positions, shape [object, 2, 2], and of the yaw [rad] and the log scale,
        shape [object, 2]. The columns of each 2x2 matrix are the deviations along and across the
        viewing direction, as vectors in the frame of the object's support [m].
    """
    poses = world_poses(scene)
    axes, yaw_and_scale = np.zeros((len(scene.objects), 2, 2)), np.zeros((len(scene.objects), 2))
    for k, item in enumerate(scene.objects):
        uncertainty = item.uncertainty
        if uncertainty is None or item.parent is None:
            continue
        frame = support_frame(scene.object(item.parent), poses[item.parent], item.parent_link)
        # The camera is above the world's origin, so the viewing direction is that of the position.
        along = math.atan2(*poses[item.name].pos[1::-1]) - yaw_of(frame.quat)
        c, s = math.cos(along), math.sin(along)
        axes[k] = np.array([[c, -s], [s, c]]) * [uncertainty.along, uncertainty.across]
        yaw_and_scale[k] = uncertainty.yaw, uncertainty.log_scale
    return axes, yaw_and_scale

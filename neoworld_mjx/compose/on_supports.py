"""Heights of objects on their supports."""

import numpy as np

from ..physics.layout import Layout, arrange
from ..physics.placed import VERTICAL
from ..physics.scene_arrays import snapped_heights
from ..spec import SceneSpec, bounds


def snap(scene: SceneSpec) -> SceneSpec:
    """Place every object on the surface under its footprint, with a clearance of 0.1 mm."""
    arrangement = arrange(scene)
    z = snapped_heights(arrangement, Layout.zero(1, len(scene.objects)))[0]
    objects = [
        obj.model_copy(update={"z": float(h)}) if flag else obj
        for obj, h, flag in zip(scene.objects, z, arrangement.snapped, strict=True)
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def put_down(scene: SceneSpec) -> SceneSpec:
    """Place the objects of an aligned scene on the surfaces under them; see `snap`.

    An object keeps its height if the surface under it is at another level than the one that it
    stands on, by more than `settling_displacement` allows. A tube that overlaps the wall of its
    hole by a millimeter stays in the hole: settling moves it out of the wall.
    """
    objects = []
    for item, snapped in zip(scene.objects, snap(scene).objects, strict=True):
        size = float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))
        near = abs(snapped.z - item.z) <= VERTICAL[0] * size + VERTICAL[1]
        objects.append(snapped if near else item)
    return scene.model_copy(update={"objects": tuple(objects)})

"""Writes Drake model directives of a scene, which add the URDF file of each object at its pose.

The directives refer to files by the name of a package, whose package.xml is in the same folder:

    parser.package_map().AddPackageXml("out/package.xml")
    parser.AddModels("out/scene.dmd.yaml")
"""

import numpy as np

from ..spec import SceneObject, SceneSpec, joint_value, world_poses
from ..spec.pose import Pose, to_rpy
from .link_frames import link_names
from .meshes import number


def directives_text(scene: SceneSpec) -> str:
    """Return the text of the .dmd.yaml file of a scene."""
    poses = world_poses(scene)
    lines = ["directives:"]
    for item in scene.objects:
        lines += _add(scene, item, poses[item.name])
    return "\n".join(lines) + "\n"


def package_text(scene: SceneSpec) -> str:
    """Return the text of package.xml, which declares the folder of a scene as a package."""
    return (
        '<?xml version="1.0"?>\n<package format="2">\n'
        f" <name>{scene.name}</name>\n <version>0.0.0</version>\n"
        " <description>A scene</description>\n"
        "</package>\n"
    )


def _add(scene: SceneSpec, item: SceneObject, pose: Pose) -> list[str]:
    root = link_names(item.spec)[item.spec.root]
    lines = [
        "- add_model:",
        f"    name: {item.name}",
        f"    file: package://{scene.name}/objects/{item.name}/object.urdf",
    ]
    state = {}
    for joint in item.spec.joints:
        if joint.type not in ("fixed", "ball"):
            value = joint_value(item.spec, joint, item.joint_state)
            if value:
                state[joint.name] = value
    if state:
        lines.append("    default_joint_positions:")
        lines += [f"      {name}: [{number(value)}]" for name, value in state.items()]
    if item.static:
        lines += ["- add_weld:", "    parent: world", f"    child: {item.name}::{root}"]
        return [*lines, "    X_PC:", *_transform(pose, 6)]
    return [*lines, "    default_free_body_pose:", f"      {root}:", *_transform(pose, 8)]


def _transform(pose: Pose, indent: int) -> list[str]:
    space = " " * indent
    position = ", ".join(number(v) for v in pose.pos)
    angles = ", ".join(number(v) for v in np.degrees(to_rpy(pose.quat)))
    return [
        f"{space}translation: [{position}]",
        f"{space}rotation: !Rpy {{deg: [{angles}]}}",
    ]

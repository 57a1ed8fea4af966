"""Drake's model directives of a scene: the objects' URDF files in their places and joint states.

They name files by a package, whose package.xml lies beside them:

    parser.package_map().AddPackageXml("out/package.xml")
    parser.AddModels("out/scene.dmd.yaml")
"""

import numpy as np

from ..spec import SceneObject, SceneSpec, joint_value, world_poses
from ..spec.pose import Pose, to_rpy
from .meshes import number
from .write_urdf import link_name


def directives_text(scene: SceneSpec) -> str:
    """Return the scene as a .dmd.yaml."""
    poses = world_poses(scene)
    lines = ["directives:"]
    for item in scene.objects:
        lines += _add(scene, item, poses[item.name])
    return "\n".join(lines) + "\n"


def package_text(scene: SceneSpec) -> str:
    """Return the package.xml that gives the scene's folder its name."""
    return (
        '<?xml version="1.0"?>\n<package format="2">\n'
        f" <name>{scene.name}</name>\n <version>0.0.0</version>\n"
        " <description>A scene</description>\n"
        ' <maintainer email="nobody@example.com">nobody</maintainer>\n'
        " <license>unknown</license>\n</package>\n"
    )


def _add(scene: SceneSpec, item: SceneObject, at: Pose) -> list[str]:
    root = link_name(item.spec, item.spec.root)
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
        return [*lines, "    X_PC:", *_transform(at, 6)]
    return [*lines, "    default_free_body_pose:", f"      {root}:", *_transform(at, 8)]


def _transform(at: Pose, indent: int) -> list[str]:
    space = " " * indent
    place = ", ".join(number(v) for v in at.pos)
    turn = ", ".join(number(v) for v in np.degrees(to_rpy(at.quat)))
    return [f"{space}translation: [{place}]", f"{space}rotation: !Rpy {{deg: [{turn}]}}"]

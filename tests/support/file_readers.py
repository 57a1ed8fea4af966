"""Exported objects as MuJoCo, yourdfpy and OpenUSD read them, compared with the spec."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import yourdfpy
from numpy.typing import ArrayLike
from pxr import Usd, UsdPhysics, UsdValidation

from neoworld_mjx.physics.mjcf import body_name
from neoworld_mjx.spec import ObjectSpec, inertial


class FileContents(NamedTuple):
    """An object that another program read from a file."""

    mass: float
    """Mass of all parts [kg]."""
    joints: int
    """Joints that move."""
    colliders: int
    origins: dict[str, ArrayLike]
    """Origin of each link in the root's frame at rest [m]; empty if the reader computes none."""


def read_with_mujoco(path: Path) -> FileContents:
    """Load an MJCF or URDF file in MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return FileContents(
        float(model.body_mass.sum()),
        int((model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).sum()),
        int((model.geom_contype != 0).sum()),
        {model.body(k).name: data.xpos[k] for k in range(1, model.nbody)},
    )


def read_with_yourdfpy(path: Path) -> FileContents:
    """Load a URDF file in yourdfpy."""
    robot = yourdfpy.URDF.load(str(path))
    links = robot.link_map.values()
    return FileContents(
        sum(link.inertial.mass for link in links if link.inertial),
        sum(joint.type != "fixed" for joint in robot.joint_map.values()),
        sum(len(link.collisions) for link in links),
        {name: robot.get_transform(name)[:3, 3] for name in robot.link_map},
    )


def read_with_usd(path: Path) -> FileContents:
    """Load a USD file in OpenUSD, and validate it.

    Raises:
        ValueError: a validator of OpenUSD reports an error.
    """
    stage = Usd.Stage.Open(str(path))
    rules = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    if errors := UsdValidation.ValidationContext(rules).Validate(stage):
        raise ValueError(errors[0].GetErrorAsString())
    prims = list(stage.Traverse())
    return FileContents(
        sum(UsdPhysics.MassAPI(p).GetMassAttr().Get() or 0.0 for p in prims),
        sum(p.IsA(UsdPhysics.Joint) and not p.IsA(UsdPhysics.FixedJoint) for p in prims),
        sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims),
        {},
    )


READERS: dict[str, Callable[[Path], FileContents]] = {
    "object.xml": read_with_mujoco,
    "object.urdf": read_with_yourdfpy,
    "object.usda": read_with_usd,
}


def check_contents(read: FileContents, spec: ObjectSpec) -> None:
    """Assert that a file contains an object's mass, movable joints, colliders and link origins."""
    np.testing.assert_allclose(
        read.mass, sum(inertial(spec, p).mass for p in spec.parts), rtol=1e-5
    )
    moving = sum(joint.type != "fixed" for joint in spec.joints)
    # URDF has three hinges for a ball joint.
    assert read.joints in (moving, moving + 2 * sum(j.type == "ball" for j in spec.joints))
    pieces = [len(g.shape.pieces()) for p in spec.parts for g in p.geoms if g.role != "visual"]
    assert read.colliders >= sum(pieces)
    origins = {name.replace("_", "-"): np.array(at) for name, at in read.origins.items()}
    for joint in spec.joints if origins else ():
        names = [n.replace("_", "-") for n in (joint.child, body_name(spec, joint.child))]
        known = [origins[name] for name in names if name in origins]
        # A link that a reader merges into its parent has no origin of its own.
        if known:
            np.testing.assert_allclose(known[0], joint.pos, atol=1e-6, err_msg=joint.child)

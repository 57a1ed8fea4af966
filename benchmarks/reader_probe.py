"""Read one file by one foreign program and print what it made of it, as JSON.

Run in the environment that has the program; it needs nothing of this package:

    python benchmarks/reader_probe.py drake object.urdf
"""

import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

Read = dict[str, Any]
"""links: origin [m] of each in the root's frame; mass [kg]; joints: how many move; shapes."""


def mujoco(path: str) -> Read:
    import mujoco

    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = int((model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).sum())
    links = {model.body(b).name: data.xpos[b].tolist() for b in range(1, model.nbody)}
    shapes = int((model.geom_contype != 0).sum())
    mass = float(model.body_mass.sum())
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def dm_control(path: str) -> Read:
    from dm_control import mjcf

    physics = mjcf.Physics.from_mjcf_model(mjcf.from_path(path))
    model = physics.model
    links = {model.id2name(b, "body"): physics.data.xpos[b].tolist() for b in range(1, model.nbody)}
    moving = int((model.jnt_type != 0).sum())
    shapes = int((model.geom_contype != 0).sum())
    mass = float(model.body_mass.sum())
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def yourdfpy(path: str) -> Read:
    import yourdfpy

    robot = yourdfpy.URDF.load(path)
    links = {name: robot.get_transform(name)[:3, 3].tolist() for name in robot.link_map}
    mass = sum(link.inertial.mass for link in robot.link_map.values() if link.inertial)
    moving = sum(joint.type != "fixed" for joint in robot.joint_map.values())
    shapes = sum(len(link.collisions) for link in robot.link_map.values())
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def pinocchio(path: str) -> Read:
    import pinocchio as pin

    model = pin.buildModelFromUrdf(path)
    kind = pin.GeometryType.COLLISION
    folder = str(Path(path).parent)
    shapes = pin.buildGeomFromUrdf(model, path, kind, package_dirs=[folder]).ngeoms
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    links = {
        frame.name: data.oMf[k].translation.tolist()
        for k, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
    }
    mass = pin.computeTotalMass(model) + model.inertias[0].mass
    return {"links": links, "mass": mass, "joints": model.njoints - 1, "shapes": shapes}


def drake(path: str) -> Read:
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.multibody.tree import BodyIndex, JointIndex
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    Parser(plant).AddModels(path)
    plant.Finalize()
    diagram = builder.Build()
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    links = {b.name(): plant.EvalBodyPoseInWorld(context, b).translation().tolist() for b in bodies}
    joints = [plant.get_joint(JointIndex(k)) for k in range(plant.num_joints())]
    moving = sum(0 < joint.num_velocities() < 6 for joint in joints)
    shapes = sum(len(plant.GetCollisionGeometriesForBody(b)) for b in bodies)
    mass = plant.CalcTotalMass(context)
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def pybullet(path: str) -> Read:
    import pybullet as bullet

    bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(path)
    count = bullet.getNumJoints(body)
    info = [bullet.getJointInfo(body, k) for k in range(count)]
    state = [bullet.getLinkState(body, k, computeForwardKinematics=True) for k in range(count)]
    links = {i[12].decode(): list(s[4]) for i, s in zip(info, state, strict=True)}
    mass = sum(bullet.getDynamicsInfo(body, k)[0] for k in range(-1, count))
    moving = sum(i[2] != bullet.JOINT_FIXED for i in info)
    shapes = sum(len(bullet.getCollisionShapeData(body, k)) for k in range(-1, count))
    # The base's own place is that of its centre of mass; links are told relative to its frame.
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes, "base": "com"}


def newton(path: str) -> Read:
    import newton

    builder = newton.ModelBuilder()
    suffix = Path(path).suffix
    add = {".xml": builder.add_mjcf, ".urdf": builder.add_urdf}.get(suffix, builder.add_usd)
    add(path)
    moving = sum(int(k) not in (3, 4) for k in builder.joint_type)  # Neither fixed nor free.
    mass = float(sum(builder.body_mass))
    names = [str(name).rpartition("/")[2] for name in builder.body_label]
    links = {name: list(map(float, q[:3])) for name, q in zip(names, builder.body_q, strict=True)}
    return {"links": links, "mass": mass, "joints": moving, "shapes": int(builder.shape_count)}


def sapien(path: str) -> Read:
    import sapien

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    robot = loader.load(path)
    links = {link.name: link.entity_pose.p.tolist() for link in robot.links}
    mass = float(sum(link.mass for link in robot.links))
    shapes = sum(len(link.collision_shapes) for link in robot.links)
    moving = len(robot.active_joints)
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def usd(path: str) -> Read:
    from pxr import Usd, UsdPhysics, UsdValidation

    stage = Usd.Stage.Open(path)
    rules = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    faults = UsdValidation.ValidationContext(rules).Validate(stage)
    if faults:
        raise ValueError(faults[0].GetErrorAsString())
    prims = list(stage.Traverse())
    mass = sum(UsdPhysics.MassAPI(p).GetMassAttr().Get() or 0.0 for p in prims)
    moving = sum(p.IsA(UsdPhysics.Joint) and not p.IsA(UsdPhysics.FixedJoint) for p in prims)
    shapes = sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims)
    return {"links": {}, "mass": mass, "joints": moving, "shapes": shapes}


def _converted(convert: Callable[[str, str], Any], path: str) -> Read:
    with tempfile.TemporaryDirectory() as folder:
        from pxr import Usd, UsdPhysics

        stage = Usd.Stage.Open(str(convert(path, folder).path))
        prims = list(stage.Traverse(Usd.TraverseInstanceProxies()))
        mass = sum(UsdPhysics.MassAPI(p).GetMassAttr().Get() or 0.0 for p in prims)
        moving = sum(p.IsA(UsdPhysics.Joint) and not p.IsA(UsdPhysics.FixedJoint) for p in prims)
        shapes = sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims)
    return {"links": {}, "mass": mass, "joints": moving, "shapes": shapes}


def mujoco_usd_converter(path: str) -> Read:
    import mujoco_usd_converter

    return _converted(mujoco_usd_converter.Converter().convert, path)


def urdf_usd_converter(path: str) -> Read:
    import urdf_usd_converter

    return _converted(urdf_usd_converter.Converter().convert, path)


READERS: dict[str, tuple[Callable[[str], Read], str, tuple[str, ...]]] = {
    "mujoco": (mujoco, "mujoco", ("xml", "urdf")),
    "dm_control": (dm_control, "dm_control", ("xml",)),
    "yourdfpy": (yourdfpy, "yourdfpy", ("urdf",)),
    "pinocchio": (pinocchio, "pinocchio", ("urdf",)),
    "drake": (drake, "pydrake", ("urdf", "sdf", "xml")),
    "pybullet": (pybullet, "pybullet", ("urdf",)),
    "sapien": (sapien, "sapien", ("urdf",)),
    "newton": (newton, "newton", ("xml", "urdf", "usda")),
    "usd": (usd, "pxr", ("usda",)),
    "mujoco_usd_converter": (mujoco_usd_converter, "mujoco_usd_converter", ("xml",)),
    "urdf_usd_converter": (urdf_usd_converter, "urdf_usd_converter", ("urdf",)),
}
"""Readers: how one reads, the module that it needs, and suffixes of what it takes."""


if __name__ == "__main__":
    # A script's folder comes first on the path, where modules of ours would hide packages.
    sys.path.pop(0)
    try:
        result = READERS[sys.argv[1]][0](sys.argv[2])
    except Exception as error:  # a foreign program's border
        result = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]}
    print(f"\n{json.dumps(result)}")

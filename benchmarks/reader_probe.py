"""Objects as other programs read them from a file, each with its own functions."""

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

Read = dict[str, Any]
"""links: origin of each in the root's frame [m]; mass [kg]; joints: number that move; shapes."""


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
    parser = Parser(plant)
    if path.endswith("dmd.yaml"):
        parser.package_map().AddPackageXml(str(Path(path).with_name("package.xml")))
    parser.AddModels(path)
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
    bullet.disconnect()
    # The base's pose is that of its center of mass; links are relative to its frame.
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes, "base": "com"}


def newton(path: str) -> Read:
    import newton

    builder = newton.ModelBuilder()
    suffix = Path(path).suffix
    add = {".xml": builder.add_mjcf, ".urdf": builder.add_urdf}.get(suffix, builder.add_usd)
    add(path)
    model = builder.finalize()
    newton.eval_fk(model, model.joint_q, model.joint_qd, model)
    moving = sum(int(k) not in (3, 4) for k in builder.joint_type)  # Neither fixed nor free.
    mass = float(sum(builder.body_mass))
    names = [str(name).rpartition("/")[2] for name in builder.body_label]
    places = model.body_q.numpy()
    links = {name: list(map(float, q[:3])) for name, q in zip(names, places, strict=True)}
    return {"links": links, "mass": mass, "joints": moving, "shapes": int(builder.shape_count)}


def sapien(path: str) -> Read:
    import sapien

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    body = sapien_object(scene, path, fixed=True)
    if not hasattr(body, "links"):  # An object of one part is no articulation.
        (rigid,) = (k for k in body.components if hasattr(k, "collision_shapes"))
        shapes = len(rigid.collision_shapes)
        return {"links": {}, "mass": float(rigid.mass), "joints": 0, "shapes": shapes}
    active, parts = body.active_joints, body.links
    # Links get their poses when joint positions are set.
    body.qpos = body.qpos * 0
    links = {link.name: link.entity_pose.p.tolist() for link in parts}
    mass = float(sum(link.mass for link in parts))
    shapes = sum(len(link.collision_shapes) for link in parts)
    return {"links": links, "mass": mass, "joints": len(active), "shapes": shapes}


def sapien_object(scene: Any, path: str, *, fixed: bool) -> Any:
    """Load a URDF and its SRDF without visual shapes, which would require a graphics device."""
    file = Path(path)
    text = re.sub("<visual.*?</visual>", "", file.read_text(), flags=re.DOTALL)
    # In the folder of the file, as mesh paths are relative to it.
    plain = file.with_name(f"{file.stem}-plain.urdf")
    plain.write_text(text)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = fixed
    # An object of one link is an actor, which `load` refuses.
    (body,) = (b for kind in loader.load_multiple(str(plain), str(file.with_suffix(".srdf")))[:2]
               for b in kind)  # fmt: skip
    return body


def genesis(path: str) -> Read:
    import genesis as gs

    if not gs._initialized:
        gs.init(backend=gs.cpu, logging_level="error")
    scene = gs.Scene(show_viewer=False)
    body = scene.add_entity(genesis_morph(gs, path, fixed=True, merged=False))
    scene.build()
    links = {link.name: link.get_pos().tolist() for link in body.links}
    mass = sum(float(link.get_mass()) for link in body.links)
    moving = sum(joint.type.name not in ("FIXED", "FREE") for joint in body.joints)
    shapes = sum(len(link.geoms) for link in body.links)
    return {"links": links, "mass": mass, "joints": moving, "shapes": shapes}


def genesis_morph(gs: Any, path: str, *, fixed: bool, merged: bool = True) -> Any:
    """Describe a file to Genesis, without the armature that it adds to joints; an MJCF is fixed by
    taking its free joint out.
    """
    if path.endswith("urdf"):
        return gs.morphs.URDF(
            file=path, fixed=fixed, merge_fixed_links=merged, default_armature=0.0
        )
    if fixed and "object" in Path(path).name:
        file = Path(path)
        held = file.with_name("object-held.xml")
        text = re.sub("<freejoint[^>]*/>|<joint [^>]*type=.free.[^>]*/>", "", file.read_text())
        held.write_text(re.sub("<keyframe>.*?</keyframe>", "", text, flags=re.DOTALL))
        path = str(held)
    return gs.morphs.MJCF(file=path, default_armature=0.0)


def usd(path: str) -> Read:
    from pxr import Usd, UsdValidation

    stage = Usd.Stage.Open(path)
    rules = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    faults = UsdValidation.ValidationContext(rules).Validate(stage)
    if faults:
        raise ValueError(faults[0].GetErrorAsString())
    return _contents(list(stage.Traverse()))


def _contents(prims: list[Any]) -> Read:
    """Return the mass, and the numbers of movable joints and colliders, of prims of a USD stage."""
    from pxr import UsdPhysics

    mass = sum(UsdPhysics.MassAPI(p).GetMassAttr().Get() or 0.0 for p in prims)
    moving = sum(p.IsA(UsdPhysics.Joint) and not p.IsA(UsdPhysics.FixedJoint) for p in prims)
    shapes = sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims)
    return {"links": {}, "mass": mass, "joints": moving, "shapes": shapes}


def nvidia(path: str) -> Read:
    from physx_usd_schemas import PhysxSchema  # noqa: F401  # Registers its attributes.
    from usd_validation_nvidia import ValidationEngine

    found = [str(issue) for issue in ValidationEngine().validate(path).issues()]
    if found:
        raise ValueError(f"{len(found)} issues: {found[0]}")
    return usd(path)


def _converted(convert: Callable[[str, str], Any], path: str) -> Read:
    with tempfile.TemporaryDirectory() as folder:
        from pxr import Usd

        stage = Usd.Stage.Open(str(convert(path, folder).path))
        return _contents(list(stage.Traverse(Usd.TraverseInstanceProxies())))


def mujoco_usd_converter(path: str) -> Read:
    import mujoco_usd_converter

    return _converted(mujoco_usd_converter.Converter().convert, path)


def urdf_usd_converter(path: str) -> Read:
    import urdf_usd_converter

    return _converted(urdf_usd_converter.Converter().convert, path)


READERS: dict[str, Callable[[str], Read]] = {
    "mujoco": mujoco, "dm_control": dm_control, "yourdfpy": yourdfpy, "pinocchio": pinocchio,
    "drake": drake, "pybullet": pybullet, "newton": newton, "sapien": sapien, "genesis": genesis,
    "usd": usd, "nvidia": nvidia, "mujoco_usd_converter": mujoco_usd_converter,
    "urdf_usd_converter": urdf_usd_converter,
}  # fmt: skip
"""Reader function of each program."""

"""Writes USD of a scene, with a posed reference to the file of each object.

    /<scene>/physics   gravity            /<scene>/<object>    reference to the object's file
    /<scene>/photo     the camera         /<scene>/fixtures    joints that fix objects in the world
    /<scene>/lights

A static object without movable joints has colliders but no rigid bodies; a static object with
movable joints is fixed in the world by a joint. A joint that is not at zero states its position in
PhysicsJointStateAPI, which PhysX reads, and in an attribute of Newton. The `mjc:` attributes are
for Newton's MuJoCo solver, which reads them after
`newton.solvers.SolverMuJoCo.register_custom_attributes(builder)`. If an object has the name of a
prim in this list, underscores are appended to the name of this prim.
"""

import math

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics

from ..io.names import unused
from ..physics.mjcf import IMPRATIO
from ..spec import Camera, SceneObject, SceneSpec, joint_value, link_poses, world_poses
from ..spec.pose import Pose, pose
from .link_frames import link_origins
from .write_usd import new_stage, quatd, quatf, set_float, set_pose


def scene_usd_layer(scene: SceneSpec, suffix: str) -> Sdf.Layer:
    """Return a scene as a USD layer, with references to ./objects/<name>/object.<suffix>."""
    stage = new_stage()
    root = UsdGeom.Xform.Define(stage, f"/{scene.name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind("assembly")
    base = root.GetPath()
    _add_physics(stage, _free(scene, "physics"), scene)
    _add_lights(stage, _free(scene, "lights"))
    if scene.camera is not None:
        _add_camera(stage, _free(scene, "photo"), scene.camera)
    poses = world_poses(scene)
    for item in scene.objects:
        _add_object(stage, base.AppendChild(item.name), item, poses[item.name])
        fixture = fixture_path(scene, item)
        if fixture is not None:
            UsdGeom.Scope.Define(stage, fixture.GetParentPath())
            _fasten(stage, fixture, base, item, poses[item.name])
    # References are added to a layer without a stage, because the files do not exist yet.
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    for item in scene.objects:
        prim = layer.GetPrimAtPath(base.AppendChild(item.name))
        prim.referenceList.Prepend(Sdf.Reference(f"./objects/{item.name}/object.{suffix}"))
    return layer


def fixture_path(scene: SceneSpec, item: SceneObject) -> Sdf.Path | None:
    """Return the path of the joint that fixes a static, articulated object in the world, or None.

    The result is None if the object is not static or has no movable joints.
    """
    if not (item.static and _articulated(item)):
        return None
    return _free(scene, "fixtures").AppendChild(item.name)


def _free(scene: SceneSpec, name: str) -> Sdf.Path:
    name = unused(name, {item.name for item in scene.objects})
    return Sdf.Path(f"/{scene.name}").AppendChild(name)


def _articulated(item: SceneObject) -> bool:
    return any(joint.type != "fixed" for joint in item.spec.joints)


def _add_physics(stage: Usd.Stage, path: Sdf.Path, scene: SceneSpec) -> None:
    physics = UsdPhysics.Scene.Define(stage, path)
    gravity = np.array(scene.gravity)
    size = float(np.linalg.norm(gravity))
    down = gravity / size if size > 0 else np.array([0.0, 0.0, -1.0])
    physics.CreateGravityDirectionAttr(Gf.Vec3f(*down.tolist()))
    physics.CreateGravityMagnitudeAttr(size)
    # By default, each pair of convex pieces has one contact point in Newton, and friction is soft.
    for name, kind, value in (
        ("mjc:option:cone", Sdf.ValueTypeNames.Token, "elliptic"),
        ("mjc:option:impratio", Sdf.ValueTypeNames.Double, IMPRATIO),
        ("mjc:flag:multiccd", Sdf.ValueTypeNames.Bool, True),
    ):
        _override(physics.GetPrim(), name, kind, value)


def _add_lights(stage: Usd.Stage, path: Sdf.Path) -> None:
    UsdGeom.Scope.Define(stage, path)
    sky = UsdLux.DomeLight.Define(stage, path.AppendChild("sky"))
    sky.CreateIntensityAttr(400.0)
    key = UsdLux.DistantLight.Define(stage, path.AppendChild("key"))
    key.CreateIntensityAttr(1500.0)
    key.CreateAngleAttr(4.0)
    tilt = math.radians(35.0) / 2
    set_pose(key, pose((0, 0, 0), (math.cos(tilt), math.sin(tilt), 0.0, 0.0)))


def _add_camera(stage: Usd.Stage, path: Sdf.Path, camera: Camera) -> None:
    prim = UsdGeom.Camera.Define(stage, path)
    set_pose(prim, camera.pose())
    focal = 35.0
    tall = 2 * focal * math.tan(camera.fovy / 2)
    prim.CreateFocalLengthAttr(focal)
    prim.CreateVerticalApertureAttr(tall)
    prim.CreateHorizontalApertureAttr(tall * camera.width / camera.height_px)
    if any(camera.principal):
        # The aperture moves against the image: its offset is that of the image's middle.
        x, y = (value * tall / camera.height_px for value in camera.principal)
        prim.CreateHorizontalApertureOffsetAttr(-x)
        prim.CreateVerticalApertureOffsetAttr(y)
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01, 1000.0))


def _add_object(stage: Usd.Stage, path: Sdf.Path, item: SceneObject, world: Pose) -> None:
    prim = UsdGeom.Xform.Define(stage, path)
    set_pose(prim, world)
    part_poses = link_poses(item.spec, item.joint_state)
    origins = link_origins(item.spec)
    for part in item.spec.parts:
        link_pose = part_poses[part.name].then(pose(origins[part.name]))
        displaced = (
            not np.array_equal(link_pose.pos, origins[part.name]) or link_pose.quat[0] != 1.0
        )
        frozen = item.static and not _articulated(item)
        if not (displaced or frozen):
            continue
        over = stage.OverridePrim(path.AppendChild("links").AppendChild(part.name))
        if displaced:
            _override(
                over, "xformOp:translate", Sdf.ValueTypeNames.Double3, Gf.Vec3d(*link_pose.pos)
            )
            _override(over, "xformOp:orient", Sdf.ValueTypeNames.Quatd, quatd(link_pose.quat))
        if frozen:
            # Some simulators let rigid bodies fall even if they are disabled.
            remove_schemas(over, "PhysicsRigidBodyAPI", "PhysicsMassAPI")
    if item.static and not _articulated(item):
        if item.spec.joints:
            remove_schemas(stage.OverridePrim(path), "PhysicsArticulationRootAPI")
        for joint in item.spec.joints:
            over = stage.OverridePrim(path.AppendChild("joints").AppendChild(joint.name))
            _override(over, "physics:jointEnabled", Sdf.ValueTypeNames.Bool, False)
        return
    for joint in item.spec.joints:
        if joint.type in ("fixed", "ball"):
            continue
        value = joint_value(item.spec, joint, item.joint_state)
        if value != 0.0:
            instance = "linear" if joint.type == "prismatic" else "angular"
            over = stage.OverridePrim(path.AppendChild("joints").AppendChild(joint.name))
            over.AddAppliedSchema(f"PhysicsJointStateAPI:{instance}")
            position = value if instance == "linear" else math.degrees(value)
            set_float(over, f"state:{instance}:physics:position", position)
            set_float(over, f"state:{instance}:physics:velocity", 0.0)
            set_float(over, f"newton:{instance}:position", position)


def remove_schemas(prim: Usd.Prim, *names: str) -> None:
    """Remove API schemas that a weaker layer applies to a prim."""
    removed = Sdf.TokenListOp()
    removed.deletedItems = list(names)
    prim.SetMetadata("apiSchemas", removed)


def _override(prim: Usd.Prim, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    prim.CreateAttribute(name, kind, custom=False).Set(value)


def _fasten(
    stage: Usd.Stage, path: Sdf.Path, base: Sdf.Path, item: SceneObject, world: Pose
) -> None:
    """Fix the root link of an articulated object in the world."""
    joint = UsdPhysics.FixedJoint.Define(stage, path)
    link = base.AppendChild(item.name).AppendChild("links").AppendChild(item.spec.root)
    joint.CreateBody1Rel().SetTargets([link])
    joint.CreateLocalPos0Attr(Gf.Vec3f(*world.pos.tolist()))
    joint.CreateLocalRot0Attr(quatf(world.quat))
    joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    joint.CreateLocalRot1Attr(quatf((1.0, 0.0, 0.0, 0.0)))

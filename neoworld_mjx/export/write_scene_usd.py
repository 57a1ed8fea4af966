"""USD of a scene: objects as references, put in their places.

    /<scene>/physics   gravity            /<scene>/<object>    reference to the object's own file
    /<scene>/photo     the camera         /<scene>/fixtures    joints that hold fastened objects
    /<scene>/lights

What cannot move has colliders and no rigid bodies; joints that are not at 0 say where they are, as
PhysX and Newton read it (PhysicsJointStateAPI).

The names after /<scene>/ that are no object's get underscores where an object has them.
"""

import math

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics

from ..spec import Camera, SceneObject, SceneSpec, joint_value, link_poses, world_poses
from ..spec.pose import Pose, pose
from .write_usd import link_origins, new_stage, quatd, quatf, set_pose


def scene_usd_text(scene: SceneSpec) -> str:
    """Return a scene as a USD layer in text form; objects are references to ./objects/<name>/."""
    return scene_usd_layer(scene).ExportToString()


def scene_usd_layer(scene: SceneSpec, suffix: str = "usda") -> Sdf.Layer:
    """Return a scene as a USD layer; its references are to ./objects/<name>/object.<suffix>."""
    stage = new_stage()
    root = UsdGeom.Xform.Define(stage, f"/{scene.name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind("assembly")
    base = root.GetPath()
    _add_physics(stage, physics_path(scene), scene)
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
    # References come last and on a layer that no stage composes: they would not resolve here.
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    for item in scene.objects:
        prim = layer.GetPrimAtPath(base.AppendChild(item.name))
        prim.referenceList.Prepend(Sdf.Reference(f"./objects/{item.name}/object.{suffix}"))
    return layer


def physics_path(scene: SceneSpec) -> Sdf.Path:
    """Return the path of the prim that holds gravity."""
    return _free(scene, "physics")


def fixture_path(scene: SceneSpec, item: SceneObject) -> Sdf.Path | None:
    """Return the path of the joint that holds an articulated object in the world; else None."""
    if not (item.static and _articulated(item)):
        return None
    return _free(scene, "fixtures").AppendChild(item.name)


def _free(scene: SceneSpec, name: str) -> Sdf.Path:
    taken = {item.name for item in scene.objects}
    while name in taken:
        name += "_"
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
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01, 1000.0))


def _add_object(stage: Usd.Stage, path: Sdf.Path, item: SceneObject, at: Pose) -> None:
    prim = UsdGeom.Xform.Define(stage, path)
    set_pose(prim, at)
    moved = link_poses(item.spec, item.joint_state)
    origins = link_origins(item.spec)
    for part in item.spec.parts:
        place = moved[part.name].then(pose(origins[part.name]))
        here = path.AppendChild("links").AppendChild(part.name)
        displaced = not np.array_equal(place.pos, origins[part.name]) or place.quat[0] != 1.0
        frozen = item.static and not _articulated(item)
        if not (displaced or frozen):
            continue
        over = stage.OverridePrim(here)
        if displaced:
            _override(over, "xformOp:translate", Sdf.ValueTypeNames.Double3, Gf.Vec3d(*place.pos))
            _override(over, "xformOp:orient", Sdf.ValueTypeNames.Quatd, quatd(place.quat))
        if frozen:
            # What is no rigid body does not fall in any reader; a switched-off one does in some.
            _withdraw(over, "PhysicsRigidBodyAPI", "PhysicsMassAPI")
    if item.static and not _articulated(item):
        if item.spec.joints:
            _withdraw(stage.OverridePrim(path), "PhysicsArticulationRootAPI")
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
            stands = value if instance == "linear" else math.degrees(value)
            for name, number in (("position", stands), ("velocity", 0.0)):
                kind = Sdf.ValueTypeNames.Float
                _override(over, f"state:{instance}:physics:{name}", kind, number)


def _withdraw(prim: Usd.Prim, *names: str) -> None:
    """Take applied schemas of a referenced prim away."""
    removed = Sdf.TokenListOp()
    removed.deletedItems = list(names)
    prim.SetMetadata("apiSchemas", removed)


def _override(prim: Usd.Prim, name: str, kind: Sdf.ValueTypeName, value: object) -> None:
    prim.CreateAttribute(name, kind, custom=False).Set(value)


def _fasten(stage: Usd.Stage, path: Sdf.Path, base: Sdf.Path, item: SceneObject, at: Pose) -> None:
    """Hold an articulated object's root in the world; without joints it is simply no rigid body."""
    joint = UsdPhysics.FixedJoint.Define(stage, path)
    link = base.AppendChild(item.name).AppendChild("links").AppendChild(item.spec.root)
    joint.CreateBody1Rel().SetTargets([link])
    joint.CreateLocalPos0Attr(Gf.Vec3f(*at.pos.tolist()))
    joint.CreateLocalRot0Attr(quatf(at.quat))
    joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    joint.CreateLocalRot1Attr(quatf((1.0, 0.0, 0.0, 0.0)))

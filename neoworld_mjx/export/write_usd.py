"""USD of one object, with UsdPhysics.

    /<object>                the object's frame; articulation root where there are joints
    /<object>/links/<part>   rigid body; origin at its joint's anchor, the object's orientation
        visuals/<geom>  collisions/<geom>_<k> (guides)  sites/<site or handle>
    /<object>/joints/<joint>   /<object>/looks/<material>

A joint's axis lies in its local rotations unless it is +X, +Y or +Z: whoever reads only the axis
token loses it. UsdPhysics counts angles in degrees: limits, and per degree stiffness and damping
of drives. Armature, dry friction, velocity limits and mimics are written twice: by Newton's schemas
(newton-usd-schemas) and by PhysX's, for Isaac; both count angles in degrees, and no number of one
contradicts the other. A ball is a spherical joint with a cone; its damping and stiffness are our
own attributes, in radians. Semantic labels name the object's class and category, its parts, their
materials, and the purpose of its joints.
"""

import math

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from ..spec import (
    GeomSpec,
    JointSpec,
    ObjectSpec,
    PartSpec,
    inertial,
)
from ..spec.convex import Piece
from ..spec.kinematics import welded
from ..spec.pose import IDENTITY, Pose, pose
from ..spec.semantics import category, purpose
from ..spec.triangles import corner_normals
from .handles import Frame, frames
from .meshes import piece_mesh
from .textures import is_textured, visible_surface
from .usd_looks import add_label, add_material, dress

_AXES = {(1.0, 0.0, 0.0): "X", (0.0, 1.0, 0.0): "Y", (0.0, 0.0, 1.0): "Z"}


FLAT = 1e-3
"""Angle [rad] above which colliders' faces are shaded as meeting at an edge."""


def usd_text(spec: ObjectSpec) -> str:
    """Return an object, all joints at 0, as a USD layer in text form."""
    return usd_layer(spec).ExportToString()


def usd_layer(spec: ObjectSpec) -> Sdf.Layer:
    """Return an object, all joints at 0, as a USD layer."""
    stage = new_stage()
    root = UsdGeom.Xform.Define(stage, f"/{spec.name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    if spec.label:
        root.GetPrim().SetDisplayName(spec.label)
    add_label(root.GetPrim(), "class", spec.label or spec.name)
    add_label(root.GetPrim(), "category", category(spec))
    if spec.joints:
        UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    base = root.GetPath()
    UsdGeom.Scope.Define(stage, base.AppendChild("looks"))
    shown = {g.material for part in spec.parts for g in part.geoms if is_textured(spec, g)}
    for material in spec.materials:
        add_material(stage, base, material, textured=material.name in shown)
    UsdGeom.Xform.Define(stage, base.AppendChild("links"))
    origins = link_origins(spec)
    points = frames(spec)
    for part, _ in spec.ordered:
        _add_link(stage, base, spec, part, origins[part.name], points)
    if spec.joints:
        UsdGeom.Scope.Define(stage, base.AppendChild("joints"))
    for joint in spec.joints:
        _add_joint(stage, base, spec, joint, origins[joint.parent])
    _filter_pairs(stage, base, spec)
    # A stage's own layer goes with it.
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    return layer


def new_stage() -> Usd.Stage:
    """Return an empty stage in metres and kilograms, Z up."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    return stage


def link_origins(spec: ObjectSpec) -> dict[str, NDArray]:
    """Return where each link's frame has its origin [m], [3], in the object's frame at rest."""
    origins = {joint.child: np.array(joint.pos) for joint in spec.joints}
    origins[spec.root] = np.zeros(3)
    return origins


def set_pose(xform: UsdGeom.Xformable, at: Pose) -> None:
    """Place a prim in its parent's frame."""
    xform.ClearXformOpOrder()
    xform.AddTranslateOp().Set(Gf.Vec3d(*map(float, at.pos)))
    xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(quatd(at.quat))


def quatd(quat: NDArray | tuple[float, ...]) -> Gf.Quatd:
    """Turn (w, x, y, z) into USD's double quaternion."""
    w, x, y, z = map(float, quat)
    return Gf.Quatd(w, x, y, z)


def quatf(quat: NDArray | tuple[float, ...]) -> Gf.Quatf:
    """Turn (w, x, y, z) into USD's single quaternion."""
    return Gf.Quatf(quatd(quat))


def _add_link(
    stage: Usd.Stage,
    base: Sdf.Path,
    spec: ObjectSpec,
    part: PartSpec,
    origin: NDArray,
    points: tuple[Frame, ...],
) -> None:
    path = base.AppendChild("links").AppendChild(part.name)
    link = UsdGeom.Xform.Define(stage, path)
    set_pose(link, pose(origin))
    UsdPhysics.RigidBodyAPI.Apply(link.GetPrim())
    add_label(link.GetPrim(), "part", part.name)
    mass = inertial(spec, part)
    physics = UsdPhysics.MassAPI.Apply(link.GetPrim())
    physics.CreateMassAttr(mass.mass)
    physics.CreateCenterOfMassAttr(Gf.Vec3f(*(np.array(mass.pos) - origin).tolist()))
    physics.CreateDiagonalInertiaAttr(Gf.Vec3f(*mass.diagonal))
    physics.CreatePrincipalAxesAttr(quatf(mass.quat))
    for geom in part.geoms:
        material = spec.material(geom.material)
        local = Pose(np.array(geom.pos) - origin, np.array(geom.quat))
        if geom.role != "collision":
            folder = UsdGeom.Scope.Define(stage, path.AppendChild("visuals")).GetPath()
            _add_visual(stage, folder.AppendChild(geom.name), spec, part, geom, local)
            dress(stage, folder.AppendChild(geom.name), base, material, physical=False)
        if geom.role != "visual":
            folder = UsdGeom.Scope.Define(stage, path.AppendChild("collisions")).GetPath()
            for k, piece in enumerate(geom.shape.pieces()):
                at = folder.AppendChild(f"{geom.name}_{k}")
                _add_collider(stage, at, geom, piece, local.then(pose(piece.pos, piece.quat)))
                dress(stage, at, base, material, physical=True)
    for frame in points:
        if frame.part == part.name:
            folder = UsdGeom.Scope.Define(stage, path.AppendChild("sites")).GetPath()
            point = UsdGeom.Xform.Define(stage, folder.AppendChild(frame.name))
            set_pose(point, pose(np.array(frame.pos) - origin))


def _add_visual(
    stage: Usd.Stage,
    path: Sdf.Path,
    spec: ObjectSpec,
    part: PartSpec,
    geom: GeomSpec,
    at: Pose,
) -> None:
    primitive = geom.shape.primitive()
    if primitive is not None and not is_textured(spec, geom):
        _gprim(stage, path, primitive, at)
        return
    vertices, faces, uv = visible_surface(spec, part.name, geom)
    mesh = _mesh(stage, path, vertices, faces, at)
    _shade(mesh, corner_normals(vertices, faces))
    if uv is not None:
        primvars = UsdGeom.PrimvarsAPI(mesh)
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        st = primvars.CreatePrimvar("st", kind, UsdGeom.Tokens.faceVarying)
        points, corners = np.unique(
            uv.reshape(-1, 2).astype(np.float32), axis=0, return_inverse=True
        )
        st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(points)))
        st.SetIndices(Vt.IntArray.FromNumpy(corners.ravel().astype(np.int32)))


def _shade(mesh: UsdGeom.Mesh, normals: NDArray) -> None:
    mesh.CreateNormalsAttr(_points(normals.reshape(-1, 3).round(6) + 0.0))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)


def _add_collider(stage: Usd.Stage, path: Sdf.Path, geom: GeomSpec, piece: Piece, at: Pose) -> None:
    triangles = piece_mesh(geom, piece)
    if triangles is None:
        prim = _gprim(stage, path, piece, at).GetPrim()
    else:
        mesh = _mesh(stage, path, *triangles, at)
        # Validators ask for normals of whatever could be drawn.
        _shade(mesh, corner_normals(*triangles, crease=FLAT))
        prim = mesh.GetPrim()
        hull = UsdPhysics.MeshCollisionAPI.Apply(prim)
        hull.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdGeom.Imageable(prim).CreatePurposeAttr(UsdGeom.Tokens.guide)


def _gprim(stage: Usd.Stage, path: Sdf.Path, piece: Piece, at: Pose) -> UsdGeom.Gprim:
    size = [float(v) for v in piece.size]
    scale: list[float] | None = None
    if piece.kind == "box":
        gprim = UsdGeom.Cube.Define(stage, path)
        gprim.CreateSizeAttr(1.0)
        scale = [2 * v for v in size]
    elif piece.kind in ("sphere", "ellipsoid"):
        gprim = UsdGeom.Sphere.Define(stage, path)
        gprim.CreateRadiusAttr(size[0] if piece.kind == "sphere" else 1.0)
        scale = size if piece.kind == "ellipsoid" else None
    elif piece.kind == "capsule":
        gprim = UsdGeom.Capsule.Define(stage, path)
    else:
        gprim = UsdGeom.Cylinder.Define(stage, path)
    if isinstance(gprim, UsdGeom.Capsule | UsdGeom.Cylinder):
        gprim.CreateRadiusAttr(size[0])
        gprim.CreateHeightAttr(2 * size[1])
        gprim.CreateAxisAttr(UsdGeom.Tokens.z)
    set_pose(gprim, at)
    if scale is not None:
        gprim.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*scale))
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(gprim, Usd.TimeCode.Default())
    gprim.CreateExtentAttr(extent)
    return gprim


def _mesh(
    stage: Usd.Stage, path: Sdf.Path, vertices: NDArray, faces: NDArray, at: Pose
) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(_points(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(_points(np.stack([vertices.min(axis=0), vertices.max(axis=0)])))
    set_pose(mesh, at)
    return mesh


def _points(values: NDArray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _add_joint(
    stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec, joint: JointSpec, parent_origin: NDArray
) -> None:
    path = base.AppendChild("joints").AppendChild(joint.name)
    turning = joint.type != "prismatic"
    kind = {
        "fixed": UsdPhysics.FixedJoint,
        "prismatic": UsdPhysics.PrismaticJoint,
        "ball": UsdPhysics.SphericalJoint,
    }
    usd_joint = kind.get(joint.type, UsdPhysics.RevoluteJoint).Define(stage, path)
    add_label(usd_joint.GetPrim(), "purpose", purpose(spec, joint))
    links = base.AppendChild("links")
    usd_joint.CreateBody0Rel().SetTargets([links.AppendChild(joint.parent)])
    usd_joint.CreateBody1Rel().SetTargets([links.AppendChild(joint.child)])
    token, turn = ("X", IDENTITY) if joint.type in ("fixed", "ball") else axis_frame(joint.axis)
    usd_joint.CreateLocalPos0Attr(Gf.Vec3f(*(np.array(joint.pos) - parent_origin).tolist()))
    usd_joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    usd_joint.CreateLocalRot0Attr(quatf(turn))
    usd_joint.CreateLocalRot1Attr(quatf(turn))
    if joint.type == "fixed":
        return
    if joint.type == "ball":
        _add_ball(usd_joint, joint)
        return
    unit = math.degrees(1.0) if turning else 1.0
    usd_joint.CreateAxisAttr(token)
    if joint.type != "continuous":
        usd_joint.CreateLowerLimitAttr(joint.lower * unit)
        usd_joint.CreateUpperLimitAttr(joint.upper * unit)
    prim = usd_joint.GetPrim()
    if joint.stiffness or joint.damping or joint.effort is not None:
        # A drive towards 0 is the spring and damper of the joint itself.
        drive = UsdPhysics.DriveAPI.Apply(prim, "angular" if turning else "linear")
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateTargetPositionAttr(0.0)
        drive.CreateTargetVelocityAttr(0.0)
        drive.CreateStiffnessAttr(joint.stiffness / unit)
        drive.CreateDampingAttr(joint.damping / unit)
        if joint.effort is not None:
            drive.CreateMaxForceAttr(joint.effort)
    _add_losses(prim, joint, "angular" if turning else "linear", unit)
    if joint.mimic is not None:
        _add_mimic(prim, base, spec, joint)


def _add_losses(prim: Usd.Prim, joint: JointSpec, instance: str, unit: float) -> None:
    """Write what UsdPhysics has no attribute for, as Newton and as PhysX want it."""
    newton = {"armature": joint.armature, "friction": joint.friction}
    physx = {
        "armature": joint.armature,
        "staticFrictionEffort": joint.friction,
        "dynamicFrictionEffort": joint.friction,
    }
    if joint.velocity is not None:
        newton["velocityLimit"] = physx["maxJointVelocity"] = joint.velocity * unit
    for api, space, values in (
        ("NewtonJointAPI", "newton", newton),
        (f"PhysxJointAxisAPI:{instance}", f"physxJointAxis:{instance}", physx),
    ):
        if any(values.values()):
            prim.AddAppliedSchema(api)
        for name, value in values.items():
            if value:
                _attribute(prim, f"{space}:{name}", value)


def _add_mimic(prim: Usd.Prim, base: Sdf.Path, spec: ObjectSpec, joint: JointSpec) -> None:
    """Let a joint follow another in Newton (q = c0 + c1 r) and PhysX (q + gear r + offset = 0)."""
    assert joint.mimic is not None
    leader = spec.joint(joint.mimic.joint)
    unit, led = (1.0 if j.type == "prismatic" else math.degrees(1.0) for j in (joint, leader))
    target = base.AppendChild("joints").AppendChild(leader.name)
    offset, factor = joint.mimic.offset * unit, joint.mimic.multiplier * unit / led
    # Neither knows a mimic between turning and sliding joints; the numbers stay for others.
    alike = unit == led
    prim.AddAppliedSchema("NewtonMimicAPI")
    prim.CreateRelationship("newton:mimicJoint", custom=False).SetTargets([target])
    _attribute(prim, "newton:mimicCoef0", offset)
    _attribute(prim, "newton:mimicCoef1", factor)
    prim.CreateAttribute("newton:mimicEnabled", Sdf.ValueTypeNames.Bool, custom=False).Set(alike)
    if alike and leader.type != "fixed":
        # Of a joint with one axis PhysX asks for some name of it, whatever the token of its frame.
        prim.AddAppliedSchema("PhysxMimicJointAPI:rotX")
        space = "physxMimicJoint:rotX"
        prim.CreateRelationship(f"{space}:referenceJoint", custom=False).SetTargets([target])
        axis = prim.CreateAttribute(
            f"{space}:referenceJointAxis", Sdf.ValueTypeNames.Token, custom=False
        )
        axis.Set("rotX")
        _attribute(prim, f"{space}:gearing", -factor)
        _attribute(prim, f"{space}:offset", -offset)


def _add_ball(usd_joint: UsdPhysics.SphericalJoint, joint: JointSpec) -> None:
    """Write the cone that a ball stays in; its twist about +X is not limited in USD."""
    usd_joint.CreateAxisAttr("X")
    cone = math.degrees(joint.upper) if joint.upper > 0 else -1.0
    usd_joint.CreateConeAngle0LimitAttr(cone)
    usd_joint.CreateConeAngle1LimitAttr(cone)
    prim = usd_joint.GetPrim()
    if joint.armature or joint.friction:
        prim.AddAppliedSchema("NewtonJointAPI")
    for name in ("armature", "friction"):
        if getattr(joint, name):
            _attribute(prim, f"newton:{name}", getattr(joint, name))
    # Spherical joints have no drive in UsdPhysics; these are of no one else's schema [N m, rad].
    for name in ("damping", "stiffness"):
        if getattr(joint, name):
            _attribute(prim, f"neoworld:{name}", getattr(joint, name))


def _attribute(prim: Usd.Prim, name: str, value: float) -> None:
    prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=False).Set(value)


def axis_frame(axis: tuple[float, float, float]) -> tuple[str, tuple[float, ...]]:
    """Return a UsdPhysics axis token and the rotation (w, x, y, z) that takes it to `axis`."""
    token = _AXES.get((float(axis[0]), float(axis[1]), float(axis[2])))
    if token is not None:
        return token, IDENTITY
    x = np.array([1.0, 0.0, 0.0])
    a = np.array(axis)
    if a[0] < -1 + 1e-12:
        return "X", (0.0, 0.0, 0.0, 1.0)
    quat = np.array([1.0 + x @ a, *np.cross(x, a)])
    return "X", tuple((quat / np.linalg.norm(quat)).tolist())


def _filter_pairs(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Keep what is fixed to either side of a joint from colliding, as the MuJoCo model does."""
    group = welded(spec)
    jointed = {(joint.parent, joint.child) for joint in spec.joints}
    links = base.AppendChild("links")
    for joint in spec.joints:
        for a in spec.parts:
            others = [
                b.name
                for b in spec.parts
                if group[a.name] == group[joint.parent]
                and group[b.name] == group[joint.child]
                and group[a.name] != group[b.name]
                and (a.name, b.name) not in jointed
            ]
            if others:
                prim = stage.GetPrimAtPath(links.AppendChild(a.name))
                pairs = UsdPhysics.FilteredPairsAPI.Apply(prim).CreateFilteredPairsRel()
                for other in others:
                    pairs.AddTarget(links.AppendChild(other))

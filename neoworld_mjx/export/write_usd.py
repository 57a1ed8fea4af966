"""Writes USD of one object, with UsdPhysics.

    /<object>                the object's frame; articulation root if it has joints
    /<object>/links/<part>   rigid body, with the link frame of `link_frames`
        visuals/<geom>  collisions/<geom>_<k> (guides)  sites/<site or handle>
    /<object>/joints/<joint>   /<object>/looks/<material>

A joint axis other than +X, +Y or +Z is written as +X with local rotations, so readers must not use
the axis token alone. UsdPhysics uses degrees in limits and in the stiffness and damping of drives.

Armature, dry friction, velocity limits and mimic joints are written in two equivalent schemas:
Newton's (newton-usd-schemas) and PhysX's (for Isaac Sim). Both schemas use degrees. A ball joint
becomes a spherical joint with a cone limit; the damping and stiffness of the ball joint are custom
attributes, in radians.

With Newton's default settings, a settled cup sinks by millimeters: contacts are detected at
distances of up to 10 cm, and joint limits are soft. Colliders therefore state the distance, and
joints the stiffness of their limits for Newton's MuJoCo solver (`mjc:` attributes).

A textured material also states its plain color, which the connection to the texture overrides.

Semantic labels state the class of the object and the names of its parts and materials.
"""

import math

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade, Vt

from ..render.appearance import linear
from ..spec import GeomSpec, JointSpec, Material, ObjectSpec, PartSpec, inertial
from ..spec.convex import Piece
from ..spec.finish import finish
from ..spec.pose import IDENTITY, Pose, pose
from ..spec.triangles import corner_normals
from .link_frames import Frame, frames, link_origins, unjoined_pairs
from .write_glb import is_textured, piece_mesh, texture_file, visible_surface

_AXES = {(1.0, 0.0, 0.0): "X", (0.0, 1.0, 0.0): "Y", (0.0, 0.0, 1.0): "Z"}
NEWTON_GAP_M = 0.002
"""Distance below which Newton detects contacts [m]."""
LIMIT_SOLREF = (0.02, 1.0)
"""Time constant [s] and damping ratio of joint limits; the values are MuJoCo's defaults."""
FLAT = 1e-3
"""Angle between two faces of a collider above which normals are split at the common edge [rad]."""


def usd_layer(spec: ObjectSpec) -> Sdf.Layer:
    """Return an object with all joints at zero as a USD layer."""
    stage = new_stage()
    root = UsdGeom.Xform.Define(stage, f"/{spec.name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    if spec.label:
        root.GetPrim().SetDisplayName(spec.label)
    add_label(root.GetPrim(), "class", spec.label or spec.name)
    if spec.joints:
        UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    base = root.GetPath()
    UsdGeom.Scope.Define(stage, base.AppendChild("looks"))
    textured = {g.material for part in spec.parts for g in part.geoms if is_textured(spec, g)}
    for material in spec.materials:
        add_material(stage, base, material, textured=material.name in textured)
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
    # The root layer expires with the stage, so its content is copied.
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    return layer


def new_stage() -> Usd.Stage:
    """Return an empty stage with units of meters and kilograms and with Z up."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    return stage


def set_pose(xform: UsdGeom.Xformable, local: Pose) -> None:
    """Set the pose of a prim in its parent's frame."""
    xform.ClearXformOpOrder()
    xform.AddTranslateOp().Set(Gf.Vec3d(*map(float, local.pos)))
    xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(quatd(local.quat))


def quatd(quat: NDArray | tuple[float, ...]) -> Gf.Quatd:
    """Convert a quaternion (w, x, y, z) to a USD quaternion in double precision."""
    w, x, y, z = map(float, quat)
    return Gf.Quatd(w, x, y, z)


def quatf(quat: NDArray | tuple[float, ...]) -> Gf.Quatf:
    """Convert a quaternion (w, x, y, z) to a USD quaternion in single precision."""
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
            bind_material(stage, folder.AppendChild(geom.name), base, material, physical=False)
        if geom.role != "visual":
            folder = UsdGeom.Scope.Define(stage, path.AppendChild("collisions")).GetPath()
            for k, piece in enumerate(geom.shape.pieces()):
                collider = folder.AppendChild(f"{geom.name}_{k}")
                piece_pose = local.then(pose(piece.pos, piece.quat))
                _add_collider(stage, collider, piece, piece_pose)
                bind_material(stage, collider, base, material, physical=True)
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
    local: Pose,
) -> None:
    primitive = geom.shape.primitive()
    if primitive is not None and not is_textured(spec, geom):
        _gprim(stage, path, primitive, local)
        return
    vertices, faces, uv = visible_surface(spec, part.name, geom)
    mesh = _mesh(stage, path, vertices, faces, local)
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


def _add_collider(stage: Usd.Stage, path: Sdf.Path, piece: Piece, local: Pose) -> None:
    triangles = piece_mesh(piece)
    if triangles is None:
        prim = _gprim(stage, path, piece, local).GetPrim()
    else:
        mesh = _mesh(stage, path, *triangles, local)
        # USD validators require normals for each mesh.
        _shade(mesh, corner_normals(*triangles, crease=FLAT))
        prim = mesh.GetPrim()
        hull = UsdPhysics.MeshCollisionAPI.Apply(prim)
        hull.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    UsdPhysics.CollisionAPI.Apply(prim)
    prim.AddAppliedSchema("NewtonCollisionAPI")
    set_float(prim, "newton:contactGap", NEWTON_GAP_M)
    UsdGeom.Imageable(prim).CreatePurposeAttr(UsdGeom.Tokens.guide)


def _gprim(stage: Usd.Stage, path: Sdf.Path, piece: Piece, local: Pose) -> UsdGeom.Gprim:
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
    set_pose(gprim, local)
    if scale is not None:
        gprim.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*scale))
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(gprim, Usd.TimeCode.Default())
    gprim.CreateExtentAttr(extent)
    return gprim


def _mesh(
    stage: Usd.Stage, path: Sdf.Path, vertices: NDArray, faces: NDArray, local: Pose
) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(_points(vertices))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel().astype(np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(_points(np.stack([vertices.min(axis=0), vertices.max(axis=0)])))
    set_pose(mesh, local)
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
    prim = usd_joint.GetPrim()
    if joint.type != "continuous":
        usd_joint.CreateLowerLimitAttr(joint.lower * unit)
        usd_joint.CreateUpperLimitAttr(joint.upper * unit)
        solref = prim.CreateAttribute(
            "mjc:solreflimit", Sdf.ValueTypeNames.DoubleArray, custom=False
        )
        solref.Set(Vt.DoubleArray(LIMIT_SOLREF))
    if joint.stiffness or joint.damping or joint.effort is not None:
        # UsdPhysics models the spring and damper of a joint as a drive whose target is 0.
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
    """Write a joint's armature, dry friction and velocity limit in Newton's and PhysX's schemas."""
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
                set_float(prim, f"{space}:{name}", value)


def _add_mimic(prim: Usd.Prim, base: Sdf.Path, spec: ObjectSpec, joint: JointSpec) -> None:
    """Write a mimic joint for Newton (q = c0 + c1 r) and PhysX (q + gear r + offset = 0)."""
    assert joint.mimic is not None
    leader = spec.joint(joint.mimic.joint)
    unit, leader_unit = (
        1.0 if j.type == "prismatic" else math.degrees(1.0) for j in (joint, leader)
    )
    target = base.AppendChild("joints").AppendChild(leader.name)
    offset, factor = joint.mimic.offset * unit, joint.mimic.multiplier * unit / leader_unit
    # Neither supports mimics between hinges and slides; other readers may use the coefficients.
    alike = unit == leader_unit
    prim.AddAppliedSchema("NewtonMimicAPI")
    prim.CreateRelationship("newton:mimicJoint", custom=False).SetTargets([target])
    set_float(prim, "newton:mimicCoef0", offset)
    set_float(prim, "newton:mimicCoef1", factor)
    prim.CreateAttribute("newton:mimicEnabled", Sdf.ValueTypeNames.Bool, custom=False).Set(alike)
    if alike and leader.type != "fixed":
        # PhysX requires an axis name, which it ignores for joints with one axis.
        prim.AddAppliedSchema("PhysxMimicJointAPI:rotX")
        space = "physxMimicJoint:rotX"
        prim.CreateRelationship(f"{space}:referenceJoint", custom=False).SetTargets([target])
        axis = prim.CreateAttribute(
            f"{space}:referenceJointAxis", Sdf.ValueTypeNames.Token, custom=False
        )
        axis.Set("rotX")
        set_float(prim, f"{space}:gearing", -factor)
        set_float(prim, f"{space}:offset", -offset)


def _add_ball(usd_joint: UsdPhysics.SphericalJoint, joint: JointSpec) -> None:
    """Write the cone limit of a ball joint; USD cannot limit the joint's twist about +X."""
    usd_joint.CreateAxisAttr("X")
    cone = math.degrees(joint.upper) if joint.upper > 0 else -1.0
    usd_joint.CreateConeAngle0LimitAttr(cone)
    usd_joint.CreateConeAngle1LimitAttr(cone)
    prim = usd_joint.GetPrim()
    if joint.armature or joint.friction:
        prim.AddAppliedSchema("NewtonJointAPI")
    # UsdPhysics has no drives for spherical joints, so these attributes are custom [N m, rad].
    for name in ("newton:armature", "newton:friction", "neoworld:damping", "neoworld:stiffness"):
        if value := getattr(joint, name.partition(":")[2]):
            set_float(prim, name, value)


def set_float(prim: Usd.Prim, name: str, value: float) -> None:
    """Set an attribute of an applied schema, in single precision."""
    prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=False).Set(value)


def axis_frame(axis: tuple[float, float, float]) -> tuple[str, tuple[float, ...]]:
    """Return a UsdPhysics axis token and the quaternion that rotates the token's axis to `axis`."""
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
    """Filter collisions between parts that are welded to the two sides of a joint, as in MJCF."""
    links = base.AppendChild("links")
    for first, second in unjoined_pairs(spec):
        prim = stage.GetPrimAtPath(links.AppendChild(first))
        pairs = UsdPhysics.FilteredPairsAPI.Apply(prim).CreateFilteredPairsRel()
        pairs.AddTarget(links.AppendChild(second))


PRINT_NOTE = "window of the photograph, with its light, projected on what faced the camera"


def add_material(stage: Usd.Stage, base: Sdf.Path, material: Material, *, textured: bool) -> None:
    """Define a material, for rendering and for physics, below the prim `looks` of an object.

    Args:
        stage: the stage.
        base: path of the object.
        material: the material.
        textured: if True, the object has a texture file for the material.
    """
    path = base.AppendChild("looks").AppendChild(material.name)
    look = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(_color(material))
    surface = finish(material)
    if material.photo is not None:
        look.GetPrim().SetCustomDataByKey("neoworld:print", PRINT_NOTE)
    if textured:
        _add_texture(stage, path, diffuse, material)
    shader.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(material.rgba[3])
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(surface.metallic)
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(surface.roughness)
    look.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    physics = UsdPhysics.MaterialAPI.Apply(look.GetPrim())
    physics.CreateStaticFrictionAttr(material.friction)
    physics.CreateDynamicFrictionAttr(material.friction)
    physics.CreateRestitutionAttr(0.0)
    physics.CreateDensityAttr(material.density)
    add_label(look.GetPrim(), "material", material.name)


def add_label(prim: Usd.Prim, kind: str, *labels: str) -> None:
    """Add semantic labels to a prim."""
    UsdSemantics.LabelsAPI.Apply(prim, kind).CreateLabelsAttr().Set(Vt.TokenArray(list(labels)))


def _add_texture(
    stage: Usd.Stage, path: Sdf.Path, diffuse: UsdShade.Input, material: Material
) -> None:
    """Connect the input of a color to a material's texture, which repeats if it is a pattern."""
    reader = UsdShade.Shader.Define(stage, path.AppendChild("coordinates"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    result = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture = UsdShade.Shader.Define(stage, path.AppendChild("texture"))
    texture.CreateIdAttr("UsdUVTexture")
    file = Sdf.AssetPath(f"./{texture_file(material)}")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    for edge in ("wrapS", "wrapT"):
        texture.CreateInput(edge, Sdf.ValueTypeNames.Token).Set(
            "repeat" if material.photo is None else "clamp"
        )
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(result)
    diffuse.ConnectToSource(texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))


def bind_material(
    stage: Usd.Stage, path: Sdf.Path, base: Sdf.Path, material: Material, *, physical: bool
) -> None:
    """Bind a material to a prim; if `physical`, bind the material only for physics."""
    prim = stage.GetPrimAtPath(path)
    look = UsdShade.Material.Get(stage, base.AppendChild("looks").AppendChild(material.name))
    UsdGeom.Gprim(prim).CreateDisplayColorAttr(Vt.Vec3fArray([_color(material)]))
    if material.rgba[3] < 1:
        UsdGeom.Gprim(prim).CreateDisplayOpacityAttr(Vt.FloatArray([material.rgba[3]]))
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    if physical:
        binding.Bind(look, UsdShade.Tokens.weakerThanDescendants, "physics")
    else:
        binding.Bind(look)


def _color(material: Material) -> Gf.Vec3f:
    """Return the color of a material in linear light."""
    return Gf.Vec3f(*np.round(linear(np.array(material.rgba[:3])), 6).tolist())

"""USD layers with settings for Newton and Isaac Sim, composed over a scene or an object.

With Newton's default settings, a settled cup sinks by millimeters:

- contacts are detected at distances of up to 10 cm, and they displace contacts that touch;
- each pair of convex pieces has one contact point;
- friction and joint limits are soft.

The `mjc:` attributes are for Newton's MuJoCo solver. Before you load the file, register these
attributes with `newton.solvers.SolverMuJoCo.register_custom_attributes(builder)`. Newton reads
joint positions only from `newton:` attributes.

The layer for Isaac Sim contains PhysX settings. It

- sets a contact offset of 2 mm;
- combines two friction coefficients by their maximum (the default of PhysX is the mean);
- disables angular damping (the default is 5 %);
- increases the number of solver iterations;
- disables sleeping and stabilization by thresholds of zero;
- preserves convex hulls of up to 64 vertices exactly;
- sets the position of each joint;
- makes the joint that fixes an object in the world the object's articulation root.

`PhysxJointAPI` is for versions of Isaac Sim before 5. `contactOffset` is for versions that do not
read `newton:contactGap`.
"""

import math
from collections.abc import Iterator

from pxr import Sdf, Usd, Vt

from ..physics.mjcf import IMPRATIO
from ..spec import JointSpec, ObjectSpec, SceneObject, SceneSpec, joint_value
from ..spec.convex import Piece
from .write_scene_usd import fixture_path, physics_path, remove_schemas
from .write_usd import new_stage, set_float

GAP_M = 0.002
"""Distance below which contacts are detected [m]."""
SOLREF = (0.02, 1.0)
"""Time constant [s] and damping ratio of joint limits; the values are MuJoCo's defaults."""


def _opened_layer(described: SceneSpec | ObjectSpec) -> tuple[Usd.Stage, Sdf.Path]:
    """Return an empty layer for a scene or an object, and the path of the layer's default prim."""
    stage = new_stage()
    base = Sdf.Path(f"/{described.name}")
    stage.SetDefaultPrim(stage.OverridePrim(base))
    return stage, base


def newton_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as USDA text.

    Args:
        described: the scene or object.
        file: name of the USD file in the same folder that the layer overrides, for example
            "scene.usdc".
    """
    stage, base = _opened_layer(described)
    if isinstance(described, SceneSpec):
        settings = stage.OverridePrim(physics_path(described))
        for name, kind, value in (
            ("mjc:option:cone", Sdf.ValueTypeNames.Token, "elliptic"),
            ("mjc:option:impratio", Sdf.ValueTypeNames.Double, IMPRATIO),
            ("mjc:flag:multiccd", Sdf.ValueTypeNames.Bool, True),
        ):
            settings.CreateAttribute(name, kind, custom=False).Set(value)
    for path, item in _placed_objects(described, base):
        _add_gaps(stage, path, item.spec)
        _add_stops(stage, path, item.spec)
        if isinstance(described, SceneSpec) and _moves(item):
            _add_states(stage, path, item.spec, item.joint_state)
    return _override_text(stage, file)


def _placed_objects(
    described: SceneSpec | ObjectSpec, base: Sdf.Path
) -> list[tuple[Sdf.Path, SceneObject]]:
    """Return the objects of a scene, or a single object, with the paths of their prims."""
    if isinstance(described, ObjectSpec):
        return [(base, SceneObject(name=described.name, spec=described))]
    return [(base.AppendChild(item.name), item) for item in described.objects]


def _moves(item: SceneObject) -> bool:
    """Return True if an object or one of its parts can move."""
    return not item.static or any(joint.type != "fixed" for joint in item.spec.joints)


def _override_text(stage: Usd.Stage, file: str) -> str:
    """Return the USDA text of a layer that overrides a file in the same folder."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    layer.subLayerPaths.append(f"./{file}")
    return layer.ExportToString()


def _collider_paths(base: Sdf.Path, spec: ObjectSpec) -> Iterator[tuple[Sdf.Path, Piece]]:
    """Yield the path and the convex piece of each collider of the object at `base`."""
    for part in spec.parts:
        folder = base.AppendPath(f"links/{part.name}/collisions")
        for geom in part.geoms:
            if geom.role != "visual":
                for k, piece in enumerate(geom.shape.pieces()):
                    yield folder.AppendChild(f"{geom.name}_{k}"), piece


def _add_gaps(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Set the contact gap of all colliders of the object at `base`."""
    for path, _ in _collider_paths(base, spec):
        prim = stage.OverridePrim(path)
        prim.AddAppliedSchema("NewtonCollisionAPI")
        set_float(prim, "newton:contactGap", GAP_M)


def _add_stops(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Make joint limits as stiff as in MuJoCo; Newton's default limits yield by centimeters."""
    for joint in spec.joints:
        if joint.type in ("prismatic", "revolute"):
            prim = stage.OverridePrim(base.AppendPath(f"joints/{joint.name}"))
            kind = Sdf.ValueTypeNames.DoubleArray
            prim.CreateAttribute("mjc:solreflimit", kind, custom=False).Set(Vt.DoubleArray(SOLREF))


def _add_states(
    stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec, joint_state: dict[str, float]
) -> None:
    for joint in spec.joints:
        if joint.type in ("fixed", "ball"):
            continue
        value = joint_value(spec, joint, joint_state)
        if value != 0.0:
            sliding = joint.type == "prismatic"
            prim = stage.OverridePrim(base.AppendPath(f"joints/{joint.name}"))
            name = "newton:linear:position" if sliding else "newton:angular:position"
            set_float(prim, name, value if sliding else math.degrees(value))


POSITION_ITERATIONS, VELOCITY_ITERATIONS = 64, 4
"""Numbers of position and velocity iterations of the PhysX solver."""
STEPS_PER_SECOND = 240
HULL_VERTICES = 64
"""Maximum number of vertices of a convex hull; PhysX simplifies larger hulls."""
_KINDS = {bool: Sdf.ValueTypeNames.Bool, int: Sdf.ValueTypeNames.Int, str: Sdf.ValueTypeNames.Token}


def isaac_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as USDA text.

    Args:
        described: the scene or object.
        file: name of the USD file in the same folder that the layer overrides, for example
            "scene.usdc".
    """
    stage, base = _opened_layer(described)
    if isinstance(described, SceneSpec):
        settings = stage.OverridePrim(physics_path(described))
        settings.AddAppliedSchema("PhysxSceneAPI")
        rate = settings.CreateAttribute(
            "physxScene:timeStepsPerSecond", Sdf.ValueTypeNames.UInt, custom=False
        )
        rate.Set(STEPS_PER_SECOND)
        _set(settings, "physxScene:enableStabilization", False)
    for path, item in _placed_objects(described, base):
        fixture = fixture_path(described, item) if isinstance(described, SceneSpec) else None
        _add_object(stage, path, item, fixture)
    return _override_text(stage, file)


def _add_object(
    stage: Usd.Stage, base: Sdf.Path, item: SceneObject, fixture: Sdf.Path | None
) -> None:
    spec = item.spec
    _add_gaps(stage, base, spec)
    for path, piece in _collider_paths(base, spec):
        prim = stage.OverridePrim(path)
        prim.AddAppliedSchema("PhysxCollisionAPI")
        set_float(prim, "physxCollision:contactOffset", GAP_M)
        set_float(prim, "physxCollision:restOffset", 0.0)
        if piece.kind == "mesh":
            prim.AddAppliedSchema("PhysxConvexHullCollisionAPI")
            _set(prim, "physxConvexHullCollision:hullVertexLimit", HULL_VERTICES)
    for material in spec.materials:
        prim = stage.OverridePrim(base.AppendPath(f"looks/{material.name}"))
        prim.AddAppliedSchema("PhysxMaterialAPI")
        _set(prim, "physxMaterial:frictionCombineMode", "max")
    if not _moves(item):
        return
    for part in spec.parts:
        prim = stage.OverridePrim(base.AppendPath(f"links/{part.name}"))
        prim.AddAppliedSchema("PhysxRigidBodyAPI")
        set_float(prim, "physxRigidBody:angularDamping", 0.0)
        _add_solver(prim, "physxRigidBody")
    if spec.joints:
        root = stage.OverridePrim(base)
        if fixture is not None:
            # The root of a fixed articulation is the joint that fixes it in the world.
            remove_schemas(root, "PhysicsArticulationRootAPI")
            root = stage.OverridePrim(fixture)
            root.AddAppliedSchema("PhysicsArticulationRootAPI")
        root.AddAppliedSchema("PhysxArticulationAPI")
        _set(root, "physxArticulation:enabledSelfCollisions", True)
        _add_solver(root, "physxArticulation")
    for joint in spec.joints:
        if joint.type not in ("fixed", "ball"):
            path = base.AppendPath(f"joints/{joint.name}")
            _add_joint(stage.OverridePrim(path), joint, joint_value(spec, joint, item.joint_state))


def _add_solver(prim: Usd.Prim, space: str) -> None:
    _set(prim, f"{space}:solverPositionIterationCount", POSITION_ITERATIONS)
    _set(prim, f"{space}:solverVelocityIterationCount", VELOCITY_ITERATIONS)
    for name in ("sleepThreshold", "stabilizationThreshold"):
        set_float(prim, f"{space}:{name}", 0.0)


def _add_joint(prim: Usd.Prim, joint: JointSpec, value: float) -> None:
    prismatic = joint.type == "prismatic"
    instance, unit = ("linear", 1.0) if prismatic else ("angular", math.degrees(1.0))
    prim.AddAppliedSchema(f"PhysicsJointStateAPI:{instance}")
    set_float(prim, f"state:{instance}:physics:position", value * unit)
    set_float(prim, f"state:{instance}:physics:velocity", 0.0)
    prim.AddAppliedSchema("PhysxJointAPI")
    # jointFriction is relative to the joint's load; PhysxJointAxisAPI has dry friction in N.
    set_float(prim, "physxJoint:jointFriction", 0.0)
    set_float(prim, "physxJoint:armature", joint.armature)
    if joint.velocity is not None:
        set_float(prim, "physxJoint:maxJointVelocity", joint.velocity * unit)


def _set(prim: Usd.Prim, name: str, value: bool | int | str) -> None:
    prim.CreateAttribute(name, _KINDS[type(value)], custom=False).Set(value)

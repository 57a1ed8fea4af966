"""A USD layer over a scene or an object that says to PhysX, as in Isaac, what MJCF says to MuJoCo.

Beside the file below it, whose attributes stay: contacts from 2 mm on, the greater of two frictions
(PhysX takes the mean), no damping of turning bodies (5 % by default), more iterations, no threshold
below which bodies sleep or are stabilised, whole hulls, a state of every joint, and an articulation
root at the joint that holds an object in the world. `PhysxJointAPI` is for Isaac before 5;
`contactOffset` besides, where `newton:contactGap` is not read yet.
"""

import math

from pxr import Sdf, Usd

from ..spec import JointSpec, ObjectSpec, SceneObject, SceneSpec, joint_value
from .newton_layer import GAP_M, add_gaps, collider_paths, laid_over, opened_layer, set_number
from .write_scene_usd import fixture_path, physics_path

POSITION_ITERATIONS, VELOCITY_ITERATIONS = 64, 4
"""Of PhysX's solver."""
STEPS_PER_SECOND = 240
HULL_VERTICES = 64
"""As many as PhysX takes; it simplifies hulls with more."""
_KINDS = {bool: Sdf.ValueTypeNames.Bool, int: Sdf.ValueTypeNames.Int, str: Sdf.ValueTypeNames.Token}


def isaac_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as text.

    Args:
        described: the scene or object.
        file: the USD file beside it that the layer lies over, such as "scene.usdc".
    """
    stage, base = opened_layer(described)
    if isinstance(described, ObjectSpec):
        _add_object(stage, base, SceneObject(name=described.name, spec=described), None)
        return laid_over(stage, file)
    settings = stage.OverridePrim(physics_path(described))
    settings.AddAppliedSchema("PhysxSceneAPI")
    count = settings.CreateAttribute(
        "physxScene:timeStepsPerSecond", Sdf.ValueTypeNames.UInt, custom=False
    )
    count.Set(STEPS_PER_SECOND)
    _set(settings, "physxScene:enableStabilization", False)
    for item in described.objects:
        _add_object(stage, base.AppendChild(item.name), item, fixture_path(described, item))
    return laid_over(stage, file)


def _add_object(
    stage: Usd.Stage, base: Sdf.Path, item: SceneObject, fixture: Sdf.Path | None
) -> None:
    spec = item.spec
    add_gaps(stage, base, spec)
    for path, piece in collider_paths(base, spec):
        prim = stage.OverridePrim(path)
        prim.AddAppliedSchema("PhysxCollisionAPI")
        set_number(prim, "physxCollision:contactOffset", GAP_M)
        set_number(prim, "physxCollision:restOffset", 0.0)
        if piece.kind == "mesh":
            prim.AddAppliedSchema("PhysxConvexHullCollisionAPI")
            _set(prim, "physxConvexHullCollision:hullVertexLimit", HULL_VERTICES)
    for material in spec.materials:
        prim = stage.OverridePrim(base.AppendPath(f"looks/{material.name}"))
        prim.AddAppliedSchema("PhysxMaterialAPI")
        _set(prim, "physxMaterial:frictionCombineMode", "max")
    if item.static and all(joint.type == "fixed" for joint in spec.joints):
        return
    for part in spec.parts:
        prim = stage.OverridePrim(base.AppendPath(f"links/{part.name}"))
        prim.AddAppliedSchema("PhysxRigidBodyAPI")
        set_number(prim, "physxRigidBody:angularDamping", 0.0)
        _add_solver(prim, "physxRigidBody")
    if spec.joints:
        root = stage.OverridePrim(base)
        if fixture is not None:
            # An articulation that is held has its root at the joint to the world.
            removed = Sdf.TokenListOp()
            removed.deletedItems = ["PhysicsArticulationRootAPI"]
            root.SetMetadata("apiSchemas", removed)
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
        set_number(prim, f"{space}:{name}", 0.0)


def _add_joint(prim: Usd.Prim, joint: JointSpec, value: float) -> None:
    sliding = joint.type == "prismatic"
    instance, unit = ("linear", 1.0) if sliding else ("angular", math.degrees(1.0))
    prim.AddAppliedSchema(f"PhysicsJointStateAPI:{instance}")
    set_number(prim, f"state:{instance}:physics:position", value * unit)
    set_number(prim, f"state:{instance}:physics:velocity", 0.0)
    prim.AddAppliedSchema("PhysxJointAPI")
    # A coefficient of the load; dry friction in N is at the joint's axis.
    set_number(prim, "physxJoint:jointFriction", 0.0)
    set_number(prim, "physxJoint:armature", joint.armature)
    if joint.velocity is not None:
        set_number(prim, "physxJoint:maxJointVelocity", joint.velocity * unit)


def _set(prim: Usd.Prim, name: str, value: bool | int | str) -> None:
    prim.CreateAttribute(name, _KINDS[type(value)], custom=False).Set(value)

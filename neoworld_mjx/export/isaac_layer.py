"""USD layer with PhysX settings for Isaac Sim, which is composed over a scene or an object.

The layer

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

from pxr import Sdf, Usd

from ..spec import JointSpec, ObjectSpec, SceneObject, SceneSpec, joint_value
from .newton_layer import (
    GAP_M,
    add_gaps,
    collider_paths,
    moves,
    opened_layer,
    override_text,
    placed_objects,
)
from .write_scene_usd import fixture_path, physics_path, remove_schemas
from .write_usd import set_float

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
    stage, base = opened_layer(described)
    if isinstance(described, SceneSpec):
        settings = stage.OverridePrim(physics_path(described))
        settings.AddAppliedSchema("PhysxSceneAPI")
        rate = settings.CreateAttribute(
            "physxScene:timeStepsPerSecond", Sdf.ValueTypeNames.UInt, custom=False
        )
        rate.Set(STEPS_PER_SECOND)
        _set(settings, "physxScene:enableStabilization", False)
    for path, item in placed_objects(described, base):
        fixture = fixture_path(described, item) if isinstance(described, SceneSpec) else None
        _add_object(stage, path, item, fixture)
    return override_text(stage, file)


def _add_object(
    stage: Usd.Stage, base: Sdf.Path, item: SceneObject, fixture: Sdf.Path | None
) -> None:
    spec = item.spec
    add_gaps(stage, base, spec)
    for path, piece in collider_paths(base, spec):
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
    if not moves(item):
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

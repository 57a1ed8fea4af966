"""USD layer with settings for Newton, composed over a scene or an object.

With Newton's default settings, a settled cup sinks by millimeters:

- contacts are detected at distances of up to 10 cm, and they displace contacts that touch;
- each pair of convex pieces has one contact point;
- friction and joint limits are soft.

The `mjc:` attributes are for Newton's MuJoCo solver. Before you load the file, register these
attributes with `newton.solvers.SolverMuJoCo.register_custom_attributes(builder)`. Newton reads
joint positions only from `newton:` attributes.
"""

import math

from pxr import Sdf, Usd, Vt

from ..physics.mjcf import IMPRATIO
from ..spec import ObjectSpec, SceneObject, SceneSpec, joint_value
from .write_scene_usd import physics_path
from .write_usd import new_stage, set_float

GAP_M = 0.002
"""Distance below which contacts are detected [m]."""
SOLREF = (0.02, 1.0)
"""Time constant [s] and damping ratio of joint limits; the values are MuJoCo's defaults."""


def newton_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as USDA text.

    Args:
        described: the scene or object.
        file: name of the USD file in the same folder that the layer overrides, for example
            "scene.usdc".
    """
    stage = new_stage()
    base = Sdf.Path(f"/{described.name}")
    stage.SetDefaultPrim(stage.OverridePrim(base))
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
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    layer.subLayerPaths.append(f"./{file}")
    return layer.ExportToString()


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


def _add_gaps(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Set the contact gap of all colliders of the object at `base`."""
    for part in spec.parts:
        folder = base.AppendPath(f"links/{part.name}/collisions")
        for geom in part.geoms:
            for k in range(0 if geom.role == "visual" else len(geom.shape.pieces())):
                prim = stage.OverridePrim(folder.AppendChild(f"{geom.name}_{k}"))
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

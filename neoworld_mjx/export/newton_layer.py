"""A USD layer over a scene or an object that says to Newton what MJCF says to MuJoCo.

Newton's own defaults let a resting cup sink by millimetres: it looks for contacts up to 10 cm away,
which crowds out those that touch, takes one point a pair of convex pieces, and has soft friction.
The `mjc:` attributes are for its MuJoCo solver; register them before reading:
`newton.solvers.SolverMuJoCo.register_custom_attributes(builder)`. Newton reads joint states only in
its own words.
"""

import math

from pxr import Sdf, Usd

from ..spec import ObjectSpec, SceneSpec, joint_value
from .write_mjcf import IMPRATIO
from .write_scene_usd import physics_path
from .write_usd import new_stage

GAP_M = 0.002
"""Distance [m] from which on contacts are looked for."""


def newton_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as text.

    Args:
        described: the scene or object.
        file: the USD file beside it that the layer lies over, such as "scene.usdc".
    """
    stage = new_stage()
    base = Sdf.Path(f"/{described.name}")
    stage.SetDefaultPrim(stage.OverridePrim(base))
    if isinstance(described, ObjectSpec):
        _add_gaps(stage, base, described)
    else:
        settings = stage.OverridePrim(physics_path(described))
        for name, kind, value in (
            ("mjc:option:cone", Sdf.ValueTypeNames.Token, "elliptic"),
            ("mjc:option:impratio", Sdf.ValueTypeNames.Double, IMPRATIO),
            ("mjc:flag:multiccd", Sdf.ValueTypeNames.Bool, True),
        ):
            settings.CreateAttribute(name, kind, custom=False).Set(value)
        for item in described.objects:
            path = base.AppendChild(item.name)
            _add_gaps(stage, path, item.spec)
            if not (item.static and all(joint.type == "fixed" for joint in item.spec.joints)):
                _add_states(stage, path, item.spec, item.joint_state)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    layer.subLayerPaths.append(f"./{file}")
    return layer.ExportToString()


def _add_gaps(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    for part in spec.parts:
        folder = base.AppendPath(f"links/{part.name}/collisions")
        for geom in part.geoms:
            if geom.role == "visual":
                continue
            for k in range(len(geom.shape.pieces())):
                prim = stage.OverridePrim(folder.AppendChild(f"{geom.name}_{k}"))
                prim.AddAppliedSchema("NewtonCollisionAPI")
                _set(prim, "newton:contactGap", GAP_M)


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
            _set(prim, name, value if sliding else math.degrees(value))


def _set(prim: Usd.Prim, name: str, value: float) -> None:
    prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=False).Set(value)

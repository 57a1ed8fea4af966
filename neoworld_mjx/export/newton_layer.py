"""A USD layer over a scene or an object that says to Newton what MJCF says to MuJoCo.

Newton's own defaults let a resting cup sink by millimetres: it looks for contacts up to 10 cm away,
which crowds out those that touch, takes one point a pair of convex pieces, and has soft friction
and soft stops of joints.
The `mjc:` attributes are for its MuJoCo solver; register them before reading:
`newton.solvers.SolverMuJoCo.register_custom_attributes(builder)`. Newton reads joint states only in
its own words.
"""

import math
from collections.abc import Iterator

from pxr import Sdf, Usd, Vt

from ..spec import ObjectSpec, SceneSpec, joint_value
from ..spec.convex import Piece
from .write_mjcf import IMPRATIO
from .write_scene_usd import physics_path
from .write_usd import new_stage

GAP_M = 0.002
"""Distance [m] from which on contacts are looked for."""
SOLREF = (0.02, 1.0)
"""Time constant [s] and damping ratio of a joint's ends: MuJoCo's default."""


def opened_layer(described: SceneSpec | ObjectSpec) -> tuple[Usd.Stage, Sdf.Path]:
    """Return an empty layer over a scene or object, and the path of its default prim."""
    stage = new_stage()
    base = Sdf.Path(f"/{described.name}")
    stage.SetDefaultPrim(stage.OverridePrim(base))
    return stage, base


def newton_text(described: SceneSpec | ObjectSpec, file: str) -> str:
    """Return the layer as text.

    Args:
        described: the scene or object.
        file: the USD file beside it that the layer lies over, such as "scene.usdc".
    """
    stage, base = opened_layer(described)
    if isinstance(described, ObjectSpec):
        add_gaps(stage, base, described)
        _add_stops(stage, base, described)
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
            add_gaps(stage, path, item.spec)
            _add_stops(stage, path, item.spec)
            if not (item.static and all(joint.type == "fixed" for joint in item.spec.joints)):
                _add_states(stage, path, item.spec, item.joint_state)
    return laid_over(stage, file)


def laid_over(stage: Usd.Stage, file: str) -> str:
    """Return a stage of overrides as the text of a layer over a file beside it."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    layer.subLayerPaths.append(f"./{file}")
    return layer.ExportToString()


def collider_paths(base: Sdf.Path, spec: ObjectSpec) -> Iterator[tuple[Sdf.Path, Piece]]:
    """Yield the path of every collider of an object at `base`, and its convex piece."""
    for part in spec.parts:
        folder = base.AppendPath(f"links/{part.name}/collisions")
        for geom in part.geoms:
            if geom.role != "visual":
                for k, piece in enumerate(geom.shape.pieces()):
                    yield folder.AppendChild(f"{geom.name}_{k}"), piece


def add_gaps(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Let contacts of an object at `base` be looked for from `GAP_M` on."""
    for path, _ in collider_paths(base, spec):
        prim = stage.OverridePrim(path)
        prim.AddAppliedSchema("NewtonCollisionAPI")
        set_number(prim, "newton:contactGap", GAP_M)


def _add_stops(stage: Usd.Stage, base: Sdf.Path, spec: ObjectSpec) -> None:
    """Make the ends of joints as stiff as in MuJoCo: Newton's own give way by centimetres."""
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
            set_number(prim, name, value if sliding else math.degrees(value))


def set_number(prim: Usd.Prim, name: str, value: float) -> None:
    """Set a number of a schema, in single precision."""
    prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=False).Set(value)

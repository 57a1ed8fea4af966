"""Forty rendered scenes with occluded, cropped, tilted, nested and leaning objects.

Boxes are of the visible pixels of ray-cast images, so the ground truth agrees with its image. Low
cameras occlude, near ones crop, and every third one is rolled.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8

from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.render import render
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Camera,
    Cylinder,
    HollowBox,
    Lathe,
    SceneObject,
    SceneSpec,
    Sphere,
    bounds,
    world_poses,
)

from ..engines.table_scenes import CERAMIC, FLAT, STEEL, TOP, block, single, standing, table

TUNED_ON, HELD_OUT = range(20), range(20, 40)
"""Numbers of the scenes that scores and fits are tuned on, and of those kept for measuring."""
SPREAD = 0.24
"""Half the edge of the square that objects stand on [m]."""
LEAST_PX = 6.0
"""Minimum side of a visible box that a parse lists [px]."""
BEHIND = 0.03
"""Share of an object that an occluder hides at least."""
KINDS = ("box", "tall", "can", "lying", "ball", "mug", "bin", "plate", "leaning")


def photo_scene(number: int, *, width: int = 640) -> SceneSpec:
    """Return a scene with its camera, and visible boxes, depths and hidden flags without noise.

    Args:
        number: of the scene, in TUNED_ON or HELD_OUT.
        width: of the picture [px].
    """
    rng = np.random.default_rng((41, number))
    pitch = float(rng.uniform(0.15, 0.8))
    away = float(rng.uniform(0.75, 1.2))
    base = table(1.0, 1.0).model_copy(update={"xy": (away, 0.0)})
    scene = SceneSpec(name=f"photo_{number}", objects=(base, *_things(rng)))
    # The smallest opening shows all objects; narrower ones cut some off.
    fovy = 2 * math.atan(0.3 / math.hypot(away, away * math.tan(pitch))) * rng.uniform(0.75, 1.4)
    camera = Camera(
        width=width,
        height_px=round(0.75 * width),
        fovy=fovy,
        height=away * math.tan(pitch) + 0.05,
        pitch=pitch,
        roll=float(rng.uniform(-0.12, 0.12)) if number % 3 == 0 else 0.0,
    )
    annotated = see(scene.model_copy(update={"camera": camera}), finer=2)
    listed = _without_unseen(annotated)
    return listed if len(listed.objects) == len(annotated.objects) else see(listed, finer=2)


def _without_unseen(scene: SceneSpec) -> SceneSpec:
    """Remove objects that the image hardly shows, and what they support."""
    visible: dict[str, SceneObject] = {}
    camera = scene.camera
    assert camera is not None
    for item in scene.objects:
        assert item.box2d is not None
        x0, y0, x1, y1 = item.box2d.as_tuple()
        visible_px = min(x1, camera.width) - max(x0, 0.0), min(y1, camera.height_px) - max(y0, 0.0)
        if item.environment or (min(visible_px) > LEAST_PX and item.parent in visible):
            visible[item.name] = item
    return scene.model_copy(update={"objects": tuple(visible.values())})


def _things(rng: np.random.Generator) -> list[SceneObject]:
    placed: list[SceneObject] = []
    discs: list[tuple[float, float, float]] = []
    for k in range(int(rng.integers(5, 11))):
        kind = KINDS[int(rng.integers(len(KINDS)))]
        rows, radius = _thing(kind, f"{kind}_{k}", rng)
        for _ in range(60):
            x, y = (float(v) for v in rng.uniform(-SPREAD, SPREAD, 2))
            if all(math.hypot(x - a, y - b) > radius + r + 0.004 for a, b, r in discs):
                discs.append((x, y, radius))
                yaw = float(rng.uniform(-math.pi, math.pi))
                placed += [_standing(row, (x, y), yaw) for row in rows]
                break
    return placed


def _standing(row: dict[str, Any], xy: tuple[float, float], yaw: float) -> SceneObject:
    row = dict(row)
    spec, parent, z = row.pop("spec"), row.pop("parent", "table"), row.pop("z", TOP)
    if parent != "table":
        return standing(spec, parent, (0.0, 0.0), z, row.pop("yaw", 0.0), **row)
    ahead = row.pop("ahead", 0.0)
    at = (xy[0] + ahead * math.cos(yaw), xy[1] + ahead * math.sin(yaw))
    return standing(spec, parent, at, z, yaw, **row)


def _thing(kind: str, name: str, rng: np.random.Generator) -> tuple[list[dict[str, Any]], float]:
    """Return the objects of one place, and the radius of the disc that they cover [m]."""
    a, b, c = (float(v) for v in rng.uniform(0.8, 1.3, 3))
    if kind in ("box", "tall"):
        x, y, z = (0.08 * a, 0.06 * b, (0.05 if kind == "box" else 0.16) * c)
        return [{"spec": block(name, x, y, z)}], math.hypot(x, y) / 2
    if kind == "can":
        shape = Cylinder(radius=0.03 * a, height=0.1 * b)
        return [{"spec": single(name, (shape, (0, 0, 0)), material=STEEL)}], 0.03 * a
    if kind == "lying":
        radius, height = 0.025 * a, 0.11 * b
        spec = single(name, (Cylinder(radius=radius, height=height), (0, 0, 0)), material=STEEL)
        low, _ = bounds(spec, tilt=FLAT)
        row = {"spec": spec, "base_tilt": FLAT, "z": TOP - float(low[2])}
        return [row], math.hypot(height, 2 * radius) / 2 + height / 2
    if kind == "ball":
        return [{"spec": single(name, (Sphere(radius=0.035 * a), (0, 0, 0)))}], 0.035 * a
    if kind == "plate":
        shape = Cylinder(radius=0.09 * a, height=0.015)
        cup = single(f"{name}_cup", (Cylinder(radius=0.03, height=0.07 * b), (0, 0, 0)))
        rows = [{"spec": single(name, (shape, (0, 0, 0)), material=CERAMIC)}]
        return [*rows, {"spec": cup, "parent": name, "z": 0.015}], 0.09 * a
    if kind == "mug":
        r, h = 0.035 * a, 0.09 * b
        shape = Lathe(profile=((0.0, 0.0), (0.8 * r, 0.0), (r, h)), thickness=0.004)
        grip = Box(size=(0.025, 0.01, 0.5 * h))
        spec = single(name, (shape, (0, 0, 0)), (grip, (r + 0.01, 0, 0.5 * h)), material=CERAMIC)
        return [{"spec": spec}], r + 0.03
    if kind == "bin":
        x, y, z = 0.13 * a, 0.11 * b, 0.06 * c
        shape = HollowBox(size=(x, y, z), wall=0.006)
        inner = block(f"{name}_in", 0.5 * x, 0.5 * y, 0.9 * z)
        rows = [{"spec": single(name, (shape, (0, 0, 0)))}]
        inside = {"spec": inner, "parent": name, "z": 0.006, "yaw": 0.4, "relation": "in"}
        return [*rows, inside], math.hypot(x, y) / 2
    # A board that leans against a box behind it.
    x, y, z = 0.05 * a, 0.1 * b, 0.11 * c
    rest = block(f"{name}_rest", x, y, z)
    thick = 0.008
    board = block(name, thick, 0.09 * b, 1.25 * z)
    tilt = math.radians(20.0)
    turn = (math.cos(tilt / 2), 0.0, -math.sin(tilt / 2), 0.0)
    low, _ = bounds(board, tilt=turn)
    # Its back touches the upper edge of the box, but for a millimetre.
    foot = x / 2 + thick / 2 * math.cos(tilt) + z * math.tan(tilt) + 0.001
    lean = {
        "spec": board,
        "base_tilt": turn,
        "relation": "leaning",
        "ahead": foot,
        "z": TOP - float(low[2]),
    }
    return [{"spec": rest}, lean], 0.5 * math.hypot(x, y) + 0.09


def see(scene: SceneSpec, *, finer: int = 1) -> SceneSpec:
    """Return a scene with visible boxes, depths and occlusion flags of its camera.

    An invisible object gets a box without area and counts as occluded.

    Args:
        scene: with a camera.
        finer: rays along a pixel's side.
    """
    camera = scene.camera
    assert camera is not None
    owners, names = _owners(scene, camera, 1 / finer)
    poses, objects = world_poses(scene), []
    for item in scene.objects:
        points = [at.apply(shape.surface()[0]) for shape, at in posed_shapes(item)]
        pixels, _ = camera.project(poses[item.name].apply(np.vstack(points)))
        full = np.array([*pixels.min(axis=0), *pixels.max(axis=0)])
        rows, columns = np.nonzero(owners == names.index(item.name))
        # Invisible objects get a spot, and are removed later.
        box = np.array([0.0, 0.0, 1e-3, 1e-3])
        if len(rows):
            ends = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            box = np.array(ends, float) / finer
            # At the edge of the object itself, its projected outline is exact.
            near = np.abs(box - full) < 1.5
            box = np.where(near, full, box)
        hidden = bool(np.abs(box - full).max() > 2.0) or not len(rows)
        low, high = bounds(item.spec, item.joint_state)
        _, depth = camera.project(poses[item.name].apply((low + high) / 2))
        edges = dict(zip(("x0", "y0", "x1", "y1"), map(float, box), strict=True))
        update = {"box2d": Box2D(**edges), "depth": float(depth), "occluded": hidden}
        objects.append(item.model_copy(update=update))
    return scene.model_copy(update={"objects": tuple(objects)})


def photograph(scene: SceneSpec) -> UInt8[np.ndarray, "row column 3"]:
    """Render the photograph of a scene with a camera (sRGB)."""
    assert scene.camera is not None
    return render(scene, scene.camera).color


def occluders(scene: SceneSpec) -> dict[str, tuple[str, ...]]:
    """Return the occluders of each object that hide a noticeable part of it."""
    camera = scene.camera
    assert camera is not None
    first, names = _owners(scene, camera, 2.0)
    hidden_by = {}
    for k, name in enumerate(names):
        whole = _owners(scene, camera, 2.0, only=k)[0] == k
        least = max(BEHIND * int(whole.sum()), 1.0)
        hidden_by[name] = tuple(
            other
            for j, other in enumerate(names)
            if j != k and int((whole & (first == j)).sum()) > least
        )
    return hidden_by


def visible_shares(scene: SceneSpec) -> dict[str, float]:
    """Return the share of each object that the camera sees, 0 to 1.

    Parts outside of the image do not count; an object outside of it has 0.
    """
    camera = scene.camera
    assert camera is not None
    first, names = _owners(scene, camera, 2.0)
    shares = {}
    for k, name in enumerate(names):
        whole = int((_owners(scene, camera, 2.0, only=k)[0] == k).sum())
        shares[name] = int((first == k).sum()) / max(whole, 1)
    return shares


def _owners(
    scene: SceneSpec, camera: Camera, step: float, only: int | None = None
) -> tuple[Int[np.ndarray, "row column"], list[str]]:
    """Return which object each ray hits first, -1 for none, and the objects' names.

    Args:
        scene: the scene.
        camera: through which rays are cast.
        step: from ray to ray [px].
        only: the one object that rays can hit; None is all.
    """
    from neoworld_mjx.render.ray_caster import LAYER_GROUP, RayCaster
    from neoworld_mjx.render.rendering import compile_posed, object_of_geoms

    model, data = compile_posed(scene)
    owner, names = object_of_geoms(model)
    caster = RayCaster(model, data)
    if only is not None:
        # A group that rays do not hit.
        caster.model.geom_group[owner != only] = LAYER_GROUP
    size = np.array([camera.height_px, camera.width])
    rows, columns = np.mgrid[tuple(slice(0, n) for n in (size / step).astype(int))]
    pixels = (np.stack([columns, rows], axis=-1).reshape(-1, 2) + 0.5) * step
    geom = caster.hits(camera.position(), camera.rays(pixels), smooth=False).geom
    return np.where(geom >= 0, owner[np.maximum(geom, 0)], -1).reshape(rows.shape), list(names)

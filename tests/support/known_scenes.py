"""Pictures with known truth: random table tops, rendered, and the scene trees that they show.

A seed draws objects, places, stacks, an open drawer and the camera. Written out with

    uv run python -m tests.support.known_scenes FOLDER [FIRST_SEED]

each gives FOLDER/NAME.png to be answered by looking, and FOLDER/NAME.truth.json to measure with.
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neoworld_mjx.compose.on_supports import snap
from neoworld_mjx.render import RenderedImage, render, to_png
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Box3D,
    Camera,
    Cylinder,
    HollowBox,
    Lathe,
    Material,
    ObjectSpec,
    PartState,
    SceneObject,
    SceneSpec,
    SceneTree,
    Sphere,
    TreeNode,
    bounds,
    recentred,
    world_poses,
)
from neoworld_mjx.spec.pose import yaw_of
from tests.support import scenes
from tests.support.mechanisms import geom, joint, part

SIZE = (640, 480)
SMALL = 0.03
"""Hidden shares of an object's pixels under this do not count as occlusion."""


class Known(NamedTuple):
    """A picture and what is in it."""

    scene: SceneSpec
    picture: RenderedImage
    truth: SceneTree


def _paint(rng: np.random.Generator, density: float) -> Material:
    hue, value = rng.uniform(0, 1), rng.uniform(0.35, 0.95)
    red, green, blue = (
        value * (0.55 + 0.45 * math.cos(2 * math.pi * (hue + k / 3))) for k in range(3)
    )
    return Material(name="paint", density=density, rgba=(red, green, blue, 1.0))


def _mug(rng: np.random.Generator) -> ObjectSpec:
    r, h = rng.uniform(0.034, 0.045), rng.uniform(0.08, 0.11)
    wall = Lathe(profile=((0, 0.004), (r - 0.003, 0.004), (r - 0.003, h)), thickness=0.003)
    grip = (
        (Box(size=(0.03, 0.012, 0.01)), (r + 0.012, 0, 0.75 * h)),
        (Box(size=(0.03, 0.012, 0.01)), (r + 0.012, 0, 0.3 * h)),
        (Box(size=(0.01, 0.012, 0.45 * h + 0.01)), (r + 0.027, 0, 0.525 * h)),
    )
    return scenes.single("mug", (wall, (0, 0, 0)), *grip, material=_paint(rng, 2300))


def _bowl(rng: np.random.Generator) -> ObjectSpec:
    r, h = rng.uniform(0.06, 0.09), rng.uniform(0.045, 0.07)
    profile = ((0, 0.004), (0.45 * r, 0.004), (0.85 * r, 0.45 * h), (r, h))
    return scenes.single(
        "bowl", (Lathe(profile=profile, thickness=0.004), (0, 0, 0)), material=_paint(rng, 2300)
    )


def _plate(rng: np.random.Generator) -> ObjectSpec:
    r = rng.uniform(0.1, 0.13)
    profile = ((0, 0.004), (0.65 * r, 0.004), (r, 0.02))
    return scenes.single(
        "plate", (Lathe(profile=profile, thickness=0.004), (0, 0, 0)), material=_paint(rng, 2300)
    )


def _book(rng: np.random.Generator) -> ObjectSpec:
    size = (rng.uniform(0.14, 0.19), rng.uniform(0.2, 0.27), rng.uniform(0.015, 0.045))
    return scenes.single("book", (Box(size=size), (0, 0, 0)), material=_paint(rng, 700))


def _carton(rng: np.random.Generator) -> ObjectSpec:
    size = tuple(rng.uniform(0.05, 0.16, 3).tolist())
    return scenes.single("carton", (Box(size=size), (0, 0, 0)), material=_paint(rng, 300))


def _can(rng: np.random.Generator) -> ObjectSpec:
    shape = Cylinder(radius=rng.uniform(0.03, 0.038), height=rng.uniform(0.09, 0.13))
    return scenes.single("can", (shape, (0, 0, 0)), material=_paint(rng, 900))


def _ball(rng: np.random.Generator) -> ObjectSpec:
    shape = Sphere(radius=rng.uniform(0.032, 0.045))
    return scenes.single("ball", (shape, (0, 0, 0)), material=_paint(rng, 600))


def _chest(rng: np.random.Generator) -> ObjectSpec:
    """A small chest with one drawer that fills its front."""
    x, y, z = rng.uniform(0.2, 0.26), rng.uniform(0.22, 0.32), rng.uniform(0.12, 0.18)
    wall, paint = 0.012, _paint(rng, 600)
    inner = (x - wall - 0.006, y - 2 * wall - 0.006, z - 2 * wall - 0.006)
    low = wall + 0.003 + 0.6 * inner[2] / 2
    shell = HollowBox(size=(x, y, z), wall=wall, open=("+x",))
    tray = HollowBox(size=(inner[0], inner[1], 0.6 * inner[2]), wall=0.006)
    front = Box(size=(0.01, inner[1], inner[2]))
    parts = (
        part("shell", geom("shell", shell, (0, 0, z / 2), "paint")),
        part(
            "drawer",
            geom("tray", tray, (wall / 2, 0, low), "paint"),
            geom("front", front, (x / 2 + 0.002, 0, z / 2), "paint"),
            geom("knob", Sphere(radius=0.01), (x / 2 + 0.015, 0, z / 2), "paint"),
        ),
    )
    slide = joint("slide", "prismatic", "shell", "drawer", axis=(1, 0, 0), upper=0.75 * x)
    return recentred(ObjectSpec(name="chest", materials=(paint,), parts=parts, joints=(slide,)))


MAKERS = {
    "mug": (_mug, "mug"),
    "bowl": (_bowl, "bowl"),
    "plate": (_plate, "plate"),
    "book": (_book, "book"),
    "carton": (_carton, "cardboard box"),
    "can": (_can, "can"),
    "ball": (_ball, "ball"),
    "chest": (_chest, "drawer chest"),
}
BEARS = {
    "book": ("book", "mug", "can", "carton", "bowl"),
    "plate": ("mug", "bowl", "ball"),
    "bowl": ("ball",),
    "carton": ("can", "carton"),
    "drawer": ("ball", "can"),
    "chest": ("book", "mug", "can"),
}
"""Kinds of objects that may stand on, or in, each kind."""


def known(seed: int, count: int, *, drawer: bool = False, size: tuple[int, int] = SIZE) -> Known:
    """Sample a scene, render it, and describe its visible objects.

    Args:
        seed: seed of all samples.
        count: number of objects, without the table.
        drawer: whether one is a chest with an object in its open drawer.
        size: width and height of the picture, in pixels.
    """
    rng = np.random.default_rng(seed)
    for _ in range(200):
        camera, middle = _camera(rng, size)
        scene, kinds = sample_scene(rng, count, drawer, camera, middle)
        picture = render(scene, camera)
        truth = _truth(scene, kinds, camera, picture)
        if truth is not None:
            return Known(scene, picture, truth)
    raise RuntimeError(f"seed {seed}: no scene of {count} objects can be seen as a whole")


def _camera(rng: np.random.Generator, size: tuple[int, int]) -> tuple[Camera, float]:
    pitch, fovy = math.radians(rng.uniform(22, 60)), math.radians(rng.uniform(28, 58))
    distance = rng.uniform(0.38, 0.5) / math.tan(fovy / 2)
    camera = Camera(
        width=size[0],
        height_px=size[1],
        fovy=fovy,
        height=distance * math.sin(pitch) + 0.03,
        pitch=pitch,
    )
    return camera, distance * math.cos(pitch)


def sample_scene(
    rng: np.random.Generator, count: int, drawer: bool, camera: Camera, middle: float
) -> tuple[SceneSpec, dict[str, str]]:
    """Return a scene on a table around (middle, 0), and each object's kind."""
    top = scenes.single("table", (Box(size=(1.6, 2.2, 0.04)), (0, 0, 0)))
    table = SceneObject(name="table", spec=top, environment=True, xy=(middle + 0.2, 0), z=-0.04)
    objects, kinds = [table], {"table": "table"}
    circles: list[tuple[float, float, float]] = []
    if drawer:
        chest = _place(rng, "chest", objects, kinds, circles, middle, facing=True)
        if chest is not None:
            inside = str(rng.choice(BEARS["drawer"]))
            _stack(rng, inside, chest, objects, kinds, link="drawer")
    for _ in range(60):
        if len(objects) > count:
            break
        bearing = [i for i in objects if kinds[i.name] in BEARS and not _bears(i, objects)]
        if bearing and rng.uniform() < 0.45:
            below = bearing[int(rng.integers(len(bearing)))]
            _stack(rng, str(rng.choice(BEARS[kinds[below.name]])), below, objects, kinds)
        else:
            kind = str(rng.choice([k for k in MAKERS if k != "chest"]))
            _place(rng, kind, objects, kinds, circles, middle)
    return snap(SceneSpec(name="known", objects=tuple(objects), camera=camera)), kinds


def _bears(obj: SceneObject, objects: list[SceneObject]) -> bool:
    return any(other.parent == obj.name and other.parent_link is None for other in objects)


def _name(kind: str, kinds: dict[str, str]) -> str:
    return f"{kind}_{sum(k == kind for k in kinds.values())}"


def _place(
    rng: np.random.Generator,
    kind: str,
    objects: list[SceneObject],
    kinds: dict[str, str],
    circles: list[tuple[float, float, float]],
    middle: float,
    *,
    facing: bool = False,
) -> SceneObject | None:
    """Add an object where the table is free; None if there is no room."""
    spec = MAKERS[kind][0](rng)
    state = {"slide": rng.uniform(0.35, 0.9) * spec.joints[0].upper} if spec.joints else {}
    low, high = bounds(spec, state)
    reach = float(np.hypot(*np.maximum(np.abs(low), np.abs(high))[:2]))
    for _ in range(40):
        x, y = rng.uniform(-0.22, 0.22), rng.uniform(-0.3, 0.3)
        # Circles around footprints may overlap a little: corners seldom point at each other.
        if all(math.hypot(x - a, y - b) > 0.85 * (reach + r) for a, b, r in circles):
            circles.append((x, y, reach))
            yaw = math.pi + rng.uniform(-0.5, 0.5) if facing else rng.uniform(-math.pi, math.pi)
            obj = SceneObject(
                name=_name(kind, kinds),
                spec=spec,
                parent="table",
                xy=(x - 0.2, y),
                z=0.04,
                yaw=yaw,
                joint_state=state,
            )
            objects.append(obj)
            kinds[obj.name] = kind
            return obj
    return None


def _stack(
    rng: np.random.Generator,
    kind: str,
    below: SceneObject,
    objects: list[SceneObject],
    kinds: dict[str, str],
    *,
    link: str | None = None,
) -> None:
    spec = MAKERS[kind][0](rng)
    low, high = bounds(below.spec)
    hollow = link is not None or kinds[below.name] == "bowl"
    room = (high - low)[:2] * (0.0 if hollow or kinds[below.name] == "plate" else 0.12)
    if link is not None:
        # In front of the shell, in the open part of the drawer.
        room = np.array([0.0, 0.2 * (high - low)[1]])
    x, y = rng.uniform(-room, room + 1e-9)
    if link is not None:
        x += (high - low)[0] * 0.22
    obj = SceneObject(
        name=_name(kind, kinds),
        spec=spec,
        parent=below.name,
        parent_link=link,
        relation="in" if hollow else "on",
        xy=(x, y),
        z=float(high[2]),
        yaw=rng.uniform(-math.pi, math.pi),
    )
    objects.append(obj)
    kinds[obj.name] = kind


def _truth(
    scene: SceneSpec, kinds: dict[str, str], camera: Camera, picture: RenderedImage
) -> SceneTree | None:
    """Return the scene tree of a picture; None if an object is mostly hidden or cut off."""
    poses = world_poses(scene)
    nodes = []
    for index, obj in enumerate(scene.objects):
        visible = picture.segmentation == index
        alone = scene.model_copy(
            update={
                "objects": (
                    obj.model_copy(
                        update={
                            "parent": None,
                            "parent_link": None,
                            "xy": tuple(poses[obj.name].pos[:2].tolist()),
                            "z": float(poses[obj.name].pos[2]),
                            "yaw": yaw_of(poses[obj.name].quat),
                        }
                    ),
                )
            }
        )
        whole = render(alone, camera, supersample=1).segmentation == 0
        hidden = 1 - visible.sum() / max(int(whole.sum()), 1)
        rows, columns = np.flatnonzero(visible.any(axis=1)), np.flatnonzero(visible.any(axis=0))
        if (hidden > 0.75 and not obj.environment) or len(rows) == 0:
            return None
        box2d = Box2D(x0=columns[0], y0=rows[0], x1=columns[-1] + 1, y1=rows[-1] + 1)
        if not obj.environment and _cut(box2d, camera):
            return None
        behind = whole & ~visible
        occluders = tuple(
            other.name
            for k, other in enumerate(scene.objects)
            if k != index and (behind & (picture.segmentation == k)).sum() > SMALL * whole.sum()
        )
        low, high = bounds(obj.spec, obj.joint_state)
        foot = poses[obj.name].apply([*((low + high) / 2)[:2], low[2]])
        states = tuple(
            PartState(
                part=joint.child,
                type=joint.type,
                opening=float(np.clip(obj.joint_state.get(joint.name, 0.0) / joint.upper, 0, 1)),
            )
            for joint in obj.spec.joints
            if joint.type in ("revolute", "continuous", "prismatic")
        )
        nodes.append(
            TreeNode(
                name=obj.name,
                label="table" if obj.environment else MAKERS[kinds[obj.name]][1],
                parent=obj.parent,
                relation=obj.relation,
                parent_link=obj.parent_link,
                environment=obj.environment,
                occluded=obj.environment or bool(occluders),
                occluded_by=() if obj.environment else occluders,
                box2d=box2d,
                box3d=Box3D(
                    position=tuple(foot.tolist()),
                    size=tuple((high - low).tolist()),
                    yaw=yaw_of(poses[obj.name].quat),
                ),
                articulation=states,
            )
        )
    return SceneTree(camera=camera, nodes=tuple(nodes))


def _cut(box: Box2D, camera: Camera) -> bool:
    return box.x0 <= 0 or box.y0 <= 0 or box.x1 >= camera.width or box.y1 >= camera.height_px


def five(first: int = 0) -> dict[str, Known]:
    """Return five scenes of 3 to 9 objects, the last with an object in an open drawer."""
    counts = (3, 5, 7, 9, 6)
    return {f"known{k}": known(first + k, count, drawer=k == 4) for k, count in enumerate(counts)}


def main(folder: Path, first: int) -> None:
    """Write pictures and truths."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, scene in five(first).items():
        (folder / f"{name}.png").write_bytes(to_png(scene.picture.color))
        (folder / f"{name}.truth.json").write_text(scene.truth.to_json())


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)

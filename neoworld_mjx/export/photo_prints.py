"""Prints of the photograph on the objects of a scene: a material for each part and material."""

from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from ..errors import SpecError
from ..render import render
from ..render.prints import encoded
from ..spec import (
    Camera,
    Material,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    link_poses,
    world_poses,
)
from ..spec.photo_print import PhotoPrint
from ..spec.pose import Pose, matrix

Alignment = tuple[NDArray, NDArray]
"""Stretch and shift [2]: a pixel x of the scene's picture is stretch x + shift in the photograph's,
both in the camera's pixels."""
PRINTED = "_photo"
"""Ends the names of printed materials."""
LONGEST_PX = 512
"""Longer side of a print's window."""
LEAST_PX = 6
"""Windows smaller than this are left plain."""
MOST_STRETCH = 1.6
"""Of an object's box in the photograph over that in the scene."""
DEPTH_PX = 256
"""Longer side of the depths that tell what was seen."""


def printed(scene: SceneSpec, photo: NDArray) -> SceneSpec:
    """Return a scene whose visible surfaces bear the photograph where its camera saw them.

    Args:
        scene: the scene, with the photograph's camera.
        photo: the photograph, uint8 [h, w, 3].

    Raises:
        SpecError: the scene has no camera.
    """
    if scene.camera is None:
        raise SpecError("the scene has no camera, so the photograph cannot be laid on it")
    view = render(scene, scene.camera, supersample=1, floor=False)
    poses, ones = world_poses(scene), np.ones(2)
    masks = {name: view.segmentation == k for k, name in enumerate(view.names)}
    at = {i.name: _alignment(masks[i.name], i, scene.camera) for i in scene.objects}
    pixels = np.array(photo.shape[1::-1]) / (scene.camera.width, scene.camera.height_px)
    objects = []
    for item in scene.objects:
        own = masks[item.name]
        if not own.any():
            objects.append(item)
            continue
        stretch, shift = at[item.name]
        source = own.copy()
        for name, (s, t) in at.items():
            if name != item.name:
                # Where the photograph shows the other object, in this one's aligned picture.
                source &= ~_warped(masks[name], (stretch / s, (shift - t) / s), ones, smooth=False)
        aligned = _warped(photo, (stretch, shift), pixels, smooth=True)
        filled = _filled(aligned, source if source.any() else own)
        moved = link_poses(item.spec, item.joint_state)
        places = {part.name: poses[item.name].then(moved[part.name]) for part in item.spec.parts}
        depth = np.where(own, view.depth, np.inf)
        spec = _printed_object(item.spec, scene.camera, filled, depth, places)
        objects.append(item.model_copy(update={"spec": spec}))
    return scene.model_copy(update={"objects": tuple(objects)})


def _printed_object(
    spec: ObjectSpec, camera: Camera, filled: NDArray, depth: NDArray, places: dict[str, Pose]
) -> ObjectSpec:
    materials, parts = list(spec.materials), []
    for part in spec.parts:
        names: dict[str, str] = {}
        for geom in part.geoms:
            material = spec.material(geom.material)
            if geom.role == "collision" or material.name in names or material.see_through:
                continue
            window = _window(camera, spec, part, material.name, places[part.name])
            shown = (
                None if window is None else _print(camera, filled, depth, window, places[part.name])
            )
            if shown is not None:
                name = _free(f"{material.name}_{part.name}"[:40] + PRINTED, materials)
                names[material.name] = name
                materials.append(material.model_copy(update={"name": name, "photo": shown}))
        geoms = tuple(
            geom.model_copy(update={"material": names[geom.material]})
            if geom.role != "collision" and geom.material in names
            else geom
            for geom in part.geoms
        )
        parts.append(part.model_copy(update={"geoms": geoms}))
    used = {geom.material for part in parts for geom in part.geoms}
    kept = tuple(material for material in materials if material.name in used)
    return spec.model_copy(update={"materials": kept, "parts": tuple(parts)})


def _free(name: str, materials: list[Material]) -> str:
    taken = {material.name for material in materials}
    while name in taken:
        name += "_"
    return name


def _alignment(own: NDArray, item: SceneObject, camera: Camera) -> Alignment:
    """Return where an object's pixels of the scene's picture lie in the photograph.

    Its box in the scene comes to lie on its box in the photograph, by the sides that are within the
    picture; what has no box of its own, or one that is all too different, stays where it is.
    """
    box = item.box2d
    stay = (np.ones(2), np.zeros(2))
    if box is None or item.environment or not own.any():
        return stay
    rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
    size = np.array([camera.width, camera.height_px], float)
    ends = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], float)
    others = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    inside = np.array([(ends[0] >= 1) & (others[0] >= 1),
                       (ends[1] <= size - 1) & (others[1] <= size - 1)])  # fmt: skip
    whole = inside.all(axis=0)
    ratios = (others[1] - others[0]) / (ends[1] - ends[0])
    known = ratios[whole]
    if not len(known) or np.any(known < 1 / MOST_STRETCH) or np.any(known > MOST_STRETCH):
        return stay
    stretch = np.where(whole, ratios, known.mean())
    side = np.where(inside[0], 0, 1)
    axis = np.arange(2)
    shift = np.where(inside.any(axis=0), others[side, axis] - stretch * ends[side, axis], 0.0)
    return stretch, shift


def _warped(picture: NDArray, at: Alignment, pixels: NDArray, *, smooth: bool) -> NDArray:
    """Return a picture moved so that what lies at stretch x + shift comes to lie at x.

    Args:
        picture: [h, w] or [h, w, 3].
        at: stretch and shift, in the camera's pixels.
        pixels: pixels of the picture for one of the camera [2].
        smooth: whether to blend pixels.
    """
    (sx, sy), (tx, ty) = at[0].tolist(), (at[1] * pixels).tolist()
    how = Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST
    moved = Image.fromarray(picture).transform(
        picture.shape[1::-1], Image.Transform.AFFINE, (sx, 0.0, tx, 0.0, sy, ty), resample=how
    )
    return np.asarray(moved)


def _filled(photo: NDArray, own: NDArray) -> NDArray:
    """Fill what is not the object's in the photograph with its nearest pixels."""
    height, width = photo.shape[:2]
    mask = np.asarray(Image.fromarray(own).resize((width, height), Image.Resampling.NEAREST))
    # At its edge the photograph shows a little of what is behind.
    inner = ndimage.binary_erosion(mask, iterations=max(1, width // 400))
    mask = inner if inner.any() else mask
    _, nearest = cast(
        tuple[NDArray, NDArray],
        ndimage.distance_transform_edt(np.logical_not(mask), return_indices=True),
    )
    return photo[nearest[0], nearest[1]]


def _window(
    camera: Camera, spec: ObjectSpec, part: PartSpec, material: str, at: Pose
) -> tuple[float, float, float, float] | None:
    """Return what a material of a part covers of the picture: x0, y0, x1, y1 in pixels."""
    corners = []
    for geom in part.geoms:
        if geom.role != "collision" and geom.material == material:
            vertices, _ = geom.shape.surface()
            corners.append(geom.pose().apply(vertices))
    pixels, depth = camera.project(at.apply(np.concatenate(corners)))
    if np.any(depth < 1e-3):
        return 0.0, 0.0, float(camera.width), float(camera.height_px)
    size = np.array([camera.width, camera.height_px], float)
    low, high = np.clip(pixels.min(axis=0), 0, size), np.clip(pixels.max(axis=0), 0, size)
    if np.any(high - low < LEAST_PX):
        return None
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _print(
    camera: Camera,
    filled: NDArray,
    depth: NDArray,
    window: tuple[float, float, float, float],
    at: Pose,
) -> PhotoPrint | None:
    x0, y0, x1, y1 = (round(v) for v in window)
    sight = depth[y0:y1, x0:x1]
    if not np.isfinite(sight).any():
        return None
    rows, columns = filled.shape[0] / camera.height_px, filled.shape[1] / camera.width
    picture = Image.fromarray(filled).crop(
        (round(x0 * columns), round(y0 * rows), round(x1 * columns), round(y1 * rows))
    )
    picture.thumbnail((LONGEST_PX, LONGEST_PX), Image.Resampling.LANCZOS)
    finite = sight[np.isfinite(sight)]
    near, far = float(finite.min()), float(finite.max())
    far = max(far, near * (1 + 1e-6))
    share = np.where(np.isfinite(sight), (sight - near) / (far - near), 0.0)
    levels = np.where(np.isfinite(sight), 1 + np.round(65534 * share), 0).astype(np.uint16)
    step = max(1, max(levels.shape) // DEPTH_PX)
    # The camera's pixels of points, x = focal X / Z + width / 2, as shares of the window.
    axes = camera.axes().T
    wide, tall = x1 - x0, y1 - y0
    inner = np.array([
        [camera.focal / wide, 0, (camera.width / 2 - x0) / wide],
        [0, camera.focal / tall, (camera.height_px / 2 - y0) / tall],
        [0, 0, 1],
    ])  # fmt: skip
    turn = inner @ axes @ matrix(at.quat)
    shift = inner @ axes @ (at.pos - camera.position())
    return PhotoPrint(
        image=encoded(np.asarray(picture)),
        depth=encoded(np.ascontiguousarray(levels[::step, ::step])),
        near=near,
        far=far,
        turn=tuple(tuple(map(float, row)) for row in turn),  # pyright: ignore[reportArgumentType]
        shift=tuple(map(float, shift)),  # pyright: ignore[reportArgumentType]
    )

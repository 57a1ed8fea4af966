"""Print the photograph on the objects of a scene, as one material for each part and material."""

from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from ..errors import SpecError
from ..render import render
from ..render.prints import base64_png
from ..spec import (
    Camera,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    link_poses,
    world_poses,
)
from ..spec.photo_print import PhotoPrint
from ..spec.pose import Pose, matrix
from .link_frames import unused

Alignment = tuple[NDArray, NDArray]
"""Stretch [2] and shift [2] px: pixel x of the rendered image is at stretch * x + shift in the
photograph, both in pixels of the camera."""
PRINTED = "_photo"
"""Suffix of the names of printed materials."""
LONGEST_PX = 512
"""Longer side of the image of a print [px]."""
LEAST_PX = 6
"""Smallest side of a window that is printed [px]."""
MOST_STRETCH = 1.6
"""Largest ratio of an object's box in the photograph to its box in the rendered image."""
DEPTH_PX = 256
"""Longer side of the depth image of a print [px]."""


def printed(scene: SceneSpec, photo: NDArray) -> SceneSpec:
    """Return a scene with the photograph printed on the surfaces that its camera saw.

    Args:
        scene: the scene, with the camera of the photograph.
        photo: the photograph, uint8 [h, w, 3].

    Raises:
        SpecError: the scene has no camera.
    """
    if scene.camera is None:
        raise SpecError("the scene has no camera, which is needed to print the photograph")
    view = render(scene, scene.camera, supersample=1, floor=False)
    poses, ones = world_poses(scene), np.ones(2)
    masks = {name: view.segmentation == k for k, name in enumerate(view.names)}
    alignments = {i.name: _alignment(masks[i.name], i, scene.camera) for i in scene.objects}
    scale = np.array(photo.shape[1::-1]) / (scene.camera.width, scene.camera.height_px)
    objects = []
    for item in scene.objects:
        mask = masks[item.name]
        if not mask.any():
            objects.append(item)
            continue
        stretch, shift = alignments[item.name]
        source = mask.copy()
        for name, (s, t) in alignments.items():
            if name != item.name:
                # Exclude the pixels where the aligned photograph shows another object.
                source &= ~_warped(masks[name], (stretch / s, (shift - t) / s), ones, smooth=False)
        aligned = _warped(photo, (stretch, shift), scale, smooth=True)
        filled = _filled(aligned, source if source.any() else mask)
        moved = link_poses(item.spec, item.joint_state)
        places = {part.name: poses[item.name].then(moved[part.name]) for part in item.spec.parts}
        depth = np.where(mask, view.depth, np.inf)
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
            photo = window and _print(camera, filled, depth, window, places[part.name])
            if photo is not None:
                taken = {material.name for material in materials}
                name = unused(f"{material.name}_{part.name}"[:40] + PRINTED, taken)
                names[material.name] = name
                materials.append(material.model_copy(update={"name": name, "photo": photo}))
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


def _alignment(mask: NDArray, item: SceneObject, camera: Camera) -> Alignment:
    """Return the alignment of an object's rendered pixels with the photograph.

    It maps the object's box in the rendered image to its box in the photograph, by the sides that
    lie within the image. It is the identity for objects without a box, or with one of a very
    different size.
    """
    box = item.box2d
    identity = (np.ones(2), np.zeros(2))
    if box is None or item.environment or not mask.any():
        return identity
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    size = np.array([camera.width, camera.height_px], float)
    ends = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], float)
    photo_ends = np.array([[box.x0, box.y0], [box.x1, box.y1]])
    inside = np.array([(ends[0] >= 1) & (photo_ends[0] >= 1),
                       (ends[1] <= size - 1) & (photo_ends[1] <= size - 1)])  # fmt: skip
    whole = inside.all(axis=0)
    ratios = (photo_ends[1] - photo_ends[0]) / (ends[1] - ends[0])
    known = ratios[whole]
    if not len(known) or np.any(known < 1 / MOST_STRETCH) or np.any(known > MOST_STRETCH):
        return identity
    stretch = np.where(whole, ratios, known.mean())
    side = np.where(inside[0], 0, 1)
    axis = np.arange(2)
    shift = np.where(inside.any(axis=0), photo_ends[side, axis] - stretch * ends[side, axis], 0.0)
    return stretch, shift


def _warped(image: NDArray, alignment: Alignment, scale: NDArray, *, smooth: bool) -> NDArray:
    """Return an image warped such that pixel stretch * x + shift moves to pixel x.

    Args:
        image: array [h, w] or [h, w, 3].
        alignment: stretch and shift, in pixels of the camera.
        scale: pixels of the image for one pixel of the camera [2].
        smooth: True for bicubic interpolation.
    """
    (sx, sy), (tx, ty) = alignment[0].tolist(), (alignment[1] * scale).tolist()
    resampling = Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST
    coefficients = (sx, 0.0, tx, 0.0, sy, ty)
    warped = Image.fromarray(image).transform(
        image.shape[1::-1], Image.Transform.AFFINE, coefficients, resample=resampling
    )
    return np.asarray(warped)


def _filled(photo: NDArray, mask: NDArray) -> NDArray:
    """Fill pixels outside an object's mask with the nearest pixel inside."""
    height, width = photo.shape[:2]
    mask = np.asarray(Image.fromarray(mask).resize((width, height), Image.Resampling.NEAREST))
    # Pixels at the edge of the object also show the background.
    inner = ndimage.binary_erosion(mask, iterations=max(1, width // 400))
    mask = inner if inner.any() else mask
    _, nearest = cast(
        tuple[NDArray, NDArray],
        ndimage.distance_transform_edt(np.logical_not(mask), return_indices=True),
    )
    return photo[nearest[0], nearest[1]]


def _window(
    camera: Camera, spec: ObjectSpec, part: PartSpec, material: str, place: Pose
) -> tuple[float, float, float, float] | None:
    """Return the window (x0, y0, x1, y1) that a material of a part covers in the image [px]."""
    corners = []
    for geom in part.geoms:
        if geom.role != "collision" and geom.material == material:
            vertices, _ = geom.shape.surface()
            corners.append(geom.pose().apply(vertices))
    pixels, depth = camera.project(place.apply(np.concatenate(corners)))
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
    place: Pose,
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
    # The projection x = focal * X / Z + width / 2, relative to the window.
    axes = camera.axes().T
    wide, tall = x1 - x0, y1 - y0
    inner = np.array([
        [camera.focal / wide, 0, (camera.width / 2 - x0) / wide],
        [0, camera.focal / tall, (camera.height_px / 2 - y0) / tall],
        [0, 0, 1],
    ])  # fmt: skip
    turn = inner @ axes @ matrix(place.quat)
    shift = inner @ axes @ (place.pos - camera.position())
    return PhotoPrint(
        image=base64_png(np.asarray(picture)),
        depth=base64_png(np.ascontiguousarray(levels[::step, ::step])),
        near=near,
        far=far,
        turn=tuple(tuple(map(float, row)) for row in turn),  # pyright: ignore[reportArgumentType]
        shift=tuple(map(float, shift)),  # pyright: ignore[reportArgumentType]
    )

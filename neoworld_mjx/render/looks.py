"""Appearance of a scene from its photograph: prints, exposure, white balance and backdrop.

Projects the photograph onto the large flat faces of the objects of a scene.

A projected image is called a print. Each combination of a part and a material gets a separate
material with a print.
"""

from typing import cast

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from scipy.ndimage import binary_erosion
from scipy.optimize import least_squares

from ..errors import SpecError
from ..io.names import unused
from ..physics.mjcf import visual_name
from ..spec import Camera, ObjectSpec, PartSpec, SceneObject, SceneSpec, link_poses, world_poses
from ..spec.pose import Pose, matrix
from ..spec.room import PhotoPrint
from ..spec.scene import Backdrop
from .appearance import base64_png, displayed, linear, to_lab
from .flat_rendering import flat_faces
from .rendering import RenderedImage, render
from .view import View

Alignment = tuple[NDArray, NDArray]
"""Stretch, shape [2], and shift [px], shape [2]: pixel x of the rendered image corresponds to pixel
stretch * x + shift of the photograph. Both pixels are in units of the rendered image's pixels."""
IDENTICAL: Alignment = (np.ones(2), np.zeros(2))
PRINTED = "_photo"
"""Suffix of the names of printed materials."""
LONGEST_PX = 512
"""Maximum of the longer side of a print's image [px]."""
LEAST_PX = 6
"""Minimum width and height of a window that is printed [px]."""
MOST_STRETCH = 1.6
"""Largest factor by which the sizes of an object's 2D box in the photograph and of its box in the
rendered image may differ."""
MOST_PX = 640
"""Maximum of the longer side of the rendered image [px]."""
FLAT_SHARE = 0.5
"""Minimum fraction of the visible pixels of a printed material that must be on flat faces."""
PHOTO_SCALE = 2
"""Ratio of the photograph's size to the rendered image's size."""
MARGIN = 0.006
"""Width of the border around other objects that a print excludes, relative to the width of the
rendered image."""
NEARBY = 0.2
"""Distance from the rendered outline of an object, relative to the shorter side of its 2D box,
within which the photograph may show the object on its support."""
UNLIKE, SPREAD = 20.0, 2.5
"""Color difference from the support [CIE Lab, standard deviations] above which it does show it."""
AROUND = 0.05
"""Standard deviation of the distance of the support's pixels to compare with, relative to the width
of the rendered image."""
DEPTH_PX = 256
"""Approximate longer side of the depth image of a print [px]."""
EDGE_STEPS = 2
"""Number of pixels by which the depth image is continued beyond the edges of surfaces. Otherwise,
the outermost pixels of a surface would have no depth to compare with, and would not be printed."""


def printed(scene: SceneSpec, photo: NDArray) -> SceneSpec:
    """Return a scene with the photograph printed on the large flat faces that its camera sees.

    A print on a flat face is correct even if the shape of the object is simplified, whereas a print
    on a round surface would show the background at the edges of the surface. An object is printed
    only if its pose agrees with its 2D box. Printed materials get the mean color of the print.

    Args:
        scene: the scene, with the camera of the photograph.
        photo: the photograph, uint8, shape [h, w, 3].

    Raises:
        SpecError: the scene has no camera.
    """
    if scene.camera is None:
        raise SpecError("the scene has no camera, which is needed to print the photograph")
    camera, reduced = _reduced(scene.camera)
    size = (PHOTO_SCALE * camera.width, PHOTO_SCALE * camera.height_px)
    photo = np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.LANCZOS))
    view = render(scene, camera, supersample=1, floor=False, shadows=False)
    poses = world_poses(scene)
    masks = {name: view.segmentation == k for k, name in enumerate(view.names)}
    faces = flat_faces(view, View.of(camera))
    alignments = {i.name: _alignment(masks[i.name], i, camera, reduced) for i in scene.objects}
    scale = np.array(photo.shape[1::-1]) / (camera.width, camera.height_px)
    objects = []
    for item in scene.objects:
        mask = masks[item.name]
        alignment = alignments[item.name]
        printable = _flat_materials(item, view, faces)
        if not mask.any() or alignment is None or not printable:
            objects.append(item)
            continue
        inside = _warped(np.ones(mask.shape, bool), alignment, np.ones(2), smooth=False)
        own = _own_pixels(scene, item, photo, masks, alignments, reduced)
        source = mask & inside & own
        printable = {
            key: pixels & inside for key, pixels in printable.items() if (pixels & source).any()
        }
        if not printable:
            objects.append(item)
            continue
        filled = _filled(_warped(photo, alignment, scale, smooth=True), source)
        part_poses = link_poses(item.spec, item.joint_state)
        places = {
            part.name: poses[item.name].then(part_poses[part.name]) for part in item.spec.parts
        }
        depth = np.where(mask & faces, view.depth, np.inf)
        spec = _printed_object(item.spec, camera, filled, depth, places, printable)
        objects.append(item.model_copy(update={"spec": spec}))
    return scene.model_copy(update={"objects": tuple(objects)})


def _reduced(camera: Camera) -> tuple[Camera, float]:
    """Return a camera whose image is at most `MOST_PX` wide and high, and its scale factor."""
    scale = min(1.0, MOST_PX / max(camera.width, camera.height_px))
    return camera.resized(round(scale * camera.width), round(scale * camera.height_px)), scale


def _printed_object(
    spec: ObjectSpec,
    camera: Camera,
    filled: NDArray,
    depth: NDArray,
    places: dict[str, Pose],
    printable: dict[tuple[str, str], NDArray],
) -> ObjectSpec:
    """Return an object with prints.

    Args:
        spec: the object.
        camera: the camera.
        filled: the photograph, aligned with the object and filled in around the object.
        depth: depth of the object in each pixel [m], inf where the camera sees no printable face.
        places: poses of the parts in the world frame, by part name.
        printable: mask of the pixels of each (part, material) that is printed; the printed material
            gets the mean color of these pixels.
    """
    materials, parts = list(spec.materials), []
    for part in spec.parts:
        names: dict[str, str] = {}
        for geom in part.geoms:
            material = spec.material(geom.material)
            if geom.role == "collision" or material.name in names or material.see_through:
                continue
            if (part.name, material.name) not in printable:
                continue
            window = _window(camera, part, material.name, places[part.name])
            photo = window and _print(camera, filled, depth, window, places[part.name])
            if photo is not None:
                taken = {material.name for material in materials}
                name = unused(f"{material.name}_{part.name}"[:40] + PRINTED, taken)
                names[material.name] = name
                mask = printable[part.name, material.name]
                rgba = (*_mean_color(filled, mask), material.rgba[3])
                changes = {"name": name, "photo": photo, "rgba": rgba}
                materials.append(material.model_copy(update=changes))
        geoms = tuple(
            geom.model_copy(update={"material": names[geom.material]})
            if geom.role != "collision" and geom.material in names
            else geom
            for geom in part.geoms
        )
        parts.append(part.model_copy(update={"geoms": geoms}))
    used = {geom.material for part in parts for geom in part.geoms}
    used_materials = tuple(material for material in materials if material.name in used)
    return spec.model_copy(update={"materials": used_materials, "parts": tuple(parts)})


def _flat_materials(
    item: SceneObject, view: RenderedImage, faces: NDArray
) -> dict[tuple[str, str], NDArray]:
    """Return a mask of the pixels on flat faces of each (part, material) that is mostly flat.

    A material is mostly flat if more than `FLAT_SHARE` of its visible pixels are on flat faces.
    """
    index = {name: g for g, name in enumerate(view.geom_names)}
    ids: dict[tuple[str, str], list[int]] = {}
    for part in item.spec.parts:
        for geom in part.geoms:
            g = index.get(visual_name(item.name, geom))
            if g is not None and geom.role != "collision":
                ids.setdefault((part.name, geom.material), []).append(g)
    pixels = {key: np.isin(view.geoms, geoms) for key, geoms in ids.items()}
    return {
        key: mask & faces
        for key, mask in pixels.items()
        if (mask & faces).sum() > max(FLAT_SHARE * mask.sum(), LEAST_PX**2)
    }


def _mean_color(photo: NDArray, mask: NDArray) -> tuple[float, float, float]:
    """Return the mean color of a mask's pixels as display RGB, averaged in linear light."""
    size = mask.shape[::-1]
    small = np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.BOX))
    red, green, blue = np.round(displayed(linear(small[mask] / 255.0).mean(axis=0)), 4).tolist()
    return red, green, blue


def _alignment(
    mask: NDArray, item: SceneObject, camera: Camera, reduced: float
) -> Alignment | None:
    """Return the alignment of an object's rendered pixels with the photograph.

    The alignment maps the object's box in the rendered image to its 2D box in the photograph; only
    sides of the boxes that are not at the border of the image are used. The alignment is the
    identity if the object is not visible, has no 2D box, is a support of the environment, or is cut
    off by the border along both axes. The result is None if the sizes of the boxes differ by more
    than the factor `MOST_STRETCH`.

    Args:
        mask: pixels of the object in the rendered image.
        item: the object.
        camera: camera of the rendered image.
        reduced: size of the rendered image relative to the image in which 2D boxes are given.
    """
    box = item.box2d
    if box is None or item.environment or not mask.any():
        return IDENTICAL
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    size = np.array([camera.width, camera.height_px], float)
    ends = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], float)
    photo_ends = reduced * np.array([[box.x0, box.y0], [box.x1, box.y1]])
    inside = np.array([(ends[0] >= 1) & (photo_ends[0] >= 1),
                       (ends[1] <= size - 1) & (photo_ends[1] <= size - 1)])  # fmt: skip
    whole = inside.all(axis=0)
    ratios = (photo_ends[1] - photo_ends[0]) / (ends[1] - ends[0])
    known = ratios[whole]
    if not len(known):
        return IDENTICAL
    if np.any(known < 1 / MOST_STRETCH) or np.any(known > MOST_STRETCH):
        return None
    stretch = np.where(whole, ratios, known.mean())
    side = np.where(inside[0], 0, 1)
    axis = np.arange(2)
    shift = np.where(inside.any(axis=0), photo_ends[side, axis] - stretch * ends[side, axis], 0.0)
    return stretch, shift


def _warped(image: NDArray, alignment: Alignment, scale: NDArray, *, smooth: bool) -> NDArray:
    """Return an image that is warped so that pixel stretch * x + shift moves to pixel x.

    Args:
        image: the image, shape [h, w] or [h, w, 3].
        alignment: stretch and shift, in pixels of the rendered image.
        scale: width and height of `image` relative to the rendered image, shape [2].
        smooth: if True, interpolate bicubically; otherwise, take the nearest pixel.
    """
    (sx, sy), (tx, ty) = alignment[0].tolist(), (alignment[1] * scale).tolist()
    resampling = Image.Resampling.BICUBIC if smooth else Image.Resampling.NEAREST
    coefficients = (sx, 0.0, tx, 0.0, sy, ty)
    warped = Image.fromarray(image).transform(
        image.shape[1::-1], Image.Transform.AFFINE, coefficients, resample=resampling
    )
    return np.asarray(warped)


def _own_pixels(
    scene: SceneSpec,
    item: SceneObject,
    photo: NDArray,
    masks: dict[str, NDArray],
    alignments: dict[str, Alignment | None],
    reduced: float,
) -> NDArray:
    """Return the pixels at which the aligned photograph shows no other object.

    On supports, pixels near the outlines of objects are
    excluded, too, if their colors differ from the support's: shapes of objects are simplified.

    Args:
        scene: the scene.
        item: the object with which the photograph is aligned.
        photo: the photograph, a multiple of the rendered image's size.
        masks: pixels of each object in the rendered image.
        alignments: alignments of the objects.
        reduced: size of the rendered image relative to the image in which 2D boxes are given.
    """
    stretch, shift = alignments[item.name] or IDENTICAL
    ones, shape = np.ones(2), masks[item.name].shape
    covered, nearby = np.zeros((2, *shape), bool)
    for other in scene.objects:
        if other.name == item.name:
            continue
        s, t = alignments[other.name] or IDENTICAL
        place = (stretch / s, (shift - t) / s)
        shown = _warped(masks[other.name], place, ones, smooth=False)
        covered |= shown
        if item.environment and not other.environment:
            nearby |= _nearby(shown, other, reduced)
    width = max(1, round(MARGIN * shape[1]))
    own = np.logical_not(ndimage.binary_dilation(covered, iterations=width))
    known = own & masks[item.name] & ~nearby
    if known.any():
        unlike = own & nearby & _unlike(photo, known)
        own &= np.logical_not(ndimage.binary_dilation(unlike, iterations=width))
    return own


def _nearby(shown: NDArray, item: SceneObject, reduced: float) -> NDArray:
    """Return the pixels of an object's 2D box that are near the object.

    The result is the whole box if no pixel of the object is known.

    Args:
        shown: pixels at which the photograph shows the object, according to the rendered image.
        item: the object.
        reduced: size of the rendered image relative to the image in which 2D boxes are given.
    """
    near = np.zeros(shown.shape, bool)
    if item.box2d is None:
        return near
    x0, y0, x1, y1 = (round(reduced * side) for side in item.box2d.as_tuple())
    near[max(y0, 0) : y1, max(x0, 0) : x1] = True
    if shown.any():
        away = np.asarray(ndimage.distance_transform_edt(np.logical_not(shown)))
        near &= away <= NEARBY * min(x1 - x0, y1 - y0)
    return near


def _unlike(photo: NDArray, mask: NDArray) -> NDArray:
    """Return the pixels whose colors differ from those of a mask's pixels around them.

    A pixel differs if its color is farther from the mean than `UNLIKE` and than `SPREAD` standard
    deviations, which are large on surfaces with a strong pattern. The color of a darker pixel is
    compared with the mean in shadow.
    """
    small = np.asarray(Image.fromarray(photo).resize(mask.shape[::-1], Image.Resampling.BOX))
    light, color = linear(small / 255.0), to_lab(small)
    values = np.dstack([np.ones(mask.shape), light, color, (color**2).sum(axis=-1)])
    sigma = (AROUND * mask.shape[1], AROUND * mask.shape[1], 0)
    sums = ndimage.gaussian_filter(values * mask[..., None], sigma)
    means = sums[..., 1:] / np.maximum(sums[..., :1], 1e-9)
    variance = np.maximum(means[..., 6] - (means[..., 3:6] ** 2).sum(axis=-1), 0.0)
    mean = means[..., :3]
    shade = np.minimum(light.sum(-1) / np.maximum(mean.sum(-1), 1e-9), 1.0)
    away = np.linalg.norm(color - _lab(shade[..., None] * mean), axis=-1)
    return away > np.maximum(UNLIKE, SPREAD * np.sqrt(variance))


def _filled(photo: NDArray, mask: NDArray) -> NDArray:
    """Replace each pixel outside an object's mask by the nearest pixel inside the mask."""
    height, width = photo.shape[:2]
    mask = np.asarray(Image.fromarray(mask).resize((width, height), Image.Resampling.NEAREST))
    # Pixels at the edge of an object also show the background.
    inner = ndimage.binary_erosion(mask, iterations=max(1, width // 400))
    mask = inner if inner.any() else mask
    _, nearest = cast(
        tuple[NDArray, NDArray],
        ndimage.distance_transform_edt(np.logical_not(mask), return_indices=True),
    )
    return photo[nearest[0], nearest[1]]


def _window(
    camera: Camera, part: PartSpec, material: str, place: Pose
) -> tuple[float, float, float, float] | None:
    """Return the window (x0, y0, x1, y1) that a material of a part covers in the image [px].

    The result is None if the window is narrower or lower than `LEAST_PX`.
    """
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
    levels = _widened(levels, EDGE_STEPS * step)
    # The projection x = focal * X / Z + principal point, relative to the window.
    axes = camera.axes().T
    wide, tall = x1 - x0, y1 - y0
    u, v = camera.center
    inner = np.array([
        [camera.focal / wide, 0, (u - x0) / wide],
        [0, camera.focal / tall, (v - y0) / tall],
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


def _widened(levels: NDArray, width: int) -> NDArray:
    """Extend the region of positive levels by `width` pixels, with the nearest positive levels."""
    distance, (rows, columns) = cast(
        tuple[NDArray, NDArray],
        ndimage.distance_transform_edt(levels == 0, return_indices=True),
    )
    return np.where(distance <= width, levels[rows, columns], 0).astype(levels.dtype)


WIDTH = 240
"""Width of the images that are compared [px]."""
LEAST_BACKDROP = 0.005
"""Least fraction of the picture that must show no object for the backdrop's color to be
measured."""
BEHIND_M = 0.02
"""Distance between the backdrop and the farthest visible point [m]."""
LEAST_PIXELS = 25
"""Least number of visible pixels at which an object is used to fit the gains."""
EXPOSURE_DEVIATION, EXPOSURE_BOUND = 0.5, 0.7
"""Prior standard deviation and bound of the log exposure. The bound allows half to twice the
exposure."""
BALANCE_DEVIATION, BALANCE_BOUND = 0.2, 0.3
"""Prior standard deviation and bound of the log gains of red and blue relative to green."""
OUTLIER = 5.0
"""Color difference [CIE Lab] above which an object's cost grows only linearly, because the object's
color is probably wrong."""


def as_photographed(scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]) -> SceneSpec:
    """Return a scene that looks like its photograph; shapes, masses and poses do not change.

    - The photograph is printed on large flat faces of objects.
    - The camera has one gain for each color channel. A robust fit with a prior near 1 determines
      the gains from the mean colors of all visible objects, in the photograph and in the rendered
      scene. Pixels of large flat faces are ignored, because the photograph is printed there.
    - A backdrop, a plane behind all objects, has the median color of the pixels that show no
      object.

    A scene without a camera is returned unchanged.

    Args:
        scene: the scene, aligned with the photograph.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    if scene.camera is None:
        return scene
    plain = scene.camera.model_copy(update={"gain": (1.0, 1.0, 1.0)})
    scene = scene.model_copy(update={"camera": plain, "backdrop": None})
    image = render(scene, plain, width=WIDTH, supersample=1)
    view = View.of(plain, WIDTH)
    faces = flat_faces(image, view)
    size = image.color.shape[1::-1]
    small = np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.BOX))
    in_photo, rendered, pixels = [], [], []
    for k in range(len(image.names)):
        mask = np.asarray(binary_erosion((image.segmentation == k) & ~faces), bool)
        if mask.sum() >= LEAST_PIXELS:
            in_photo.append(linear(small[mask] / 255.0).mean(axis=0))
            rendered.append(linear(image.color[mask] / 255.0).mean(axis=0))
            pixels.append(mask.sum())
    camera = plain
    if pixels:
        gain = _gain(np.array(in_photo), np.array(rendered), np.sqrt(pixels))
        camera = plain.model_copy(update={"gain": tuple(np.round(gain, 4).tolist())})
    changes = {"camera": camera, "backdrop": _backdrop(image, view, small)}
    return printed(scene, photo).model_copy(update=changes)


def _backdrop(
    image: RenderedImage, view: View, photo: UInt8[np.ndarray, "row column 3"]
) -> Backdrop | None:
    """Return the backdrop of a rendered scene, or None if hardly any of it would be visible."""
    rows, columns = np.nonzero(image.segmentation >= 0)
    if not len(rows):
        return None
    rays = view.rays(np.column_stack([columns, rows]) + 0.5)
    depth = image.depth[rows, columns]
    farthest = (depth / (rays @ view.axes[:, 2]) * rays[:, 0]).max()
    empty = image.segmentation < 0
    if empty.mean() < LEAST_BACKDROP or farthest <= 0:
        return None
    red, green, blue = np.round(np.median(photo[empty], axis=0) / 255.0, 4).tolist()
    return Backdrop(x=round(float(farthest) + BEHIND_M, 4), rgb=(red, green, blue))


def _gain(
    in_photo: Float[np.ndarray, "k 3"],
    rendered: Float[np.ndarray, "k 3"],
    weights: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "3"]:
    """Return the gains that best map linear colors of rendered objects to photographed ones."""
    target = _lab(in_photo)
    weights = np.sqrt(weights / weights.max())
    deviations = np.array([EXPOSURE_DEVIATION, BALANCE_DEVIATION, BALANCE_DEVIATION])
    bounds = np.array([EXPOSURE_BOUND, BALANCE_BOUND, BALANCE_BOUND])

    def gains(x: np.ndarray) -> np.ndarray:
        return np.exp(x[0] + np.array([x[1], 0.0, x[2]]))

    def residuals(x: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(_lab(rendered * gains(x)) - target, axis=1) / OUTLIER
        robust = np.sqrt(2.0 * (np.sqrt(1.0 + away**2) - 1.0))
        return np.concatenate([weights * robust, x / deviations])

    return gains(least_squares(residuals, np.zeros(3), bounds=(-bounds, bounds)).x)


def _lab(light: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return to_lab(255.0 * displayed(light))

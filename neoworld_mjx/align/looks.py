"""Appearance of a scene from its photograph: prints, exposure, white balance and backdrop."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from scipy.ndimage import binary_erosion
from scipy.optimize import least_squares

from ..render import RenderedImage, View, render
from ..render.appearance import displayed, linear
from ..render.flat_faces import flat_faces
from ..spec import SceneSpec
from ..spec.scene import Backdrop
from .colors import to_lab
from .photo_prints import printed

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


def _lab(light: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    return to_lab(255.0 * displayed(light))

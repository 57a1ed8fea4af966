"""Picture of the pixel evidence: where the photograph agrees with an object, and where not."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from ..spec import SceneSpec
from .colors import LARGEST
from .photo_evidence import WIDTH_PX, rated_pixels
from .rasterize import height_of

AGREES, CONTRADICTS, UNCLAIMED = (0.0, 200.0, 80.0), (255.0, 0.0, 60.0), (60.0, 90.0, 255.0)
"""Colors (sRGB) of three kinds of pixels: pixels of an object that look like the object, pixels of
an object that look like the background, and pixels around an object that look like the object."""
GRAY = 0.35
"""Share of the gray photograph in the picture; the rest is white."""


def evidence_picture(
    scene: SceneSpec, photo: UInt8[np.ndarray, "row column 3"]
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draw the log likelihood ratio of every pixel near an object over a gray photograph.

    The stronger the color, the larger the absolute ratio. All other pixels are gray.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
    """
    assert scene.camera is not None
    height = height_of(scene.camera, WIDTH_PX)
    gray = Image.fromarray(photo).convert("L").resize((WIDTH_PX, height))
    picture = np.repeat((255 * (1 - GRAY) + GRAY * np.asarray(gray, float))[..., None], 3, axis=2)
    covered = np.zeros((height, WIDTH_PX), bool)
    rated = list(rated_pixels(scene, photo))
    for _, window, _, inside in rated:
        covered[window] |= inside
    for _, window, ratio, inside in rated:
        around = ~covered[window] & (ratio > 0)
        for pixels, color in (
            (around, UNCLAIMED),
            (inside & (ratio > 0), AGREES),
            (inside & (ratio < 0), CONTRADICTS),
        ):
            share: Float[np.ndarray, " n 1"] = np.abs(ratio[pixels])[:, None] / LARGEST
            part = picture[window]
            part[pixels] = (1 - share) * part[pixels] + share * np.array(color)
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)

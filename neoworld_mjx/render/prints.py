"""Prints of the photograph: what of a surface was seen, and the colours there."""

import base64
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import SpecError
from ..io.image_files import open_image
from ..spec import Material
from ..spec.photo_print import PhotoPrint

LEAST_COSINE = 0.2
"""Of the angle between a surface's normal and the way to the camera; flatter ones smear."""
DEPTH_SHARE = 0.015
"""Difference of depths, over the depth, up to which a point is what was seen."""
MOST_CONDITION = 1e9
"""Of the matrix of a print: a camera's is far below."""
STRIP = 8
"""Rows of the material's own colour below the picture of a print."""


@dataclass(frozen=True)
class ReadPrint:
    """A print with its pictures decoded."""

    colours: NDArray
    """uint8 [h, w, 3], for display."""
    depths: NDArray
    """[h, w] m; inf where the object was not seen."""
    turn: NDArray
    """[3, 3] 1/m."""
    shift: NDArray
    """[3]"""

    def shifted(self, origin: NDArray) -> "ReadPrint":
        """Take points from another origin [3] m of the object's frame."""
        shift = self.shift + self.turn @ origin
        return ReadPrint(self.colours, self.depths, self.turn, shift)

    def seen(self, points: NDArray, normals: NDArray) -> tuple[NDArray, NDArray]:
        """Return places (u, v) [n, 2] in the window, and which points were seen, bool [n].

        Args:
            points: in the object's frame [n, 3] m.
            normals: there [n, 3], of any length.
        """
        local = points @ self.turn.T + self.shift
        depth = np.where(local[:, 2] > 1e-9, local[:, 2], 1e-9)
        at = local[:, :2] / depth[:, None]
        eye = np.linalg.solve(self.turn, -self.shift)
        away = eye - points
        sizes = np.linalg.norm(away, axis=1) * np.linalg.norm(normals, axis=1)
        facing = np.sum(away * normals, axis=1) > LEAST_COSINE * sizes
        inside = np.all((at >= 0) & (at < 1), axis=1) & (local[:, 2] > 1e-9)
        h, w = self.depths.shape
        row = np.clip((at[:, 1] * h).astype(int), 0, h - 1)
        column = np.clip((at[:, 0] * w).astype(int), 0, w - 1)
        near = np.abs(self.depths[row, column] - depth) < DEPTH_SHARE * depth
        return at, facing & inside & near

    def colour(self, at: NDArray) -> NDArray:
        """Return display colours [n, 3] in [0, 1] at places (u, v) [n, 2] of the window."""
        h, w = self.colours.shape[:2]
        x, y = np.clip(at[:, 0] * w - 0.5, 0, w - 1), np.clip(at[:, 1] * h - 0.5, 0, h - 1)
        left, top = x.astype(int), y.astype(int)
        right, low = np.minimum(left + 1, w - 1), np.minimum(top + 1, h - 1)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        c = self.colours / 255.0
        upper = c[top, left] * (1 - fx) + c[top, right] * fx
        lower = c[low, left] * (1 - fx) + c[low, right] * fx
        return upper * (1 - fy) + lower * fy

    def texture_coordinates(self, at: NDArray, seen: NDArray) -> NDArray:
        """Return (u, v) [n, 2] on the texture of `print_png`, v upwards; unseen is plain colour."""
        rows = self.colours.shape[0]
        share = rows / (rows + STRIP)
        u = np.where(seen, np.clip(at[:, 0], 0, 1), 0.5)
        v = np.where(seen, 1 - np.clip(at[:, 1], 0, 1) * share, (1 - share) / 2)
        return np.round(np.stack([u, v], axis=1), 6)


def read_print(photo: PhotoPrint) -> ReadPrint:
    """Decode a print; the last ones are kept.

    Raises:
        SpecError: its pictures cannot be read.
    """
    return _read_print(photo)  # pyright: ignore[reportArgumentType] frozen models are hashable


@lru_cache(maxsize=64)
def _read_print(photo: PhotoPrint) -> ReadPrint:
    # Of a camera its rows are independent; the eye is where they meet.
    if np.linalg.cond(np.array(photo.turn)) > MOST_CONDITION:
        raise SpecError("a print's turn is no projection: its rows are not independent")
    colours = _decoded(photo.image, "RGB")
    levels = _decoded(photo.depth, "I;16").astype(float)
    depths = photo.near + (levels - 1) / 65534 * (photo.far - photo.near)
    depths = np.where(levels > 0, depths, np.inf)
    return ReadPrint(colours, depths, np.array(photo.turn), np.array(photo.shift))


def _decoded(text: str, mode: str) -> NDArray:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        raise SpecError("the picture of a print is no base64") from None
    with open_image(data, "the picture of a print", SpecError, ("PNG",)) as image:
        if mode == "RGB":
            return np.asarray(image.convert("RGB"))
        if image.mode not in ("I;16", "I"):
            raise SpecError(f"the depths of a print have mode {image.mode}, not 16 bits")
        return np.asarray(image)


def encoded(picture: NDArray) -> str:
    """Return a picture, uint8 [h, w, 3] or uint16 [h, w], as PNG in base64."""
    content = BytesIO()
    Image.fromarray(picture).save(content, format="PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode()


def print_png(material: Material) -> bytes:
    """Return the texture of a printed material: its window, and its own colour below."""
    assert material.photo is not None
    colours = read_print(material.photo).colours
    own = np.round(255 * np.array(material.rgba[:3])).astype(np.uint8)
    strip = np.broadcast_to(own, (STRIP, colours.shape[1], 3))
    content = BytesIO()
    Image.fromarray(np.concatenate([colours, strip])).save(content, format="PNG", optimize=True)
    return content.getvalue()

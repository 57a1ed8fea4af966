"""Prints of the photograph: the surface points that a print shows, and their colors."""

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
"""Smallest cosine between the normal at a printed point and the direction towards the camera."""
DEPTH_SHARE = 0.015
"""Largest difference between the depth of a visible point and the depth stored in the print,
relative to the depth of the point."""
MOST_CONDITION = 1e9
"""Largest condition number of the matrix of a print. Real cameras have far smaller ones."""
STRIP = 8
"""Number of rows in the strip of plain color below the image of a print."""


@dataclass(frozen=True)
class ReadPrint:
    """A print with decoded images."""

    colours: NDArray
    """Display (sRGB) colors, uint8 [h, w, 3]."""
    depths: NDArray
    """Depths [m], shape [h, w]; inf where the object was not visible."""
    turn: NDArray
    """Linear part of the projection [1/m], shape [3, 3]."""
    shift: NDArray
    """Translation of the projection, shape [3]."""

    def shifted(self, origin: NDArray) -> "ReadPrint":
        """Return the print for points that are given relative to another origin [m], shape [3]."""
        shift = self.shift + self.turn @ origin
        return ReadPrint(self.colours, self.depths, self.turn, shift)

    def project(self, points: NDArray, normals: NDArray) -> tuple[NDArray, NDArray]:
        """Project points into the window of the print, and test which points the print shows.

        Args:
            points: points in the object's frame [m], shape [n, 3].
            normals: normals at the points, of any length, shape [n, 3].

        Returns:
            Positions (u, v) in the window, shape [n, 2], and a mask of the visible points, [n].
        """
        local = points @ self.turn.T + self.shift
        depth = np.where(local[:, 2] > 1e-9, local[:, 2], 1e-9)
        position = local[:, :2] / depth[:, None]
        eye = np.linalg.solve(self.turn, -self.shift)
        away = eye - points
        sizes = np.linalg.norm(away, axis=1) * np.linalg.norm(normals, axis=1)
        facing = np.sum(away * normals, axis=1) > LEAST_COSINE * sizes
        inside = np.all((position >= 0) & (position < 1), axis=1) & (local[:, 2] > 1e-9)
        h, w = self.depths.shape
        row = np.clip((position[:, 1] * h).astype(int), 0, h - 1)
        column = np.clip((position[:, 0] * w).astype(int), 0, w - 1)
        near = np.abs(self.depths[row, column] - depth) < DEPTH_SHARE * depth
        return position, facing & inside & near

    def colour(self, position: NDArray) -> NDArray:
        """Return display colors [n, 3] in [0, 1] at positions (u, v) [n, 2] in the window."""
        h, w = self.colours.shape[:2]
        x, y = (
            np.clip(position[:, 0] * w - 0.5, 0, w - 1),
            np.clip(position[:, 1] * h - 0.5, 0, h - 1),
        )
        left, top = x.astype(int), y.astype(int)
        right, low = np.minimum(left + 1, w - 1), np.minimum(top + 1, h - 1)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        c = self.colours / 255.0
        upper = c[top, left] * (1 - fx) + c[top, right] * fx
        lower = c[low, left] * (1 - fx) + c[low, right] * fx
        return upper * (1 - fy) + lower * fy

    def texture_coordinates(self, position: NDArray, visible: NDArray) -> NDArray:
        """Return texture coordinates on the image of `print_png`, shape [n, 2]; v points upwards.

        Points that the camera does not see map to the strip of plain color at the lower edge.
        """
        rows = self.colours.shape[0]
        share = rows / (rows + STRIP)
        u = np.where(visible, np.clip(position[:, 0], 0, 1), 0.5)
        v = np.where(visible, 1 - np.clip(position[:, 1], 0, 1) * share, (1 - share) / 2)
        return np.round(np.stack([u, v], axis=1), 6)


def read_print(photo: PhotoPrint) -> ReadPrint:
    """Decode a print; recent results are cached.

    Raises:
        SpecError: the images of the print cannot be read, or its matrix is singular.
    """
    return _read_print(photo)  # pyright: ignore[reportArgumentType] frozen models are hashable


@lru_cache(maxsize=64)
def _read_print(photo: PhotoPrint) -> ReadPrint:
    if np.linalg.cond(np.array(photo.turn)) > MOST_CONDITION:
        raise SpecError("the matrix of a print is singular: its rows are not independent")
    colours = _decoded(photo.image, "RGB")
    levels = _decoded(photo.depth, "I;16").astype(float)
    depths = photo.near + (levels - 1) / 65534 * (photo.far - photo.near)
    depths = np.where(levels > 0, depths, np.inf)
    return ReadPrint(colours, depths, np.array(photo.turn), np.array(photo.shift))


def _decoded(text: str, mode: str) -> NDArray:
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        raise SpecError("the image of a print is not base64") from None
    with open_image(data, "the image of a print", SpecError, ("PNG",)) as image:
        if mode == "RGB":
            return np.asarray(image.convert("RGB"))
        if image.mode not in ("I;16", "I"):
            raise SpecError(f"the depths of a print have mode {image.mode}, not 16 bits")
        return np.asarray(image)


def base64_png(image: NDArray) -> str:
    """Return an image, uint8 [h, w, 3] or uint16 [h, w], as PNG in base64."""
    content = BytesIO()
    Image.fromarray(image).save(content, format="PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode()


def print_png(material: Material) -> bytes:
    """Return the texture of a printed material as PNG: the print above a strip of plain color."""
    assert material.photo is not None
    colours = read_print(material.photo).colours
    plain = np.round(255 * np.array(material.rgba[:3])).astype(np.uint8)
    strip = np.broadcast_to(plain, (STRIP, colours.shape[1], 3))
    content = BytesIO()
    Image.fromarray(np.concatenate([colours, strip])).save(content, format="PNG", optimize=True)
    return content.getvalue()

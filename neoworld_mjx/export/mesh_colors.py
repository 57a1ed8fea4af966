"""Triangles of meshes with one color each: the mean of textures and of vertex colors."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import SpecError
from ..io.binary_files import open_image

MAX_SAMPLES = 20_000
"""Largest number of triangles at which a texture is sampled."""
MAX_SIDE_PX = 1024
"""Size to which textures are reduced before they are sampled [px]."""
SAME = 0.02
"""Largest difference of colors that count as equal."""
Color = tuple[float, float, float, float]


class Surface(NamedTuple):
    """Part of a mesh file that has one material."""

    vertices: NDArray
    """Vertices, shape [v, 3]."""
    faces: NDArray
    """Triangles, shape [f, 3]."""
    rgba: Color | None = None
    """Color; None if the file states none."""
    metallic: float | None = None
    roughness: float | None = None


def face_weights(vertices: NDArray, faces: NDArray) -> NDArray:
    """Return the share of each triangle in the area of a mesh, shape [f]."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    total = float(area.sum())
    return area / total if total > 0 else np.full(len(faces), 1 / max(len(faces), 1))


def mean_color(colors: NDArray, weights: NDArray, label: str, notes: list[str]) -> NDArray:
    """Return the mean of RGBA colors, and add a note if they differ.

    Args:
        colors: colors of the triangles of a mesh from 0 to 1, shape [f, 4].
        weights: weights that add up to 1, shape [f].
        label: what has these colors, for the note.
        notes: list to which the note is added.

    Returns:
        RGBA, shape [4].
    """
    mean = np.clip(weights @ colors, 0.0, 1.0)
    if np.abs(colors - mean).max() > SAME:
        red, green, blue = mean[:3]
        notes.append(f"{label}: replaced by the mean color ({red:.2f}, {green:.2f}, {blue:.2f})")
    return mean


def texture_color(
    image: Image.Image,
    uv: NDArray,
    vertices: NDArray,
    faces: NDArray,
    notes: list[str],
) -> NDArray:
    """Return the mean color [4] of a texture over the triangles of a mesh.

    Args:
        image: the texture.
        uv: texture coordinates with v upwards, shape [v, 2].
        vertices: vertices, shape [v, 3].
        faces: triangles, shape [f, 3].
        notes: list to which a note is added if the texture has several colors.
    """
    faces = faces[:: len(faces) // MAX_SAMPLES + 1]
    pixels = np.asarray(image.convert("RGBA"), float) / 255
    height, width = pixels.shape[:2]
    u, v = np.nan_to_num(uv)[faces].mean(axis=1).T
    rows = np.floor((1 - v) % 1.0 * height).astype(int) % height
    columns = np.floor(u % 1.0 * width).astype(int) % width
    return mean_color(pixels[rows, columns], face_weights(vertices, faces), "texture", notes)


@contextmanager
def small_image(data: bytes, name: str) -> Iterator[Image.Image]:
    """Open an image of at most `MAX_SIDE_PX` pixels on each side; larger images are reduced."""
    with open_image(data, name, SpecError, large=True) as image:
        image.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
        yield image


def small_png(data: bytes, name: str) -> bytes:
    """Return an untrusted image as a PNG of at most `MAX_SIDE_PX` pixels on each side."""
    stream = io.BytesIO()
    with small_image(data, name) as image:
        image.convert("RGBA").save(stream, "PNG")
    return stream.getvalue()

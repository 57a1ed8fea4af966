"""Appearance of surfaces: colour, gloss and procedural grain by the name of the material."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import body_name
from ..spec import SceneSpec

_METAL = ("steel", "metal", "silver", "chrome", "iron", "alumin", "brass", "copper", "gold", "tin")
_WOOD = ("wood", "oak", "walnut", "pine", "birch", "teak", "bamboo", "beech", "maple", "cherry")
_GLOSSY = ("ceramic", "porcelain", "china", "glaze", "enamel", "glass", "lacquer", "plastic")
_MATTE = ("cloth", "fabric", "paper", "cardboard", "rubber", "felt", "leather", "concrete")


@dataclass(frozen=True)
class Appearance:
    """Optical properties per geom of a model."""

    colour: NDArray
    """Linear rgb, [geom, 3]."""
    gloss: NDArray
    """Share of the surroundings that it mirrors when seen head-on, [geom]."""
    metal: NDArray
    """Whether it mirrors in its own colour and scatters little, bool [geom]."""
    grain: NDArray
    """Whether it shows wood grain, bool [geom]."""
    to_object: NDArray
    """Rotation of geom to object coordinates at rest, [geom, 3, 3]."""
    offset: NDArray
    """Translation of the same [m], [geom, 3]."""


def appearance_of(
    model: mujoco.MjModel, data: mujoco.MjData, scene: SceneSpec | None = None
) -> Appearance:
    """Look up the appearance of each geom.

    Args:
        model: the model; colours are its own.
        data: its pose, from which grain takes its place on an object.
        scene: what the model was made of; without it materials have no names and all are alike.
    """
    n = model.ngeom
    rgba = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    rgba[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    gloss, metal, grain = np.full(n, 0.04), np.zeros(n, bool), np.zeros(n, bool)
    owner = model.geom_bodyid.copy()
    if scene is not None:
        for item in scene.objects:
            for part in item.spec.parts:
                body = model.body(body_name(item, part.name)).id
                for geom in part.geoms:
                    name = f"{item.name}/{geom.name}/visual"
                    g = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
                    if g < 0:
                        continue
                    words = geom.material.lower()
                    metal[g] = any(word in words for word in _METAL)
                    grain[g] = any(word in words for word in _WOOD)
                    if metal[g]:
                        gloss[g] = 0.55
                    elif any(word in words for word in _GLOSSY):
                        gloss[g] = 0.06
                    elif any(word in words for word in _MATTE):
                        gloss[g] = 0.0
                    owner[g] = body
    # Grain lives in the frame of the geom's own body: a drawer keeps its pattern as it slides.
    turn = data.xmat[owner].reshape(n, 3, 3)
    to_object = np.swapaxes(turn, 1, 2)
    offset = -np.einsum("nij,nj->ni", to_object, data.xpos[owner])
    return Appearance(linear(rgba[:, :3]), gloss, metal, grain, to_object, offset)


def albedo(appearance: Appearance, geom: NDArray, point: NDArray) -> NDArray:
    """Return the linear colour [n, 3] of geoms [n] at world points [n, 3] m."""
    colour = appearance.colour[geom]
    rows = np.flatnonzero(appearance.grain[geom])
    if len(rows):
        g = geom[rows]
        local = np.einsum("nij,nj->ni", appearance.to_object[g], point[rows]) + appearance.offset[g]
        colour[rows] *= _wood(local)[:, None]
    return colour


def _wood(p: NDArray) -> NDArray:
    """Brightness about 1 of wood at points [n, 3] m of an object: rings cut lengthwise."""
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    # The tree's axis runs along x a little off the surface, and wanders slowly.
    wander = 0.010 * _noise(np.column_stack([x * 3.0, y * 9.0, z * 9.0]))
    radius = np.hypot(y + 0.7 * wander + 0.013, 1.6 * (z + 0.06) + wander)
    rings = radius * 95.0 + 0.8 * _noise(np.column_stack([x * 5.0, y * 40.0, z * 40.0]))
    wave = rings - np.floor(rings)
    # Early wood darkens slowly into late wood, then the next year begins.
    ring = np.where(wave < 0.8, wave / 0.8, (1.0 - wave) / 0.2)
    fibre = _noise(np.column_stack([x * 30.0, y * 700.0, z * 700.0]))
    return 1.06 - 0.22 * ring * ring + 0.05 * fibre


def _noise(p: NDArray) -> NDArray:
    """Smooth value noise in [-1, 1] at points [n, 3]; integer hashing, so the same everywhere."""
    cell = np.floor(p)
    f = p - cell
    f = f * f * (3.0 - 2.0 * f)
    i = cell.astype(np.int64)
    total = np.zeros(len(p))
    for corner in range(8):
        bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        weight = np.prod(np.where(bits, f, 1.0 - f), axis=1)
        total += weight * _hash(i + bits)
    return total


def _hash(i: NDArray) -> NDArray:
    h = i[:, 0] * 73856093 ^ i[:, 1] * 19349663 ^ i[:, 2] * 83492791
    h = (h ^ (h >> 13)) * 1274126177 & 0xFFFFFFFF
    h = (h ^ (h >> 16)) & 0xFFFF
    return h / 32767.5 - 1.0


def linear(colour: NDArray) -> NDArray:
    """Turn display (sRGB) colour in [0, 1] into linear light."""
    c = np.asarray(colour, float)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


_STEPS = 8192
_light = np.linspace(0.0, 1.0, _STEPS)
_DISPLAY = np.round(
    255 * np.where(_light <= 0.0031308, 12.92 * _light, 1.055 * _light ** (1 / 2.4) - 0.055)
).astype(np.uint8)


def display(light: NDArray) -> NDArray:
    """Turn linear light into display colour, uint8, rolling off softly towards 1 and above."""
    x = np.maximum(light, 0.0)
    knee = 0.7
    over = x - knee
    rolled = knee + (1.0 - knee) * over / (over + (1.0 - knee))
    x = np.where(x > knee, rolled, x)
    return _DISPLAY[np.round(x * (_STEPS - 1)).astype(np.int64)]


__all__ = ["Appearance", "albedo", "appearance_of", "display", "linear"]

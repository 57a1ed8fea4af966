"""Lighting: a soft key light and a sky, with shadows and ambient occlusion.

Each light is sampled at 16 points. The 16 pixels of a 4 x 4 tile trace one shadow ray per light,
each to a different sample point. The average over neighboring pixels of the same surface combines
all 16 samples at the cost of one shadow ray per pixel and light.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .appearance import linear
from .ray_caster import RayCaster
from .view import View

TILE = 4
FLOOR = -2
"""Id of the floor in arrays of geom ids."""

# The lights add up to about 1 on horizontal surfaces and on surfaces that face the camera, so these
# show the color of their material. Surfaces that face away from both lights are half as bright.
KEY_COLOUR = np.array([1.03, 1.0, 0.94]) * 0.82
SKY_COLOUR = np.array([0.95, 0.99, 1.06]) * 0.5
BOUNCE_COLOUR = np.array([1.02, 1.0, 0.97]) * 0.58
ZENITH, HORIZON = linear(np.array([0.72, 0.76, 0.81])), linear(np.array([0.90, 0.91, 0.92]))
GROUND = linear(np.array([0.74, 0.73, 0.72]))
AMBIENT = 0.65
"""Mean brightness of reflected surroundings. The color of a material already includes it, so only
brighter reflections add a highlight."""
FLOOR_COLOUR = linear(np.array([0.74, 0.735, 0.73]))


@dataclass(frozen=True)
class Lights:
    """Sample points of the key light and of the sky, far from the scene."""

    key: NDArray
    """Sample points of the key light [m], shape [16, 3]."""
    key_direction: NDArray
    """Unit vector [3] towards the key light."""
    sky: NDArray
    """Sample points of the sky [m], shape [16, 3]."""
    sky_directions: NDArray
    """Unit vectors towards the sample points of the sky, shape [16, 3]."""


def lights(view: View, centre: NDArray, reach: float) -> Lights:
    """Return a key light, which shines from behind the camera, above and to the left, and a sky.

    Args:
        view: the camera.
        centre: center of the scene [m], shape [3].
        reach: radius of the scene [m].
    """
    forward = view.axes[:, 2] * [1.0, 1.0, 0.0]
    if np.linalg.norm(forward) < 1e-6:
        forward = -view.axes[:, 1] * [1.0, 1.0, 0.0]
    forward = forward / np.linalg.norm(forward)
    left = np.array([-forward[1], forward[0], 0.0])
    towards = 0.6 * left - 0.8 * forward + [0.0, 0.0, 1.0]
    towards = towards / np.linalg.norm(towards)
    u = np.cross(towards, [0.0, 0.0, 1.0])
    u = u / np.linalg.norm(u)
    v = np.cross(towards, u)
    n = TILE * TILE
    k = np.arange(n)
    # The stride through the sunflower pattern keeps the samples of adjacent pixels far apart.
    spread = (k * 7) % n
    radius, angle = np.sqrt((spread + 0.5) / n), spread * math.pi * (3 - math.sqrt(5))
    disc = radius[:, None] * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    far = 12.0 * reach
    height = 1.0 - (spread + 0.5) / n * 0.92
    level = np.sqrt(1.0 - height**2)
    dome = np.column_stack([level * np.cos(angle), level * np.sin(angle), height])
    return Lights(centre + far * (towards + 0.075 * disc), towards, centre + far * dome, dome)


def visibility(
    caster: RayCaster,
    sources: Lights,
    surface: NDArray,
    point: NDArray,
    normal: NDArray,
    depth: NDArray,
) -> tuple[NDArray, NDArray]:
    """Return the fractions of the key light and of the sky that each pixel sees, both [h, w].

    Args:
        caster: ray caster of the model.
        sources: the lights.
        surface: geom id of each pixel, FLOOR, or -1 for the background, shape [h, w].
        point: points on the surfaces [m], shape [h, w, 3].
        normal: normals of the surfaces, shape [h, w, 3].
        depth: depth along the view [m], shape [h, w]. The offset of shadow rays is proportional to
            the depth.
    """
    h, w = surface.shape
    # Facets lie inside the smooth surface. The offset prevents them from shadowing themselves.
    lifted = point + normal * (np.where(np.isfinite(depth), depth, 0.0) * 1.0e-3)[..., None]
    key, key_weight = np.zeros((h, w)), np.zeros((h, w))
    sky, sky_weight = np.zeros((h, w)), np.zeros((h, w))
    for k in range(TILE * TILE):
        tile = (slice(k // TILE, None, TILE), slice(k % TILE, None, TILE))
        facing_key = normal[tile] @ sources.key_direction
        facing_sky = np.maximum(normal[tile] @ sources.sky_directions[k], 0.0)
        for value, weight, source, share in (
            (key, key_weight, sources.key[k], (facing_key > 0).astype(float)),
            (sky, sky_weight, sources.sky[k], facing_sky),
        ):
            # Surfaces that face away from the light need no ray.
            lit = share > 0
            value[tile][lit] = share[lit] * caster.visible(source, lifted[tile][lit])
            weight[tile] = share
    fields = np.stack([key, key_weight, sky, sky_weight], axis=-1)
    # Two asymmetric passes give a mean that is centered on the pixel.
    fields = _mean(fields, ((-1, 0, 1, 2), (-2, -1, 0, 1)), surface, point, normal, depth)
    # Sky visibility has no sharp edges, so it is smoothed more.
    sky_fields = _mean(fields[..., 2:], ((-4, 0, 4), (-8, 0, 8)), surface, point, normal, depth)
    return (
        fields[..., 0] / np.maximum(fields[..., 1], 1e-9),
        sky_fields[..., 0] / np.maximum(sky_fields[..., 1], 1e-9),
    )


def _mean(
    fields: NDArray,
    passes: tuple[tuple[int, ...], ...],
    surface: NDArray,
    point: NDArray,
    normal: NDArray,
    depth: NDArray,
) -> NDArray:
    """Average fields [h, w, c] over shifted pixels that show the same smooth surface."""
    reach = 0.01 * np.where(np.isfinite(depth), depth, 1.0)
    for shifts in passes:
        for axis in (0, 1):
            total, count = np.zeros_like(fields), np.zeros(surface.shape)
            for shift in shifts:
                near = _shift(surface, shift, axis, -3)
                same = near == surface
                if shift:
                    gap = _dot(_shift(point, shift, axis, 0.0) - point, normal)
                    same &= np.abs(gap) < reach
                    same &= _dot(_shift(normal, shift, axis, 0.0), normal) > 0.8
                total += np.where(same[..., None], _shift(fields, shift, axis, 0.0), 0.0)
                count += same
            fields = total / np.maximum(count, 1)[..., None]
    return fields


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return np.einsum("...x,...x->...", a, b)


def _shift(a: NDArray, by: int, axis: int, fill: float | int) -> NDArray:
    if by == 0:
        return a
    out = np.full_like(a, fill)
    to: list[slice] = [slice(None)] * a.ndim
    source = list(to)
    to[axis] = slice(max(0, -by), a.shape[axis] - max(0, by))
    source[axis] = slice(max(0, by), a.shape[axis] - max(0, -by))
    out[tuple(to)] = a[tuple(source)]
    return out


def surroundings(direction: NDArray, key_direction: NDArray | None = None) -> NDArray:
    """Return the light [n, 3] that arrives from each direction: a bright sky over a gray ground.

    Args:
        direction: unit vectors [n, 3].
        key_direction: unit vector towards the key light, which adds a soft bright spot; if None,
            omit the spot.
    """
    z = direction[..., 2:3]
    up = np.clip(z, 0.0, 1.0)
    sky = HORIZON + (ZENITH - HORIZON) * up * (2.0 - up)
    blend = np.clip(0.5 + z * 4.0, 0.0, 1.0)
    light = GROUND + (sky - GROUND) * blend * blend * (3.0 - 2.0 * blend)
    if key_direction is not None:
        near = np.clip((direction @ key_direction - 0.93) / 0.06, 0.0, 1.0)
        light = light + (near * near * (3.0 - 2.0 * near))[..., None] * KEY_COLOUR * 1.6
    return light


def shade(
    colour: NDArray,
    gloss: NDArray,
    metal: NDArray,
    normal: NDArray,
    towards_eye: NDArray,
    key: NDArray,
    sky: NDArray,
    key_direction: NDArray,
    opacity: NDArray | None = None,
    behind: NDArray | None = None,
) -> NDArray:
    """Return the light [n, 3] that surfaces emit towards the eye.

    Args:
        colour: linear albedo [n, 3].
        gloss: reflectance at normal incidence [n].
        metal: whether reflections have the color of the surface, bool [n].
        normal: unit normals [n, 3].
        towards_eye: unit vectors towards the eye [n, 3].
        key: visible fraction of the key light [n].
        sky: visible fraction of the sky [n].
        key_direction: unit vector [3] towards the key light.
        opacity: opacity of the surfaces [n]; if None, the surfaces are opaque.
        behind: light from behind the surfaces [n, 3], used together with `opacity`.
    """
    facing = np.clip(normal @ key_direction, 0.0, 1.0) * key
    up = 0.5 + 0.5 * normal[:, 2]
    sky = 0.15 + 0.85 * sky
    light = (
        facing[:, None] * KEY_COLOUR
        + (up * sky)[:, None] * SKY_COLOUR
        + ((1.0 - up) * (0.4 + 0.6 * sky))[:, None] * BOUNCE_COLOUR
    )
    cosine = np.clip(np.sum(normal * towards_eye, axis=1), 0.0, 1.0)
    grazing = (1.0 - cosine) ** 5
    mirror = 2.0 * cosine[:, None] * normal - towards_eye
    mirrored = surroundings(mirror, key_direction) * (0.25 + 0.75 * np.maximum(sky, key))[:, None]
    share = np.where(gloss > 0, gloss + (1.0 - gloss) * grazing * 0.5, 0.0)[:, None]
    body = colour * light
    if opacity is not None and behind is not None:
        body = opacity[:, None] * body + (1.0 - opacity)[:, None] * behind
    highlight = np.maximum(mirrored - AMBIENT, 0.0)
    highlight = np.where(metal[:, None], colour * mirrored / AMBIENT - body, highlight)
    return body + share * highlight

"""Render color, depth, normals and object masks by ray casting, without OpenGL.

Depth, normals and segmentation describe the first surface, transparent or opaque, on the ray
through the center of each pixel. Color is supersampled only at edges, that is, in pixels with a
neighbor that shows another surface. Transparent surfaces, such as glass, are composited from back
to front; only the front of each transparent geom is rendered, without refraction.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import start_data, to_mjspec
from ..spec import Camera, SceneSpec
from ..spec.scene import Backdrop
from .appearance import Appearance, albedo, appearance_of, display, linear
from .lighting import FLOOR, FLOOR_COLOUR, Lights, lights, shade, surroundings, visibility
from .ray_caster import Hits, RayCaster
from .view import View


@dataclass(frozen=True)
class Layers:
    """Hits on transparent geoms in front of opaque ones, sorted by ray, then from back to front."""

    ray: NDArray
    """Index of the ray of each hit, shape [hit]."""
    hits: Hits
    """The hits; their rows correspond to the entries of `ray`."""

    @classmethod
    def cast(
        cls,
        caster: RayCaster,
        eye: NDArray,
        rays: NDArray,
        reach: NDArray,
        *,
        smooth: bool = True,
    ) -> "Layers":
        """Return the hits of rays [n, 3] on transparent geoms at distances below `reach` [n]."""
        parts = caster.layers(eye, rays, smooth=smooth)
        ray = np.concatenate([np.zeros(0, np.int64), *(rows for rows, _ in parts)])
        hits = Hits(
            geom=np.concatenate([np.zeros(0, np.int32), *(h.geom for _, h in parts)]),
            distance=np.concatenate([np.zeros(0), *(h.distance for _, h in parts)]),
            point=np.concatenate([np.zeros((0, 3)), *(h.point for _, h in parts)]),
            normal=np.concatenate([np.zeros((0, 3)), *(h.normal for _, h in parts)]),
        )
        before = np.flatnonzero(hits.distance < reach[ray])
        order = before[np.lexsort((-hits.distance[before], ray[before]))]
        return cls(ray[order], hits.rows(order))

    def over(self, light: NDArray, paint: Callable[[NDArray, NDArray], NDArray]) -> NDArray:
        """Return the light [n, 3] along each ray after it passes through all layers.

        Args:
            light: light from opaque surfaces along each ray, shape [n, 3].
            paint: function that receives the indices of hits [k] and the light behind these hits
                [k, 3], and returns the light in front of them [k, 3].
        """
        if not len(self.ray):
            return light
        light = light.copy()
        first = np.searchsorted(self.ray, self.ray, side="left")
        rank = np.arange(len(self.ray)) - first
        for k in range(int(rank.max()) + 1):
            chosen = np.flatnonzero(rank == k)
            rows = self.ray[chosen]
            light[rows] = paint(chosen, light[rows])
        return light

    def nearest(self) -> NDArray:
        """Return the index of the nearest hit of each ray that hits a transparent geom."""
        return np.flatnonzero(np.append(self.ray[1:] != self.ray[:-1], len(self.ray) > 0))


OPEN_SKY = 0.8
"""Fraction of the sky that is assumed visible from transparent surfaces, and from all surfaces if
shadows are omitted."""


@dataclass(frozen=True)
class RenderedImage:
    """Rendered image of a scene with depth, normals and object masks.

    In all arrays but `color`, the floor counts as background.
    """

    color: NDArray
    """Display color (sRGB), uint8 [h, w, 3]."""
    depth: NDArray
    """Depth along the optical axis [m], float64 [h, w]; inf for the background."""
    normal: NDArray
    """Outward unit normal in the world frame, float64 [h, w, 3]; zero for the background."""
    segmentation: NDArray
    """Index of the object, int32 [h, w]; -1 for the background."""
    names: tuple[str, ...]
    """Names of the objects, by the index in `segmentation`."""
    geoms: NDArray
    """Index of the geom, int32 [h, w]; -1 for the background."""
    geom_names: tuple[str, ...]
    """Names of the geoms, by the index in `geoms`."""


def render(
    scene: SceneSpec | tuple[mujoco.MjModel, mujoco.MjData],
    camera: Camera | View,
    *,
    width: int | None = None,
    height: int | None = None,
    spec: SceneSpec | None = None,
    supersample: int = 2,
    floor: bool = True,
    shadows: bool = True,
) -> RenderedImage:
    """Render a scene or a posed model.

    If only one of `width` and `height` is given, the other is computed from the aspect ratio of a
    `Camera`; for a `View`, it is the size stored in the view.

    Args:
        scene: a scene, rendered at its poses and joint states, or a model and its data after
            `mj_kinematics`. If a model has geoms in group 1, only these are rendered. Each child
            body of the world, with its descendants, is one object, in the order of the model.
        camera: the camera.
        width: width [px].
        height: height [px].
        spec: the scene of a posed model, for its patterns, prints and backdrop.
        supersample: rays per pixel along each axis, at edges only; 1 disables antialiasing.
        floor: if True, render a plain floor below all objects, and the scene's backdrop. Neither
            counts as an object.
        shadows: if False, omit shadows. This halves the rendering time and affects only the colors.
    """
    if isinstance(camera, Camera):
        view = View.of(camera, width, height)
    else:
        view = camera.resized(width or camera.width, height or camera.height)
    spec = scene if isinstance(scene, SceneSpec) else spec
    model, data = compile_posed(scene) if isinstance(scene, SceneSpec) else scene
    caster = RayCaster(model, data)
    backdrop = None if spec is None or not floor else spec.backdrop
    stage = _Stage.of(caster, appearance_of(model, data, spec), view, floor, backdrop)

    rows, columns = np.mgrid[: view.height, : view.width]
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1)
    cast = stage.cast(view.rays(pixels.reshape(-1, 2)))
    shape = (view.height, view.width)
    surface = cast.surface.reshape(shape)
    point, normal = cast.hits.point.reshape(*shape, 3), cast.hits.normal.reshape(*shape, 3)
    depth = ((cast.hits.point - view.eye) @ view.axes[:, 2]).reshape(shape)
    depth = np.where(surface == -1, np.inf, depth)
    key, sky = np.ones(shape), np.full(shape, OPEN_SKY)
    if shadows:
        key, sky = visibility(caster, stage.lights, surface, point, normal, depth)
    light = stage.shade(cast, key.ravel(), sky.ravel()).reshape(*shape, 3)
    color = display(light)
    if supersample > 1:
        edge = _edges(surface, point, normal, depth)
        if len(cast.layers.ray):
            edge |= _edges(*stage.front(cast, shape))
        _smooth_edges(color, edge, stage, surface, point, normal, key, sky, supersample)
    surface, point, normal, depth = stage.front(cast, shape)
    objects, names = object_of_geoms(model)
    hit = surface >= 0
    return RenderedImage(
        color=color,
        depth=np.where(hit, depth, np.inf),
        normal=np.where(hit[..., None], normal, 0.0),
        segmentation=np.where(hit, objects[np.maximum(surface, 0)], -1).astype(np.int32),
        names=names,
        geoms=np.where(hit, surface, -1).astype(np.int32),
        geom_names=tuple(model.geom(g).name for g in range(model.ngeom)),
    )


def compile_posed(scene: SceneSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile a scene with visual geoms; set the data to the scene's poses and joint states."""
    model = to_mjspec(scene, visual=True).compile()
    data = start_data(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def object_of_geoms(model: mujoco.MjModel) -> tuple[NDArray, tuple[str, ...]]:
    """Return the index of each geom's object (-1 for the world), and the names of the objects."""
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    index = np.full(model.nbody, -1)
    index[roots] = np.arange(len(roots))
    root_of = model.body_rootid[model.geom_bodyid]
    return index[root_of], tuple(model.body(b).name for b in roots)


@dataclass(frozen=True)
class _RayHits:
    rays: NDArray
    hits: Hits
    surface: NDArray
    """Id of the first opaque geom, FLOOR, or -1 for the background, shape [n]."""
    layers: Layers
    """Hits on transparent geoms in front of the surface."""


@dataclass(frozen=True)
class _Stage:
    caster: RayCaster
    appearance: Appearance
    view: View
    lights: Lights
    centre: NDArray
    reach: float
    ground: float | None
    """Height of the floor [m]; None if there is no floor."""
    backdrop: Backdrop | None

    @classmethod
    def of(
        cls,
        caster: RayCaster,
        appearance: Appearance,
        view: View,
        floor: bool,
        backdrop: Backdrop | None,
    ) -> "_Stage":
        model, data = caster.model, caster.data
        shown = np.flatnonzero(caster.shown & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE))
        turn = data.geom_xmat[shown].reshape(-1, 3, 3)
        middle = np.einsum("nij,nj->ni", turn, model.geom_aabb[shown, :3]) + data.geom_xpos[shown]
        half = np.einsum("nij,nj->ni", np.abs(turn), model.geom_aabb[shown, 3:])
        low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
        centre, reach = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        return cls(
            caster,
            appearance,
            view,
            lights(view, centre, reach),
            centre,
            reach,
            float(low[2]) if floor else None,
            backdrop,
        )

    def cast(self, rays: NDArray) -> _RayHits:
        hits = self.caster.hits(self.view.eye, rays, opaque=True)
        reach = hits.distance.copy()
        surface = hits.geom.astype(np.int64)
        down = rays[:, 2] < -1e-6
        if self.ground is not None and self.view.eye[2] > self.ground and down.any():
            distance = (self.ground - self.view.eye[2]) / np.where(down, rays[:, 2], -1.0)
            floor = (surface < 0) & down & (distance < 40.0 * self.reach)
            if self.backdrop is not None and self.view.eye[0] < self.backdrop.x:
                floor &= self.view.eye[0] + rays[:, 0] * distance < self.backdrop.x
            surface[floor] = FLOOR
            hits.point[floor] = self.view.eye + rays[floor] * distance[floor, None]
            hits.normal[floor] = [0.0, 0.0, 1.0]
            reach[floor] = distance[floor]
        layers = Layers.cast(self.caster, self.view.eye, rays, reach)
        return _RayHits(rays, hits, surface, layers)

    def front(
        self, cast: _RayHits, shape: tuple[int, int]
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return the id, point, normal and depth of the first surface of each pixel."""
        surface, point = cast.surface.copy(), cast.hits.point.copy()
        normal = cast.hits.normal.copy()
        nearest = cast.layers.nearest()
        rows, hits = cast.layers.ray[nearest], cast.layers.hits
        surface[rows], point[rows] = hits.geom[nearest], hits.point[nearest]
        normal[rows] = hits.normal[nearest]
        depth = np.where(surface == -1, np.inf, (point - self.view.eye) @ self.view.axes[:, 2])
        return (
            surface.reshape(shape),
            point.reshape(*shape, 3),
            normal.reshape(*shape, 3),
            depth.reshape(shape),
        )

    def shade(self, cast: _RayHits, key: NDArray, sky: NDArray) -> NDArray:
        """Return the light along each ray, multiplied by the camera's gain, shape [n, 3]."""
        light = surroundings(cast.rays)
        if self.backdrop is not None and self.view.eye[0] < self.backdrop.x:
            # The backdrop extends upwards and sideways without end. Its color includes lighting.
            light[cast.rays[:, 0] > 0] = self._floor_color()
        body = np.flatnonzero(cast.surface >= 0)
        light[body] = self._shade_hits(cast.hits, body, cast.rays[body], key[body], sky[body])
        floor = np.flatnonzero(cast.surface == FLOOR)
        n = len(floor)
        lit = shade(
            np.tile(self._floor_color(), (n, 1)),
            np.zeros(n),
            np.zeros(n, bool),
            cast.hits.normal[floor],
            -cast.rays[floor],
            key[floor],
            sky[floor],
            self.lights.key_direction,
        )
        if self.backdrop is not None:
            light[floor] = lit
            return self._through(cast, light) * self.view.gain
        # The floor fades into the horizon.
        away = np.linalg.norm((cast.hits.point[floor] - self.centre)[:, :2], axis=1) / self.reach
        fade = np.clip((away - 2.0) / 10.0, 0.0, 1.0)[:, None]
        light[floor] = lit + (surroundings(cast.rays[floor] * [1, 1, 0]) - lit) * fade
        return self._through(cast, light) * self.view.gain

    def _floor_color(self) -> NDArray:
        """Return the linear color [3] of the floor: the color of the backdrop, if there is one."""
        if self.backdrop is None:
            return FLOOR_COLOUR
        return linear(np.array(self.backdrop.rgb)) / self.view.gain

    def _through(self, cast: _RayHits, light: NDArray) -> NDArray:
        """Return the light [n, 3] after it passes through transparent surfaces."""
        layers, hits = cast.layers, cast.layers.hits
        lifted = hits.point + hits.normal * (1e-3 * hits.distance)[:, None]
        key = self.caster.visible(self.lights.key[0], lifted)

        def paint(k: NDArray, behind: NDArray) -> NDArray:
            rays, sky = cast.rays[layers.ray[k]], np.full(len(k), OPEN_SKY)
            opacity = self.caster.alpha[hits.geom[k]]
            return self._shade_hits(hits, k, rays, key[k], sky, opacity, behind)

        return layers.over(light, paint)

    def _shade_hits(
        self,
        hits: Hits,
        rows: NDArray,
        rays: NDArray,
        key: NDArray,
        sky: NDArray,
        opacity: NDArray | None = None,
        behind: NDArray | None = None,
    ) -> NDArray:
        """Return the light [k, 3] from the hits with the given indices [k]."""
        geom, normal = hits.geom[rows], hits.normal[rows]
        pixel = hits.distance[rows] / self.view.focal
        colour = albedo(self.appearance, geom, hits.point[rows], normal, pixel)
        # Colors of the photograph already include its exposure, so the gain must not change them.
        colour[self.appearance.photographed[geom]] /= self.view.gain
        return shade(
            colour,
            self.appearance.gloss[geom],
            self.appearance.metal[geom],
            normal,
            -rays,
            key,
            sky,
            self.lights.key_direction,
            opacity,
            behind,
        )


def _edges(surface: NDArray, point: NDArray, normal: NDArray, depth: NDArray) -> NDArray:
    """Return a mask of the pixels [h, w] with a neighbor that shows another surface or a crease."""
    edge = np.zeros(surface.shape, bool)
    for axis in (0, 1):
        every = (slice(None),) * axis
        a, b = (*every, slice(None, -1)), (*every, slice(1, None))
        differs = surface[a] != surface[b]
        differs |= np.sum(normal[a] * normal[b], axis=-1) < 0.9
        gap = np.abs(np.sum((point[a] - point[b]) * normal[a], axis=-1))
        differs |= gap > 0.02 * np.minimum(depth[a], depth[b])
        differs &= (surface[a] != -1) | (surface[b] != -1)
        edge[a] |= differs
        edge[b] |= differs
    return edge


def _smooth_edges(
    color: NDArray,
    edge: NDArray,
    stage: _Stage,
    surface: NDArray,
    point: NDArray,
    normal: NDArray,
    key: NDArray,
    sky: NDArray,
    supersample: int,
) -> None:
    """Replace the color of edge pixels by the mean over several rays, in place."""
    rows, columns = np.nonzero(edge)
    if not len(rows):
        return
    step = (np.arange(supersample) + 0.5) / supersample
    du, dv = (grid.ravel() for grid in np.meshgrid(step, step))
    u = (columns[:, None] + du).ravel()
    v = (rows[:, None] + dv).ravel()
    cast = stage.cast(stage.view.rays(np.column_stack([u, v])))
    row, column = np.repeat(rows, len(du)), np.repeat(columns, len(du))
    best = np.full(len(row), np.inf)
    lit, open_ = key[row, column].copy(), sky[row, column].copy()
    h, w = surface.shape
    # Each ray takes the shadows of the nearest neighboring pixel on the same surface.
    for i in (0, -1, 1):
        for j in (0, -1, 1):
            r, c = np.clip(row + i, 0, h - 1), np.clip(column + j, 0, w - 1)
            distance = np.linalg.norm(point[r, c] - cast.hits.point, axis=1)
            normal_change = 1.0 - np.sum(normal[r, c] * cast.hits.normal, axis=1)
            cost = np.where(
                surface[r, c] == cast.surface, distance * (1.0 + 20.0 * normal_change), np.inf
            )
            better = cost < best
            best[better] = cost[better]
            lit[better], open_[better] = key[r, c][better], sky[r, c][better]
    shaded = stage.shade(cast, lit, open_).reshape(len(rows), -1, 3)
    # The mean of display colors antialiases the edges of bright surfaces.
    total = display(shaded).astype(np.int64).sum(axis=1)
    color[rows, columns] = ((2 * total + len(du)) // (2 * len(du))).astype(np.uint8)

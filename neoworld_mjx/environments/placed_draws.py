"""Draws where contacts place them, and how far they move in the image."""

import math
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float, Int

from ..estimate.unknowns import Unknowns
from ..physics.layout import Candidates, Layout, Poses
from ..physics.posterior import Draws
from ..render import visible_surface
from ..spec import Camera
from ..spec.pose import matrix
from .contact_draws import SceneContacts

PIXEL_WIDTH = 640
"""Width of the image in which displacements are measured [px]."""
MAX_SHARE = 0.05
"""Additional displacement, relative to the diagonal of the box: the estimate allows a program to be
wrong in its proportions by a few percent, so sizes vary as much."""


class PlacedDraws(Candidates):
    """Draws where contacts place them."""

    drawn: Draws
    """The draws before contacts."""
    layouts: Layout
    poses: Poses
    camera: Float[np.ndarray, "n 4"]
    """Changes of the camera with contacts, in the units of `Draws.camera`."""
    excess_px: Float[np.ndarray, "n object"]
    """Displacement of each object's 2D box beyond the limit, as in `SceneSamples.shift_px`."""

    @classmethod
    def of(cls, contacts: SceneContacts, drawn: Draws, max_px: float) -> "PlacedDraws":
        """Place draws."""
        kept = contacts.kept(drawn)
        layouts = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), kept.layouts)
        poses = replace(contacts.scene.place_exactly(layouts), variation=drawn.variation)
        excess = np.full(poses.scale.shape, -math.inf)
        if math.isfinite(max_px):
            _, excess = box_shifts(contacts, poses, kept.camera, max_px)
        return cls(drawn, layouts, poses, kept.camera, excess)

    def replaced(self, rows: Int[np.ndarray, " m"], others: "PlacedDraws") -> "PlacedDraws":
        """Return these draws with others in some rows."""
        index = np.arange(len(self.excess_px))
        index[rows] = len(index) + np.arange(len(rows))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[index], self, others)


def moved_camera(unknowns: Unknowns, change: Float[np.ndarray, " 4"]) -> Camera | None:
    """Return the camera of a draw, None without a camera; see `posterior.Draws.camera`.

    A change of the focal length also moves the camera along its view, so that the middle of the
    scene keeps its size in the image. The alignment moves the scene instead of the camera.
    """
    c = unknowns.scene.camera
    if c is None:
        return None
    moved, ahead = unknowns.camera_at(change)
    xy = (c.xy[0] - ahead * math.cos(c.yaw), c.xy[1] - ahead * math.sin(c.yaw))
    return moved.model_copy(update={"xy": xy})


def box_shifts(
    contacts: SceneContacts, poses: Poses, camera: Float[np.ndarray, "n 4"], max_px: float
) -> tuple[Float[np.ndarray, "n object"], Float[np.ndarray, "n object"]]:
    """Return how far each object's 2D box moved from the scene's, and how far beyond the limit.

    Both are in pixels of an image `PIXEL_WIDTH` wide; supports, and scenes without a camera, do not
    move.
    """
    model = contacts.scene
    spec, shifts = model.spec, np.zeros(poses.scale.shape)
    diagonals = np.zeros(len(spec.objects))
    if spec.camera is None:
        return shifts, shifts - max_px
    cameras = [moved_camera(contacts.unknowns, change) for change in camera]
    per_px = PIXEL_WIDTH / spec.camera.width
    before = model.poses()
    pose = lambda p, k, n: (np.asarray(p.pos)[k, n], matrix(np.asarray(p.quat)[k, n]).T)
    for n, item in enumerate(spec.objects):
        if item.environment:
            continue
        vertices, _ = visible_surface(item.spec, item.joint_state)
        pos, turn = pose(before, 0, n)
        box = _box(spec.camera, pos + vertices @ turn)
        diagonals[n] = per_px * float(np.hypot(*(box[2:] - box[:2])))
        for k, seen_by in enumerate(cameras):
            assert seen_by is not None
            sized = float(poses.scale[k, n]) * vertices
            pos, turn = pose(poses, k, n)
            shifts[k, n] = per_px * np.abs(_box(seen_by, pos + sized @ turn) - box).max()
    return shifts, shifts - max_px - MAX_SHARE * diagonals


def _box(camera: Camera, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 4"]:
    """Return the 2D box of points, clipped to the image [px]."""
    pixels, _ = camera.project(points)
    size = np.array([camera.width, camera.height_px])
    box = np.clip([pixels.min(axis=0), pixels.max(axis=0)], 0, size)
    return np.asarray(box).ravel()

"""The least-squares problem of the fit: unknowns of camera and boxes, residuals, and Jacobian."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..measure import SidesShown
from ..spec import Box3D, Camera, SceneTree, TreeNode
from ..spec.pose import rotate
from .prior_widths import (
    camera_spread,
    place_information,
    rests_on_slab,
    shift_inside,
    side_tolerance,
    size_spread,
    wall_normal,
    yaw_spread,
)
from .projection import NEAR_M, Silhouette, silhouette_of
from .sides import EDGE, hidden_sides
from .wireframe import Wireframe, extents_in_picture, hull_wireframe, near_border

CAMERA = 2
"""Unknowns of the camera; each object has seven."""
STEP = 1e-7
"""Step of finite differences, in m, log or rad."""
TOLERATED = 1.0
"""Miss of a side, in standard deviations, that moves nothing."""
BEYOND = 5.0
"""Miss of a side of a partly hidden object, in standard deviations, from which on it is hidden."""
BASE = 0.03
"""Height over the lowest point, over the object's height, up to which points count as its foot."""
OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])


class FitProblem:
    """The unknowns of a tree and their residuals.

    Unknowns: camera (pitch [rad], log height), each over its standard deviation, then per object
    (x, y, z [m], log length, width, height, yaw [rad]). An object with a real shape keeps its
    proportions: its log length is that of its scale, and the next two stay 0.
    """

    def __init__(
        self,
        tree: SceneTree,
        objects: Sequence[TreeNode],
        shapes: Mapping[str, Wireframe] | None = None,
        shown: Mapping[str, SidesShown] | None = None,
    ) -> None:
        """Set up the problem at the tree's own values.

        Args:
            tree: the answer.
            objects: the nodes to fit, carriers first.
            shapes: real surfaces [m] by name, untilted, in the frame of `Box3D`, its position at
                their origin; other objects have the outline of their category.
            shown: which sides the real shapes show, see `hidden_sides`.
        """
        self.initial, self.objects = tree, list(objects)
        shapes, shown = shapes or {}, shown or {}
        camera = tree.camera
        names = [node.name for node in objects]
        self.rigid = np.array([name in shapes for name in names])
        self.camera_spread = camera_spread(tree)
        self.sizes = np.array(
            [np.ones(3) if n.name in shapes else np.array(n.box3d.size) for n in objects]
        )
        self.heights = np.array([node.box3d.size[2] for node in objects])
        self.places = np.array([node.box3d.position for node in objects])
        self.yaws = np.array([node.box3d.yaw for node in objects])
        self.tilts = np.array([node.base_tilt for node in objects])
        self.boxes = np.array([node.box2d.as_tuple() for node in objects])
        silhouettes = [
            Silhouette(shapes[n.name].hull, shapes[n.name].hull, shapes[n.name].hull)
            if n.name in shapes
            else silhouette_of(n)
            for n in objects
        ]
        self.inner, self.outer, self.lowest = (
            _stacked([getattr(s, kind) for s in silhouettes])
            for kind in ("inner", "outer", "lowest")
        )
        self.hidden = np.array([hidden_sides(tree, node, shown.get(node.name)) for node in objects])
        self.tolerance = np.array([side_tolerance(camera, node) for node in objects])
        contacts = [node.cues.contact or (np.nan, np.nan) for node in objects]
        self.contacts = np.array(contacts, float)
        spreads = [size_spread(node) for node in objects]
        self.scale_spread = np.array([whole for whole, _ in spreads])
        self.edge_spread = np.array([edges for _, edges in spreads])
        self.yaw_spread = np.array([yaw_spread(node) for node in objects])
        self.normals = np.array([wall_normal(tree, node) for node in objects])
        self.information = np.array([place_information(tree, node) for node in objects])
        self.parents = np.array(
            [names.index(n.parent) if n.parent in names else -1 for n in objects]
        )
        self.levels = np.zeros(len(objects), int)
        for i, parent in enumerate(self.parents):
            self.levels[i] = self.levels[parent] + 1 if parent >= 0 else 0
        self.round = np.array(
            [n.name not in shapes and s.round for n, s in zip(objects, silhouettes, strict=True)]
        )
        zero = np.zeros((len(objects), 3))
        self.values = np.concatenate([self.places, zero, self.yaws[:, None]], axis=1)
        self.cut = {
            i: [self._trimmed(i, shapes[node.name])]
            if node.name in shapes
            else [hull_wireframe(points) for points in (silhouettes[i].inner, silhouettes[i].outer)]
            for i, node in enumerate(objects)
            if self._may_be_cut(i)
        }
        # An outline far beyond a side tells that something hides the rest, whatever the shapes show
        # where the answer puts them.
        far = self.misses(self.start())[:, :4] < -BEYOND * self.tolerance
        may_hide = np.array([node.occluded and node.name in shown for node in objects])
        self.hidden |= far & may_hide[:, None]
        rests = np.array([self._rest(node) for node in objects])
        # A visible object is where the picture shows it; a hidden one goes with its carrier, and
        # so does what is in another one.
        inside = np.array([node.relation == "in" for node in objects])
        carried = np.where(inside, 1.0, self.hidden.mean(axis=1))
        self.carried = np.column_stack([carried, carried, np.ones(len(objects))])
        self.offsets = self.places - self.carriers(self.values)
        self.offsets[:, 2] += rests
        # What is in another thing is looked for there, though the answer may have it beside.
        held = self.parents >= 0
        self.offsets[held, :2] += np.array([shift_inside(tree, node) for node in objects])[held]

    def start(self) -> Float[np.ndarray, " u"]:
        """Return the unknowns of the answer."""
        return np.concatenate([np.zeros(CAMERA), self.values.ravel()])

    def free(self, kept: Bool[np.ndarray, " n"], *, camera: bool) -> Int[np.ndarray, " f"]:
        """Return the indices of the unknowns to solve for.

        Args:
            kept: objects that stay as they are.
            camera: whether the camera moves.
        """
        free = np.ones((len(self.objects), 7), bool)
        free[self.rigid, 4:6] = False
        free[self.round | self.normals.any(axis=1), 6] = False
        free[kept] = False
        return np.flatnonzero(np.concatenate([np.full(CAMERA, camera), free.ravel()]))

    def carriers(self, values: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 3"]:
        """Return the points [n, 3] m that positions are held to: on the carriers, as far as they
        take an object along; the world's origin on the environment.
        """
        grown = np.exp(values[self.parents, np.where(self.rigid[self.parents], 3, 5)])
        top = values[self.parents, :3].copy()
        top[:, 2] += grown * self.heights[self.parents]
        return np.where(self.parents[:, None] >= 0, self.carried * top, 0.0)

    def unpacked(self, x: Float[np.ndarray, " u"]) -> tuple[Camera, Float[np.ndarray, "n 7"]]:
        """Return the camera and the unknowns of the objects [n, 7]."""
        camera = self.initial.camera
        pitch, log_height = x[:CAMERA] * self.camera_spread
        moved = camera.model_copy(
            update={
                "pitch": float(np.clip(camera.pitch + pitch, -1.55, 1.55)),
                "height": camera.height * math.exp(np.clip(log_height, -2, 2)),
            }
        )
        values = x[CAMERA:].reshape(len(self.objects), 7).copy()
        off = np.sum((values[:, :3] - self.places) * self.normals, axis=1, keepdims=True)
        values[:, :3] -= off * self.normals
        return moved, values

    def _may_be_cut(self, index: int) -> bool:
        """Return whether an object's 2D box or its outline as answered reaches the border."""
        camera, rows = self.initial.camera, np.array([index])
        size = np.array([camera.width, camera.height_px], float)
        ends = [self.boxes[index].reshape(2, 2)]
        for points in (self.inner, self.outer):
            ends.append(_projected(camera, self._view(camera, self.values, points[rows], rows)[0]))
        pixels = np.concatenate([of.reshape(-1, 2) for of in ends])
        edge = EDGE * size.max()
        return bool((pixels <= edge).any() or (pixels >= size - edge).any())

    def _trimmed(self, index: int, frame: Wireframe) -> Wireframe:
        """Leave out edges of a cut object that do not decide its box, and their points."""
        camera, rows = self.initial.camera, np.array([index])
        view, _ = self._view(camera, self.values, frame.points[None], rows)
        edges = near_border(camera, view[0], frame.edges)
        used, renumbered = np.unique(edges, return_inverse=True)
        return Wireframe(frame.hull, frame.points[used], renumbered.reshape(-1, 2))

    def _view(
        self,
        camera: Camera,
        values: Float[np.ndarray, "n 7"],
        points: Float[np.ndarray, "k m 3"],
        rows: Int[np.ndarray, " k"],
    ) -> tuple[Float[np.ndarray, "k m 3"], Float[np.ndarray, "k m"]]:
        """Return points of some objects in the camera's axes, and their heights over the lowest."""
        values, tilts = values[rows], self.tilts[rows][:, None]
        log_size = np.where(self.rigid[rows][:, None], values[:, 3:4], values[:, 3:6])
        sizes = (self.sizes[rows] * np.exp(np.clip(log_size, -3, 3)))[:, None]
        local = rotate(tilts, points * sizes)
        low = rotate(tilts, self.lowest[rows] * sizes)[..., 2].min(axis=1)
        height = local[..., 2] - low[:, None]
        c, s = np.cos(values[:, 6])[:, None], np.sin(values[:, 6])[:, None]
        world = np.stack(
            [c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1], height],
            -1,
        )
        return (world + values[:, None, :3] - camera.position()) @ camera.axes(), height

    def misses(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "n 6"]:
        """Return how far 2D sides, and contacts, lie out of what the outlines allow [px].

        Positive where the visible box goes beyond the largest outline, negative where the smallest
        outline goes beyond a side that is the object's own. The last two columns are those of the
        contact, right and down; 0 where no contact is told.
        """
        camera, values = self.unpacked(x)
        extents, feet = [], []
        every = np.arange(len(self.objects))
        for k, points in enumerate((self.inner, self.outer)):
            view, height = self._view(camera, values, points, every)
            pixels = _projected(camera, view)
            boxes = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
            for i, frames in self.cut.items():
                if k == len(frames):  # The same surface is the smallest and the largest.
                    boxes[i] = OUTWARD * extents[0][i]
                    continue
                rows, frame = every[i : i + 1], frames[k]
                view, _ = self._view(camera, values, frame.points[None], rows)
                size = np.tile([camera.width, camera.height_px], 2)
                shown = extents_in_picture(camera, view[0], frame.edges)
                boxes[i] = np.clip(boxes[i], 0, size) if shown is None else shown
            extents.append(OUTWARD * boxes)
            off = (height > BASE * self.heights[:, None] + 1e-4)[..., None]
            low = np.where(off, np.inf, pixels).min(axis=1)
            high = np.where(off, -np.inf, pixels).max(axis=1)
            feet.append((low[:, 0], high[:, 0], high[:, 1]))
        visible = OUTWARD * self.boxes
        beyond = np.maximum(visible - np.maximum(*extents), 0.0)
        within = np.maximum(np.minimum(*extents) - visible, 0.0)
        sides = beyond - np.where(self.hidden, 0.0, within)
        (left, right, near), (left_2, right_2, near_2) = feet
        u, v = self.contacts.T
        aside = _outside(u, np.minimum(left, left_2), np.maximum(right, right_2))
        down = _outside(v, np.minimum(near, near_2), np.maximum(near, near_2))
        contact = np.nan_to_num(np.column_stack([aside, down]), nan=0.0, posinf=0.0, neginf=0.0)
        return np.concatenate([sides, contact], axis=1)

    def residuals(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " r"]:
        """Return all residuals, each over its standard deviation; soft L1 but for the camera.

        A miss counts from one standard deviation on, so that what agrees with the picture is not
        moved. A box or a number may be an outlier, so its pull is bounded. The camera's prior is
        quadratic, so that no single object moves it far.
        """
        _, values = self.unpacked(x)
        misses = self.misses(x)
        error = np.concatenate([self.tolerance, self.tolerance[:, [0, 1]]], axis=1)
        data = np.sign(misses) * np.maximum(np.abs(misses) / error - TOLERATED, 0.0)
        place = values[:, :3] - self.carriers(values) - self.offsets
        place = np.einsum("nij,nj->ni", self.information, place)
        log_size = np.where(self.rigid[:, None], values[:, 3:4], values[:, 3:6])
        whole = log_size.mean(axis=1, keepdims=True)
        return np.concatenate(
            [
                _soft(data).ravel(),
                x[:CAMERA],
                _soft(place).ravel(),
                _soft(whole / self.scale_spread[:, None]).ravel(),
                _soft((log_size - whole) / self.edge_spread).ravel(),
                _soft((values[:, 6] - self.yaws) / self.yaw_spread),
            ]
        )

    def owners(self) -> Int[np.ndarray, " r"]:
        """Return the object of each residual, in the order of `residuals`; -1 for the camera's."""
        n = len(self.objects)
        owners = np.concatenate([np.arange(n).repeat(count) for count in (6, 3, 1, 3, 1)])
        return np.insert(owners, 6 * n, [-1] * CAMERA)

    def costs(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " n_1"]:
        """Return the sum of squared residuals of each object, and last of the camera."""
        owners = self.owners() % (len(self.objects) + 1)
        return np.bincount(owners, self.residuals(x) ** 2, len(self.objects) + 1)

    def jacobian(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "r u"]:
        """Return the derivative of the residuals by forward differences.

        An object's residuals depend on its own unknowns, its carrier's and the camera's. So one
        difference serves all objects whose depths in the tree have the same parity.
        """
        n, residuals = len(self.objects), self.residuals(x)
        jacobian = np.zeros((len(residuals), len(x)))
        for k in range(CAMERA):
            jacobian[:, k] = self._difference(x, residuals, np.array([k]))
        index = np.arange(n)
        owners = self.owners()
        carriers = np.where(owners >= 0, self.parents[owners], -1)
        for parity in (0, 1):
            group = self.levels % 2 == parity
            moved = np.where(
                (owners >= 0) & group[owners],
                owners,
                np.where((carriers >= 0) & group[carriers], carriers, -1),
            )
            rows = np.flatnonzero(moved >= 0)
            for k in range(7):
                change = self._difference(x, residuals, CAMERA + 7 * index[group] + k)
                jacobian[rows, CAMERA + 7 * moved[rows] + k] = change[rows]
        return jacobian

    def _difference(
        self,
        x: Float[np.ndarray, " u"],
        residuals: Float[np.ndarray, " r"],
        columns: Int[np.ndarray, " k"],
    ) -> Float[np.ndarray, " r"]:
        """Return the change of the residuals over a step of some unknowns at once."""
        ahead = x.copy()
        ahead[columns] += STEP
        return (self.residuals(ahead) - residuals) / STEP

    def tree(
        self, x: Float[np.ndarray, " u"], kept: Bool[np.ndarray, " n"] | None = None
    ) -> SceneTree:
        """Return the tree of the unknowns, lengths rounded to 10 um, angles to 1e-5 rad.

        Args:
            x: the unknowns.
            kept: objects that stay as the answer has them, to the bit.
        """
        camera, values = self.unpacked(x)
        kept = np.zeros(len(self.objects), bool) if kept is None else kept
        log_size = np.where(self.rigid[:, None], values[:, 3:4], values[:, 3:6])
        boxes = {}
        for i, node in enumerate(self.objects):
            if kept[i] or np.allclose(values[i], self.values[i], rtol=0, atol=1e-6):
                continue
            size = np.array(node.box3d.size) * np.exp(log_size[i])
            boxes[node.name] = Box3D(
                position=tuple(np.round(values[i, :3], 5).tolist()),
                size=tuple(np.maximum(np.round(size, 5), 1e-5).tolist()),
                yaw=round(math.remainder(values[i, 6], 2 * math.pi), 5),
            )
        old = self.initial.camera
        moved = {
            name: round(getattr(camera, name), 5)
            for name in ("pitch", "height")
            if abs(getattr(camera, name) - getattr(old, name)) > 1e-6
        }
        nodes = tuple(
            node.model_copy(update={"box3d": boxes[node.name]}) if node.name in boxes else node
            for node in self.initial.nodes
        )
        return self.initial.model_copy(
            update={"camera": old.model_copy(update=moved), "nodes": nodes}
        )

    def _rest(self, node: TreeNode) -> float:
        """Return how far [m] the prior height of an object is over the answer's.

        On a slab of the environment it is on its top. Elsewhere it may be at any depth within the
        carrier, since hollows are unknown; attached and leaning objects keep their height.
        """
        if node.parent is None or node.relation in ("attached", "leaning"):
            return 0.0
        parent = self.initial.node(node.parent)
        gap = node.box3d.position[2] - parent.box3d.position[2] - parent.box3d.size[2]
        if rests_on_slab(self.initial, node):
            return -gap
        return float(np.clip(gap, -parent.box3d.size[2], 0.0)) - gap


def _projected(camera: Camera, view: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return the pixels of points in the camera's axes."""
    pixels = view[..., :2] / np.maximum(view[..., 2:], NEAR_M) * camera.focal
    return pixels + np.array([camera.width, camera.height_px]) / 2


def _stacked(points: list[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "n m 3"]:
    """Stack sets of points; shorter ones repeat points, which changes no extent."""
    longest = max(len(p) for p in points)
    return np.array([np.resize(p, (longest, 3)) for p in points])


def _outside(
    value: Float[np.ndarray, " n"], low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return how far values lie above or below (negative) an interval."""
    return np.maximum(value - high, 0.0) - np.maximum(low - value, 0.0)


def _soft(residual: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return residuals whose squares grow like r^2 near 0 and like 2 |r| far from it (soft L1)."""
    return residual * np.sqrt(2.0 / (np.sqrt(1.0 + residual**2) + 1.0))

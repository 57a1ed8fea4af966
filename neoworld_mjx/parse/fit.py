"""Fit of camera and 3D boxes to the 2D boxes by robust least squares.

A model localises objects well in the picture and knows their common sizes, but estimates distances
and angles poorly. So the fit moves the camera (pitch, height, field of view, a little roll) and the
boxes (position, size, yaw) until the boxes project onto the 2D boxes. Priors hold sizes, yaws and
camera near the answer, bottoms on their carriers, and positions relative to their carriers. Hidden
sides of a 2D box count only where the projection lies inside them.

The fit is kept only if the reprojected boxes then agree better with the photo; the report lists all
changes. Environment supports do not move.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import OptimizeResult, least_squares

from ..spec import Box3D, Camera, SceneTree, TreeNode
from ..spec.pose import rotate
from .checks import agreement, check_tree, hidden_sides
from .project import BOX_POINTS, NEAR_M, outline_points

PIXELS = 0.006
"""Standard deviation of a 2D side, over the picture's longer side; at least SIDE of its own box, or
SIDE_LOOSE where the outline is not known."""
SIDE, SIDE_LOOSE = 0.04, 0.1
LOG_SIZE, LOG_ASPECT = 0.15, 0.08
"""Standard deviations of the log of an object's scale and of its edges' ratios."""
YAW, PITCH, ROLL = math.radians(12), math.radians(6), math.radians(1.5)
LOG_HEIGHT, LOG_FOCAL = 0.35, 0.15
PLACE = 0.35
"""Standard deviation of a position relative to its carrier, over the carrier's size; on the
environment over the distance from the camera."""
CONTACT_M, CONTACT = 0.002, 0.05
"""Standard deviation of the height over the carrier: metres plus a share of the object's height."""
GAIN = 0.01
"""Least gain in mean agreement for which the fit is kept."""
LOSS = 0.1
"""Largest loss of agreement of any one object for which the fit is kept."""
STEPS = 60
EXACT = 12
"""Most objects for the exact solver, reproducible to 1e-8 across machines; lsmr is to 1e-6."""
STEP = 1e-7
"""Step of finite differences, in m, log or rad."""


@dataclass(frozen=True)
class BoxChange:
    """Change of one object's box by the fit, kept or not."""

    distance_m: float
    size_ratio: tuple[float, float, float]
    """New over old size along x, y, z."""
    yaw_deg: float
    agreement_before: float
    agreement_after: float


@dataclass(frozen=True)
class FitReport:
    """Outcome of a fit."""

    applied: bool
    reason: str
    """Why the fit was kept or dropped."""
    agreement_before: float
    """Mean agreement of projected 3D boxes with 2D boxes, 0 to 1."""
    agreement_after: float
    """Mean agreement of the fitted tree, kept or not."""
    pitch_deg: float = 0.0
    """Change of the camera's pitch; the next three are also changes of the camera."""
    height_m: float = 0.0
    fovy_deg: float = 0.0
    roll_deg: float = 0.0
    objects: dict[str, BoxChange] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return plain data, numbers rounded to four decimals."""
        return {
            **{
                name: round(value, 4) if isinstance(value, float) else value
                for name, value in vars(self).items()
                if name != "objects"
            },
            "objects": {
                name: {
                    key: [round(v, 4) for v in value]
                    if isinstance(value, tuple)
                    else round(value, 4)
                    for key, value in vars(moved).items()
                }
                for name, moved in self.objects.items()
            },
        }


def fit_tree(tree: SceneTree) -> tuple[SceneTree, FitReport]:
    """Fit camera and 3D boxes to the 2D boxes.

    Returns:
        The fitted tree, or the given one if the fit is dropped, and the report.
    """
    objects = [node for node in tree.top_down() if not node.environment]
    if not objects:
        return tree, FitReport(False, "there is no object to fit", 0.0, 0.0)
    before = {node.name: agreement(tree, node) for node in objects}
    mean = float(np.mean(list(before.values())))
    problem = _Problem(tree, objects)
    try:
        solutions = [_solved(problem, start) for start in problem.starts()]
    except (ValueError, np.linalg.LinAlgError) as error:
        return tree, FitReport(False, f"the solver failed: {error}", mean, mean)
    # Rounded, so that of two equal solutions every machine takes the same one.
    fitted = problem.tree(min(solutions, key=lambda result: float(f"{result.cost:.4g}")).x)
    after = {node.name: agreement(fitted, fitted.node(node.name)) for node in objects}
    gain = float(np.mean(list(after.values()))) - mean
    worst = min(objects, key=lambda node: after[node.name] - before[node.name]).name
    errors = [sum(f.severity == "error" for f in check_tree(t)) for t in (tree, fitted)]
    applied, reason = True, f"mean agreement rises by {gain:.3f}"
    if gain < GAIN:
        applied, reason = False, f"mean agreement would change by {gain:.3f}, under {GAIN:g}"
    elif after[worst] < before[worst] - LOSS:
        drop = before[worst] - after[worst]
        applied, reason = False, f"the agreement of {worst} would fall by {drop:.2f}"
    elif errors[1] > errors[0]:
        applied, reason = False, f"checks would find {errors[1]} errors in place of {errors[0]}"
    report = _report(tree, fitted, before, after, applied, reason)
    return (fitted if applied else tree), report


class _Problem:
    """The unknowns of a tree and their residuals.

    Unknowns: camera (pitch [rad], log height, log focal, roll [rad]), each over its standard
    deviation, then per object (x, y [m], z [m], log length, width, height, yaw [rad]).
    """

    def __init__(self, tree: SceneTree, objects: list[TreeNode]) -> None:
        self.given, self.objects = tree, objects
        camera = tree.camera
        names = [node.name for node in objects]
        self.sizes = np.array([node.box3d.size for node in objects])
        self.places = np.array([node.box3d.position for node in objects])
        self.yaws = np.array([node.box3d.yaw for node in objects])
        self.tilts = np.array([node.base_tilt for node in objects])
        self.boxes = np.array([node.box2d.as_tuple() for node in objects])
        self.hidden = np.array([hidden_sides(tree, node) for node in objects])
        self.outward = np.array([-1.0, -1.0, 1.0, 1.0])
        sides = np.tile(self.boxes[:, 2:] - self.boxes[:, :2], 2)
        outlines = [outline_points(node) for node in objects]
        longest = max(len(points) for points, _ in outlines)
        # Shorter point sets are filled up by repeating points, which changes no extent.
        self.inner = np.array([np.resize(points, (longest, 3)) for points, _ in outlines])
        self.corners = np.array([weight for _, weight in outlines])[:, None]
        share = np.where((self.corners > 0) & (self.corners < 1), SIDE_LOOSE, SIDE)
        self.error = np.maximum(PIXELS * max(camera.width, camera.height_px), share * sides)
        self.parents = np.array(
            [names.index(n.parent) if n.parent in names else -1 for n in objects]
        )
        # Carriers come first in `objects`.
        self.levels = np.zeros(len(objects), int)
        for i, parent in enumerate(self.parents):
            self.levels[i] = self.levels[parent] + 1 if parent >= 0 else 0
        zero = np.zeros_like(self.sizes)
        self.answered = np.concatenate([self.places, zero, self.yaws[:, None]], axis=1)
        self._frame_places()
        at, _ = self.carriers(self.answered)
        self.offsets = self.places[:, :2] - at

    def _frame_places(self) -> None:
        """Set the priors' references: heights over carriers, standard deviations of positions."""
        n = len(self.objects)
        self.base_height = np.zeros(n)
        self.reach = np.zeros(n)
        self.rests = np.zeros(n)
        for i, node in enumerate(self.objects):
            parent = None if node.parent is None else self.given.node(node.parent)
            distance = float(np.linalg.norm(self.places[i] - self.given.camera.position()))
            self.reach[i] = PLACE * distance
            if parent is None:
                self.rests[i] = self.places[i, 2]
                continue
            if self.parents[i] < 0:
                self.base_height[i] = parent.box3d.position[2] + parent.box3d.size[2]
            else:
                self.reach[i] = PLACE * max(parent.box3d.size[:2])
            top = parent.box3d.position[2] + parent.box3d.size[2]
            self.rests[i] = _rest(node, parent, self.places[i, 2] - top)

    def carriers(
        self, values: Float[np.ndarray, "n 7"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        """Return the carriers' centres [n, 2] and tops [n]; the world's for the environment."""
        at = np.where(self.parents[:, None] >= 0, values[self.parents, :2], 0.0)
        grown = np.exp(values[self.parents, 5]) * self.sizes[self.parents, 2]
        top = np.where(self.parents >= 0, values[self.parents, 2] + grown, self.base_height)
        return at, top

    def unpacked(self, x: Float[np.ndarray, " u"]) -> tuple[Camera, Float[np.ndarray, "n 7"]]:
        """Return camera and per-object unknowns [n, 7]."""
        camera = self.given.camera
        focal = camera.focal * math.exp(np.clip(x[2] * LOG_FOCAL, -2, 2))
        moved = camera.model_copy(
            update={
                "pitch": float(np.clip(camera.pitch + x[0] * PITCH, -1.55, 1.55)),
                "height": camera.height * math.exp(np.clip(x[1] * LOG_HEIGHT, -2, 2)),
                "fovy": 2 * math.atan(camera.height_px / 2 / focal),
                "roll": float(camera.roll + x[3] * ROLL),
            }
        )
        return moved, x[4:].reshape(len(self.objects), 7)

    def extents(self, camera: Camera, values: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 4"]:
        """Return the projected outlines' boxes [n, 4] in pixels, not cut at the picture's edge."""
        sizes = self.sizes * np.exp(np.clip(values[:, 3:6], -3, 3))
        boxes = []
        for points in (np.broadcast_to(BOX_POINTS, (len(sizes), 8, 3)), self.inner):
            local = rotate(self.tilts[:, None], points * sizes[:, None])
            low = rotate(self.tilts[:, None], BOX_POINTS * sizes[:, None])[..., 2].min(axis=1)
            local[..., 2] -= low[:, None]
            c, s = np.cos(values[:, 6])[:, None], np.sin(values[:, 6])[:, None]
            turned = np.stack(
                [c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1]], -1
            )
            world = np.concatenate([turned, local[..., 2:]], axis=-1) + values[:, None, :3]
            view = (world - camera.position()) @ camera.axes()
            depth = np.maximum(view[..., 2:], NEAR_M)
            pixels = view[..., :2] / depth * camera.focal
            pixels = pixels + np.array([camera.width, camera.height_px]) / 2
            boxes.append(np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1))
        return self.corners * boxes[0] + (1 - self.corners) * boxes[1]

    def residuals(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " r"]:
        """Return all residuals, each over its standard deviation; soft L1 but for the camera.

        A box or a size may be an outlier, so its pull is bounded. The camera's prior is quadratic,
        so that no single object moves it far.
        """
        camera, values = self.unpacked(x)
        off = (self.extents(camera, values) - self.boxes) / self.error
        # A hidden side may lie anywhere outside the visible box.
        off = np.where(self.hidden & (off * self.outward > 0), 0.0, off)
        at, top = self.carriers(values)
        place = values[:, :2] - at - self.offsets
        log_size = values[:, 3:6]
        whole = log_size.mean(axis=1, keepdims=True)
        soft = CONTACT_M + CONTACT * self.sizes[:, 2]
        return np.concatenate(
            [
                _soft(off).ravel(),
                x[:4],
                _soft(place / self.reach[:, None]).ravel(),
                _soft((values[:, 2] - top - self.rests) / soft),
                _soft(whole / LOG_SIZE).ravel(),
                _soft((log_size - whole) / LOG_ASPECT).ravel(),
                _soft((values[:, 6] - self.yaws) / YAW),
            ]
        )

    def jacobian(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, "r u"]:
        """Return the derivative of the residuals by forward differences.

        An object's residuals depend on its own unknowns, its carrier's and the camera's. So one
        difference serves all objects whose depths in the tree have the same parity.
        """
        n, here = len(self.objects), self.residuals(x)
        jacobian = np.zeros((len(here), len(x)))
        for k in range(4):
            jacobian[:, k] = self._difference(x, here, np.array([k]))
        index = np.arange(n)
        owners = np.concatenate(
            [
                index.repeat(4),
                np.full(4, -1),
                index.repeat(2),
                index,
                index,
                index.repeat(3),
                index,
            ]
        )
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
                change = self._difference(x, here, 4 + 7 * index[group] + k)
                jacobian[rows, 4 + 7 * moved[rows] + k] = change[rows]
        return jacobian

    def _difference(
        self,
        x: Float[np.ndarray, " u"],
        here: Float[np.ndarray, " r"],
        columns: Int[np.ndarray, " k"],
    ) -> Float[np.ndarray, " r"]:
        ahead = x.copy()
        ahead[columns] += STEP
        return (self.residuals(ahead) - here) / STEP

    def starts(self) -> list[Float[np.ndarray, " u"]]:
        """Return the initial guesses: the answer, and objects moved to where their 2D boxes are."""
        placed = self.answered.copy()
        camera = self.given.camera
        for i in range(len(self.objects)):
            _, top = self.carriers(placed)
            placed[i, 2] = top[i] + self.rests[i]
            placed[i, :2] = self._under(camera, placed, i)
        return [np.concatenate([np.zeros(4), v.ravel()]) for v in (self.answered, placed)]

    def _under(
        self, camera: Camera, values: Float[np.ndarray, "n 7"], i: int
    ) -> Float[np.ndarray, "2"]:
        """Return the position [2] at its height where an object projects to its 2D box's centre."""
        aim = (self.boxes[i, :2] + self.boxes[i, 2:]) / 2
        trial = values.copy()
        for _ in range(4):
            drawn = self.extents(camera, trial)[i]
            middle = (drawn[:2] + drawn[2:]) / 2
            feet, depth = camera.project(trial[i, :3])
            if depth < NEAR_M:
                break
            ray = camera.rays(feet + aim - middle)
            if ray[2] > -1e-3:
                break
            t = (trial[i, 2] - camera.height) / ray[2]
            if not 0 < t < 20 * max(camera.height, 0.1):
                break
            trial[i, :2] = ray[:2] * t
        return trial[i, :2]

    def tree(self, x: Float[np.ndarray, " u"]) -> SceneTree:
        """Return the tree of the unknowns, lengths rounded to 10 um, angles to 1e-5 rad."""
        camera, values = self.unpacked(x)
        sizes = self.sizes * np.exp(values[:, 3:6])
        boxes = {
            node.name: Box3D(
                position=tuple(np.round(values[i, :3], 5).tolist()),
                size=tuple(np.maximum(np.round(sizes[i], 5), 1e-5).tolist()),
                yaw=round(math.remainder(values[i, 6], 2 * math.pi), 5),
            )
            for i, node in enumerate(self.objects)
        }
        return SceneTree(
            camera=camera.model_copy(
                update={
                    name: round(getattr(camera, name), 5)
                    for name in ("pitch", "height", "fovy", "roll")
                }
            ),
            nodes=tuple(
                node.model_copy(update={"box3d": boxes[node.name]}) if node.name in boxes else node
                for node in self.given.nodes
            ),
        )


def _rest(node: TreeNode, parent: TreeNode, gap: float) -> float:
    """Return the prior height of an object over its carrier's top [m]; the answer says `gap`.

    On a slab of the environment it is 0. Elsewhere it may be any depth within the carrier, since
    hollows are not known; attached objects keep their height.
    """
    if node.relation == "attached":
        return gap
    if parent.environment and node.relation == "on":
        height, width = parent.box3d.size[2], min(parent.box3d.size[:2])
        if height < 0.2 * width:
            return 0.0
    return float(np.clip(gap, -parent.box3d.size[2], 0.0))


def _soft(residual: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return residuals whose squares grow like r^2 near 0 and like 2 |r| far from it (soft L1)."""
    return residual * np.sqrt(2.0 / (np.sqrt(1.0 + residual**2) + 1.0))


def _solved(problem: _Problem, start: Float[np.ndarray, " u"]) -> OptimizeResult:
    derivative: Any = problem.jacobian  # SciPy's annotations know the names of schemes alone.
    return least_squares(
        problem.residuals,
        start,
        jac=derivative,
        x_scale="jac",
        tr_solver="exact" if len(problem.objects) <= EXACT else "lsmr",
        max_nfev=STEPS,
        ftol=1e-11,
        xtol=1e-11,
    )


def _report(
    given: SceneTree,
    fitted: SceneTree,
    before: dict[str, float],
    after: dict[str, float],
    applied: bool,
    reason: str,
) -> FitReport:
    old, new = given.camera, fitted.camera
    objects = {}
    for name, was in before.items():
        a, b = given.node(name).box3d, fitted.node(name).box3d
        ratio = np.array(b.size) / np.array(a.size)
        objects[name] = BoxChange(
            float(np.linalg.norm(np.array(b.position) - np.array(a.position))),
            tuple(ratio.tolist()),
            math.degrees(math.remainder(b.yaw - a.yaw, 2 * math.pi)),
            was,
            after[name],
        )
    return FitReport(
        applied,
        reason,
        float(np.mean(list(before.values()))),
        float(np.mean(list(after.values()))),
        math.degrees(new.pitch - old.pitch),
        new.height - old.height,
        math.degrees(new.fovy - old.fovy),
        math.degrees(new.roll - old.roll),
        objects,
    )

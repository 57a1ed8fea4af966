"""Fit of camera and 3D boxes to the 2D boxes by robust least squares, object by object.

A model localises objects well in the picture and knows their common sizes, but distances less
well. So the fit moves the camera (pitch, height) and the boxes (position, size, heading) as far as
the picture asks: a visible side of a 2D box pulls only where it misses the outline by more than
its noise, a hidden one only where the outline does not reach it, and priors (`judgement`) hold the
rest at the answer. The camera moves only if more than one object asks for it. An object
whose fit is refused stays as the answer has it, without a word to the others. Environment supports
do not move. With real shapes in place of outlines the same problem serves after Step 2.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from ..measure import SidesShown
from ..spec import Box3D, SceneTree, TreeNode
from .fit_problem import CAMERA, FitProblem
from .prior_widths import is_slab
from .supports_by_picture import OtherCarrier
from .tree_checks import agreement, check_tree
from .wireframe import Wireframe

WORSE = 1.0
"""Growth of an object's largest miss, in standard deviations, at which its fit is refused."""
CAMERA_GAIN = 0.01
"""Fall of the sum of squared residuals for which the camera moves, above the solver's tolerance."""
FAR, SIDES_FAR = 3.0, 3
"""A change of so many standard deviations needs so many visible sides."""
STEPS = 60
"""Largest number of evaluations by the solver."""
ROUNDS = 3
"""Largest number of solutions, each without the objects that were refused before."""
EXACT = 12
"""Most objects for the exact solver, reproducible to 1e-8 across machines; lsmr is to 1e-6."""
NOTED_M, NOTED_SIZE = 0.10, 0.10
"""Changes of position [m] and size from which on a note says so."""


@dataclass(frozen=True)
class BoxChange:
    """Change of one object's box by the fit."""

    before: Box3D
    after: Box3D
    distance_m: float
    size_ratio: tuple[float, float, float]
    """New over old size along x, y, z."""
    yaw_deg: float
    agreement_before: float
    agreement_after: float
    hidden: tuple[bool, bool, bool, bool]
    """Which sides of its 2D box (left, top, right, bottom) are not its own outline."""
    refused: str = ""
    """Reason why the fit was refused, so that the object is as the answer has it."""


@dataclass(frozen=True)
class FitReport:
    """Outcome of a fit."""

    applied: bool
    """Whether anything moved."""
    reason: str
    agreement_before: float
    """Mean agreement of projected 3D boxes with 2D boxes, 0 to 1."""
    agreement_after: float
    pitch_deg: float = 0.0
    """Change of the camera's pitch; the next is also a change of the camera."""
    height_m: float = 0.0
    objects: dict[str, BoxChange] = field(default_factory=dict)
    carriers: dict[str, OtherCarrier] = field(default_factory=dict)
    """What carries objects by the picture, where the answer's carrier cannot."""

    def notes(self) -> Iterator[tuple[str, str]]:
        """Yield what a person should know: objects that were refused, or that moved far."""
        for name, change in self.objects.items():
            ratio = math.prod(change.size_ratio) ** (1 / 3)
            if change.refused:
                yield f"{name} as the answer has it", f"its fit was refused: {change.refused}"
            elif change.distance_m > NOTED_M or abs(ratio - 1) > NOTED_SIZE:
                yield (
                    f"{name} other than the answer has it",
                    f"the fit to the photo moved it by {100 * change.distance_m:.1f} cm, scaled "
                    f"it by {ratio:.2f} and turned it by {change.yaw_deg:.0f} deg",
                )

    def to_json(self) -> dict[str, Any]:
        """Return plain data, numbers rounded to four decimals."""
        grouped = ("objects", "carriers")
        return {
            **{name: _plain(value) for name, value in vars(self).items() if name not in grouped},
            **{
                group: {
                    name: {key: _plain(value) for key, value in vars(change).items()}
                    for name, change in getattr(self, group).items()
                }
                for group in grouped
            },
        }


def fit_tree(
    tree: SceneTree,
    shapes: Mapping[str, Wireframe] | None = None,
    shown: Mapping[str, SidesShown] | None = None,
) -> tuple[SceneTree, FitReport]:
    """Fit camera and 3D boxes to the 2D boxes.

    Args:
        tree: the answer, or an earlier fit.
        shapes: surfaces that replace the outlines of categories, see `FitProblem`.
        shown: which sides they show where the answer puts them, see `hidden_sides`.

    Returns:
        The fitted tree, and the report.
    """
    objects = [node for node in tree.top_down() if not node.environment]
    if not objects:
        return tree, FitReport(False, "there is no object to fit", 0.0, 0.0)
    problem = FitProblem(tree, objects, shapes, shown)
    refused: dict[str, str] = {}
    kept = np.zeros(len(objects), bool)
    try:
        x = _with_camera(problem, kept)
        for _ in range(ROUNDS):
            again = _refused(problem, x, kept)
            if not again:
                break
            refused |= again
            kept = np.array([node.name in refused for node in objects])
            start = np.where(np.repeat(kept, 7), problem.values.ravel(), x[CAMERA:])
            x = _minimised(problem, np.concatenate([x[:CAMERA], start]), kept, camera=False)
    except (ValueError, np.linalg.LinAlgError) as error:
        mean = float(np.mean([agreement(tree, node) for node in objects]))
        return tree, FitReport(False, f"the solver failed: {error}", mean, mean)
    return _outcome(problem, x, kept, refused)


def _with_camera(problem: FitProblem, kept: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " u"]:
    """Return the solution with the camera as it is, or one with it moved if that helps.

    The objects must gain more than the camera's prior loses even without the one that gains most:
    a single object that is off says nothing about the camera, a little of each says much. The
    environment does not move along, so where walls or furniture belong to it, the camera stays.
    """
    still = _minimised(problem, problem.start(), kept, camera=False)
    if not all(is_slab(node) for node in problem.initial.nodes if node.environment):
        return still
    moved = _minimised(problem, still, kept, camera=True)
    *gains, price = problem.costs(still) - problem.costs(moved)
    return moved if sum(gains) - max(gains) + price > CAMERA_GAIN else still


def _minimised(
    problem: FitProblem,
    start: Float[np.ndarray, " u"],
    kept: Bool[np.ndarray, " n"],
    *,
    camera: bool,
) -> Float[np.ndarray, " u"]:
    free = problem.free(kept, camera=camera)
    if len(free) == 0:
        return start
    full = start.copy()

    def expanded(part: Float[np.ndarray, " f"]) -> Float[np.ndarray, " u"]:
        full[free] = part
        return full

    derivative: Any = lambda part: problem.jacobian(expanded(part))[:, free]
    result = least_squares(
        lambda part: problem.residuals(expanded(part)),
        start[free],
        jac=derivative,
        x_scale="jac",
        tr_solver="exact" if len(problem.objects) <= EXACT else "lsmr",
        max_nfev=STEPS,
        ftol=1e-7,
        xtol=1e-7,
    )
    return expanded(result.x).copy()


def _refused(
    problem: FitProblem, x: Float[np.ndarray, " u"], kept: Bool[np.ndarray, " n"]
) -> dict[str, str]:
    """Return the objects whose fit is refused, with reasons."""
    errors = [_errors(tree) for tree in (problem.initial, problem.tree(x, kept))]
    misses = [
        np.abs(problem.misses(values)[:, :4] / problem.tolerance).max(axis=1)
        for values in (problem.start(), x)
    ]
    changes, visible = _deviations(problem, x), (~problem.hidden).sum(axis=1)
    refused = {}
    for i, node in enumerate(problem.objects):
        if kept[i]:
            continue
        new = errors[1].get(node.name, set()) - errors[0].get(node.name, set())
        if misses[1][i] > max(misses[0][i] + WORSE, 1.0 + WORSE):
            refused[node.name] = (
                f"its outline would miss its 2D box by {misses[1][i]:.1f} standard deviations in "
                f"place of {misses[0][i]:.1f}"
            )
        elif new:
            refused[node.name] = f"checks would report {', '.join(sorted(new))}"
        elif changes[i] > FAR and visible[i] < SIDES_FAR:
            refused[node.name] = (
                f"it needs a change of {changes[i]:.0f} standard deviations, and {visible[i]} "
                "visible sides do not pin it"
            )
    return refused


def _deviations(problem: FitProblem, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " n"]:
    """Return each object's largest change of place on its carrier or of scale, in deviations."""
    values = x[CAMERA:].reshape(-1, 7)
    place = values[:, :3] - problem.carriers(values) - problem.offsets
    place = np.einsum("nij,nj->ni", problem.information, place)[:, :2]
    log_size = np.where(problem.rigid, values[:, 3], values[:, 3:6].mean(axis=1))
    scale = np.abs(log_size) / problem.scale_spread
    return np.maximum(np.abs(place).max(axis=1), scale)


def _errors(tree: SceneTree) -> dict[str, set[str]]:
    codes: dict[str, set[str]] = {}
    for issue in check_tree(tree):
        if issue.severity == "error":
            codes.setdefault(issue.node, set()).add(issue.code)
    return codes


def _outcome(
    problem: FitProblem,
    x: Float[np.ndarray, " u"],
    kept: Bool[np.ndarray, " n"],
    refused: dict[str, str],
) -> tuple[SceneTree, FitReport]:
    initial = problem.initial
    fitted = problem.tree(x, kept)
    changes = {
        node.name: _change(
            initial, fitted, node, tuple(problem.hidden[i].tolist()), refused.get(node.name, "")
        )
        for i, node in enumerate(problem.objects)
    }
    before, after = np.mean(
        [(change.agreement_before, change.agreement_after) for change in changes.values()], axis=0
    )
    moved = sum(
        change.distance_m > 0 or change.yaw_deg != 0 or change.size_ratio != (1.0, 1.0, 1.0)
        for change in changes.values()
    )
    applied = moved > 0 or fitted.camera != initial.camera
    reason = f"{moved} of {len(changes)} objects moved, {len(refused)} refused"
    report = FitReport(
        applied,
        reason,
        float(before),
        float(after),
        math.degrees(fitted.camera.pitch - initial.camera.pitch),
        fitted.camera.height - initial.camera.height,
        changes,
    )
    return (fitted if applied else initial), report


def _change(
    initial: SceneTree,
    fitted: SceneTree,
    node: TreeNode,
    hidden: tuple[bool, bool, bool, bool],
    refused: str,
) -> BoxChange:
    new = fitted.node(node.name)
    a, b = node.box3d, new.box3d
    return BoxChange(
        a,
        b,
        float(np.linalg.norm(np.array(b.position) - np.array(a.position))),
        tuple((np.array(b.size) / np.array(a.size)).tolist()),
        math.degrees(math.remainder(b.yaw - a.yaw, 2 * math.pi)),
        agreement(initial, node),
        agreement(fitted, new),
        hidden,
        refused,
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Box3D):
        return value.model_dump(mode="json")
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return round(value, 4) if isinstance(value, float) else value

"""Fit of camera and 3D boxes to the 2D boxes by robust least squares, and its report.

A model localizes objects well in the picture and knows their common sizes, but estimates distances
less accurately. The fit therefore moves the camera (pitch, height) and the boxes (position, size,
heading) only as far as the picture requires:

- A visible side of a 2D box has an effect only if its residual exceeds its noise.
- A hidden side has an effect only if the outline does not reach it.
- `priors` keep all values near the parsed ones.
- The camera moves only if this improves the fit of several objects.
- An object whose fit is refused keeps its parsed box and does not affect the others; so does an
  object that the user placed.
- Supports of the environment do not move.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix

from ...evidence.known_camera import KnownCamera
from ...spec import Box3D, SceneTree, TreeNode
from .fit_data import CAMERA
from .fit_problem import FitProblem, fit_problem, outline_residuals
from .tree_checks import agreement, check_objects
from .tree_prior import is_slab

NOTED_M, NOTED_SIZE = 0.10, 0.05
"""Changes of position [m] and size (relative) above which a note reports them."""


@dataclass(frozen=True)
class BoxChange:
    """Change of one object's box by the fit."""

    before: Box3D
    after: Box3D
    distance_m: float
    size_ratio: tuple[float, float, float]
    """Ratio of the new to the old size along x, y, z."""
    yaw_deg: float
    agreement_before: float
    agreement_after: float
    hidden: tuple[bool, bool, bool, bool]
    """True for sides of the 2D box (left, top, right, bottom) that are not the object's outline."""
    refused: str = ""
    """Reason why the object's fit was refused and its box is as parsed; empty if it was not
    refused."""


@dataclass(frozen=True)
class FitReport:
    """Outcome of a fit."""

    applied: bool
    """True if anything moved."""
    reason: str
    agreement_before: float
    """Mean agreement of the 2D boxes with the projected outlines of categories, from 0 to 1."""
    agreement_after: float
    pitch_deg: float = 0.0
    """Change of the camera's pitch [deg]."""
    height_m: float = 0.0
    """Change of the camera's height [m]."""
    objects: dict[str, BoxChange] = field(default_factory=dict)

    def notes(self) -> Iterator[tuple[str, str]]:
        """Yield a note, as a title and a text, if the fit was not applied.

        Each object whose fit was refused or that moved far has a note, too.
        """
        if self.reason.startswith("not applied"):
            yield "the parsed camera and boxes are kept", self.reason
        for name, change in self.objects.items():
            ratio = math.prod(change.size_ratio) ** (1 / 3)
            if change.refused:
                yield f"{name} kept as parsed", f"its fit was refused: {change.refused}"
            elif change.distance_m > NOTED_M or abs(ratio - 1) > NOTED_SIZE:
                yield (
                    f"{name} differs from the parse",
                    f"the fit to the photo moved it by {100 * change.distance_m:.1f} cm, scaled "
                    f"it by {ratio:.2f} and turned it by {change.yaw_deg:.0f} deg",
                )

    def to_json(self) -> dict[str, Any]:
        """Return JSON data with numbers rounded to four decimals."""
        objects = {
            name: {key: _json_value(value) for key, value in vars(change).items()}
            for name, change in self.objects.items()
        }
        return {k: _json_value(v) for k, v in vars(self).items()} | {"objects": objects}


def _json_value(value: Any) -> Any:
    if isinstance(value, Box3D):
        return value.model_dump(mode="json")
    if isinstance(value, tuple):
        return [_json_value(entry) for entry in value]
    return round(value, 4) if isinstance(value, float) else value


MAX_RESIDUAL_GROWTH = 1.0
"""Maximum growth of an object's largest residual at which its fit is accepted, in standard
deviations."""
MAX_AGREEMENT_LOSS = 0.005
"""Loss of mean agreement with the 2D boxes above which a fit is not applied."""
CAMERA_GAIN = 0.01
"""Minimum decrease of the sum of squared residuals for which the camera moves."""
LARGE_CHANGE, SIDES_FOR_LARGE_CHANGE = 3.0, 3
"""Change, in prior standard deviations, above which an object must have this number of visible
sides."""
MAX_EVALUATIONS = 60
"""Maximum number of evaluations by the solver."""
MAX_WORK, FEWEST_EVALUATIONS = 50_000, 5
"""Maximum product of the number of evaluations and the squared number of objects, which reduces the
evaluations for more than 28 objects; and the least number of evaluations."""
MAX_SOLVES = 3
"""Maximum number of further solves, in which refused objects are fixed."""
MAX_EXACT_OBJECTS = 12
"""Maximum number of objects for the exact solver. Its results are reproducible across machines to
1e-8, those of lsmr only to 1e-6."""


def fit_tree(tree: SceneTree, known: KnownCamera | None = None) -> tuple[SceneTree, FitReport]:
    """Fit camera and 3D boxes to the 2D boxes.

    Args:
        tree: the parsed scene, or an earlier fit.
        known: known parameters of the camera, which the tree has.

    Returns:
        The fitted tree, and the report.
    """
    objects = [node for node in tree.top_down() if not node.environment]
    if not objects:
        return tree, FitReport(False, "there is no object to fit", 0.0, 0.0)
    problem = fit_problem(tree, objects)
    if known is not None:
        deviations = known.deviations()
        pairs = zip(("pitch", "height"), problem.data.camera_sd.tolist(), strict=True)
        camera_sd = np.array([deviations.get(name, sd) for name, sd in pairs])
        problem = replace(problem, data=replace(problem.data, camera_sd=camera_sd))
    refused: dict[str, str] = {}
    kept = fixed = np.array([node.cues.kept for node in objects])
    try:
        x = _solve_with_camera(problem, fixed)
        known_errors = _error_codes(tree)
        for _ in range(MAX_SOLVES):
            newly_refused = _refused_objects(problem, x, fixed, known_errors)
            if not newly_refused:
                break
            refused |= newly_refused
            fixed = kept | np.array([node.name in refused for node in objects])
            values = np.where(np.repeat(fixed, 7), problem.data.values.ravel(), x[CAMERA:])
            x = _minimize(problem, np.concatenate([x[:CAMERA], values]), fixed, camera=False)
    except (ValueError, np.linalg.LinAlgError) as error:
        mean = float(np.mean([agreement(tree, node) for node in objects]))
        return tree, FitReport(False, f"the solver failed: {error}", mean, mean)
    return _outcome(problem, x, fixed, refused)


def _solve_with_camera(
    problem: FitProblem, fixed: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " u"]:
    """Return the solution with a moved camera if it is better than the one with a fixed camera.

    The sum of all objects' gains without the largest gain must exceed the cost of the camera's
    prior, because the error of a single object is no evidence about the camera. Otherwise, the
    solution with a fixed camera is returned. The camera does not move if the environment contains
    walls or furniture, which would not move with it.
    """
    data = problem.data
    fixed_camera = _minimize(problem, data.initial_unknowns(), fixed, camera=False)
    if not all(is_slab(node) for node in data.tree.nodes if node.environment):
        return fixed_camera
    moved_camera = _minimize(problem, fixed_camera, fixed, camera=True)
    *gains, camera_gain = problem.costs(fixed_camera) - problem.costs(moved_camera)
    return moved_camera if sum(gains) - max(gains) + camera_gain > CAMERA_GAIN else fixed_camera


def _minimize(
    problem: FitProblem,
    initial: Float[np.ndarray, " u"],
    fixed: Bool[np.ndarray, " n"],
    *,
    camera: bool,
) -> Float[np.ndarray, " u"]:
    free = problem.free(fixed, camera=camera)
    if len(free) == 0:
        return initial
    full = initial.copy()

    def expand(part: Float[np.ndarray, " f"]) -> Float[np.ndarray, " u"]:
        full[free] = part
        return full

    count = len(problem.data.objects)
    exact = count <= MAX_EXACT_OBJECTS

    def derivative(part: Float[np.ndarray, " f"]) -> Any:
        jacobian = problem.jacobian(expand(part))[:, free]
        # An object's residuals depend on few unknowns.
        return jacobian if exact else csr_matrix(jacobian)

    result = least_squares(
        lambda part: problem.residuals(expand(part)),
        initial[free],
        jac=derivative,  # pyright: ignore[reportArgumentType] Its stubs lack functions.
        x_scale="jac",
        tr_solver="exact" if exact else "lsmr",
        max_nfev=min(MAX_EVALUATIONS, max(MAX_WORK // count**2, FEWEST_EVALUATIONS)),
        ftol=1e-7,
        xtol=1e-7,
    )
    return expand(result.x).copy()


def _refused_objects(
    problem: FitProblem,
    x: Float[np.ndarray, " u"],
    fixed: Bool[np.ndarray, " n"],
    known_errors: Mapping[str, set[str]],
) -> dict[str, str]:
    """Return the objects whose fit is refused, with reasons."""
    data, errors = problem.data, _error_codes(problem.tree(x, fixed))
    residuals = [
        np.abs(outline_residuals(data, unknowns)[:, :4] / data.side_sd).max(axis=1)
        for unknowns in (data.initial_unknowns(), x)
    ]
    changes, visible = _prior_deviations(problem, x), (~data.hidden).sum(axis=1)
    refused = {}
    for i, node in enumerate(data.objects):
        if fixed[i]:
            continue
        new = errors.get(node.name, set()) - known_errors.get(node.name, set())
        if residuals[1][i] > max(residuals[0][i] + MAX_RESIDUAL_GROWTH, 1.0 + MAX_RESIDUAL_GROWTH):
            refused[node.name] = (
                f"its outline would differ from its 2D box by {residuals[1][i]:.1f} standard "
                f"deviations instead of {residuals[0][i]:.1f}"
            )
        elif new:
            refused[node.name] = f"checks would report {', '.join(sorted(new))}"
        elif changes[i] > LARGE_CHANGE and visible[i] < SIDES_FOR_LARGE_CHANGE:
            refused[node.name] = (
                f"it needs a change of {changes[i]:.0f} standard deviations, which {visible[i]} "
                "visible sides do not justify"
            )
    return refused


def _prior_deviations(problem: FitProblem, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " n"]:
    """Return each object's largest change of position or scale, in prior standard deviations.

    Only horizontal positions count.
    """
    data, values = problem.data, x[CAMERA:].reshape(-1, 7)
    position = np.abs(problem.position_deviations(values)[:, :2]).max(axis=1)
    log_scale = values[:, 3:6].mean(axis=1)
    return np.maximum(position, np.abs(log_scale) / data.scale_sd)


def _error_codes(tree: SceneTree) -> dict[str, set[str]]:
    codes: dict[str, set[str]] = {}
    for issue in check_objects(tree):
        if issue.severity == "error":
            codes.setdefault(issue.node, set()).add(issue.code)
    return codes


def _outcome(
    problem: FitProblem,
    x: Float[np.ndarray, " u"],
    fixed: Bool[np.ndarray, " n"],
    refused: dict[str, str],
) -> tuple[SceneTree, FitReport]:
    """Return the fitted tree and the report.

    If the fit lowers the agreement, the initial tree is returned.
    """
    data = problem.data
    initial, fitted = data.tree, problem.tree(x, fixed)
    changes = {
        node.name: _change(initial, fitted, node, data.hidden[i], refused.get(node.name, ""))
        for i, node in enumerate(data.objects)
    }
    before, after = np.mean(
        [(change.agreement_before, change.agreement_after) for change in changes.values()], axis=0
    )
    moved = sum(
        change.distance_m > 0 or change.yaw_deg != 0 or change.size_ratio != (1.0, 1.0, 1.0)
        for change in changes.values()
    )
    # Contents and containers move toward each other, even if their 2D boxes then agree less.
    inside = {
        name for node in initial.nodes if node.relation == "in" for name in (node.name, node.parent)
    }
    gains = [c.agreement_after - c.agreement_before for n, c in changes.items() if n not in inside]
    is_worse = bool(gains) and float(np.mean(gains)) < -MAX_AGREEMENT_LOSS
    applied = (moved > 0 or fitted.camera != initial.camera) and not is_worse
    reason = f"{moved} of {len(changes)} objects moved, {len(refused)} refused"
    if is_worse:
        reason = f"not applied: it would lower the agreement from {before:.3f} to {after:.3f}"
        changes = {
            node.name: replace(
                _change(initial, initial, node, data.hidden[i], refused.get(node.name, "")),
                agreement_before=changes[node.name].agreement_before,
                agreement_after=changes[node.name].agreement_before,
            )
            for i, node in enumerate(data.objects)
        }
        return initial, FitReport(False, reason, float(before), float(before), objects=changes)
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
    hidden: Bool[np.ndarray, "4"],
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
        tuple(hidden.tolist()),
        refused,
    )

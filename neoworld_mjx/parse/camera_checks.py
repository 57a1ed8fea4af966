"""Check of the parsed camera by the vertical edges in the photograph, see `fit.vertical_edges`."""

import math

import numpy as np
from jaxtyping import UInt8

from ..fit.priors import is_slab
from ..fit.projection import outline_of
from ..fit.tree_checks import SceneIssue
from ..fit.vertical_edges import EdgeRegion, VerticalEdges, vertical_edges
from ..spec import SceneTree, TreeNode
from ..spec.pose import matrix

CAMERA = "the camera"
"""Name under which issues of the camera are reported; no object can have this name."""
UPRIGHT_TILT = math.radians(1.0)
"""Maximum tilt of an object whose edges vote [rad]."""
SIGMA = 3.5
"""Significance above which a deviation is an issue, in standard deviations (the square root of
twice the gain in log-likelihood, with two degrees of freedom). Of 210 correct cameras of 70
rendered scenes (exact, or with the noise of a response), none has an issue; with 2.5, one has."""
LEAST_DEVIATION = math.radians(3.0)
"""Deviation above which a camera has an issue [rad]; fit and alignment correct smaller ones."""
CERTAIN = 2.5
"""Ratio of a deviation to its standard deviation above which the deviation counts."""


def camera_issue(
    rgb: UInt8[np.ndarray, "h w 3"], tree: SceneTree, *, already_asked: bool = False
) -> SceneIssue | None:
    """Return an issue if the parsed camera contradicts the vertical edges, otherwise None.

    Args:
        rgb: the photograph.
        tree: the parsed scene.
        already_asked: if True, the model was already asked about the camera, so the issue is a
            warning and not an error.
    """
    edges = edges_of(rgb, tree)
    if edges is None or edges.sigma <= SIGMA or _deviation(edges) <= LEAST_DEVIATION:
        return None
    camera = edges.camera
    pitch, roll, fovy, new, turned, sd = (
        round(math.degrees(angle))
        for angle in (
            camera.pitch,
            camera.roll,
            camera.fovy,
            edges.pitch,
            edges.roll,
            edges.pitch_sd,
        )
    )
    ratio = math.tan(camera.fovy / 2) * math.tan(edges.pitch) / max(math.tan(camera.pitch), 1e-6)
    other = ""
    if ratio > 0:
        other = f", or a field of view of {math.degrees(2 * math.atan(ratio)):.0f} with your pitch"
    hint = (
        f"{edges.count:.0f} straight edges that look vertical meet where a pitch of {new} +- "
        f"{max(sd, 1)} and a roll of {turned} degrees put them with your field of view of {fovy}"
        f"{other}; you gave pitch {pitch} and roll {roll}. Measure pitch, roll and field of view "
        "again. If the camera changes, objects that you do not list again keep their pixels"
    )
    return SceneIssue(
        severity="warning" if already_asked else "error",
        node=CAMERA,
        code="upright_edges_deg",
        value=math.degrees(_deviation(edges)),
        threshold=math.degrees(LEAST_DEVIATION),
        hint=hint,
    )


def edges_of(rgb: UInt8[np.ndarray, "h w 3"], tree: SceneTree) -> VerticalEdges | None:
    """Estimate pitch and roll from the vertical edges of a photograph; None if no two edges vote.

    Edges in the 2D box of a node without vertical edges do not vote. Such nodes are flat supports,
    and objects that are tilted, have an open hinge, are tapered or have an unknown shape.

    Args:
        rgb: the photograph, of any size with the camera's aspect ratio.
        tree: the parsed scene.
    """
    regions = [
        EdgeRegion(node.box2d, _has_vertical_edges(node), node.environment) for node in tree.nodes
    ]
    return vertical_edges(rgb, tree.camera, regions)


def _deviation(edges: VerticalEdges) -> float:
    """Return the larger of the deviations of pitch and roll from the camera [rad].

    A deviation within CERTAIN standard deviations counts as 0.
    """
    off = [(edges.pitch - edges.camera.pitch, edges.pitch_sd)]
    off.append((edges.roll - edges.camera.roll, edges.roll_sd))
    certain = [abs(value) for value, sd in off if abs(value) > CERTAIN * sd]
    return float(max(certain, default=0.0))


def _has_vertical_edges(node: TreeNode) -> bool:
    if node.environment:
        return not is_slab(node)
    outline, axes = outline_of(node), np.abs(matrix(np.array(node.base_tilt)))
    # A box that lies on any of its faces has vertical edges.
    level = axes.max(axis=0) if outline == "box" else axes[2:, 2]
    tilted = float(level.min()) < math.cos(UPRIGHT_TILT) or node.relation == "leaning"
    part_turned = any(part.type != "prismatic" and part.opening > 0 for part in node.articulation)
    return not tilted and not part_turned and outline in ("box", "round")

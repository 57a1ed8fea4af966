"""Check of the parsed camera by the vertical edges in the photograph.

The images of vertical edges meet at one point, which pitch, roll and field of view determine. The
straight edges near the expected direction vote for pitch and roll, while the field of view keeps
its parsed value. An edge is assumed to be vertical with a probability of one half; otherwise its
direction is uniform within REACH of the expected direction. Edges that are not vertical do not
agree on another point, so a few of them do no harm. An error of the field of view appears as an
error of the pitch, because the point lies f / tan(pitch) below the middle of the picture.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from ..fit.priors import is_slab
from ..fit.projection import outline_of
from ..fit.tree_checks import SceneIssue
from ..spec import Camera, SceneTree, TreeNode
from ..spec.pose import matrix
from .line_segments import Segments, line_segments

CAMERA = "the camera"
"""Name under which issues of the camera are reported; no object can have this name."""
LONGER_PX = 960
"""Maximum length of the longer side [px]; edges are found in a picture reduced to it."""
REACH = math.radians(15.0)
"""Maximum angle between an edge and the expected direction [rad]."""
UPRIGHT = math.radians(0.6)
"""Standard deviation of the angle of a vertical edge in the picture [rad], in addition to the error
of its measurement. Reasons are that sides of objects bulge, and that lenses bend lines."""
VERTICAL = 0.5
"""Probability that an edge near the expected direction is vertical."""
PITCH_RANGE, ROLL_RANGE, GRID = math.radians(16.0), math.radians(8.0), math.radians(0.25)
"""Maximum deviations of pitch and roll from the parsed camera, and step of the grid [rad]."""
MAX_VOTES_PER_OBJECT = 6.0
"""Maximum total vote of the edges of one object, because these tend to be wrong together. It also
limits the vote of each of STRIPS vertical strips of the background."""
STRIPS = 8
MOST_SEGMENTS = 150
"""Maximum number of segments; the longest ones are used."""
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


@dataclass(frozen=True)
class UprightEdges:
    """Pitch and roll estimated from vertical edges, with the parsed field of view."""

    pitch: float
    """Mean of the distribution of the pitch [rad]."""
    pitch_sd: float
    """Standard deviation of the pitch [rad]."""
    roll: float
    """Mean of the distribution of the roll [rad]."""
    roll_sd: float
    """Standard deviation of the roll [rad]."""
    count: float
    """Expected number of vertical edges at the estimate, each weighted by its vote."""
    sigma: float
    """Significance with which the edges exclude the parsed camera, in standard deviations."""
    camera: Camera
    """The parsed camera."""

    @property
    def deviation(self) -> float:
        """Larger of the deviations of pitch and roll from the parsed camera [rad].

        A deviation within CERTAIN standard deviations counts as 0.
        """
        off = [(self.pitch - self.camera.pitch, self.pitch_sd)]
        off.append((self.roll - self.camera.roll, self.roll_sd))
        return max((abs(value) for value, sd in off if abs(value) > CERTAIN * sd), default=0.0)

    @property
    def contradicts(self) -> bool:
        """True if the edges exclude the parsed camera."""
        return self.sigma > SIGMA and self.deviation > LEAST_DEVIATION


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
    edges = upright_edges(rgb, tree)
    if edges is None or not edges.contradicts:
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
        value=math.degrees(edges.deviation),
        threshold=math.degrees(LEAST_DEVIATION),
        hint=hint,
    )


def upright_edges(rgb: UInt8[np.ndarray, "h w 3"], tree: SceneTree) -> UprightEdges | None:
    """Estimate pitch and roll from the vertical edges of a photograph.

    Edges in the 2D box of a node without vertical edges do not vote. Such nodes are flat supports,
    and objects that are tilted, have an open hinge, are tapered or have an unknown shape.

    Args:
        rgb: the photograph, of any size with the camera's aspect ratio.
        tree: the parsed scene.

    Returns:
        The estimate; None if no two edges vote.
    """
    camera = tree.camera
    factor = -(-max(rgb.shape[:2]) // LONGER_PX)
    cropped_size = [side // factor * factor for side in rgb.shape[1::-1]]
    small = np.asarray(Image.fromarray(rgb).reduce(factor, (0, 0, *cropped_size)))
    height, width = small.shape[:2]
    per_pixel = np.array([camera.width / width, camera.height_px / height])
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([columns, rows], axis=-1) * per_pixel
    expected = _towards_ground(camera, pixels, np.array(camera.pitch), np.array(camera.roll))
    all_segments = line_segments(small, expected / per_pixel, REACH)
    segments = Segments(*(values[:MOST_SEGMENTS] for values in all_segments))
    middle = segments.middle * per_pixel
    weights = _weights(tree, middle)
    votes = weights > 0
    if votes.sum() < 2:
        return None
    segments = Segments(*(values[votes] for values in segments))
    return _estimate(camera, middle[votes], segments, weights[votes])


def _estimate(
    camera: Camera,
    middle: Float[np.ndarray, "n 2"],
    segments: Segments,
    weights: Float[np.ndarray, " n"],
) -> UprightEdges:
    """Return the mean of the likelihood over a grid around the parsed pitch and roll."""
    steps = [np.arange(-round(r / GRID), round(r / GRID) + 1) for r in (PITCH_RANGE, ROLL_RANGE)]
    off = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1) * GRID
    pitch, roll = camera.pitch + off[..., 0], camera.roll + off[..., 1]
    expected = _towards_ground(camera, middle, pitch[..., None], roll[..., None])
    right, down = segments.direction.T
    angle = np.arctan2(
        expected[..., 0] * down - expected[..., 1] * right,
        expected[..., 0] * right + expected[..., 1] * down,
    )
    angle -= np.pi * np.round(angle / np.pi)
    sd = np.hypot(segments.sd, UPRIGHT)
    vertical = VERTICAL * np.exp(-((angle / sd) ** 2) / 2) / (sd * math.sqrt(2 * math.pi))
    other = (1 - VERTICAL) / (2 * REACH)
    log_likelihood = np.log(vertical + other) @ weights
    best = np.unravel_index(int(log_likelihood.argmax()), log_likelihood.shape)
    gain = log_likelihood[best] - log_likelihood[len(steps[0]) // 2, len(steps[1]) // 2]
    share = np.exp(log_likelihood - log_likelihood[best])
    share /= share.sum()
    at_best = vertical[best] / (vertical[best] + other)
    return UprightEdges(
        *_mean_and_sd(pitch, share),
        *_mean_and_sd(roll, share),
        count=float(at_best @ weights),
        sigma=math.sqrt(2 * max(float(gain), 0.0)),
        camera=camera,
    )


def _mean_and_sd(
    values: Float[np.ndarray, "p r"], share: Float[np.ndarray, "p r"]
) -> tuple[float, float]:
    mean = float(np.sum(share * values))
    return mean, math.sqrt(float(np.sum(share * (values - mean) ** 2)) + GRID**2 / 12)


def _towards_ground(
    camera: Camera,
    pixels: Float[np.ndarray, "*n 2"],
    pitch: Float[np.ndarray, "*m"],
    roll: Float[np.ndarray, "*m"],
) -> Float[np.ndarray, "*k 2"]:
    """Return the image direction of a vertical line, downwards, at each pixel; shape [..., 2]."""
    right, down = np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)
    ahead = np.sin(pitch)
    x, y = np.moveaxis(pixels - np.array([camera.width, camera.height_px]) / 2, -1, 0)
    return np.stack([camera.focal * right - x * ahead, camera.focal * down - y * ahead], axis=-1)


def _weights(tree: SceneTree, middle: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the weight of each edge's vote, from the smallest 2D box that contains its middle."""
    boxes = np.array([node.box2d.as_tuple() for node in tree.nodes])
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    pad = 0.006 * max(tree.camera.width, tree.camera.height_px)
    x = middle[:, None]
    within = np.all((x > boxes[:, :2] - pad) & (x < boxes[:, 2:] + pad), axis=2)
    owner = np.where(within.sum(axis=1), np.where(within, area, np.inf).argmin(axis=1), -1)
    has_edges = np.array([*(_has_upright_edges(node) for node in tree.nodes), True])
    background = np.array([*(node.environment for node in tree.nodes), True])
    strip = (middle[:, 0] / tree.camera.width * STRIPS).astype(int)
    group = np.where(background[owner], -1 - strip, owner)
    votes = has_edges[owner].astype(float)
    alike = (group[:, None] == group) @ votes
    return votes * np.minimum(1.0, MAX_VOTES_PER_OBJECT / np.maximum(alike, 1.0))


def _has_upright_edges(node: TreeNode) -> bool:
    if node.environment:
        return not is_slab(node)
    outline, axes = outline_of(node), np.abs(matrix(np.array(node.base_tilt)))
    # A box that lies on any of its faces has vertical edges.
    level = axes.max(axis=0) if outline == "box" else axes[2:, 2]
    tilted = float(level.min()) < math.cos(UPRIGHT_TILT) or node.relation == "leaning"
    part_turned = any(part.type != "prismatic" and part.opening > 0 for part in node.articulation)
    return not tilted and not part_turned and outline in ("box", "round")

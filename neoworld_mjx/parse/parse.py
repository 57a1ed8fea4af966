"""Step 1: request the scene in a photo; check and criticize it; and return the best round.

Each response is checked without a model. A repair request lists

- the issues of the response that the critic does not dismiss,
- the faults that the critic sees in the drawing of the scene.

The response to a repair request contains only changes. The result is the response with the best
score. The vertical edges in the photograph (`estimate.image.lines`) check the parsed camera.
"""

import asyncio
import json
import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8
from pydantic import ValidationError

from ..config import ParseOptions
from ..errors import ModelError, SpecError
from ..estimate.image.lines import EdgeRegion, VerticalEdges, vertical_edges
from ..evidence.evidence import Evidence
from ..evidence.known_camera import with_known_camera
from ..mllm import Fallback, Model, ask_or_record
from ..spec import SceneTree, TreeNode
from ..spec.pose import matrix
from .checks import SceneIssue, check_score, check_tree
from .draw import draw_parse
from .object_schema import error_line
from .outlines import is_slab, outline_of
from .photo import Photo
from .prompts import (
    NOTHING,
    SceneCritique,
    correction_request,
    critic_request,
    parse_request,
)
from .schema import ParsedScene, to_tree

CAMERA = "the camera"
"""Name under which issues of the camera are reported; no object can have this name."""
UPRIGHT_TILT = math.radians(1.0)
"""Maximum tilt of an object whose edges vote [rad]."""
SIGMA = 3.5
"""Significance above which a deviation is an issue, in standard deviations (the square root of
twice the gain in log-likelihood, with two degrees of freedom). Of 210 correct cameras of 70
rendered scenes (exact, or with the noise of a response), none has an issue; with 2.5, one has."""
LEAST_DEVIATION = math.radians(3.0)
"""Deviation above which a camera has an issue [rad]; the alignment corrects smaller ones."""
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


ACCEPT = 9.0
"""A response is accepted only if each of the critic's three scores is at least this value."""


@dataclass(frozen=True)
class SceneAttempt:
    """One response, with the results of its checks and its critique."""

    response: ParsedScene
    tree: SceneTree | None
    """The response's tree, with what the user knows; None if the response gives no tree."""
    broken: str = ""
    """Reason why the response gives no tree; empty if it gives one."""
    checks: tuple[SceneIssue, ...] = ()
    verdict: SceneCritique | None = None

    @property
    def open_issues(self) -> tuple[SceneIssue, ...]:
        """Issues that the critic did not dismiss."""
        dismissed = () if self.verdict is None else self.verdict.dismissed
        return tuple(
            issue for number, issue in enumerate(self.checks, start=1) if number not in dismissed
        )

    @property
    def score(self) -> float:
        """Score of the checks, 0 to 1, averaged with the critic's score if there is a critique.

        Without a tree, the score is -1.
        """
        if self.tree is None:
            return -1.0
        checks = check_score(self.tree, self.open_issues)
        return checks if self.verdict is None else (checks + self.verdict.score) / 2

    @property
    def corrections(self) -> tuple[str, ...]:
        """Faults to correct, each as one line; empty if the response is accepted."""
        if self.tree is None:
            return (self.broken,)
        low_score = self.verdict is not None and self.verdict.lowest < ACCEPT
        if not low_score and not any(issue.severity == "error" for issue in self.open_issues):
            return ()
        faults = () if self.verdict is None else self.verdict.faults
        return (
            *(issue.phrase() for issue in self.open_issues),
            *(f"{fault.node or 'scene'}: {fault.what} {fault.correction}" for fault in faults),
        )


@dataclass(frozen=True)
class Parsed:
    """The result of Step 1."""

    tree: SceneTree
    picture: bytes
    """The parsed scene drawn on the photo, as PNG."""
    rounds: tuple[SceneAttempt, ...]
    best_round: int
    """Index of the round that gave `tree`."""
    fallbacks: tuple[Fallback, ...] = ()
    """Stages that failed, each with the reason."""

    @property
    def checks(self) -> tuple[SceneIssue, ...]:
        """Issues that remain in `tree`."""
        return self.rounds[self.best_round].open_issues

    def to_json(self) -> str:
        """Return all rounds as JSON."""
        rounds = [
            {
                "answer": attempt.response.model_dump(mode="json"),
                "broken": attempt.broken,
                "checks": [issue.model_dump(mode="json") for issue in attempt.checks],
                "verdict": None
                if attempt.verdict is None
                else attempt.verdict.model_dump(mode="json"),
                "score": round(attempt.score, 4),
                "kept": number == self.best_round,
            }
            for number, attempt in enumerate(self.rounds)
        ]
        return json.dumps({"rounds": rounds}, indent=1) + "\n"


async def parse(
    photo: Photo,
    models: Model,
    options: ParseOptions | None = None,
    evidence: Evidence = NOTHING,
) -> Parsed:
    """Parse a photograph into a scene tree.

    Args:
        photo: the photograph.
        models: reasoner and critic.
        options: number of rounds.
        evidence: what is known. Values of the camera replace those of a response, whose objects
            keep their pixels; a metric depth image is shown to the models, and their requests list
            the names of known objects.

    Raises:
        ModelError: the first request failed, or no response gave a tree.
    """
    options = options or ParseOptions()
    fallbacks: list[Fallback] = []
    attempts: list[SceneAttempt] = []
    response = (await models.ask(parse_request(photo, evidence))).value
    attempt = await check_response(photo, response, evidence)
    for remaining in range(options.critic_rounds, -1, -1):
        if options.critic_rounds and attempt.tree is not None:
            # Draw only 2D boxes, so every machine draws the same.
            drawn = draw_parse(photo, attempt.tree)
            findings = [issue.phrase() for issue in attempt.checks]
            request = critic_request(photo, attempt.response, drawn, findings)
            verdict = await ask_or_record(models, request, "no judge round", fallbacks)
            attempt = replace(attempt, verdict=verdict)
        attempts.append(attempt)
        if not remaining or not attempt.corrections:
            break
        request = correction_request(photo, attempt.response, attempt.corrections, evidence)
        correction = await ask_or_record(models, request, "no repair round", fallbacks)
        if correction is None:
            break
        try:
            response = correction.applied(attempt.response, photo.size)
        except ValidationError as error:
            attempt = SceneAttempt(attempt.response, None, error_line(error))
            continue
        if response == attempt.response:
            break
        asked = any(issue.node == CAMERA for earlier in attempts for issue in earlier.checks)
        attempt = await check_response(photo, response, evidence, already_asked=asked)
    best = max(range(len(attempts)), key=lambda number: attempts[number].score)
    tree = attempts[best].tree
    if tree is None:
        raise ModelError(f"no response of {len(attempts)} gave a scene: {attempts[best].broken}")
    drawn = await asyncio.to_thread(draw_parse, photo, tree, draw_3d_boxes=True)
    return Parsed(tree, drawn.data, tuple(attempts), best, tuple(fallbacks))


async def check_response(
    photo: Photo,
    response: ParsedScene,
    evidence: Evidence = NOTHING,
    *,
    already_asked: bool = False,
) -> SceneAttempt:
    """Return the tree of a response with what the user knows, and its issues.

    Args:
        photo: the photograph.
        response: the response.
        evidence: what is known of the camera and of single objects.
        already_asked: if True, the model was already asked about the camera.
    """
    try:
        tree = to_tree(response, photo)
    except SpecError as error:
        return SceneAttempt(response, None, str(error))
    issue, known = None, evidence.camera
    if known is not None:
        tree = with_known_camera(tree, known)
    tree = evidence.objects.applied(tree)
    if known is None or known.pitch is None or known.roll is None:
        issue = await asyncio.to_thread(camera_issue, photo.rgb, tree, already_asked=already_asked)
    if issue is not None and not already_asked:
        # The picture contradicts the camera, so its numbers do not count as measured, unless the
        # model measures them again and insists: edges that look vertical need not be.
        tree = tree.model_copy(update={"camera_measured": (), "pitch_sd": None, "height_sd": None})
    checks = check_tree(tree)
    return SceneAttempt(response, tree, checks=checks if issue is None else (issue, *checks))

"""Preview of a reasoner's response before it is given: 3D boxes on the photograph, and numbers.

The response may be a whole scene, or the changes that answer a request for corrections. It is
checked as Step 1 does, so the preview shows what the run would find.
"""

import json
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..evidence.evidence import Evidence
from ..evidence.known_camera import KnownCamera
from ..mllm import Picture
from ..mllm.panel import run_coroutine
from ..mllm.requests import InvalidResponse, read_response
from ..spec import SceneTree, TreeNode
from .checks import AGREEMENT_ERROR, AGREEMENT_WARNING, REACH, agreement, best_agreement
from .draw import draw_parse
from .outlines import expected_box, nearest_outline, outline_of
from .parse import check_response
from .photo import Photo
from .prompts import REPAIR_PROMPT
from .schema import ParsedScene, SceneCorrection


class Preview(NamedTuple):
    """Result of Step 1 for one response."""

    picture: Picture
    """The photograph with 2D and 3D boxes; the 3D boxes are those of the response."""
    objects: list[dict[str, object]]
    """For each object, the 2D box and the nearest box of the projected outline [px], their IoU, the
    best IoU within reach, the class of the outline, the heading [deg], and the gap above the
    support [m]."""
    issues: list[str]
    """Issues, one line each. A run asks for corrections of the errors."""


def preview(photo: Photo, text: str, prompt: str = "", known: KnownCamera | None = None) -> Preview:
    """Draw and check a response to a request for a scene or for corrections of a scene.

    Args:
        photo: the photograph. Numbers are in pixels of its resized picture, as in the request.
        text: the response.
        prompt: the request's prompt, which contains the scene that a correction changes.
        known: what is known of the camera.

    Raises:
        SpecError: the response is invalid, or gives no scene.
    """
    attempt = run_coroutine(
        check_response(photo, _scene(photo, text, prompt), Evidence(camera=known))
    )
    tree = attempt.tree
    if tree is None:
        raise SpecError(f"the response gives no scene: {attempt.broken}")
    return Preview(
        draw_parse(photo, tree, draw_3d_boxes=True),
        [dict(_numbers(tree, node, photo.scale)) for node in tree.nodes],
        [f"{issue.severity}: {issue.phrase()}" for issue in attempt.checks],
    )


LEGEND = (
    "box_iou: intersection over union of `box` and `outline`, the box of the object's outline in "
    f"its 3D box, as in run.json. best_iou: the same after a move of at most {REACH:.0%} of the "
    f"distance along and across the view, as Step 4 makes it; below {AGREEMENT_WARNING:g} is a "
    f"warning, below {AGREEMENT_ERROR:g} an error. The arrow on each base points to the front "
    "(yaw_deg)."
)
LOOSE = "loose (its shape in the 3D box is unknown, so box_iou is high: look at the picture)"
"""Class of an outline whose sides lie anywhere between the middles of faces and the 3D box."""


def number_lines(objects: list[dict[str, object]], issues: list[str]) -> list[str]:
    """Return the numbers of a preview as lines of text, with a line that explains them."""
    rows = [LEGEND]
    for entry in objects:
        texts = [f"{key} {_text(value)}" for key, value in entry.items() if key != "name"]
        rows.append(f"{entry['name']}: {'; '.join(texts)}")
    return [*rows, *(issues or ["no issues"])]


def _scene(photo: Photo, text: str, prompt: str) -> ParsedScene:
    """Return the scene of a response; a correction is applied to the scene in the prompt."""
    _, corrects, rest = prompt.partition(REPAIR_PROMPT.partition("{ask}")[2].partition("{")[0])
    try:
        if not corrects:
            return read_response(text, ParsedScene)
        earlier, _ = json.JSONDecoder().raw_decode(rest)
        scene = ParsedScene.model_validate_json(json.dumps(earlier))
        return read_response(text, SceneCorrection).applied(scene, photo.size)
    except (InvalidResponse, ValueError) as error:
        raise SpecError(f"the response is invalid: {error}") from None


def _numbers(tree: SceneTree, node: TreeNode, scale: float) -> Iterator[tuple[str, object]]:
    is_support = node.environment
    projected = expected_box(tree.camera, node) if is_support else nearest_outline(tree, node)
    yield "name", node.name
    yield "box", _pixels(node.box2d.as_tuple(), scale)
    yield "outline", "outside the picture" if projected is None else _pixels(projected, scale)
    if not is_support:
        yield "box_iou", round(agreement(tree, node), 2)
        yield "best_iou", round(best_agreement(tree, node), 2)
        outline = outline_of(node)
        yield "class", LOOSE if outline == "loose" else outline
        yield "yaw_deg", round(math.degrees(node.box3d.yaw))
    if node.parent is not None and node.relation == "on":
        box = tree.node(node.parent).box3d
        yield "gap_m", round(node.box3d.position[2] - box.position[2] - box.size[2], 3)


def _pixels(box: Sequence[float] | NDArray, scale: float) -> list[int]:
    return np.round(np.asarray(box) * scale).astype(int).tolist()


def _text(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)

"""A model as judge of reconstructed scenes: completeness, layout and function from 1 to 7.

Each request shows one scene and is repeated. A response is valid only if all three scores are whole
numbers from 1 to 7; other responses and refusals count as missing.
"""

import asyncio
from collections.abc import Iterator, Sequence
from statistics import fmean, stdev
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from neoworld_mjx.errors import BudgetError, ConfigError, MissingResponseError, ModelError
from neoworld_mjx.mllm import Panel, Picture, Request, Response, package_text
from neoworld_mjx.render import View, render_scene
from neoworld_mjx.render.scene_images import subject_points, with_open_joints
from neoworld_mjx.spec import SceneSpec

from ..paper_figures import of_scenes
from ..rows import Row
from .picture_rows import MadeScene

QUESTIONS = ("completeness", "layout", "function")
SHOWN_PX = 640
"""Longer side of the images for the judge [px]."""
ASIDE_DEG, ABOVE_DEG = 50.0, 40.0
"""Azimuth of the second view relative to the photograph's, and its elevation [deg]."""
MOST_JOINTS = 40
"""Maximum number of listed joints."""


class RatedQuestion(BaseModel):
    """One question; the reason comes first, so that the score follows from it."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, Field(max_length=1000)]
    score: Literal[1, 2, 3, 4, 5, 6, 7]

    @field_validator("score", mode="before")
    @classmethod
    def _a_number(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("a score is a number from 1 to 7, not true or false")
        return value


class SceneRating(BaseModel):
    """The judge's answer about one scene."""

    model_config = ConfigDict(extra="forbid")

    completeness: RatedQuestion
    layout: RatedQuestion
    function: RatedQuestion


class RatingRow(Row):
    """Result of one judgement of a scene."""

    folder: str
    scene_number: int
    repeat: int
    """Number of the judgement, from 1."""
    completeness: int | None
    layout: int | None
    function: int | None
    model: str
    why: str
    """Reason for a missing response."""


def judged_pictures(made: MadeScene) -> list[Picture]:
    """Render the images of a scene for the judge, the photograph first."""
    photo, rendered = made.whole(SHOWN_PX)
    height, width = photo.shape[:2]
    half_open = with_open_joints(made.scene, 0.5)
    backward = -made.camera.axes()[:, 2]
    view = View.framing(
        np.vstack([subject_points(made.scene), subject_points(half_open)]),
        width=width,
        height=height,
        azimuth=float(np.arctan2(backward[1], backward[0])) + np.radians(ASIDE_DEG),
        elevation=np.radians(ABOVE_DEG),
        margin=1.05,
    )
    pictures = {"photo": photo, "scene": rendered, "aside": render_scene(made.scene, view).color}
    if _moving(made.scene):
        pictures["open"] = render_scene(half_open, view).color
    return [Picture.of(label, rgb) for label, rgb in pictures.items()]


def rating_request(
    made: MadeScene, pictures: list[Picture], repeat: int, repeats: int
) -> Request[SceneRating]:
    """Return the request for one judgement; the repeats of a scene differ by their number."""
    joints = _moving(made.scene)
    listed = "\n".join(f"- {line}" for line in joints[:MOST_JOINTS]) or "- none"
    remainder = f"\n- and {len(joints) - MOST_JOINTS} more" if len(joints) > MOST_JOINTS else ""
    prompt = (
        f"Joints that can move:\n{listed}{remainder}\n\nThis is judgement {repeat} of {repeats} of "
        "this scene. The others are not known to you: judge it as if it were the only one."
    )
    system = package_text(__package__, "judge").removesuffix("\n")
    name = f"judge:{made.name}:{repeat}"
    return Request("critic", name, system, prompt, SceneRating, pictures)


def rating_rows(
    models: Panel, scenes: Sequence[MadeScene], *, repeats: int = 3
) -> Iterator[RatingRow]:
    """Yield the judgements of each scene.

    Args:
        models: provides the critic; its tape records every response.
        scenes: the scenes.
        repeats: judgements of each.

    Raises:
        ConfigError: `repeats` is out of range.
        BudgetError: the cost cap is reached.
        MissingResponseError: a tape lacks a response.
    """
    if not 1 <= repeats <= 20:
        raise ConfigError(f"--repeats takes 1 to 20, got {repeats}")
    for made in scenes:
        pictures = judged_pictures(made)
        requests = [rating_request(made, pictures, k, repeats) for k in range(1, repeats + 1)]
        for k, answer in enumerate(_answers(models, requests), start=1):
            yield _row(made, k, answer)


def _answers(
    models: Panel, requests: Sequence[Request[SceneRating]]
) -> list[Response[SceneRating] | ModelError]:
    """Send requests concurrently; a refusal or invalid response becomes its error."""

    async def one(request: Request[SceneRating]) -> Response[SceneRating] | ModelError:
        try:
            return await models.ask(request)
        except (BudgetError, MissingResponseError):
            raise
        except ModelError as error:
            return error

    async def together() -> list[Response[SceneRating] | ModelError]:
        return await asyncio.gather(*map(one, requests))

    return models.run(together())


def rating_figures(rows: Sequence[RatingRow]) -> dict[str, Any]:
    """Return each question's mean over the n scenes with a valid response, alongside the paper's,
    which are of its own scenes by its own judge.

    A scene's score is the mean of its valid responses. "sd_scenes" is the standard deviation of
    these scores, "sd_repeats" the mean standard deviation of the responses about one scene; None if
    undefined.
    """
    by_scene: dict[int, list[RatingRow]] = {}
    for row in rows:
        if row.completeness is not None:
            by_scene.setdefault(row.scene_number, []).append(row)
    answers = sum(map(len, by_scene.values()))
    means: dict[str, float | None] = {}
    spread: dict[str, dict[str, float | None]] = {"sd_scenes": {}, "sd_repeats": {}}
    for question in QUESTIONS:
        scores = [
            [getattr(row, question) for row in scene_rows] for scene_rows in by_scene.values()
        ]
        own_means = [fmean(scene_scores) for scene_scores in scores]
        repeated = [stdev(scene_scores) for scene_scores in scores if len(scene_scores) > 1]
        means[question] = fmean(own_means) if own_means else None
        spread["sd_scenes"][question] = stdev(own_means) if len(own_means) > 1 else None
        spread["sd_repeats"][question] = fmean(repeated) if repeated else None
    return {
        "scenes": len({row.scene_number for row in rows}),
        "n": len(by_scene),
        "answers": answers,
        "missing": len(rows) - answers,
        **means,
        **spread,
        "paper": of_scenes("complete", "layout", "function"),
    }


def _row(made: MadeScene, repeat: int, answer: Response[SceneRating] | ModelError) -> RatingRow:
    if isinstance(answer, ModelError):
        scores, model, why = dict.fromkeys(QUESTIONS), "", str(answer)
    else:
        rating = answer.value
        scores = {question: getattr(rating, question).score for question in QUESTIONS}
        model, why = answer.model, ""
    return RatingRow(
        folder=made.name,
        scene_number=made.number,
        repeat=repeat,
        **scores,
        model=model,
        why=why,
    )


def _moving(scene: SceneSpec) -> list[str]:
    """Return the moving joints, one per line."""
    return [
        f"{item.name}: {joint.child} ({joint.type})"
        for item in scene.objects
        for joint in item.spec.joints
        if joint.type != "fixed"
    ]

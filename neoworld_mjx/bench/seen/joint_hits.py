"""Hits of joints as the paper decides them: a model compares films of paired joints.

The total is the number of true joints that move. Those without a made joint to be held against
are missed; of the others the model says whether both films show the same joint.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from ...errors import ConfigError, ModelError, RunError
from ...files import write_atomic
from ...measure import pooled
from ...mllm import Panel, Picture, Request, package_text
from ..rows import Row
from .answer_file import AnswerFile, answers_to
from .joint_films import JointedPair
from .paper_figures import PAPER_JOINTS

NOTE = "NeoWorld-Pro as the paper reports it: 216 hits of its 245 joints, miss 0.1183"


class FilmComparison(BaseModel):
    """The model's answer about two films; the reason comes first, so that the rest follows."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, Field(max_length=1000)]
    same_joint: Annotated[bool, Field(strict=True)]


class JointHitRow(Row):
    """One true joint."""

    object: str
    joint: str
    made_joint: str
    """That it is held against; empty if there is none."""
    answers: int
    """Valid ones."""
    same: int
    """Of them those that say it is the same joint."""
    hit: bool | None
    """Whether more than half say so; None without a valid answer."""
    geometric_hit: bool
    """Whether the measure by geometry pairs it with any made joint."""
    why: str


def comparison_request(
    pair: JointedPair, joint: str, films: Sequence[Picture], repeat: int, repeats: int
) -> Request[FilmComparison]:
    """Return the request about a true joint; repeats differ by their number."""
    prompt = (
        f"The object: {pair.true.label or pair.name}.\n\nThis is answer {repeat} of {repeats} "
        "about these strips. The others are not known to you."
    )
    system = package_text(__package__, "joint_judge").removesuffix("\n")
    name = f"joint:{pair.name}:{joint}:{repeat}"
    return Request("critic", name, system, prompt, FilmComparison, films)


def joint_hit_rows(
    models: Panel,
    pairs: Sequence[JointedPair],
    *,
    repeats: int = 1,
    out: Path | None = None,
) -> Iterator[JointHitRow]:
    """Yield a row for every true joint that moves something.

    Args:
        models: the critic answers.
        pairs: the objects.
        repeats: answers about each joint.
        out: folder for answers.json, with every answer as it came, and the films.

    Raises:
        ConfigError: `repeats` is out of range.
        BudgetError: the cost cap is reached.
        MissingAnswerError: a tape lacks an answer.
        RunError: a file cannot be written.
    """
    if not 1 <= repeats <= 20:
        raise ConfigError(f"--repeats takes 1 to 20, got {repeats}")
    file = AnswerFile(out)
    for number, pair in enumerate(pairs):
        by_geometry = {each.true for each in pair.geometry().pairs}
        partners = pair.partners
        for joint in (each.name for each in pair.truth.joints):
            partner = partners.get(joint, "")
            answers, same, why = 0, 0, ""
            balls = "ball" in (pair.true_joint(joint).type, _type(pair, partner))
            if not partner:
                why = "no made joint is left for it"
            elif balls:
                why = "ball joints are not filmed"
            else:
                films = pair.strips(joint, partner)
                _save(out, f"{number:02d}_{pair.name}-{joint}", films)
                requests = [
                    comparison_request(pair, joint, films, k, repeats)
                    for k in range(1, repeats + 1)
                ]
                for request, answer in zip(requests, answers_to(models, requests), strict=True):
                    file.add(request, answer)
                    if isinstance(answer, ModelError):
                        why = str(answer)
                    else:
                        answers += 1
                        same += answer.value.same_joint
            yield JointHitRow(
                object=pair.name,
                joint=joint,
                made_joint=partner,
                answers=answers,
                same=same,
                hit=False if not partner else 2 * same > answers if answers else None,
                geometric_hit=joint in by_geometry,
                why=why,
            )


def joint_hit_figures(rows: Sequence[JointHitRow], pairs: Sequence[JointedPair]) -> dict[str, Any]:
    """Return hits and misses by the model and, another measure, by geometry, beside the paper's.

    `miss` is 1 - hits / (total - unanswered).
    """
    decided = [row for row in rows if row.hit is not None]
    hits = sum(bool(row.hit) for row in decided)
    geometry = pooled([pair.geometry() for pair in pairs])
    return {
        "objects": len(pairs),
        "total": len(rows),
        "predicted": geometry.predicted,
        "hits": hits,
        "missed": len(decided) - hits,
        "unanswered": len(rows) - len(decided),
        "miss": 1 - hits / len(decided) if decided else None,
        "geometry": {"total": geometry.total, "hits": geometry.hits, "miss": geometry.miss},
        "paper": {"joints": PAPER_JOINTS, "note": NOTE},
    }


def _type(pair: JointedPair, name: str) -> str:
    joints = () if pair.made is None else pair.made.joints
    return next((joint.type for joint in joints if joint.name == name), "")


def _save(out: Path | None, name: str, films: Sequence[Picture]) -> None:
    for film in films if out is not None else ():
        assert out is not None
        file = out / f"{name}-{film.label}.png"
        try:
            out.mkdir(parents=True, exist_ok=True)
            write_atomic(file, film.data)
        except OSError as error:
            raise RunError(f"cannot write {file}: {error.strerror}") from None

"""Joint hits as the paper defines them: a model compares film strips of paired joints.

The total is the number of moving ground-truth joints. Those without a reconstructed partner are
missed; for the others the model decides whether both strips show the same joint.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from neoworld_mjx.errors import ConfigError, ModelError
from neoworld_mjx.mllm import Panel, Picture, Request, package_text

from ..measures import pooled
from ..paper_figures import PAPER_JOINTS
from ..rows import Row
from .answer_file import AnswerFile, answers_to, save_pictures
from .joint_films import JointedPair

MOST_LABEL = 80
"""Maximum length of an object's label in a request."""
NOTE = "NeoWorld-Pro as the paper reports it: 216 hits of its 245 joints, miss 0.1183"


class FilmComparison(BaseModel):
    """The model's answer about two films; the reason comes first, so that the rest follows."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, Field(max_length=1000)]
    same_joint: Annotated[bool, Field(strict=True)]


class JointHitRow(Row):
    """One ground-truth joint."""

    object: str
    joint: str
    made_joint: str
    """Its partner; empty if there is none."""
    answers: int
    """Number of valid responses."""
    same: int
    """Number of valid responses that call the joints the same."""
    hit: bool | None
    """True if the majority calls them the same; None without a valid response."""
    geometric_hit: bool
    """True if the measure by geometry pairs it with any reconstructed joint."""
    why: str


def comparison_request(
    pair: JointedPair, joint: str, films: Sequence[Picture], repeat: int, repeats: int
) -> Request[FilmComparison]:
    """Return the request about a ground-truth joint; repeats differ by their number."""
    kind = " ".join((pair.true.label or pair.true.name).split())[:MOST_LABEL]
    prompt = (
        f"The object: {kind}.\n\nThis is answer {repeat} of {repeats} "
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
    """Yield a row for every ground-truth joint that moves something.

    Args:
        models: provides the critic.
        pairs: the objects.
        repeats: responses about each joint.
        out: folder for answers.json, with every response as it came, and the films.

    Raises:
        ConfigError: `repeats` is out of range.
        BudgetError: the cost cap is reached.
        MissingResponseError: a tape lacks a response.
        RunError: a file cannot be written.
    """
    if not 1 <= repeats <= 20:
        raise ConfigError(f"--repeats takes 1 to 20, got {repeats}")
    file = AnswerFile(out)
    for number, pair in enumerate(pairs):
        by_geometry = {each.true for each in pair.geometry().pairs}
        partners = pair.partners
        requests: dict[str, list[Request[FilmComparison]]] = {}
        for joint, partner in partners.items():
            if "ball" not in (pair.true_joint(joint).type, pair.made_type(partner)):
                films = pair.strips(joint, partner)
                if out is not None:
                    save_pictures(out, f"{number:02d}_{pair.name}-{joint}", films)
                requests[joint] = [
                    comparison_request(pair, joint, films, k, repeats)
                    for k in range(1, repeats + 1)
                ]
        all_requests = [request for of_joint in requests.values() for request in of_joint]
        answers = dict(zip(all_requests, answers_to(models, all_requests), strict=True))
        for joint in (each.name for each in pair.truth.joints):
            answered = [(request, answers[request]) for request in requests.get(joint, ())]
            for request, answer in answered:
                file.add(request, answer)
            valid = [a.value.same_joint for _, a in answered if not isinstance(a, ModelError)]
            failed = [str(a) for _, a in answered if isinstance(a, ModelError)]
            made_joint, same = partners.get(joint, ""), sum(valid)
            if not made_joint:
                failed = [pair.why if pair.made is None else "no made joint is left for it"]
            elif not answered:
                failed = ["ball joints are not filmed"]
            decided = 2 * same > len(valid) if valid else None
            yield JointHitRow(
                object=pair.name,
                joint=joint,
                made_joint=made_joint,
                answers=len(valid),
                same=same,
                hit=decided if made_joint else False,
                geometric_hit=joint in by_geometry,
                why=failed[-1] if failed else "",
            )


def joint_hit_figures(rows: Sequence[JointHitRow], pairs: Sequence[JointedPair]) -> dict[str, Any]:
    """Return hits and misses by the model and, another measure, by geometry, beside the paper's.

    `miss` is 1 - hits / (total - unanswered).
    """
    decided = [row for row in rows if row.hit is not None]
    hits = sum(bool(row.hit) for row in decided)
    geometry = pooled([pair.geometry() for pair in pairs])
    return {
        "total": len(rows),
        "predicted": geometry.predicted,
        "hits": hits,
        "unanswered": len(rows) - len(decided),
        "miss": 1 - hits / len(decided) if decided else None,
        "geometry": {"hits": geometry.hits, "miss": geometry.miss},
        "objects": len(pairs),
        "missed": len(decided) - hits,
        "paper": {"joints": PAPER_JOINTS, "note": NOTE},
    }

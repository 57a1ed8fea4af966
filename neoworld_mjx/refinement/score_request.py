"""Request to score a candidate by four criteria, in comparison with the photograph (Appendix B).

The system text and the photograph come first and are equal for all candidates of a run, so a server
with a prompt cache charges their full price only once.
"""

from functools import cache
from importlib import resources
from typing import Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, field_validator

from ..mllm import Picture, Request
from ..spec import SceneSpec

Level = Literal[0, 1, 2, 3, 4]
MAX_LEVEL = max(get_args(Level))
CRITERIA = ("depth_ordering", "relative_size", "relative_orientation", "intersections")

PROMPT = (
    "The objects and their supports:\n\n{listing}\n\n"
    "Compare the arrangement of the objects in the candidate with that in the photograph."
)


class Judged(BaseModel):
    """One criterion; the reason comes first, so that the level follows from it."""

    model_config = ConfigDict(extra="forbid")

    reason: str = Field(description="What agrees and what does not, in one or two sentences.")
    level: Level = Field(description="0 (most pairs disagree) to 4 (all agree).")

    @field_validator("level", mode="before")
    @classmethod
    def _reject_bool(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("a level is a number from 0 to 4, not true or false")
        return value


class Judgement(BaseModel):
    """The critic's judgement of one candidate."""

    model_config = ConfigDict(extra="forbid")

    depth_ordering: Judged
    relative_size: Judged
    relative_orientation: Judged
    intersections: Judged

    @property
    def levels(self) -> dict[str, int]:
        """The level of each criterion, 0 to 4."""
        return {name: getattr(self, name).level for name in CRITERIA}

    @property
    def reasons(self) -> dict[str, str]:
        """The reason for the level of each criterion."""
        return {name: getattr(self, name).reason for name in CRITERIA}

    @property
    def value(self) -> float:
        """S_sem: the sum of the levels over its maximum, in [0, 1]."""
        return sum(self.levels.values()) / (MAX_LEVEL * len(CRITERIA))


@cache
def system_text() -> str:
    """Return the critic's system text."""
    return resources.files("neoworld_mjx.refinement").joinpath("scorer.md").read_text("utf-8")


def score_request(photo: Picture, candidate: Picture, scene: SceneSpec) -> Request[Judgement]:
    """Build the request that scores one candidate.

    Args:
        photo: the photograph; pass the same Python object for all candidates.
        candidate: the rendered image of the candidate, labeled "candidate".
        scene: the scene of any candidate, for the names and the hierarchy of its objects.
    """
    return Request(
        role="critic",
        name="score",
        system=system_text(),
        prompt=PROMPT.format(listing=listing(scene)),
        schema=Judgement,
        pictures=[photo, candidate],
    )


def listing(scene: SceneSpec) -> str:
    """List the objects of a scene with their supports, one object per line."""
    lines = []
    for item in scene.objects:
        place = "the environment" if item.environment else "stands by itself"
        if item.parent is not None:
            place = f"{item.relation} {item.parent}"
            if item.parent_link is not None:
                place += f" ({item.parent_link})"
        lines.append(f"- {item.name}: {place}")
    return "\n".join(lines)

"""Report of a fit: changes of the camera, of each object's box, and of supports."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ..spec import Box3D
from ..spec.tree import Relation

NOTED_M, NOTED_SIZE = 0.10, 0.10
"""Changes of position [m] and size (relative) above which a note reports them."""
MIN_GAIN = 2 * math.log(31)
"""Minimum decrease of the sum of squared residuals at which another support is used.

It is twice the log of the prior odds of the parsed support. The odds are 31:1 by Laplace's rule of
succession: of 30 objects in five rendered pictures, none had a wrong support."""


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
class OtherSupport:
    """New support of an object, which replaces the parsed support."""

    before: str
    """Parsed relation and parent."""
    parent: str
    relation: Relation
    z: float
    """Height of the object's lowest point [m]."""
    gain: float
    """Decrease of the sum of squared residuals of the object's fit."""

    def phrase(self) -> str:
        """Return the reason for the change as a phrase."""
        return (
            f"{self.before}, it would penetrate another object or rest on nothing; "
            f"{self.relation} {self.parent}, the sum of squared residuals of its fit is lower by "
            f"{self.gain:.0f}, and at least {MIN_GAIN:.0f} is required"
        )


@dataclass(frozen=True)
class FitReport:
    """Outcome of a fit."""

    applied: bool
    """True if anything moved."""
    reason: str
    agreement_before: float
    """Mean agreement of the 2D boxes with the projected outlines of categories or built shapes,
    from 0 to 1."""
    agreement_after: float
    pitch_deg: float = 0.0
    """Change of the camera's pitch [deg]."""
    height_m: float = 0.0
    """Change of the camera's height [m]."""
    objects: dict[str, BoxChange] = field(default_factory=dict)
    supports: dict[str, OtherSupport] = field(default_factory=dict)
    """New supports of the objects whose parsed support is infeasible."""

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
        groups = {"objects": self.objects, "carriers": self.supports}
        return {
            **{
                k: _json_value(v) for k, v in vars(self).items() if k not in ("objects", "supports")
            },
            **{
                group: {
                    name: {key: _json_value(value) for key, value in vars(change).items()}
                    for name, change in changes.items()
                }
                for group, changes in groups.items()
            },
        }


def _json_value(value: Any) -> Any:
    if isinstance(value, Box3D):
        return value.model_dump(mode="json")
    if isinstance(value, tuple):
        return [_json_value(entry) for entry in value]
    return round(value, 4) if isinstance(value, float) else value

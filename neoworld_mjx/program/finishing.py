"""The finish of a material that a program defines: pattern, metallic and roughness."""

from typing import Any

from .. import spec as S
from ..errors import choices
from ..spec.finish import finish, named_finish
from ..spec.surface_pattern import PATTERN_KINDS
from . import validate


def stated_finish(
    kind: Any, rgb2: Any, step: Any, along: Any, metallic: Any, roughness: Any, context: str
) -> dict[str, Any]:
    """Return the fields of a material that a program states; each argument may be None.

    Raises:
        ValueError, TypeError: one is of a wrong kind.
    """
    fields: dict[str, Any] = {
        key: validate.number(share, f"{context}: {key}")
        for key, share in (("metallic", metallic), ("roughness", roughness))
        if share is not None
    }
    if kind is None:
        if rgb2 is not None or step is not None:
            raise ValueError(f"{context}: rgb2 and step belong to a pattern=")
        return fields
    if kind not in PATTERN_KINDS:
        raise ValueError(f"{context}: pattern: {choices(str(kind), list(PATTERN_KINDS))}")
    fields["pattern"] = validate.described(
        S.SurfacePattern,
        f"{context}: pattern",
        kind=kind,
        rgb=None if rgb2 is None else validate.colour(rgb2, f"{context}: rgb2"),
        step=None if step is None else validate.length(step, f"{context}: step"),
        along=along,
    )
    return fields


def inherited_finish(base: S.Material, name: str) -> dict[str, Any]:
    """Return the fields that a material has from another that it is like.

    They matter where its own name does not say what it is made of: "seat", like oak.
    """
    if named_finish(name) or not named_finish(base.name):
        return {}
    return {k: v for k, v in finish(base)._asdict().items() if v not in (None, 0.0)}

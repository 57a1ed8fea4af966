"""An object through Step 3: the battery, repairs, and what is kept of both between runs."""

import logging
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from ..cache import cache_folder
from ..config import VerifyOptions
from ..files import content_hash, write_atomic
from ..mllm import Panel
from ..spec import ObjectSpec
from ..spec.object import Quat
from ..spec.pose import IDENTITY
from .battery import VERSION, Battery
from .critic import Seen, with_models
from .patch import Patch, apply
from .ranges import Allowed
from .repairs import repair
from .verdict import Verdict

_log = logging.getLogger(__name__)


class Sound(BaseModel):
    """What Step 3 came to."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    verdict: Verdict
    """On the object as it is handed on."""
    before: Verdict | None = None
    """On the object as it came, where it was repaired."""
    patch: Patch = Patch()
    changes: tuple[str, ...] = ()
    """Each change, in words."""
    tried: tuple[str, ...] = ()
    """Every patch that was tried, also those that did not help."""
    seen: tuple[str, ...] = ()
    """What the critic saw in the key frames."""

    def applied(self, spec: ObjectSpec) -> ObjectSpec:
        """Return the object with its patch."""
        return spec if self.patch.empty else apply(self.patch, spec)[0]


def make_sound(
    spec: ObjectSpec,
    options: VerifyOptions | None = None,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    allowed: Allowed | None = None,
    models: Panel | None = None,
    keep: bool = True,
) -> Sound:
    """Try an object, and mend what numbers tell how to mend, in at most `options.rounds` rounds.

    Args:
        spec: the object.
        options: of the battery; with `rounds` 0 nothing is changed.
        fixed_base: whether its base stays fastened.
        tilt: how it rests.
        allowed: overlaps [m] that its program asks for, by the names of two parts.
        models: critic and reasoner, who look at what numbers did not mend; None asks nobody.
        keep: whether an earlier result for the same content may stand for this one, and is kept.
    """
    o = options or VerifyOptions()
    place = _place(spec, o, fixed_base, tilt, allowed)
    keep = keep and models is None  # What models say is kept on tapes.
    if keep and (found := _read(place)) is not None:
        return found

    def run(made: ObjectSpec) -> Battery:
        return Battery(made, o, fixed_base=fixed_base, tilt=tilt, allowed=allowed)

    first = run(spec)
    if first.verdict.passed or o.rounds == 0:
        result = Sound(verdict=first.verdict)
    else:
        made = repair(spec, run, rounds=o.rounds, first=first)
        seen: list[Seen] = []
        if models is not None and not made.after.passed:
            seen = with_models(made, run(made.spec), models, run, spec)
        result = Sound(
            verdict=made.after,
            before=None if made.patch.empty else made.before,
            patch=made.patch,
            changes=made.changes,
            tried=tuple(made.tried),
            seen=tuple(f"{f.where}: {f.what}" for s in seen for f in s.findings),
        )
    if keep:
        _write(place, result)
    return result


def _place(
    spec: ObjectSpec, o: VerifyOptions, fixed_base: bool, tilt: Quat, allowed: Allowed | None
) -> Path:
    key = content_hash(
        {
            "battery": VERSION,
            "spec": spec.model_dump(mode="json"),
            "options": o.model_dump(mode="json"),
            "fixed": fixed_base,
            "tilt": list(tilt),
            "allowed": sorted([*sorted(pair), depth] for pair, depth in (allowed or {}).items()),
        }
    )
    return cache_folder() / "verify" / f"{key}.json"


def _read(place: Path) -> Sound | None:
    try:
        return Sound.model_validate_json(place.read_text(encoding="utf-8"))
    except (OSError, ValidationError, ValueError):
        return None


def _write(place: Path, result: Sound) -> None:
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(place, result.model_dump_json())
    except OSError as error:
        _log.debug("verdict not kept: %s", error)  # It costs time only.


__all__ = ["Sound", "make_sound"]

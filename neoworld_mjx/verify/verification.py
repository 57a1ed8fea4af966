"""An object through Step 3: the battery, repairs, and what is kept of both between runs."""

import json
import logging
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from ..cache import cache_folder
from ..config import VerifyOptions
from ..files import content_hash, write_atomic
from ..mllm import Panel
from ..program.allowance import Allowance
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .battery import VERSION, Battery
from .critic import MotionCritique, with_models
from .patch import Patch, apply
from .repairs import repair
from .verdict import Verdict

_log = logging.getLogger(__name__)


class VerificationResult(BaseModel):
    """Result of Step 3 for one object."""

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

    def to_json(self) -> str:
        """Write down the verdict, with what was changed, tried and seen on the way to it."""
        data = self.verdict.model_dump(mode="json")
        data |= {"changes": self.changes, "tried": self.tried, "seen": self.seen}
        return json.dumps(data, indent=1) + "\n"


def verify_and_repair(
    spec: ObjectSpec,
    options: VerifyOptions | None = None,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    allowed: Sequence[Allowance] = (),
    models: Panel | None = None,
    keep: bool = True,
) -> VerificationResult:
    """Verify an object, and repair it by numbers in at most `options.rounds` rounds.

    Args:
        spec: the object.
        options: of the battery; with `rounds` 0 nothing is changed.
        fixed_base: whether its base stays fastened.
        tilt: how it rests.
        allowed: overlaps that its program asks for.
        models: critic and reasoner, who look at what failed or only just passed; None
            asks nobody.
        keep: whether an earlier result for the same content may stand for this one, and is kept.
    """
    o = options or VerifyOptions()
    place = _place(spec, o, fixed_base, tilt, allowed)
    keep = keep and models is None  # What models say is kept on tapes.
    if keep and (found := _read(place)) is not None:
        return found

    run = lambda made: Battery(made, o, fixed_base=fixed_base, tilt=tilt, allowed=allowed)

    first = run(spec)
    made = repair(spec, run, rounds=o.rounds, first=first)
    seen: list[MotionCritique] = []
    if models is not None and (not made.after.passed or made.after.doubtful):
        now = first if made.patch.empty else run(made.spec)
        seen = with_models(made, now, models, run, spec, rounds=min(2, o.rounds))
    result = VerificationResult(
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
    spec: ObjectSpec, o: VerifyOptions, fixed_base: bool, tilt: Quat, allowed: Sequence[Allowance]
) -> Path:
    key = content_hash(
        {
            "battery": VERSION,
            "spec": spec.model_dump(mode="json"),
            "options": o.model_dump(mode="json"),
            "fixed": fixed_base,
            "tilt": list(tilt),
            "allowed": [list(allowance) for allowance in allowed],
        }
    )
    return cache_folder() / "verify" / f"{key}.json"


def _read(place: Path) -> VerificationResult | None:
    try:
        return VerificationResult.model_validate_json(place.read_text(encoding="utf-8"))
    except (OSError, ValidationError, ValueError):
        return None


def _write(place: Path, result: VerificationResult) -> None:
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(place, result.model_dump_json())
    except OSError as error:
        _log.debug("verdict not kept: %s", error)  # It costs time only.


__all__ = ["VerificationResult", "verify_and_repair"]

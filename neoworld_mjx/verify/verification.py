"""Step 3 of one object: the tests, repairs, and the cache of results."""

import json
import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from ..cache import cache_folder
from ..checks.allowance import Allowance
from ..checks.object_tests import VERSION, run_object_tests
from ..checks.verdict import Verdict
from ..config import VerifyOptions
from ..errors import RunError
from ..io import read_model
from ..io.files import content_hash, write_atomic
from ..mllm import Panel
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .critic import MotionCritique, with_models
from .key_frames import standard_runs
from .patch import Patch, apply
from .repairs import repair

_log = logging.getLogger(__name__)


class VerificationResult(BaseModel):
    """Result of Step 3 for one object."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    verdict: Verdict
    """Verdict on the resulting object."""
    before: Verdict | None = None
    """Verdict on the object before its repair; None if it was not repaired."""
    patch: Patch = Patch()
    changes: tuple[str, ...] = ()
    """Each change of the patch, in words."""
    tried: tuple[str, ...] = ()
    """Every patch that was tried, with the fault score before and after."""
    seen: tuple[str, ...] = ()
    """The critic's findings in the key frames."""
    lost_critics: tuple[tuple[str, str], ...] = ()
    """Requests that a model failed to answer, and why."""

    def applied(self, spec: ObjectSpec) -> ObjectSpec:
        """Return the object with its patch."""
        return spec if self.patch.empty else apply(self.patch, spec)[0]

    def to_json(self) -> str:
        """Return the verdict as JSON, with changes, tried patches and the critic's findings."""
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
        options: options of the tests; with `rounds` 0 the object is not changed, without
            `direct_repairs` only by models.
        fixed_base: whether its base is fixed.
        tilt: its resting orientation.
        allowed: overlaps that its program declares.
        models: critic and reasoner for failed and doubtful checks, or as `options.critic` says;
            None sends no request.
        keep: whether to read and write the cache; with models the tapes are the cache.
    """
    options = options or VerifyOptions()
    path = _cache_path(spec, options, fixed_base, tilt, allowed)
    always = models is not None and options.critic == "always"
    cached = _read(path) if keep and not always else None
    if cached is not None and (models is None or not cached.verdict.questionable):
        return cached

    run = partial(
        run_object_tests, options=options, fixed_base=fixed_base, tilt=tilt, allowed=allowed
    )
    first = run(spec)
    by_numbers = options.rounds if options.direct_repairs else 0
    repaired = repair(spec, run, rounds=by_numbers, first=first)
    critiques: list[MotionCritique] = []
    asked = False
    if models is not None and (always or repaired.after.questionable):
        tests = first if repaired.patch.empty else run(repaired.spec)
        # A support without joints is in no scenario: there is nothing to show.
        asked = repaired.after.questionable or bool(standard_runs(tests))
        if asked:
            rounds = min(2, options.rounds)
            critiques = with_models(
                repaired, tests, models, run, spec, rounds=rounds, always=always
            )
    result = VerificationResult(
        verdict=repaired.after,
        before=None if repaired.patch.empty else repaired.before,
        patch=repaired.patch,
        changes=repaired.changes,
        tried=tuple(repaired.tried),
        lost_critics=tuple(repaired.lost_critics),
        seen=tuple(f"{f.where}: {f.what}" for critique in critiques for f in critique.findings),
    )
    if keep and not asked:  # With models the tapes are the cache.
        _write(path, result)
    return result


def _cache_path(
    spec: ObjectSpec,
    options: VerifyOptions,
    fixed_base: bool,
    tilt: Quat,
    allowed: Sequence[Allowance],
) -> Path:
    """Return the cache file of a result; its name is the hash of everything that it depends on."""
    key = content_hash(
        {
            "version": VERSION,
            "spec": spec.model_dump(mode="json"),
            "options": options.model_dump(mode="json"),
            "fixed": fixed_base,
            "tilt": list(tilt),
            "allowed": [list(allowance) for allowance in allowed],
        }
    )
    return cache_folder() / "verify" / f"{key}.json"


def _read(path: Path) -> VerificationResult | None:
    try:
        return read_model(path, VerificationResult, RunError, "a result of the cache")
    except RunError:
        return None  # It is made again.


def _write(path: Path, result: VerificationResult) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, result.model_dump_json())
    except OSError as error:
        _log.debug("result not cached: %s", error)

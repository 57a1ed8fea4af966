"""Step 3 for one object: object tests, repairs, and the cache of results."""

import asyncio
import json
import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from ..cache import cache_folder
from ..checks.allowance import Allowance
from ..checks.object_tests import VERSION, run_object_tests
from ..checks.verdict import WAIVER_HINT, Check, Verdict
from ..config import VerifyOptions
from ..errors import RunError
from ..io import read_model
from ..io.files import content_hash, write_atomic
from ..mllm import Model, Panel
from ..mllm.coroutines import run_coroutine
from ..spec import ObjectSpec, Quat
from ..spec.pose import IDENTITY
from .critic import Compute, MotionCritique, Reprogram, revise_with_models
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
    """Verdict on the object before repairs; None if the object was not changed."""
    patch: Patch = Patch()
    changes: tuple[str, ...] = ()
    """Description of each change of the patch."""
    tried: tuple[str, ...] = ()
    """Description of every patch that was tried, with the fault score before and after."""
    seen: tuple[str, ...] = ()
    """The critic's findings in the key frames."""
    lost_critics: tuple[tuple[str, str], ...] = ()
    """Pairs of a request that a model failed to answer, and the reason."""
    unmet: tuple[str, ...] = ()
    """Findings for which the critic asked for a new program that could not be requested."""
    program: str | None = None
    """Text of a new program that replaces the first program; None without a new program."""
    program_json: str | None = None
    """All rounds of the new program; see `SynthesisResult.to_json`."""
    reprogrammed: ObjectSpec | None = None
    """The object that the new program builds, without `patch`."""

    @property
    def changed(self) -> bool:
        """True if the object has a new program or a patch."""
        return self.reprogrammed is not None or not self.patch.empty

    @property
    def waived(self) -> tuple[Check, ...]:
        """Failed checks that the critic waived."""
        return tuple(check for check in self.verdict.checks if check.hint == WAIVER_HINT)

    def applied(self, spec: ObjectSpec) -> ObjectSpec:
        """Return the object with the patch; a new program's object replaces `spec` first."""
        spec = self.reprogrammed or spec
        return spec if self.patch.empty else apply(self.patch, spec)[0]

    def to_json(self) -> str:
        """Return the verdict as JSON, with changes, tried patches and the critic's findings."""
        data = self.verdict.model_dump(mode="json")
        data |= {"changes": self.changes, "tried": self.tried, "seen": self.seen}
        return json.dumps(data, indent=1) + "\n"


async def verify_object(
    spec: ObjectSpec,
    options: VerifyOptions,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    allowed: Sequence[Allowance] = (),
    models: Model | None = None,
    surroundings: str = "",
    reprogram: Reprogram | None = None,
    compute: Compute = asyncio.to_thread,
) -> VerificationResult:
    """Test and repair an object; this is the asynchronous form of `verify_and_repair`.

    Several objects can be verified concurrently, so that one object is tested while others wait for
    models.

    Args:
        spec: the object.
        options: options of the tests.
        fixed_base: if True, the base of the object is fixed.
        tilt: orientation in which the object rests.
        allowed: overlaps that the object's program declares.
        models: models for the critic and the reasoner; if None, no requests are sent.
        surroundings: a sentence for the models that says what the object stands on or in.
        reprogram: requests a new program of the object if the critic asks for it.
        compute: runs simulations.
    """
    key = {
        "version": VERSION,
        "spec": spec.model_dump(mode="json"),
        "options": options.model_dump(mode="json"),
        "fixed": fixed_base,
        "tilt": list(tilt),
        "allowed": [list(allowance) for allowance in allowed],
    }
    path = cache_folder() / "verify" / f"{content_hash(key)}.json"
    always = models is not None and options.critic == "always"
    cached = None if always else _read(path)
    if cached is not None and (models is None or not cached.verdict.questionable):
        return cached

    run = partial(
        run_object_tests, options=options, fixed_base=fixed_base, tilt=tilt, allowed=allowed
    )
    direct = options.rounds if options.direct_repairs else 0
    repaired = await compute(lambda: repair(spec, run, rounds=direct))
    critiques: list[MotionCritique] = []
    # A fixed object without joints has no scenarios, so there is nothing to show.
    shown = repaired.after.questionable or (always and bool(standard_runs(repaired.tests)))
    if models is not None and shown:
        critiques = await revise_with_models(
            repaired,
            models,
            rounds=options.rounds,
            always=always,
            surroundings=surroundings,
            reprogram=reprogram,
            compute=compute,
        )
    program = repaired.program
    result = VerificationResult(
        verdict=repaired.after,
        before=None if repaired.patch.empty and program is None else repaired.before,
        patch=repaired.patch,
        changes=repaired.patch.changes(),
        tried=tuple(repaired.tried),
        lost_critics=tuple(repaired.lost_critics),
        seen=tuple(f"{f.where}: {f.what}" for critique in critiques for f in critique.findings),
        unmet=tuple(repaired.unfulfilled),
        program=None if program is None else program.text,
        program_json=None if program is None else program.to_json(),
        reprogrammed=None if program is None else program.spec,
    )
    if models is None or not shown:
        _write(path, result)
    return result


def verify_and_repair(
    spec: ObjectSpec,
    options: VerifyOptions | None = None,
    *,
    fixed_base: bool = False,
    tilt: Quat = IDENTITY,
    allowed: Sequence[Allowance] = (),
    models: Panel | None = None,
    reprogram: Reprogram | None = None,
) -> VerificationResult:
    """Test an object, and repair it in at most `options.rounds` rounds.

    Results are cached if no request was sent to a model. Otherwise, recorded responses (tapes)
    serve as the cache.

    Args:
        spec: the object.
        options: options of the tests. If `rounds` is 0, the object is not changed. If
            `direct_repairs` is False, only models change the object.
        fixed_base: if True, the base of the object is fixed.
        tilt: orientation in which the object rests.
        allowed: overlaps that the object's program declares.
        models: models for the critic and the reasoner, which are asked about objects with failed or
            borderline checks, or about all objects if `options.critic` is "always". If None, no
            requests are sent.
        reprogram: requests a new program of the object if the critic asks for it. If None, the
            rounds end when the critic asks for a new program.
    """
    work = verify_object(
        spec,
        options or VerifyOptions(),
        fixed_base=fixed_base,
        tilt=tilt,
        allowed=allowed,
        models=models,
        reprogram=reprogram,
    )
    return run_coroutine(work)


def _read(path: Path) -> VerificationResult | None:
    try:
        return read_model(path, VerificationResult, RunError, "a cached result")
    except RunError:
        return None


def _write(path: Path, result: VerificationResult) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, result.model_dump_json())
    except OSError as error:
        _log.debug("result not cached: %s", error)

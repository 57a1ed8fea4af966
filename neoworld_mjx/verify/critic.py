"""The critic looks at key frames of what failed, the reasoner edits what Step 3 may edit (Section 3.2).

Numbers come first: only an object that direct repairs left with failed or doubtful checks is shown. What
the reasoner proposes is a `Patch`, tried by the same rule as every repair: it must lower the fault score.
What the critic thinks is told beside the verdict and changes no outcome. Of an object that only just passes
it is all that is asked: its fault score is 0, and no edit could lower that.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from ..errors import BudgetError, MissingAnswerError, ModelError
from ..mllm import Panel, Request
from ..spec import ObjectSpec, inertial
from .battery import Battery
from .key_frames import questionable, strips
from .patch import Patch
from .repairs import Repaired, RunBattery, try_patches


class Finding(BaseModel):
    """One thing seen in the key frames."""

    model_config = ConfigDict(extra="forbid")

    where: Annotated[str, Field(max_length=60)]
    """Part or joint."""
    what: Annotated[str, Field(max_length=400)]
    suggestion: Annotated[str, Field(max_length=400)] = ""


class Seen(BaseModel):
    """The critic's answer."""

    model_config = ConfigDict(extra="forbid")

    findings: list[Finding] = Field(default=[], max_length=6)
    verdict: Literal["sound", "edit", "reprogram"]


class Edited(BaseModel):
    """The reasoner's answer."""

    model_config = ConfigDict(extra="forbid")

    patch: Patch
    why: Annotated[str, Field(max_length=600)] = ""


SYSTEM = """You judge whether a simulated object behaves as the real thing would. You see strips of key
frames, from left to right in time, each labelled, of trials of one object by itself: falls from small
heights, pushes, joints that are released or driven. Beside them stand the numbers that failed or only just
passed. Say what is wrong and where; do not mind looks. `verdict` is "sound" if nothing is wrong that
matters, "edit" if changed masses, inertias, joint limits, damping, friction, origins or colliders would
mend it, "reprogram" if parts, axes or shapes are wrong."""
EDITOR = """You mend an object for simulation by editing numbers. You may change only: of a part `mass` [kg]
or "derived", `inertia` or "derived", `shift` of its origin [m]; of a joint `lower`, `upper` [rad or m],
`damping`, `friction`, `origin` [m]; of a geom `shrink` (0.5 to 1) of its collider, or `as_seen`. Parts,
joints, axes, types and what is seen stay. Lengths are in the object's frame: +x its front, +z up. Change as
little as cures what is told. Your edit is tried in simulation and dropped if it does not help."""


def shown(battery: Battery) -> Request[Seen]:
    """Ask the critic about an object's key frames."""
    prompt = f"The object: {battery.spec.label or battery.spec.name}.\n\n{_told(battery)}"
    name = f"simulation:{battery.spec.name}"
    return Request("critic", name, SYSTEM, prompt, Seen, strips(battery))


def edit(battery: Battery, seen: Seen) -> Request[Edited]:
    """Ask the reasoner for a patch."""
    findings = "\n".join(f"- {f.where}: {f.what} -> {f.suggestion}" for f in seen.findings)
    prompt = (
        f"{_told(battery)}\n\nThe critic saw:\n{findings or '- nothing more'}\n\n"
        f"The object:\n{described(battery.spec)}"
    )
    return Request("reasoner", f"edit:{battery.spec.name}", EDITOR, prompt, Edited)


def _told(battery: Battery) -> str:
    lines = []
    for check in questionable(battery.verdict):
        value = "none" if check.value is None else f"{check.value:.3g}"
        outcome = "ONLY JUST PASSED" if check.doubtful else check.outcome
        lines.append(
            f"- {outcome} {check.scenario} {check.name}: {value} against "
            f"{check.threshold:.3g} {check.unit} {check.evidence}".rstrip()
        )
    return "Numbers that failed or only just passed:\n" + "\n".join(lines or ["- none"])


def described(spec: ObjectSpec) -> str:
    """Say in words what may be edited of an object, and where it stands."""
    lines = []
    for part in spec.parts:
        own = inertial(spec, part)
        x, y, z = own.pos
        geoms = ", ".join(f"{g.name} ({g.shape.type}, {g.role})" for g in part.geoms[:12])
        lines.append(
            f"part {part.name}: {own.mass:.4g} kg, centre ({x:.3f}, {y:.3f}, {z:.3f}); {geoms}"
        )
    for j in spec.joints:
        x, y, z = j.pos
        lines.append(
            f"joint {j.name}: {j.type}, {j.child} on {j.parent}, at ({x:.3f}, {y:.3f}, {z:.3f}) along "
            f"{tuple(round(v, 3) for v in j.axis)}, {j.lower:.4g} to {j.upper:.4g}, damping "
            f"{j.damping:.4g}, friction {j.friction:.4g}"
        )
    return "\n".join(lines)


def with_models(
    made: Repaired,
    now: Battery,
    models: Panel,
    run: RunBattery,
    spec: ObjectSpec,
    *,
    rounds: int = 2,
) -> list[Seen]:
    """Let the critic look and the reasoner edit, as long as it helps, for at most `rounds` rounds.

    What passes is looked at and not edited; so is everything with `rounds` 0.

    Args:
        made: what direct repairs came to; it is carried on.
        now: the battery's run on it.
        models: who answers.
        run: the battery with its options.
        spec: the object as it came.
        rounds: how often edits may be tried.

    Returns:
        What the critic saw in each round.

    Raises:
        BudgetError: the cost cap is reached.
        MissingAnswerError: a tape lacks the answer.
    """
    told: list[Seen] = []
    for _ in range(max(rounds, 1)):
        seen = _asked(models, shown(now), made)
        if seen is None:
            break
        told.append(seen)
        if now.verdict.passed or not rounds or seen.verdict != "edit":
            break
        edited = _asked(models, edit(now, seen), made)
        if edited is None or edited.patch.empty:
            break
        found = try_patches(made, now, [edited.patch], run, spec)
        if found is None or found.verdict.passed:
            break
        now = found
    return told


def _asked(models: Panel, request: Request[Any], made: Repaired) -> Any:
    """Ask for what the object can do without; what could not be had is noted."""
    try:
        return models.ask_sync(request).value
    except (BudgetError, MissingAnswerError):
        raise
    except ModelError as error:
        made.tried.append(f"{request.name} was not answered: {error}")
        return None


__all__ = ["Edited", "Finding", "Seen", "described", "edit", "shown", "with_models"]

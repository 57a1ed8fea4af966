"""Requests of Step 3 to models (3.2): the critic judges key frames, and the reasoner edits.

The critic returns one of three verdicts:

- "edit": the reasoner proposes a `Patch`, which is accepted only if it lowers the fault score.
- "reprogram": the programmer writes the program again, which is accepted only if it lowers the
  fault score.
- "sound": checks that fail only because the object is tested without its scene are waived.

The critic sees key frames of failed and borderline checks as labeled strips.
"""

import io
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from PIL import Image, ImageDraw
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from ..checks.motion_checks import support_polygon
from ..checks.object_tests import ObjectTests
from ..checks.scenarios import SINGLE_DOF_TYPES
from ..checks.simulation import Trajectory
from ..checks.verdict import Check, Verdict
from ..mllm import Request, package_text
from ..program.views import DescribedPicture
from ..render import View, render_scene, to_png
from ..render.scene_images import visible_vertices
from ..spec import PartSpec, SceneObject, bounds, inertial, pieces, single_object_scene
from ..spec.convex import box_around
from ..spec.opening import prerequisite_state
from ..spec.pose import IDENTITY
from .patch import Patch

WIDTH, HEIGHT, BAND = 220, 200, 16
FRAMES, MAX_STRIPS = 4, 3


def questionable(verdict: Verdict) -> list[Check]:
    """Return the failed checks, the worst first, followed by the borderline checks."""
    checks = [c for c in verdict.checks if c.outcome == "FAIL" or c.borderline]
    return sorted(checks, key=lambda c: (c.borderline, -c.margin))


def standard_runs(tests: ObjectTests) -> dict[str, Trajectory]:
    """Return one run of each of the two standard scenarios of the paper, by kind of scenario.

    The run of a push is that in which the object or one of its joints moves the most. For an object
    with a fixed base, which neither falls nor is pushed, return the first drive of a joint.
    """

    def displacement(run: Trajectory) -> float:
        return float(np.abs(run.qpos - run.qpos[0]).max())

    recorded = [run for run in tests.trajectories if len(run.time)]
    falls = [run for run in recorded if run.scenario.name == "fall"]
    pushes = [run for run in recorded if run.scenario.kind == "force_perturbation"]
    drives = [run for run in recorded if run.scenario.driven]
    runs = falls[:1] + ([max(pushes, key=displacement)] if pushes else [])
    return {run.scenario.kind: run for run in runs or drives[:1]}


def strips(tests: ObjectTests, *, include_standard: bool = False) -> list[DescribedPicture]:
    """Return strips of the runs and poses of failed and borderline checks, the worst first.

    Args:
        tests: results of the object tests.
        include_standard: if True, add the standard scenarios, up to the largest number of strips.

    Returns:
        At most three strips of four frames. Each frame is labeled with the time or the joint value.
    """
    by_name = {trajectory.scenario.name: trajectory for trajectory in tests.trajectories}
    # Four frames of one value cannot show the direction of a ball joint; the evidence states it.
    balls = {j.name for j in tests.spec.joints if j.type == "ball"}
    pictures: dict[str, DescribedPicture] = {}
    for check in questionable(tests.verdict):
        label = f"{check.scenario} {check.name}"
        trajectory = by_name.get(check.evidence.removeprefix("run "))
        key = trajectory.scenario.name if trajectory else f"{check.joint}:{check.at}"
        if key in pictures or len(pictures) == MAX_STRIPS:
            continue
        if trajectory is not None:
            pictures[key] = _run_strip(tests, trajectory, label)
        elif check.joint not in {None, *balls}:
            pictures[key] = _joint_strip(tests, check, label)
    if include_standard:
        for kind, run in standard_runs(tests).items():
            if run.scenario.name not in pictures and len(pictures) < MAX_STRIPS:
                pictures[run.scenario.name] = _run_strip(tests, run, kind.replace("_", " "))
    return list(pictures.values())


def _run_strip(tests: ObjectTests, trajectory: Trajectory, label: str) -> DescribedPicture:
    """Return a strip of four frames of a run."""
    steps = np.linspace(0, len(trajectory.time) - 1, FRAMES).astype(int)
    poses = [posed_at(tests, trajectory, int(k)) for k in steps]
    titles = [f"{label[:24]} t={trajectory.time[k]:.2f} s" for k in steps]
    return _strip(label, poses, titles)


def posed_at(tests: ObjectTests, trajectory: Trajectory, k: int) -> SceneObject:
    """Return the object with its pose and joint positions at step `k` of a run."""
    simulation = tests.simulation
    assert simulation is not None
    q = trajectory.qpos[k]
    state = {
        joint.name: float(q[simulation.address(joint.name)[0]])
        for joint in tests.spec.joints
        if joint.type in SINGLE_DOF_TYPES
    }
    return _posed(tests, state, q[:3], q[3:7])


def _joint_strip(tests: ObjectTests, check: Check, label: str) -> DescribedPicture:
    """Return a strip of a joint from 0 to its worst position, while its prerequisites are open."""
    joint = next(j for j in tests.spec.joints if j.name == check.joint)
    end = check.at if check.at is not None else 0.0
    if check.at is None and joint.type in ("revolute", "prismatic"):
        end = joint.upper
    values = [end * k / (FRAMES - 1) for k in range(FRAMES)]
    prerequisites = prerequisite_state(tests.spec, joint)
    states = [
        {**prerequisites, joint.name: v} if joint.type in SINGLE_DOF_TYPES else {} for v in values
    ]
    poses = [_posed(tests, state, np.zeros(3), np.array(IDENTITY)) for state in states]
    return _strip(label, poses, [f"{joint.name[:20]} = {v:.3g}" for v in values])


def _posed(
    tests: ObjectTests, state: dict[str, float], pos: np.ndarray, quat: np.ndarray
) -> SceneObject:
    return SceneObject(
        name=tests.spec.name,
        spec=tests.spec,
        xy=(float(pos[0]), float(pos[1])),
        z=float(pos[2]),
        base_tilt=tuple((quat / np.linalg.norm(quat)).tolist()),
        joint_state=state,
    )


def _strip(label: str, poses: list[SceneObject], titles: list[str]) -> DescribedPicture:
    """Return a strip of frames in a row, all rendered from one viewpoint."""
    states = [
        [
            np.round([*posed.xy, posed.z, *posed.base_tilt], 3).tolist(),
            {n: round(v, 3) for n, v in posed.joint_state.items()},
        ]
        for posed in poses
    ]
    shows = f"{label}{poses[0].spec.to_json()}{states}{titles}"
    return DescribedPicture(label, lambda: _render_png(poses, titles), shows)


def view_of_all(poses: list[SceneObject]) -> View:
    """Return a view in which the whole object is visible in all of the poses."""
    points = []
    for posed in poses:
        rotation = Rotation.from_quat(np.roll(posed.base_tilt, -1))
        vertices = rotation.apply(visible_vertices(posed.spec, posed.joint_state))
        points.append(vertices + [*posed.xy, posed.z])
    return View.framing(np.vstack(points), width=WIDTH, height=HEIGHT)


def _render_png(poses: list[SceneObject], titles: list[str]) -> bytes:
    """Render the frames of a strip, and return a PNG image."""
    view = view_of_all(poses)
    sheet = Image.new("RGB", (WIDTH * len(poses), HEIGHT + BAND), "white")
    draw = ImageDraw.Draw(sheet)
    for k, (posed, title) in enumerate(zip(poses, titles, strict=True)):
        scene = single_object_scene(posed)
        shot = to_png(render_scene(scene, view, width=WIDTH, height=HEIGHT, supersample=1))
        sheet.paste(Image.open(io.BytesIO(shot), formats=["PNG"]).convert("RGB"), (k * WIDTH, BAND))
        draw.text((k * WIDTH + 3, 2), title, fill="black")
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


# Titles, docstrings and descriptions of response schemas are part of the requests. Recorded
# responses (tapes) match only requests that are exactly equal.


class Finding(BaseModel):
    """One observation in the key frames."""

    model_config = ConfigDict(extra="forbid")

    where: Annotated[str, Field(max_length=60)]
    """Part or joint."""
    what: Annotated[str, Field(max_length=400)]
    suggestion: Annotated[str, Field(max_length=400)] = ""


class MotionCritique(BaseModel):
    """The critic's verdict on an object's motion."""

    model_config = ConfigDict(extra="forbid", title="MotionVerdict")

    findings: list[Finding] = Field(default=[], max_length=6)
    verdict: Literal["sound", "edit", "reprogram"]


class ProposedEdit(BaseModel):
    """The reasoner's edit of an object."""

    model_config = ConfigDict(extra="forbid", title="Edit")

    patch: Patch
    why: Annotated[str, Field(max_length=600)] = ""


def key_frames_request(
    tests: ObjectTests,
    *,
    surroundings: str = "",
    tried: Sequence[str] = (),
    always: bool = False,
) -> Request[MotionCritique]:
    """Return the request to the critic to judge an object's key frames.

    Args:
        tests: results of the object tests.
        surroundings: a sentence that says what the object stands on or in.
        tried: changes that models proposed before, with their outcomes.
        always: if True, add the standard scenarios; see `strips`.
    """
    paragraphs = [
        f"The object: {tests.spec.label or tests.spec.name}. {surroundings}".rstrip(),
        _numbers(tests),
        _listed("Tried before", tried) if tried else "",
    ]
    prompt = "\n\n".join(filter(None, paragraphs))
    name, frames = f"simulation:{tests.spec.name}", strips(tests, include_standard=always)
    return Request("critic", name, _instructions("critic"), prompt, MotionCritique, frames)


def edit_request(
    tests: ObjectTests,
    critique: MotionCritique,
    *,
    surroundings: str = "",
    tried: Sequence[str] = (),
) -> Request[ProposedEdit]:
    """Return the request to the reasoner for a patch.

    Args:
        tests: results of the object tests.
        critique: the critic's critique, whose findings the request lists.
        surroundings: a sentence that says what the object stands on or in.
        tried: changes that models proposed before, with their outcomes.
    """
    paragraphs = [
        surroundings,
        _numbers(tests),
        _listed("The critic's findings", findings(critique)),
        _listed("Edits that were dropped or did not suffice", tried) if tried else "",
        f"The object:\n{described(tests)}",
    ]
    prompt = "\n\n".join(filter(None, paragraphs))
    name = f"edit:{tests.spec.name}"
    return Request("reasoner", name, _instructions("editor"), prompt, ProposedEdit)


def findings(critique: MotionCritique) -> list[str]:
    """Return the findings of a critique, one line each."""
    return [
        f"{f.where}: {f.what}" + (f" -> {f.suggestion}" if f.suggestion else "")
        for f in critique.findings
    ]


def _instructions(name: str) -> str:
    return package_text(__package__, name).removesuffix("\n")


def _listed(title: str, lines: Sequence[str]) -> str:
    return f"{title}:\n" + "\n".join(f"- {line}" for line in lines or ("none",))


def _numbers(tests: ObjectTests) -> str:
    lines = []
    for check in questionable(tests.verdict):
        outcome = "BARELY PASSED" if check.borderline else check.outcome
        evidence = f" ({check.evidence})" if check.evidence else ""
        lines.append(f"{outcome} {check.scenario} {check.phrase()}{evidence}")
    return _listed("Values that failed or barely passed", lines)


def described(tests: ObjectTests) -> str:
    """Describe an object's extent and base, and the current values that a patch can edit."""
    spec = tests.spec
    low, high = bounds(spec)
    lines = [f"extent: {_ranges(low, high)}; the origin is (0, 0, 0)"]
    if tests.simulation is not None:
        width, margin = support_polygon(tests.simulation)
        place = (
            f"{1e3 * margin:.1f} mm within it" if margin >= 0 else f"{-1e3 * margin:.1f} mm outside"
        )
        mass = sum(inertial(spec, part).mass for part in spec.parts)
        lines.append(
            f"base: its contact with a level floor is {1e3 * width:.1f} mm wide; the centre of "
            f"mass is {place}; {mass:.4g} kg in all"
        )
    for material in spec.materials:
        lines.append(f"material {material.name}: friction {material.friction:.3g}")
    for part in spec.parts:
        inertia = inertial(spec, part)
        x, y, z = inertia.pos
        lines.append(f"part {part.name}: {inertia.mass:.4g} kg, centre ({x:.3f}, {y:.3f}, {z:.3f})")
        lines += _geom_lines(part)
    for j in spec.joints:
        x, y, z = j.pos
        lines.append(
            f"joint {j.name}: {j.type}, {j.child} on {j.parent}, at ({x:.3f}, {y:.3f}, {z:.3f}) "
            f"along {tuple(round(v, 3) for v in j.axis)}, {j.lower:.4g} to {j.upper:.4g}, damping "
            f"{j.damping:.4g}, friction {j.friction:.4g}"
        )
    return "\n".join(lines)


def _geom_lines(part: PartSpec) -> list[str]:
    """Describe the first 12 geoms of a part, with their extents."""
    boxes: dict[str, list[np.ndarray]] = {}
    for role in ("collision", "visual"):
        for geom, piece, frame in pieces(part, role):
            boxes.setdefault(geom.name, []).append(np.array(box_around(piece, frame)))
    lines = []
    for geom in part.geoms[:12]:
        ends = np.array(boxes[geom.name]) if geom.name in boxes else np.zeros((1, 2, 3))
        lines.append(
            f"  geom {geom.name}: {geom.shape.type}, {geom.role}, {geom.material}, "
            f"{_ranges(ends[:, 0].min(axis=0), ends[:, 1].max(axis=0))}"
        )
    return lines


def _ranges(low: np.ndarray, high: np.ndarray) -> str:
    axes = zip("xyz", low, high, strict=True)
    return ", ".join(f"{axis} {a + 0.0:.3f} to {b + 0.0:.3f}" for axis, a, b in axes)

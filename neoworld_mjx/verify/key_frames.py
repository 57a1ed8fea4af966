"""Key frames of failed and borderline checks, as labeled strips for the critic."""

import io

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from ..checks.object_tests import ObjectTests
from ..checks.scenarios import SINGLE_DOF_TYPES
from ..checks.simulation import Trajectory
from ..checks.verdict import Check, Verdict
from ..program.views import DescribedPicture
from ..render import View, render_scene, to_png
from ..render.scene_images import visible_vertices
from ..spec import SceneObject, single_object_scene
from ..spec.opening import prerequisite_state
from ..spec.pose import IDENTITY

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


def view_of_all(poses: list[SceneObject], width: int, height: int) -> View:
    """Return a view in which the whole object is visible in all of the poses."""
    points = []
    for posed in poses:
        rotation = Rotation.from_quat(np.roll(posed.base_tilt, -1))
        vertices = rotation.apply(visible_vertices(posed.spec, posed.joint_state))
        points.append(vertices + [*posed.xy, posed.z])
    return View.framing(np.vstack(points), width=width, height=height)


def _render_png(poses: list[SceneObject], titles: list[str]) -> bytes:
    """Render the frames of a strip, and return a PNG image."""
    view = view_of_all(poses, WIDTH, HEIGHT)
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

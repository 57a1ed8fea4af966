"""Key frames of failed and doubtful checks, as labelled strips for the critic."""

import io

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from ..checks.object_tests import ObjectTests
from ..checks.scenarios import PRESETS, SINGLE
from ..checks.simulation import Trajectory
from ..checks.verdict import Check, Verdict
from ..program.views import DescribedPicture
from ..render import View, render_scene, to_png
from ..render.scene_images import visible_vertices
from ..spec import SceneObject, single_object_scene
from ..spec.opening import prerequisite_state

WIDTH, HEIGHT, BAND = 220, 200, 16
FRAMES, MOST = 4, 3


def questionable(verdict: Verdict) -> list[Check]:
    """Return failed checks, the worst first, then doubtful ones."""
    checks = [c for c in verdict.checks if c.outcome == "FAIL" or c.borderline]
    return sorted(checks, key=lambda c: (c.borderline, -c.margin))


def standard_runs(tests: ObjectTests) -> dict[str, Trajectory]:
    """Return a run of each of the paper's two standard scenarios, by their names.

    Of the pushes it is the one that moves the object, or a joint of it, the most. An object with a
    fixed base neither falls nor is pushed: there the first drive of a joint is returned.
    """
    runs: dict[str, Trajectory] = {}
    travelled = lambda run: float(np.abs(run.qpos - run.qpos[0]).max(initial=0.0))
    for kind, names in PRESETS.items():
        ends = tuple(name.rpartition(":")[2] for name in names)
        of_kind = [
            run
            for run in tests.trajectories
            if run.scenario.kind == kind and run.scenario.name.endswith(ends) and len(run.time)
        ]
        if of_kind:
            plain = kind == "free_fall"
            runs[kind] = of_kind[0] if plain else max(of_kind, key=travelled)
    if not runs:
        drives = [run for run in tests.trajectories if run.scenario.driven and len(run.time)]
        runs = {run.scenario.kind: run for run in drives[:1]}
    return runs


def strips(tests: ObjectTests, *, always: bool = False) -> list[DescribedPicture]:
    """Return strips of the runs and poses of failed and doubtful checks, the worst first.

    Args:
        tests: the tests's results.
        always: whether the standard scenarios are added, as far as there is room.

    Returns:
        At most three strips of four frames, each frame labelled with its time or joint value.
    """
    by_name = {trajectory.scenario.name: trajectory for trajectory in tests.trajectories}
    # Four frames of one value do not show the direction of a ball joint; its evidence states it.
    balls = {j.name for j in tests.spec.joints if j.type == "ball"}
    pictures: list[DescribedPicture] = []
    drawn: set[str] = set()
    for check in questionable(tests.verdict):
        if len(pictures) == MOST:
            break
        trajectory = by_name.get(check.evidence.removeprefix("run ")) if check.evidence else None
        key = trajectory.scenario.name if trajectory is not None else f"{check.joint}:{check.at}"
        if key in drawn or (trajectory is None and check.joint in {None, *balls}):
            continue
        drawn.add(key)
        label = f"{check.scenario} {check.name}"
        pictures.append(
            _of_run(tests, trajectory, label)
            if trajectory is not None
            else _of_joint(tests, check, label)
        )
    if always:
        for kind, trajectory in standard_runs(tests).items():
            if trajectory.scenario.name not in drawn and len(pictures) < MOST:
                pictures.append(_of_run(tests, trajectory, kind.replace("_", " ")))
    return pictures


def _of_run(tests: ObjectTests, trajectory: Trajectory, label: str) -> DescribedPicture:
    """Draw four frames of a run."""
    steps = np.linspace(0, len(trajectory.time) - 1, FRAMES).astype(int)
    poses = [posed_at(tests, trajectory, int(k)) for k in steps]
    titles = [f"{label[:24]} t={trajectory.time[k]:.2f} s" for k in steps]
    return _strip(label, poses, titles)


def posed_at(tests: ObjectTests, trajectory: Trajectory, k: int) -> SceneObject:
    """Return the object as it is at a step of a run."""
    simulation = tests.simulation
    assert simulation is not None
    q = trajectory.qpos[k]
    state = {
        j.name: float(q[simulation.address(j.name)[0]])
        for j in tests.spec.joints
        if j.type in SINGLE
    }
    return _posed(tests, state, q[:3], q[3:7])


def _of_joint(tests: ObjectTests, check: Check, label: str) -> DescribedPicture:
    """Draw a joint from rest to its worst position, while the joints that it waits for are open."""
    worst = check.at if check.at is not None else 0.0
    joint = next(j for j in tests.spec.joints if j.name == check.joint)
    if check.at is None and joint.type in ("revolute", "prismatic"):
        worst = joint.upper
    values = [worst * k / (FRAMES - 1) for k in range(FRAMES)]
    opened = prerequisite_state(tests.spec, joint)
    state = lambda value: {**opened, joint.name: value} if joint.type in SINGLE else {}
    poses = [_posed(tests, state(v), np.zeros(3), np.array([1.0, 0, 0, 0])) for v in values]
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
    """Return frames side by side, all seen from the same viewpoint."""
    states = [
        [
            np.round([*posed.xy, posed.z, *posed.base_tilt], 3).tolist(),
            {n: round(v, 3) for n, v in posed.joint_state.items()},
        ]
        for posed in poses
    ]
    return DescribedPicture(
        label, lambda: _drawn(poses, titles), f"{label}{poses[0].spec.to_json()}{states}{titles}"
    )


def view_of_all(poses: list[SceneObject], width: int, height: int) -> View:
    """Return a view in which an object is seen whole in all of its poses."""
    points = []
    for posed in poses:
        turn = Rotation.from_quat(np.roll(posed.base_tilt, -1))
        vertices = turn.apply(visible_vertices(posed.spec, posed.joint_state))
        points.append(vertices + [*posed.xy, posed.z])
    return View.framing(np.vstack(points), width=width, height=height)


def _drawn(poses: list[SceneObject], titles: list[str]) -> bytes:
    """Draw the frames of a strip, and return it as PNG."""
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

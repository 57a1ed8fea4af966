"""Key frames of what failed or is doubtful, as labelled strips for the critic to look at."""

import io

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

from ..program.views import DescribedPicture
from ..render import View, render_scene, to_png
from ..render.scene_images import visible_vertices
from ..spec import SceneObject, SceneSpec
from ..spec.opening import prerequisite_state
from .battery import Battery
from .scenarios import SINGLE
from .simulation import Trajectory
from .verdict import Check, Verdict

WIDTH, HEIGHT, BAND = 220, 200, 16
FRAMES, MOST = 4, 3


def questionable(verdict: Verdict) -> list[Check]:
    """Return the checks that failed, the worst first, then those that only just passed."""
    checks = [c for c in verdict.checks if c.outcome == "FAIL" or c.doubtful]
    return sorted(checks, key=lambda c: (c.doubtful, -c.margin))


def strips(battery: Battery) -> list[DescribedPicture]:
    """Draw the runs and poses that failed or doubtful checks speak of, the worst first.

    Returns:
        At most three strips of four frames, each frame labelled with its time or joint value.
    """
    by_name = {trajectory.scenario.name: trajectory for trajectory in battery.trajectories}
    # Four frames of one value do not show which way a ball was turned; its evidence says so.
    balls = {j.name for j in battery.spec.joints if j.type == "ball"}
    found: list[DescribedPicture] = []
    shown: set[str] = set()
    for check in questionable(battery.verdict):
        if len(found) == MOST:
            break
        trajectory = by_name.get(check.evidence.removeprefix("run ")) if check.evidence else None
        key = trajectory.scenario.name if trajectory is not None else f"{check.joint}:{check.at}"
        if key in shown or (trajectory is None and check.joint in {None, *balls}):
            continue
        shown.add(key)
        label = f"{check.scenario} {check.name}"
        found.append(
            _of_run(battery, trajectory, label)
            if trajectory is not None
            else _of_joint(battery, check, label)
        )
    return found


def _of_run(battery: Battery, trajectory: Trajectory, label: str) -> DescribedPicture:
    """Draw four moments of a run, on the floor or held."""
    simulation = battery.simulation
    assert simulation is not None
    steps = np.linspace(0, len(trajectory.time) - 1, FRAMES).astype(int)
    items, titles = [], []
    for k in steps:
        q = trajectory.qpos[k]
        state = {
            j.name: float(q[simulation.address(j.name)[0]])
            for j in battery.spec.joints
            if j.type in SINGLE
        }
        items.append(_posed(battery, state, q[:3], q[3:7]))
        titles.append(f"{label[:24]} t={trajectory.time[k]:.2f} s")
    return _strip(label, items, titles)


def _of_joint(battery: Battery, check: Check, label: str) -> DescribedPicture:
    """Draw a joint from rest to where it was worst, with those open that it waits for."""
    worst = check.at if check.at is not None else 0.0
    joint = next(j for j in battery.spec.joints if j.name == check.joint)
    if check.at is None and joint.type in ("revolute", "prismatic"):
        worst = joint.upper
    values = [worst * k / (FRAMES - 1) for k in range(FRAMES)]
    opened = prerequisite_state(battery.spec, joint)
    state = lambda value: {**opened, joint.name: value} if joint.type in SINGLE else {}
    items = [_posed(battery, state(v), np.zeros(3), np.array([1.0, 0, 0, 0])) for v in values]
    return _strip(label, items, [f"{joint.name[:20]} = {v:.3g}" for v in values])


def _posed(
    battery: Battery, state: dict[str, float], pos: np.ndarray, quat: np.ndarray
) -> SceneObject:
    return SceneObject(
        name=battery.spec.name,
        spec=battery.spec,
        xy=(float(pos[0]), float(pos[1])),
        z=float(pos[2]),
        base_tilt=tuple((quat / np.linalg.norm(quat)).tolist()),
        joint_state=state,
    )


def _strip(label: str, items: list[SceneObject], titles: list[str]) -> DescribedPicture:
    """Put frames side by side, all seen from one place."""
    points = []
    for item in items:
        turn = Rotation.from_quat(np.roll(item.base_tilt, -1))
        own = turn.apply(visible_vertices(item.spec, item.joint_state)) + [*item.xy, item.z]
        points.append(own)
    view = View.framing(np.vstack(points), width=WIDTH, height=HEIGHT)
    sheet = Image.new("RGB", (WIDTH * len(items), HEIGHT + BAND), "white")
    draw = ImageDraw.Draw(sheet)
    for k, (item, title) in enumerate(zip(items, titles, strict=True)):
        scene = SceneSpec(name=item.name, objects=(item,))
        shot = to_png(render_scene(scene, view, width=WIDTH, height=HEIGHT, supersample=1))
        sheet.paste(Image.open(io.BytesIO(shot)).convert("RGB"), (k * WIDTH, BAND))
        draw.text((k * WIDTH + 3, 2), title, fill="black")
    buffer = io.BytesIO()
    sheet.save(buffer, "PNG", compress_level=6)
    states = [
        [
            np.round([*i.xy, i.z, *i.base_tilt], 3).tolist(),
            {n: round(v, 3) for n, v in i.joint_state.items()},
        ]
        for i in items
    ]
    return DescribedPicture(
        label, buffer.getvalue(), f"{label}{items[0].spec.to_json()}{states}{titles}"
    )


__all__ = ["questionable", "strips"]

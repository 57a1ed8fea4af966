"""Turn simulated trajectories into checks with numbers; each judges one thing of one scenario."""

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..physics.mjcf import body_name
from ..spec import bounds, link_poses, pieces
from ..spec.convex import Piece, box_around
from ..spec.pose import angle_between, matrix, pose, tilt_between
from .scenarios import STEEPEST_DEG, STILL_S, TILT_FROM_S, slope_at
from .simulation import G, Simulation, Trajectory
from .verdict import Check, Fault, Limit, judged, skipped

SETTLED_S = 0.2
"""At the end of a run, in which what has come to rest does not move."""
JOINT_SPEED = 0.03
"""Speed [m/s] at a joint's far end below which it counts as at rest."""
STIRRED = 0.02
"""Share of its range by which a joint may move by itself."""
BEGINS_M = 0.001
"""Movement on a slope that counts as sliding."""
COASTED_S = 0.5
SHORT_M, SHORT_RAD = 0.08, 0.6
ROUND = 0.01
"""What stands on less than this, over its size, with its weight above, is round below."""


def checks_of(simulation: Simulation, trajectories: Iterable[Trajectory]) -> list[Check]:
    """Return the checks of all trajectories of an object."""
    by_kind: dict[str, list[Trajectory]] = {}
    for trajectory in trajectories:
        by_kind.setdefault(trajectory.scenario.kind, []).append(trajectory)
    found: list[Check] = []
    if by_kind.get("free_fall"):
        found += falls(simulation, by_kind["free_fall"])
    else:
        found.append(skipped("free_fall", "rests", "base is fixed"))
    found += pushes(simulation, by_kind.get("force_perturbation", []))
    for trajectory in by_kind.get("tilt_until_slide", []):
        found.append(slid(simulation, trajectory))
    for trajectory in by_kind.get("joint_release", []):
        found += released(simulation, trajectory)
    for trajectory in by_kind.get("joint_drive", []):
        found.append(driven(simulation, trajectory))
    return found


def falls(simulation: Simulation, trajectories: list[Trajectory]) -> list[Check]:
    """Ask of free falls that it comes to rest upright, where it was put, and not in the floor."""
    o = simulation.options
    found: list[Check] = []
    width, margin = stance(simulation)
    if margin < 0:
        # What comes down to the floor before it leans too far holds it as well.
        lean = float(np.tan(np.radians(o.max_tilt_deg)) * np.linalg.norm(simulation.size[:2]) / 2)
        width, margin = max((width, margin), stance(simulation, lean), key=lambda found: found[1])
    # In the middle of its base there is nothing to doubt.
    balance = Limit(threshold=0.0, unit="m", fault=Fault.OFF_BALANCE, least=True, best=width / 2)
    low = 0.02 * float(np.linalg.norm(simulation.size))
    small = ROUND * float(np.linalg.norm(simulation.size))
    rolls = width < small and margin > -small
    if rolls:
        found.append(skipped("free_fall", "balance", "it is round below, or stands on points"))
    else:
        found.append(judged("free_fall", "balance", margin, balance))
    for trajectory in trajectories:
        if trajectory.broke:
            found.append(broke(trajectory))
            continue
        name = trajectory.scenario.name
        found += [still(simulation, trajectory, name), *quiet(simulation, trajectory, name)]
        if name == "fall_high":
            continue
        if name == "fall":
            side = np.linalg.norm(trajectory.qpos[:, :2] - trajectory.qpos[0, :2], axis=1)
            limit = Limit(threshold=o.max_drift_m, unit="m", fault=Fault.DRIFTS)
            found.append(_worst(trajectory, "drift", side, limit))
            limit = Limit(threshold=o.max_tilt_deg, unit="deg", fault=Fault.TOPPLES)
            found.append(
                _worst(
                    trajectory,
                    "tilt",
                    np.degrees(angle_between(trajectory.qpos[:, 3:7], trajectory.qpos[0, 3:7])),
                    limit,
                )
            )
            fall = float(trajectory.qpos[0, 2] - trajectory.qpos[-1, 2])
            limit = Limit(
                threshold=o.drop_height_m + max(o.max_depth_m, 0.5 * low),
                unit="m",
                fault=Fault.SINKS_IN,
                best=o.drop_height_m,
            )
            found.append(judged("free_fall", "fall", fall, limit, evidence=_shown(trajectory)))
        elif rolls:
            found.append(skipped("free_fall", name, "it is round below: a tilt rolls it"))
        else:
            limit = Limit(threshold=o.max_tilt_deg, unit="deg", fault=Fault.TOPPLES)
            lean = np.degrees(tilt_between(simulation.tilt, trajectory.qpos[-1:, 3:7])[0])
            found.append(judged("free_fall", name, float(lean), limit, evidence=_shown(trajectory)))
    return found


def pushes(simulation: Simulation, trajectories: list[Trajectory]) -> list[Check]:
    """Ask of pushed objects that nothing breaks, sinks in or gains energy after the push.

    Of the pushes of one part the worst is told.
    """
    found: dict[tuple[str | None, str], Check] = {}
    for trajectory in trajectories:
        name = f"push:{trajectory.scenario.part}"
        checks = [broke(trajectory)] if trajectory.broke else quiet(simulation, trajectory, name)
        for check in checks:
            key = (trajectory.scenario.part, check.name)
            old = found.get(key)
            rank = lambda c: (c.outcome == "FAIL", c.value if c.value is not None else np.inf)
            if old is None or rank(check) > rank(old):
                found[key] = check
    return list(found.values())


def quiet(simulation: Simulation, trajectory: Trajectory, name: str) -> list[Check]:
    """Ask what every free run must hold: resting depth, energy, limits."""
    o = simulation.options
    kind = trajectory.scenario.kind
    # By its largest extent: a plate's height would make nothing of what soft contacts give back.
    weight = simulation.mass * G * float(simulation.size.max())
    # A push itself puts energy in; after it nothing may.
    pushed = trajectory.scenario.part is not None
    after = round(o.push_duration_s / o.timestep_s) + 1 if pushed else 0
    energy = trajectory.energy[after:]
    gain = float(np.max(energy - energy[0])) / weight if len(energy) else 0.0
    found = []
    limit = Limit(threshold=o.max_depth_m, unit="m", fault=Fault.SINKS_IN)
    depth, part = resting_depth(simulation, trajectory)
    shown = _shown(trajectory)
    found.append(judged(kind, f"resting_depth:{name}", depth, limit, part=part, evidence=shown))
    limit = Limit(threshold=o.max_energy_gain, unit="", fault=Fault.GAINS_ENERGY)
    found.append(
        judged(
            kind, f"energy_gain:{name}", gain, limit, part=trajectory.scenario.part, evidence=shown
        )
    )
    over, joint, when = overshoot(simulation, trajectory)
    limit = Limit(threshold=o.max_overshoot, unit="of its range", fault=Fault.LIMIT_SOFT)
    found.append(
        judged(kind, f"limit_overshoot:{name}", over, limit, joint=joint, time=when, evidence=shown)
    )
    return found


def still(simulation: Simulation, trajectory: Trajectory, name: str) -> Check:
    """Ask that the object has come to rest at the end."""
    o = simulation.options
    last = trajectory.qvel[-max(1, round(SETTLED_S / o.timestep_s)) :, :3]
    speed = float(np.linalg.norm(last, axis=1).min())
    limit = Limit(threshold=o.max_rest_speed, unit="m/s", fault=Fault.RESTLESS)
    return judged("free_fall", f"resting_speed:{name}", speed, limit, evidence=_shown(trajectory))


def released(simulation: Simulation, trajectory: Trajectory) -> list[Check]:
    """Judge a joint that was let go: does it settle, stay, and lose its speed?"""
    scenario, o = trajectory.scenario, simulation.options
    assert scenario.joint is not None
    if trajectory.broke:
        return [broke(trajectory)]
    moving = next(j for j in simulation.joints if j.name == scenario.joint)
    at, dof = simulation.address(scenario.joint)
    span = moving.high - moving.low
    common: dict[str, Any] = {
        "part": moving.child,
        "joint": moving.name,
        "evidence": _shown(trajectory),
    }
    if scenario.name.startswith("still:"):
        if moving.sprung:
            return [skipped("joint_release", scenario.name, "a spring moves it", moving.name)]
        stirred = float(np.abs(trajectory.qpos[:, at] - trajectory.qpos[0, at]).max()) / span
        limit = Limit(threshold=STIRRED, unit="of its range", fault=Fault.JOINT_MOVES_ITSELF)
        return [judged("joint_release", scenario.name, stirred, limit, **common)]
    if scenario.name.startswith("coast:"):
        if moving.sprung:
            return [skipped("joint_release", scenario.name, "a spring moves it", moving.name)]
        then = min(round(COASTED_S / o.timestep_s), len(trajectory.time) - 1)
        first = abs(scenario.speeds[scenario.joint])
        loss = 1.0 - abs(float(trajectory.qvel[then, dof])) / first
        limit = Limit(threshold=o.min_loss, unit="of it", fault=Fault.JOINT_UNDAMPED, least=True)
        return [judged("joint_release", scenario.name, loss, limit, time=COASTED_S, **common)]
    found = []
    if moving.high - moving.low < 2 * np.pi - 1e-6:
        last = np.abs(trajectory.qvel[-max(1, round(SETTLED_S / o.timestep_s)) :, dof])
        speed = float(last.max()) * simulation.lever(moving)
        limit = Limit(threshold=JOINT_SPEED, unit="m/s", fault=Fault.RESTLESS)
        found.append(judged("joint_release", scenario.name, speed, limit, **common))
    over, joint, when = overshoot(simulation, trajectory)
    limit = Limit(threshold=o.max_overshoot, unit="of its range", fault=Fault.LIMIT_SOFT)
    found.append(
        judged(
            "joint_release", f"overshoot:{scenario.name}", over, limit, joint=joint, time=when,
            evidence=_shown(trajectory),
        )
    )  # fmt: skip
    return found


def driven(simulation: Simulation, trajectory: Trajectory) -> Check:
    """Ask how much of its range a driven joint reaches."""
    scenario = trajectory.scenario
    assert scenario.joint is not None
    if trajectory.broke:
        return broke(trajectory)
    moving = next(j for j in simulation.joints if j.name == scenario.joint)
    at, _ = simulation.address(scenario.joint)
    # Before it is driven nothing counts: it may fall there by itself.
    reached = float(np.ptp(trajectory.qpos[:, at])) / (moving.high - moving.low)
    limit = Limit(
        threshold=simulation.options.min_mobility,
        unit="of its range",
        fault=Fault.JOINT_STUCK,
        least=True,
        best=1.0,
    )
    return judged(
        "joint_drive", scenario.name, reached, limit, part=moving.child, joint=moving.name,
        evidence=_shown(trajectory),
    )  # fmt: skip


def slid(simulation: Simulation, trajectory: Trajectory) -> Check:
    """Ask on which slope it begins to slide; what topples or rolls before that does not slide."""
    o = simulation.options
    if trajectory.broke:
        return broke(trajectory)
    kind, name = "tilt_until_slide", "slide"
    begin = round(STILL_S / o.timestep_s)
    moved = np.linalg.norm(trajectory.qpos[:, :2] - trajectory.qpos[begin, :2], axis=1)
    turned = np.degrees(angle_between(trajectory.qpos[:, 3:7], trajectory.qpos[begin, 3:7]))
    slope = np.degrees(slope_at(trajectory.time, o.duration_s))
    if _on_wheels(simulation):
        return skipped(kind, name, "it stands on wheels")
    goes, leans = np.flatnonzero(moved > BEGINS_M), np.flatnonzero(turned > 1.0)
    first = int(goes[0]) if len(goes) else len(slope) - 1
    limit = Limit(threshold=o.max_slide_deg, unit="deg", fault=Fault.FRICTION_IMPLAUSIBLE)
    if len(leans) and leans[0] <= first:
        return skipped(kind, name, f"it topples or rolls at {slope[leans[0]]:.0f} degrees")
    # While it slides that far from where it let go the ground tilts on: x = g rate t^3 / 6.
    rate = np.radians(STEEPEST_DEG) / (o.duration_s - TILT_FROM_S)
    late = (6 * BEGINS_M / (G * rate)) ** (1 / 3)
    angle = max(float(slope[first]) - float(np.degrees(rate * late)), 0.0)
    if angle < o.min_slide_deg:
        limit = limit.model_copy(update={"threshold": o.min_slide_deg, "least": True})
    return judged(
        kind, name, angle, limit, time=float(trajectory.time[first]), evidence=_shown(trajectory)
    )


def broke(trajectory: Trajectory) -> Check:
    """Say that a simulation broke down."""
    when = float(trajectory.time[-1]) if len(trajectory.time) else 0.0
    limit = Limit(threshold=0.0, unit="", fault=Fault.DIVERGES)
    name = f"finite:{trajectory.scenario.name}"
    return judged(
        trajectory.scenario.kind, name, float("nan"), limit, joint=trajectory.scenario.joint,
        part=trajectory.scenario.part, time=when, evidence=_shown(trajectory),
    )  # fmt: skip


def resting_depth(simulation: Simulation, trajectory: Trajectory) -> tuple[float, str | None]:
    """Return how deep [m] contacts are at the end of a run, impact long past, and whose."""
    model, data = simulation.model, simulation.data
    data.qpos[:], data.qvel[:] = trajectory.qpos[-1], 0.0
    mujoco.mj_forward(model, data)
    if data.ncon == 0:
        return 0.0, None
    worst = int(np.argmin(data.contact.dist[: data.ncon]))
    depth = max(-float(data.contact.dist[worst]), 0.0)
    body = model.body(int(model.geom_bodyid[int(data.contact.geom[worst].max())])).name
    return depth, body.split("/", 1)[-1] if "/" in body else simulation.spec.root


def overshoot(simulation: Simulation, trajectory: Trajectory) -> tuple[float, str | None, float]:
    """Return how far joints go beyond their limits, over their range; which one and when.

    Ranges shorter than 8 cm or 0.6 rad count as that long.
    """
    model = simulation.model
    single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = np.flatnonzero(model.jnt_limited.astype(bool) & single)
    if not len(limited):
        return 0.0, None, 0.0
    q = trajectory.qpos[:, model.jnt_qposadr[limited]]
    low, high = model.jnt_range[limited].T
    # Limits are soft: of a short range a millimetre counts no more than of one of usual length.
    sliding = model.jnt_type[limited] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    span = np.maximum(high - low, np.where(sliding, SHORT_M, SHORT_RAD))
    over = np.maximum(low - q, q - high) / span
    step, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    name = model.joint(int(limited[joint])).name.split("/", 1)[-1]
    return max(float(over[step, joint]), 0.0), name, float(trajectory.time[step])


def stance(simulation: Simulation, slack: float = 0.0) -> tuple[float, float]:
    """Return how wide [m] what the object stands on is, and how far inside it the weight falls.

    The margin is negative where the centre of mass lies beyond the base. Pieces at most `slack` [m]
    above the lowest point count as touching, and those within a millimetre always do.
    """
    spec, tilt = simulation.spec, pose((0, 0, 0), simulation.tilt)
    moved = link_poses(spec, simulation.state)
    feet, lowest = [], np.inf
    placed = [
        (piece, tilt.then(moved[p.name]).then(at)) for p in spec.parts for _, piece, at in pieces(p)
    ]
    for piece, at in placed:
        lowest = min(lowest, float(box_around(piece, at)[0][2]))
    reach = lowest + max(0.001, 0.002 * float(simulation.size[2]), slack)
    for piece, at in placed:
        if box_around(piece, at)[0][2] > reach:
            continue
        feet.append(_foot(piece, at.pos, matrix(at.quat), reach))
    points = np.vstack(feet)
    data, model = simulation.data, simulation.model
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    data.qpos[:3], data.qpos[3:7] = 0.0, simulation.tilt
    for joint, value in simulation.state.items():
        data.qpos[simulation.address(joint)[0]] = value
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    centre = data.subtree_com[simulation.root][:2]
    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0, -_beside(points, centre)
    faces = hull.equations
    corners = points[hull.vertices]
    spread = corners @ faces[:, :2].T
    return float(np.ptp(spread, axis=0).min()), float(-(faces[:, :2] @ centre + faces[:, 2]).max())


def _foot(piece: Piece, pos: NDArray, turn: NDArray, reach: float) -> NDArray:
    """Return points [n, 2] around what a piece has below a height."""
    s = np.array(piece.size)
    if piece.kind == "mesh":
        local = np.array(piece.vertices)
    elif piece.kind == "box":
        local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * s
    else:
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        if piece.kind == "cylinder":
            local = np.vstack(
                [np.column_stack([ring * s[0], np.full(24, z)]) for z in (-s[1], s[1])]
            )
        else:
            # Round all over: it touches at the lowest point, of a capsule at either end's.
            half = s[1] if piece.kind == "capsule" else 0.0
            ends = np.array([[0, 0, -half], [0, 0, half]])
            radius = s if piece.kind == "ellipsoid" else np.full(3, s[0])
            down = radius**2 * -turn[2]
            down = down / np.sqrt(np.sum((turn[2] * radius) ** 2))
            local = ends + down
    points = local @ turn.T + pos
    return points[points[:, 2] <= reach + 1e-9][:, :2].reshape(-1, 2)


def _beside(points: NDArray, centre: NDArray) -> float:
    """Return how far [m] a point lies beside the stretch that points [n, 2] in a line span."""
    ends = points[[int(np.argmin(points.sum(axis=1))), int(np.argmax(points.sum(axis=1)))]]
    far = points[int(np.argmax(np.linalg.norm(points - ends[0], axis=1)))]
    way = far - ends[0]
    share = np.clip((centre - ends[0]) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(centre - ends[0] - share * way))


def _on_wheels(simulation: Simulation) -> bool:
    """Tell whether what touches the floor turns without end."""
    data, model = simulation.data, simulation.model
    data.qpos[:], data.qvel[:] = model.key_qpos[0], 0.0
    low, _ = bounds(simulation.spec, simulation.state, tuple(simulation.tilt.tolist()))
    data.qpos[:7] = [0, 0, -low[2] - 1e-4, *simulation.tilt]
    mujoco.mj_forward(model, data)
    wheels = {
        model.body(body_name(simulation.spec, j.child)).id
        for j in simulation.spec.joints
        if j.type == "continuous"
    }
    touching = {
        int(model.geom_bodyid[g])
        for pair in data.contact.geom[: data.ncon]
        for g in pair
        if simulation.floor in pair and g != simulation.floor
    }
    return bool(touching & wheels)


def _worst(trajectory: Trajectory, name: str, values: NDArray, limit: Limit) -> Check:
    k = int(np.argmax(values))
    return judged(
        trajectory.scenario.kind,
        name,
        float(values[k]),
        limit,
        time=trajectory.time[k],
        evidence=_shown(trajectory),
    )


def _shown(trajectory: Trajectory) -> str:
    return f"run {trajectory.scenario.name}"


__all__ = ["checks_of", "overshoot", "resting_depth", "stance"]

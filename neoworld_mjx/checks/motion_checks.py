"""Dynamic checks of an object: each check compares a measurement in one scenario with a limit.

The balance of an object at rest follows from its support polygon: the polygon's width, and the
margin of the center of mass.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from shapely import MultiPoint, Point

from ..physics.mjcf import START
from ..spec import link_poses, pieces
from ..spec.convex import Piece, box_around
from ..spec.pose import angle_between, matrix, pose, tilt_between
from ..spec.shapes import faceted
from .scenarios import DROP_HEIGHT_M
from .simulation import PUSH_S, TIMESTEP_S, G, Simulation, Trajectory
from .verdict import Check, Fault, Limit, make_check, skipped


def support_polygon(simulation: Simulation, slack: float = 0.0) -> tuple[float, float]:
    """Return the width and the margin of an object's support polygon on a level floor.

    The support polygon is the convex hull of the contacts with the floor.

    Args:
        simulation: the object.
        slack: height above the object's lowest point up to which a piece counts as touching the
            floor [m]. Values below 1 mm count as 1 mm.

    Returns:
        The smallest width of the polygon [m], and the distance of the center of mass from the
        border of the polygon [m], which is positive inside the polygon.
    """
    spec, tilt = simulation.spec, pose((0, 0, 0), simulation.tilt)
    links = link_poses(spec, {})
    posed_pieces = [
        (piece, tilt.then(links[p.name]).then(piece_pose))
        for p in spec.parts
        for _, piece, piece_pose in pieces(p)
    ]
    bottoms = [float(box_around(piece, piece_pose)[0][2]) for piece, piece_pose in posed_pieces]
    reach = min(bottoms) + max(0.001, 0.002 * float(simulation.size[2]), slack)
    points = np.vstack(
        [
            _contact_points(piece, piece_pose.pos, matrix(piece_pose.quat), reach)
            for (piece, piece_pose), bottom in zip(posed_pieces, bottoms, strict=True)
            if bottom <= reach
        ]
    )
    data, model = simulation.data, simulation.model
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    data.qpos[:3], data.qpos[3:7] = 0.0, simulation.tilt
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    centre = data.subtree_com[simulation.root][:2]
    try:
        hull = ConvexHull(points)
    except QhullError:
        # The points lie on a line or coincide.
        return 0.0, -MultiPoint(points).convex_hull.distance(Point(centre))
    faces = hull.equations
    corners = points[hull.vertices]
    widths = np.ptp(corners @ faces[:, :2].T, axis=0)
    return float(widths.min()), float(-(faces[:, :2] @ centre + faces[:, 2]).max())


def _contact_points(piece: Piece, pos: NDArray, rotation: NDArray, reach: float) -> NDArray:
    """Return the horizontal positions of a piece's lowest points below a height.

    Args:
        piece: the convex piece.
        pos: position of the piece [m], shape [3].
        rotation: rotation matrix of the piece, shape [3, 3].
        reach: the height [m].

    Returns:
        Positions of corners, or of points where a round piece touches the floor [m], shape [n, 2].
    """
    s = np.array(piece.size)
    if piece.kind in ("box", "mesh"):
        local = faceted(piece)
    else:
        # The lowest point of a ring is one of the points, however the piece is turned.
        lowest_angle = np.arctan2(-rotation[2, 1], -rotation[2, 0])
        angle = lowest_angle + np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        if piece.kind == "cylinder":
            local = np.vstack(
                [np.column_stack([ring * s[0], np.full(24, z)]) for z in (-s[1], s[1])]
            )
        else:
            # A sphere or an ellipsoid touches the floor at its lowest point, and a capsule at the
            # lowest points of its two ends.
            half = s[1] if piece.kind == "capsule" else 0.0
            ends = np.array([[0, 0, -half], [0, 0, half]])
            radius = s if piece.kind == "ellipsoid" else np.full(3, s[0])
            lowest = radius**2 * -rotation[2]
            lowest = lowest / np.sqrt(np.sum((rotation[2] * radius) ** 2))
            local = ends + lowest
    points = local @ rotation.T + pos
    return points[points[:, 2] <= reach + 1e-9][:, :2].reshape(-1, 2)


MAX_REST_SPEED = 0.01
"""Largest speed at the end of a fall [m/s]."""
MAX_ENERGY_GAIN = 0.02
"""Largest gain of energy without a force, over the object's weight times its extent."""
MAX_OVERSHOOT = 0.05
"""Largest travel beyond a joint's limit, as a fraction of the joint's range."""
MIN_MOBILITY = 0.9
"""Smallest fraction of its range that a joint covers when it is driven up and down."""
MIN_LOSS = 0.05
"""Smallest fraction of its speed that a coasting joint loses in `COAST_S`."""
SETTLE_WINDOW_S = 0.2
"""Time at the end of a run during which the object and its joints must be settled [s]."""
JOINT_SPEED = 0.03
"""Largest speed of a settled joint, measured at the far end of the parts that it moves [m/s]."""
MAX_FREE_MOTION = 0.02
"""Largest motion of a joint on which no force acts, as a fraction of the joint's range."""
COAST_S = 0.5
"""Time after which the loss of speed of a coasting joint is measured [s]."""
MIN_RANGE_M, MIN_RANGE_RAD = 0.08, 0.6
"""Overshoot is relative to the range, but at least to this: sliding [m], turning joints [rad]."""
ROUND_WIDTH = 0.01
"""A bottom is round if the support polygon's width, over the object's size, is below this."""
ROUND_WIDENING = 1.25
"""A faceted bottom is round if the support polygon widens by more than this factor when leaning.

The object leans by `max_tilt_deg`.
"""
FLAT_BASE_FRACTION = 0.7
"""A base is flat with a bump, and not round, if the widened polygon is at least this wide.

The value is a fraction of the object's smaller horizontal extent.
"""
ROUND_MAX_TILT_DEG, ROUND_MAX_DRIFT = 30.0, 0.5
"""Limits for a round object, which may settle with another side down.

The first is the largest tilt [deg], which is also the largest tilt that composition corrects. The
second is the largest displacement, over the object's size.
"""
ROUND_HINT = "draw it in the pose in which it rests, or give it a flat where it lies"


def check_motion(simulation: Simulation, trajectories: Iterable[Trajectory]) -> Iterator[Check]:
    """Yield the checks of all scenarios of an object from their trajectories."""
    by_kind: dict[str, list[Trajectory]] = defaultdict(list)
    for trajectory in trajectories:
        by_kind[trajectory.scenario.kind].append(trajectory)
    if by_kind["free_fall"]:
        yield from _falls(simulation, by_kind["free_fall"])
    else:
        yield skipped("free_fall", "rests", "base is fixed")
    yield from _pushes(simulation, by_kind["force_perturbation"])
    for kind, checks_of in (
        ("joint_release", _release),
        ("joint_drive", _drive),
    ):
        for trajectory in by_kind[kind]:
            if trajectory.diverged:
                yield _diverged(trajectory)
            else:
                yield from checks_of(simulation, trajectory)


def _falls(simulation: Simulation, trajectories: Sequence[Trajectory]) -> Iterator[Check]:
    """Check that the object balances, and that it is upright, in place and settled after a fall."""
    o, size = simulation.options, float(np.linalg.norm(simulation.size))
    width, margin = support_polygon(simulation)
    # Pieces that touch the floor before the object leans too far also support the object.
    lean = float(np.tan(np.radians(o.max_tilt_deg)) * np.linalg.norm(simulation.size[:2]) / 2)
    wider = support_polygon(simulation, lean)
    rolls = width < ROUND_WIDTH * size and max(margin, wider[1]) > -ROUND_WIDTH * size
    # The polygon of a round bottom widens as the object leans. That of a flat base with a bump
    # below it widens much more.
    is_round = rolls or wider[0] > ROUND_WIDENING * width
    is_round &= wider[0] < FLAT_BASE_FRACTION * float(simulation.size[:2].min())
    if margin < 0 and wider[1] > margin:
        width, margin = wider
        rolls = width < ROUND_WIDTH * size and margin > -ROUND_WIDTH * size
    is_round &= margin > -ROUND_WIDTH * size
    if rolls:
        yield skipped("free_fall", "balance", "its bottom is round, or it stands on points")
    else:
        # The best margin is that of a center of mass above the middle of the support polygon.
        limit = Limit(0.0, "m", Fault.OFF_BALANCE, least=True, best=width / 2)
        yield make_check("free_fall", "balance", margin, limit)
    upright = Limit(o.max_tilt_deg, "deg", Fault.TOPPLES)
    in_place = Limit(o.max_drift_m, "m", Fault.DRIFTS)
    if is_round:
        upright = Limit(
            max(ROUND_MAX_TILT_DEG, o.max_tilt_deg), "deg", Fault.TOPPLES, hint=ROUND_HINT
        )
        in_place = Limit(
            max(ROUND_MAX_DRIFT * size, o.max_drift_m), "m", Fault.DRIFTS, hint=ROUND_HINT
        )
    drop = DROP_HEIGHT_M
    on_floor = Limit(drop + max(o.max_depth_m, 0.01 * size), "m", Fault.SINKS_IN, best=drop)
    for trajectory in trajectories:
        if trajectory.diverged:
            yield _diverged(trajectory)
            continue
        name, qpos = trajectory.scenario.name, trajectory.qpos
        # A round object that is dropped with a tilt rolls, and nothing on a level floor stops it.
        tilted = name != "fall"
        if not (rolls and tilted):
            speeds = np.linalg.norm(_last_steps(trajectory.qvel)[:, :3], axis=1)
            limit = Limit(MAX_REST_SPEED, "m/s", Fault.RESTLESS)
            yield _check(trajectory, f"resting_speed:{name}", speeds.min(), limit)
        yield from _free_run(simulation, trajectory, name)
        if name == "fall":
            drift = np.linalg.norm(qpos[:, :2] - qpos[0, :2], axis=1)
            tilt = np.degrees(angle_between(qpos[:, 3:7], qpos[0, 3:7]))
            yield _largest(trajectory, "drift", drift, in_place)
            yield _largest(trajectory, "tilt", tilt, upright)
            if tilt[-1] > o.max_tilt_deg and is_round:
                yield skipped("free_fall", "fall", "it is round and settles with another side down")
            else:
                yield _check(trajectory, "fall", qpos[0, 2] - qpos[-1, 2], on_floor)
        elif tilted and rolls:
            yield skipped("free_fall", name, "its bottom is round, so it rolls when tilted")
        elif tilted:
            lean = np.degrees(tilt_between(simulation.tilt, qpos[-1:, 3:7])[0])
            yield _check(trajectory, name, lean, upright)


def _pushes(simulation: Simulation, trajectories: Iterable[Trajectory]) -> Iterable[Check]:
    """Return the worst check over all pushes, for each part and name of a check."""
    worst: dict[tuple[str | None, str], Check] = {}

    def rank(check: Check) -> tuple[bool, float]:
        return check.outcome == "FAIL", np.inf if check.value is None else check.value

    for trajectory in trajectories:
        part = trajectory.scenario.part
        checks = [_diverged(trajectory)]
        if not trajectory.diverged:
            checks = list(_free_run(simulation, trajectory, f"push:{part}"))
        for check in checks:
            previous = worst.setdefault((part, check.name), check)
            if rank(check) > rank(previous):
                worst[part, check.name] = check
    return worst.values()


def _free_run(simulation: Simulation, trajectory: Trajectory, name: str) -> Iterator[Check]:
    """Check the final depth of contacts, the gain of energy, and the overshoot of joint limits."""
    o, pushed = simulation.options, trajectory.scenario.part
    depth, part = _resting_depth(simulation, trajectory)
    limit = Limit(o.max_depth_m, "m", Fault.SINKS_IN)
    yield _check(trajectory, f"resting_depth:{name}", depth, limit, part=part)
    # The energy is relative to the weight times the largest extent. If it were relative to the
    # height, the energy of soft contacts would be large for a plate.
    weight = simulation.mass * G * float(simulation.size.max())
    # A push adds energy. Afterwards, the energy must not increase.
    first = 0 if pushed is None else round(PUSH_S / TIMESTEP_S) + 1
    energy = trajectory.energy[first:]
    gain = float(np.max(energy - energy[0])) / weight if len(energy) else 0.0
    limit = Limit(MAX_ENERGY_GAIN, "", Fault.GAINS_ENERGY)
    yield _check(trajectory, f"energy_gain:{name}", gain, limit, part=pushed)
    yield _overshoot(simulation, trajectory, f"limit_overshoot:{name}")


def _release(simulation: Simulation, trajectory: Trajectory) -> Iterator[Check]:
    """Check a joint release; the check depends on the scenario.

    A released joint must settle, a joint without forces must not move, and a coasting joint must
    lose speed.
    """
    scenario = trajectory.scenario
    name, joint = scenario.name, simulation.joint_of(scenario)
    position, dof = simulation.address(joint.name)
    span = joint.high - joint.low
    names = {"part": joint.child, "joint": joint.name}
    kind = name.partition(":")[0]
    if kind != "release" and joint.has_spring:
        yield skipped("joint_release", name, "a spring moves it", joint.name)
    elif kind == "still":
        q = trajectory.qpos[:, position]
        limit = Limit(MAX_FREE_MOTION, "of its range", Fault.JOINT_MOVES_ITSELF)
        yield _check(trajectory, name, float(np.abs(q - q[0]).max()) / span, limit, **names)
    elif kind == "coast":
        step = min(round(COAST_S / TIMESTEP_S), len(trajectory.time) - 1)
        loss = 1.0 - abs(float(trajectory.qvel[step, dof])) / abs(scenario.speeds[joint.name])
        limit = Limit(MIN_LOSS, "of it", Fault.JOINT_UNDAMPED, least=True)
        yield _check(trajectory, name, loss, limit, **names, time=COAST_S)
    else:
        if span < 2 * np.pi - 1e-6:
            fastest = float(np.abs(_last_steps(trajectory.qvel)[:, dof]).max())
            limit = Limit(JOINT_SPEED, "m/s", Fault.RESTLESS)
            speed = fastest * simulation.moment_arm(joint)
            yield _check(trajectory, name, speed, limit, **names)
        yield _overshoot(simulation, trajectory, f"overshoot:{name}")


def _drive(simulation: Simulation, trajectory: Trajectory) -> Iterator[Check]:
    """Check the fraction of its range that a driven joint covers."""
    scenario = trajectory.scenario
    joint = simulation.joint_of(scenario)
    q = trajectory.qpos[:, simulation.address(joint.name)[0]]
    covered = float(np.ptp(q)) / (joint.high - joint.low)
    limit = Limit(MIN_MOBILITY, "of its range", Fault.JOINT_STUCK, least=True, best=1.0)
    yield _check(trajectory, scenario.name, covered, limit, part=joint.child, joint=joint.name)


def _diverged(trajectory: Trajectory) -> Check:
    """Return the failed check of a simulation that diverged."""
    scenario, time = trajectory.scenario, trajectory.time[-1] if len(trajectory.time) else 0.0
    limit = Limit(0.0, "", Fault.DIVERGES)
    name, part, joint = f"finite:{scenario.name}", scenario.part, scenario.joint
    return _check(trajectory, name, float("nan"), limit, part=part, joint=joint, time=time)


def _last_steps(values: NDArray) -> NDArray:
    """Return the values of the last steps of a run, during which the object must be settled.

    The first axis of the values is time.
    """
    return values[-max(1, round(SETTLE_WINDOW_S / TIMESTEP_S)) :]


def _resting_depth(simulation: Simulation, trajectory: Trajectory) -> tuple[float, str | None]:
    """Return the depth of the deepest contact at the end of a run [m], and the part in contact.

    Without contacts, the depth is 0 and the part is None.
    """
    model, data = simulation.model, simulation.data
    data.qpos[:], data.qvel[:] = trajectory.qpos[-1], 0.0
    mujoco.mj_forward(model, data)
    if data.ncon == 0:
        return 0.0, None
    deepest = int(np.argmin(data.contact.dist[: data.ncon]))
    depth = max(-float(data.contact.dist[deepest]), 0.0)
    body = model.body(int(model.geom_bodyid[int(data.contact.geom[deepest].max())])).name
    return depth, body.split("-", 1)[-1] if "-" in body else simulation.spec.root


def _overshoot(simulation: Simulation, trajectory: Trajectory, name: str) -> Check:
    """Check the largest excess over any joint's limits, relative to the joint's range."""
    model = simulation.model
    limit = Limit(MAX_OVERSHOOT, "of its range", Fault.LIMIT_SOFT)
    single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = np.flatnonzero(model.jnt_limited.astype(bool) & single)
    if not len(limited):
        return _check(trajectory, name, 0.0, limit)
    q = trajectory.qpos[:, model.jnt_qposadr[limited]]
    low, high = model.jnt_range[limited].T
    # Limits are soft, so an excess of a millimeter must not count more for a very short range.
    sliding = model.jnt_type[limited] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    span = np.maximum(high - low, np.where(sliding, MIN_RANGE_M, MIN_RANGE_RAD))
    excess = np.maximum(low - q, q - high) / span
    step, index = np.unravel_index(int(np.argmax(excess)), excess.shape)
    joint = model.joint(int(limited[index])).name.split("-", 1)[-1]
    value, time = max(float(excess[step, index]), 0.0), float(trajectory.time[step])
    return _check(trajectory, name, value, limit, joint=joint, time=time)


def _check(trajectory: Trajectory, name: str, value: float, limit: Limit, **context: Any) -> Check:
    """Compare a value that was measured in a run with a limit; the evidence is the run."""
    scenario = trajectory.scenario
    evidence = f"run {scenario.name}"
    return make_check(scenario.kind, name, float(value), limit, evidence=evidence, **context)


def _largest(trajectory: Trajectory, name: str, values: NDArray, limit: Limit) -> Check:
    """Compare the largest value over time, shape [t], with a limit."""
    k = int(np.argmax(values))
    return _check(trajectory, name, values[k], limit, time=trajectory.time[k])

"""Dynamic checks of an object: each compares one number of one scenario with its limit."""

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..spec.pose import angle_between, tilt_between
from .scenarios import STEEPEST_DEG, STILL_S, TILT_FROM_S, slope_at
from .simulation import G, Simulation, Trajectory
from .support_polygon import on_wheels, support_polygon
from .verdict import Check, Fault, Limit, judged, skipped

SETTLED_S = 0.2
"""Time at the end of a run over which an object at rest does not move."""
JOINT_SPEED = 0.03
"""Speed [m/s] of the far end of a joint's child below which it is at rest."""
STIRRED = 0.02
"""Share of its range by which a joint may move without forces."""
BEGINS_M = 0.001
"""Movement on a slope that counts as sliding."""
COASTED_S = 0.5
"""Time after which the loss of speed of a coasting joint is measured."""
SHORT_M, SHORT_RAD = 0.08, 0.6
"""Shortest ranges, of a sliding and a turning joint, that overshoot is taken relative to."""
ROUND = 0.01
"""Width of the support polygon, over the object's size, below which its bottom is round."""


def checks_of(simulation: Simulation, trajectories: Iterable[Trajectory]) -> list[Check]:
    """Return the checks of all trajectories of an object."""
    by_kind: dict[str, list[Trajectory]] = {}
    for trajectory in trajectories:
        by_kind.setdefault(trajectory.scenario.kind, []).append(trajectory)
    if by_kind.get("free_fall"):
        checks = falls(simulation, by_kind["free_fall"])
    else:
        checks = [skipped("free_fall", "rests", "base is fixed")]
    checks += pushes(simulation, by_kind.get("force_perturbation", []))
    checks += [slid(simulation, run) for run in by_kind.get("tilt_until_slide", [])]
    for trajectory in by_kind.get("joint_release", []):
        checks += released(simulation, trajectory)
    checks += [driven(simulation, run) for run in by_kind.get("joint_drive", [])]
    return checks


def falls(simulation: Simulation, trajectories: list[Trajectory]) -> list[Check]:
    """Check that the object balances, and that falls leave it upright, in place, and at rest."""
    o = simulation.options
    width, margin = support_polygon(simulation)
    if margin < 0:
        # Pieces that reach the floor before it leans too far support it as well.
        lean = float(np.tan(np.radians(o.max_tilt_deg)) * np.linalg.norm(simulation.size[:2]) / 2)
        wider = support_polygon(simulation, lean)
        if wider[1] > margin:
            width, margin = wider
    size = float(np.linalg.norm(simulation.size))
    rolls = width < ROUND * size and margin > -ROUND * size
    if rolls:
        checks = [skipped("free_fall", "balance", "it is round below, or stands on points")]
    else:
        # The best margin is that of the middle of the support polygon.
        limit = Limit(threshold=0.0, unit="m", fault=Fault.OFF_BALANCE, least=True, best=width / 2)
        checks = [judged("free_fall", "balance", margin, limit)]
    upright = Limit(threshold=o.max_tilt_deg, unit="deg", fault=Fault.TOPPLES)
    in_place = Limit(threshold=o.max_drift_m, unit="m", fault=Fault.DRIFTS)
    on_floor = Limit(
        threshold=o.drop_height_m + max(o.max_depth_m, 0.01 * size),
        unit="m",
        fault=Fault.SINKS_IN,
        best=o.drop_height_m,
    )
    for trajectory in trajectories:
        if trajectory.broke:
            checks.append(diverged(trajectory))
            continue
        name, qpos = trajectory.scenario.name, trajectory.qpos
        # A tilt sets a round thing rolling, and nothing on a level floor stops it.
        tilted = name not in ("fall", "fall_high")
        if not (rolls and tilted):
            checks.append(still(simulation, trajectory, name))
        checks += quiet(simulation, trajectory, name)
        if name == "fall":
            drift = np.linalg.norm(qpos[:, :2] - qpos[0, :2], axis=1)
            tilt = np.degrees(angle_between(qpos[:, 3:7], qpos[0, 3:7]))
            checks += [
                _largest(trajectory, "drift", drift, in_place),
                _largest(trajectory, "tilt", tilt, upright),
                _check(trajectory, "fall", qpos[0, 2] - qpos[-1, 2], on_floor),
            ]
        elif tilted and rolls:
            checks.append(skipped("free_fall", name, "it is round below: a tilt rolls it"))
        elif tilted:
            lean = np.degrees(tilt_between(simulation.tilt, qpos[-1:, 3:7])[0])
            checks.append(_check(trajectory, name, lean, upright))
    return checks


def pushes(simulation: Simulation, trajectories: list[Trajectory]) -> list[Check]:
    """Check that pushed objects neither diverge, nor sink in, nor gain energy after the push.

    The result has one check of each name for each part, the worst over all pushes.
    """
    worst: dict[tuple[str | None, str], Check] = {}
    rank = lambda c: (c.outcome == "FAIL", c.value if c.value is not None else np.inf)
    for trajectory in trajectories:
        part = trajectory.scenario.part
        checks = [diverged(trajectory)]
        if not trajectory.broke:
            checks = quiet(simulation, trajectory, f"push:{part}")
        for check in checks:
            previous = worst.get((part, check.name))
            if previous is None or rank(check) > rank(previous):
                worst[part, check.name] = check
    return list(worst.values())


def quiet(simulation: Simulation, trajectory: Trajectory, name: str) -> list[Check]:
    """Check the resting depth, gain of energy and overshoot of joint limits of a free run."""
    o, pushed = simulation.options, trajectory.scenario.part
    limit = Limit(threshold=o.max_depth_m, unit="m", fault=Fault.SINKS_IN)
    depth, part = resting_depth(simulation, trajectory)
    checks = [_check(trajectory, f"resting_depth:{name}", depth, limit, part=part)]
    # Over the largest extent: over a plate's height, the energy of soft contacts would be large.
    weight = simulation.mass * G * float(simulation.size.max())
    # A push adds energy; after it nothing may.
    after = 0 if pushed is None else round(o.push_duration_s / o.timestep_s) + 1
    energy = trajectory.energy[after:]
    gain = float(np.max(energy - energy[0])) / weight if len(energy) else 0.0
    limit = Limit(threshold=o.max_energy_gain, unit="", fault=Fault.GAINS_ENERGY)
    checks.append(_check(trajectory, f"energy_gain:{name}", gain, limit, part=pushed))
    excess, joint, time = overshoot(simulation, trajectory)
    limit = Limit(threshold=o.max_overshoot, unit="of its range", fault=Fault.LIMIT_SOFT)
    name = f"limit_overshoot:{name}"
    checks.append(_check(trajectory, name, excess, limit, joint=joint, time=time))
    return checks


def still(simulation: Simulation, trajectory: Trajectory, name: str) -> Check:
    """Check that the object has come to rest at the end of a run."""
    o = simulation.options
    last = trajectory.qvel[-max(1, round(SETTLED_S / o.timestep_s)) :, :3]
    speed = float(np.linalg.norm(last, axis=1).min())
    limit = Limit(threshold=o.max_rest_speed, unit="m/s", fault=Fault.RESTLESS)
    return _check(trajectory, f"resting_speed:{name}", speed, limit)


def released(simulation: Simulation, trajectory: Trajectory) -> list[Check]:
    """Check that a released joint settles, stays still without forces, or loses its speed."""
    scenario, o = trajectory.scenario, simulation.options
    if trajectory.broke:
        return [diverged(trajectory)]
    moving = simulation.joint_of(scenario)
    at, dof = simulation.address(moving.name)
    child, joint, span = moving.child, moving.name, moving.high - moving.low
    alone = scenario.name.startswith(("still:", "coast:"))
    if alone and moving.sprung:
        return [skipped("joint_release", scenario.name, "a spring moves it", joint)]
    if scenario.name.startswith("still:"):
        movement = float(np.abs(trajectory.qpos[:, at] - trajectory.qpos[0, at]).max()) / span
        limit = Limit(threshold=STIRRED, unit="of its range", fault=Fault.JOINT_MOVES_ITSELF)
        return [_check(trajectory, scenario.name, movement, limit, part=child, joint=joint)]
    if scenario.name.startswith("coast:"):
        step = min(round(COASTED_S / o.timestep_s), len(trajectory.time) - 1)
        loss = 1.0 - abs(float(trajectory.qvel[step, dof])) / abs(scenario.speeds[joint])
        limit = Limit(threshold=o.min_loss, unit="of it", fault=Fault.JOINT_UNDAMPED, least=True)
        return [
            _check(trajectory, scenario.name, loss, limit, part=child, joint=joint, time=COASTED_S)
        ]
    checks = []
    if span < 2 * np.pi - 1e-6:
        last = np.abs(trajectory.qvel[-max(1, round(SETTLED_S / o.timestep_s)) :, dof])
        speed = float(last.max()) * simulation.moment_arm(moving)
        limit = Limit(threshold=JOINT_SPEED, unit="m/s", fault=Fault.RESTLESS)
        checks.append(_check(trajectory, scenario.name, speed, limit, part=child, joint=joint))
    excess, joint, time = overshoot(simulation, trajectory)
    limit = Limit(threshold=o.max_overshoot, unit="of its range", fault=Fault.LIMIT_SOFT)
    name = f"overshoot:{scenario.name}"
    return [*checks, _check(trajectory, name, excess, limit, joint=joint, time=time)]


def driven(simulation: Simulation, trajectory: Trajectory) -> Check:
    """Check the share of its range that a driven joint reaches."""
    if trajectory.broke:
        return diverged(trajectory)
    moving = simulation.joint_of(trajectory.scenario)
    at, _ = simulation.address(moving.name)
    reached = float(np.ptp(trajectory.qpos[:, at])) / (moving.high - moving.low)
    limit = Limit(
        threshold=simulation.options.min_mobility,
        unit="of its range",
        fault=Fault.JOINT_STUCK,
        least=True,
        best=1.0,
    )
    name = trajectory.scenario.name
    return _check(trajectory, name, reached, limit, part=moving.child, joint=moving.name)


def slid(simulation: Simulation, trajectory: Trajectory) -> Check:
    """Check the slope at which an object begins to slide, unless it topples or rolls before."""
    o, qpos = simulation.options, trajectory.qpos
    if trajectory.broke:
        return diverged(trajectory)
    kind, name = "tilt_until_slide", "slide"
    if on_wheels(simulation):
        return skipped(kind, name, "it stands on wheels")
    begin = round(STILL_S / o.timestep_s)
    sliding = np.linalg.norm(qpos[:, :2] - qpos[begin, :2], axis=1) > BEGINS_M
    leaning = np.degrees(angle_between(qpos[:, 3:7], qpos[begin, 3:7])) > 1.0
    slope = np.degrees(slope_at(trajectory.time, o.duration_s))
    first = int(np.argmax(sliding)) if sliding.any() else len(slope) - 1
    if leaning[: first + 1].any():
        degrees = slope[int(np.argmax(leaning))]
        return skipped(kind, name, f"it topples or rolls at {degrees:.0f} degrees")
    # The ground keeps tilting while the object slides this far: x = g rate t^3 / 6.
    rate = np.radians(STEEPEST_DEG) / (o.duration_s - TILT_FROM_S)
    delay = (6 * BEGINS_M / (G * rate)) ** (1 / 3)
    angle = max(float(slope[first]) - float(np.degrees(rate * delay)), 0.0)
    shallow = angle < o.min_slide_deg
    limit = Limit(
        threshold=o.min_slide_deg if shallow else o.max_slide_deg,
        unit="deg",
        fault=Fault.FRICTION_IMPLAUSIBLE,
        least=shallow,
    )
    return _check(trajectory, name, angle, limit, time=trajectory.time[first])


def diverged(trajectory: Trajectory) -> Check:
    """Return the failed check of a simulation that diverged."""
    scenario, time = trajectory.scenario, trajectory.time[-1] if len(trajectory.time) else 0.0
    limit = Limit(threshold=0.0, unit="", fault=Fault.DIVERGES)
    name, part, joint = f"finite:{scenario.name}", scenario.part, scenario.joint
    return _check(trajectory, name, float("nan"), limit, part=part, joint=joint, time=time)


def resting_depth(simulation: Simulation, trajectory: Trajectory) -> tuple[float, str | None]:
    """Return the deepest contact [m] at the end of a run, and its part; None without contact."""
    model, data = simulation.model, simulation.data
    data.qpos[:], data.qvel[:] = trajectory.qpos[-1], 0.0
    mujoco.mj_forward(model, data)
    if data.ncon == 0:
        return 0.0, None
    worst = int(np.argmin(data.contact.dist[: data.ncon]))
    depth = max(-float(data.contact.dist[worst]), 0.0)
    body = model.body(int(model.geom_bodyid[int(data.contact.geom[worst].max())])).name
    return depth, body.split("-", 1)[-1] if "-" in body else simulation.spec.root


def overshoot(simulation: Simulation, trajectory: Trajectory) -> tuple[float, str | None, float]:
    """Return the largest excess over a joint's limits, over its range, the joint, and its time [s].

    Ranges shorter than `SHORT_M` or `SHORT_RAD` count as that long.
    """
    model = simulation.model
    single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = np.flatnonzero(model.jnt_limited.astype(bool) & single)
    if not len(limited):
        return 0.0, None, 0.0
    q = trajectory.qpos[:, model.jnt_qposadr[limited]]
    low, high = model.jnt_range[limited].T
    # Limits are soft: in a short range a millimetre must not count more than in a usual one.
    sliding = model.jnt_type[limited] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    span = np.maximum(high - low, np.where(sliding, SHORT_M, SHORT_RAD))
    over = np.maximum(low - q, q - high) / span
    step, joint = np.unravel_index(int(np.argmax(over)), over.shape)
    name = model.joint(int(limited[joint])).name.split("-", 1)[-1]
    return max(float(over[step, joint]), 0.0), name, float(trajectory.time[step])


def _check(
    trajectory: Trajectory,
    name: str,
    value: float,
    limit: Limit,
    *,
    part: str | None = None,
    joint: str | None = None,
    time: float | None = None,
) -> Check:
    """Compare a value of a run with its limit; the run is the evidence."""
    kind, run = trajectory.scenario.kind, f"run {trajectory.scenario.name}"
    return judged(kind, name, float(value), limit, part=part, joint=joint, time=time, evidence=run)


def _largest(trajectory: Trajectory, name: str, values: NDArray, limit: Limit) -> Check:
    """Compare the largest of values [t] over time with its limit."""
    k = int(np.argmax(values))
    return _check(trajectory, name, values[k], limit, time=trajectory.time[k])

"""The two standard scenarios of Step 3, free fall and force perturbation, judged by numbers."""

from collections.abc import Callable
from typing import Literal

import mujoco
import numpy as np

from ..config import VerifyOptions
from ..physics.exact import object_depths, pair_distance, start_state
from ..spec import Box, Geom, Material, ObjectSpec, Part, SceneObject, SceneSpec, bounds
from ..spec.object import Spec

Outcome = Literal["PASS", "FAIL", "SKIP", "TOOL_FAILURE"]


class Check(Spec):
    """One verdict with its number."""

    scenario: Literal["static", "free_fall", "force_perturbation"]
    name: str
    outcome: Outcome
    value: float | None = None
    threshold: float | None = None
    unit: str = ""
    hint: str = ""


class Verdict(Spec):
    """All verdicts on one object."""

    object: str
    passed: bool
    """No check failed, and none could not be made."""
    mass_kg: float
    checks: tuple[Check, ...]

    def to_json(self) -> str:
        """Serialise, the same bytes for the same verdict."""
        return self.model_dump_json(indent=1) + "\n"


def verify(
    spec: ObjectSpec, options: VerifyOptions | None = None, *, fixed_base: bool = False
) -> Verdict:
    """Try an object by itself on a floor.

    Free fall drops it from a small height and asks that it comes to rest upright where it was put,
    neither sinking in nor gaining energy. Force perturbation pushes it at its centre of mass and
    works every joint with a generalised impulse, and asks that it neither diverges nor sinks in nor
    keeps gaining energy, and that its joints move.

    Args:
        spec: the object.
        options: durations, impulses and thresholds.
        fixed_base: whether its base stays fastened; then only its joints are tried.
    """
    o = options or VerifyOptions()
    checks: list[Check] = []
    scenarios: list[tuple[str, Callable[[], list[Check]]]] = [
        ("static", lambda: [_internal_depth(spec, o)]),
        ("free_fall", lambda: _free_fall(spec, o, fixed_base)),
        ("force_perturbation", lambda: _perturbation(spec, o, fixed_base)),
    ]
    for name, run in scenarios:
        try:
            checks += run()
        except (ValueError, mujoco.FatalError) as error:
            # An error of the tool says nothing about the object, and is not a pass either.
            checks.append(
                Check(scenario=name, name="runs", outcome="TOOL_FAILURE", hint=str(error))  # pyright: ignore[reportArgumentType]
            )
    try:
        mass = float(sum(start_state(_on_floor(spec, 0.0, False))[0].body_mass[2:]))
    except (ValueError, mujoco.FatalError):
        mass = float("nan")
    bad = any(check.outcome in ("FAIL", "TOOL_FAILURE") for check in checks)
    return Verdict(object=spec.name, passed=not bad, mass_kg=mass, checks=tuple(checks))


FLOOR = "floor_of_the_trial"


def _on_floor(spec: ObjectSpec, height: float, fixed_base: bool) -> SceneSpec:
    low, high = bounds(spec)
    size = 20 * float((high - low).max()) + 2.0
    stone = Material(name="stone", density=2500, friction=0.6)
    slab = Geom(name="slab", shape=Box(size=(size, size, 0.2)), pos=(0, 0, -0.1), material="stone")
    floor = ObjectSpec(name=FLOOR, materials=(stone,), parts=(Part(name="slab", geoms=(slab,)),))
    return SceneSpec(
        objects=(
            SceneObject(name=FLOOR, spec=floor, environment=True),
            SceneObject(
                name=spec.name,
                spec=spec,
                parent=FLOOR,
                z=float(height - low[2]),
                fixed_base=fixed_base,
            ),
        )
    )


def _check(
    scenario: str,
    name: str,
    value: float,
    threshold: float,
    unit: str,
    hint: str,
    *,
    least: bool = False,
) -> Check:
    good = np.isfinite(value) and (value >= threshold if least else value <= threshold)
    return Check(
        scenario=scenario,  # pyright: ignore[reportArgumentType]
        name=name,
        outcome="PASS" if good else "FAIL",
        value=float(value) if np.isfinite(value) else None,
        threshold=threshold,
        unit=unit,
        hint="" if good else hint,
    )


def _internal_depth(spec: ObjectSpec, o: VerifyOptions) -> Check:
    """Depth between any two parts at rest, parent and child included."""
    model, data = start_state(_on_floor(spec, 0.1, True))
    own = [b for b in range(model.nbody) if model.body(b).name.split("/")[0] == spec.name]
    welded = {b: _moving_root(model, b) for b in own}
    worst = 0.0
    for i, a in enumerate(own):
        for b in own[i + 1 :]:
            if welded[a] == welded[b]:
                continue
            one, two = (np.flatnonzero(model.geom_bodyid == body) for body in (a, b))
            worst = max(worst, -pair_distance(model, data, one, two, reach=1e-3))
    hint = "shrink or move the colliders of the parts that overlap"
    return _check("static", "part_depth", worst, o.max_depth_m, "m", hint)


def _moving_root(model: mujoco.MjModel, body: int) -> int:
    while model.body_jntnum[body] == 0 and model.body_parentid[body] > 0:
        body = model.body_parentid[body]
    return int(body)


def _free_fall(spec: ObjectSpec, o: VerifyOptions, fixed_base: bool) -> list[Check]:
    if fixed_base:
        return [Check(scenario="free_fall", name="rests", outcome="SKIP", hint="base is fixed")]
    scene = _on_floor(spec, o.drop_height_m, False)
    trace = _simulate(scene, o, spec)
    if trace.diverged:
        return [_diverged("free_fall")]
    side = np.linalg.norm(trace.pos[:, :2] - trace.pos[0, :2], axis=1).max()
    fall = trace.pos[0, 2] - trace.pos[-1, 2]
    return [
        _check("free_fall", "drift", side, o.max_drift_m, "m", "widen or flatten the base"),
        _check(
            "free_fall", "tilt", trace.tilt.max(), o.max_tilt_deg, "deg", "lower the centre of mass"
        ),
        _check(
            "free_fall",
            "fall",
            fall,
            o.drop_height_m + o.max_depth_m,
            "m",
            "it sinks or comes apart",
        ),
        _check(
            "free_fall",
            "resting_depth",
            trace.depth,
            o.max_depth_m,
            "m",
            "check mass and colliders",
        ),
        _check(
            "free_fall",
            "resting_speed",
            trace.speed[-1],
            o.max_rest_speed,
            "m/s",
            "it does not come to rest",
        ),
        _check(
            "free_fall",
            "energy_gain",
            trace.gain,
            o.max_energy_gain,
            "",
            "colliders overlap or joints fight",
        ),
        _check(
            "free_fall",
            "limit_overshoot",
            trace.overshoot,
            o.max_overshoot,
            "",
            "stiffen or widen joint limits",
        ),
    ]


def _perturbation(spec: ObjectSpec, o: VerifyOptions, fixed_base: bool) -> list[Check]:
    checks = []
    if not fixed_base:
        trace = _simulate(_on_floor(spec, 1e-4, False), o, spec, push=True)
        if trace.diverged:
            return [_diverged("force_perturbation")]
        # The push itself puts energy in; after it nothing may.
        checks += [
            _check(
                "force_perturbation",
                "energy_gain",
                trace.gain,
                o.max_energy_gain,
                "",
                "colliders overlap or joints fight",
            ),
            _check(
                "force_perturbation",
                "resting_depth",
                trace.depth,
                o.max_depth_m,
                "m",
                "check mass and colliders",
            ),
            _check(
                "force_perturbation",
                "limit_overshoot",
                trace.overshoot,
                o.max_overshoot,
                "",
                "stiffen or widen joint limits",
            ),
        ]
    scene = _on_floor(spec, 0.05, True)
    for joint in spec.joints:
        if joint.type == "fixed" or joint.mimic is not None:
            continue
        travel, wanted = _work_joint(scene, spec, joint.name, o)
        checks.append(
            _check(
                "force_perturbation",
                f"mobility:{joint.name}",
                travel / wanted,
                o.min_mobility,
                "of its range",
                "it is blocked: check axis, limits, friction and colliders",
                least=True,
            )
        )
    return checks


def _diverged(scenario: str) -> Check:
    hint = "the simulation diverged: check masses, inertias and overlapping parts"
    return Check(scenario=scenario, name="finite", outcome="FAIL", hint=hint)  # pyright: ignore[reportArgumentType]


class _Trace:
    def __init__(self) -> None:
        self.pos, self.tilt, self.speed = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        self.depth, self.gain, self.overshoot = 0.0, 0.0, 0.0
        self.diverged = False


def _simulate(
    scene: SceneSpec, o: VerifyOptions, spec: ObjectSpec, *, push: bool = False
) -> _Trace:
    """Let an object fall, optionally pushed along +x at its centre of mass; record its root."""
    model, data = start_state(scene, o.timestep_s)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    body = model.body(spec.name).id
    mass = float(model.body_subtreemass[body])
    weight = mass * 9.81 * max(float(bounds(spec)[1][2] - bounds(spec)[0][2]), 1e-3)
    trace, energy, poses, tilts, speeds = _Trace(), [], [], [], []
    quat0 = data.xquat[body].copy()
    after = round(o.push_duration_s / o.timestep_s) if push else 0
    for step in range(round(o.duration_s / o.timestep_s)):
        data.xfrc_applied[:] = 0
        if step < after:
            data.xfrc_applied[body, 0] = o.impulse_ns_per_kg * mass / o.push_duration_s
        mujoco.mj_step(model, data)
        poses.append(data.xpos[body].copy())
        chord = min(np.linalg.norm(data.xquat[body] - s * quat0) for s in (1, -1))
        tilts.append(np.degrees(4 * np.arcsin(min(chord / 2, 1.0))))
        speeds.append(float(np.linalg.norm(data.qvel[:3])) if model.nv >= 6 else 0.0)
        energy.append(float(data.energy.sum()))
        trace.overshoot = max(trace.overshoot, _overshoot(model, data))
    trace.pos, trace.tilt, trace.speed = np.array(poses), np.array(tilts), np.array(speeds)
    trace.diverged = not (np.isfinite(data.qpos).all() and np.isfinite(trace.pos).all())
    if trace.diverged:
        return trace
    rest = np.array(energy[after:])
    # Soft contacts give back what they stored, but never more than there was to begin with. Against
    # the weight raised by the object's own height it is a pure number.
    trace.gain = float(np.max(rest - rest[0]) / weight)
    trace.depth = max(object_depths(scene, model, data).values(), default=0.0)
    return trace


def _overshoot(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    limited = np.flatnonzero(model.jnt_limited)
    q = data.qpos[model.jnt_qposadr[limited]]
    low, high = model.jnt_range[limited].T
    return float(np.max(np.maximum(low - q, q - high) / (high - low), initial=0.0))


def _work_joint(
    scene: SceneSpec, spec: ObjectSpec, name: str, o: VerifyOptions
) -> tuple[float, float]:
    """Push a joint both ways from the middle of its range; return what it covers and the range."""
    joint = next(j for j in spec.joints if j.name == name)
    span = 2 * np.pi if joint.type == "continuous" else joint.upper - joint.lower
    middle = 0.0 if joint.type == "continuous" else (joint.lower + joint.upper) / 2
    objects = (
        scene.objects[0],
        scene.objects[1].model_copy(update={"joint_state": {name: middle}}),
    )
    model, data = start_state(scene.model_copy(update={"objects": objects}), o.timestep_s)
    found = model.joint(f"{spec.name}/{name}")
    adr, dof = int(found.qposadr[0]), int(found.dofadr[0])
    model.opt.gravity[:] = 0.0
    low = high = middle
    for sign in (1.0, -1.0):
        mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        # Enough to cross the range in the given time without losses, and dry friction on top.
        force = 2 * full[dof, dof] * span / o.joint_push_s**2 + 2 * model.dof_frictionloss[dof]
        force += model.dof_damping[dof].sum() * span / o.joint_push_s
        for _ in range(round(o.joint_push_s / o.timestep_s)):
            data.qfrc_applied[dof] = sign * force
            mujoco.mj_step(model, data)
            low, high = min(low, float(data.qpos[adr])), max(high, float(data.qpos[adr]))
    return high - low, span


__all__ = ["Check", "Outcome", "Verdict", "verify"]

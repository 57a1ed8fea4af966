"""Simulations of a file by other simulators, each with its own functions and defaults.

A simulation takes the file and options. It returns `roots`, for every root body its initial
position `start` [m] and its displacement, `pos` [m] and `quat` (w, x, y, z); or `q` of a joint.

    {"low": 0.0, "seconds": 2}            an object rests on a plane at this height [m]
    {"scene": true, "seconds": 2}         an unchanged scene
    {"joint": "slide", "link": "drawer", "offset": [0.2, 0, 0], "force": [3, 0, 0], "seconds": 0.5}
                                          the base is fixed, and the force [N] acts at an offset
                                          [m] in the link's frame; `dry` false removes the joints'
                                          dry friction (MuJoCo, SAPIEN)
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from typing import Any

Options = dict[str, Any]
Motion = dict[str, Any]
STEP_S = 0.001
LONG_STEP_S = 0.002
"""Time step for slow simulators."""


def _between(start: Any, end: Any, turned: Any) -> Motion:
    """Return the motion of a body: start and displacement [m], and rotation (w, x, y, z)."""
    return {
        "start": [float(a) for a in start],
        "pos": [float(b) - float(a) for a, b in zip(start, end, strict=True)],
        "quat": [float(v) for v in turned],
    }


def _since(first: Any, last: Any) -> list[float]:
    """Return the rotation from one quaternion (w, x, y, z) to another."""
    a, b, c, d = (float(v) for v in first)
    w, x, y, z = (float(v) for v in last)
    return [
        w * a + x * b + y * c + z * d,
        -w * b + x * a - y * d + z * c,
        -w * c + x * d + y * a - z * b,
        -w * d - x * c + y * b + z * a,
    ]


def _find(names: list[str], own: str) -> int:
    """Return the index of our name among a program's names, which may have prefixes.

    The shortest match counts: `cabinet_door` rather than `cabinet_left_door`.
    """
    last = [name.rpartition("/")[2].rstrip("_") for name in names]
    fits = [k for k, name in enumerate(last)
            if name == own or name.endswith(tuple(f"{mark}{own}" for mark in "-_:"))]  # fmt: skip
    return min(fits, key=lambda k: len(last[k]))


def mujoco(path: str, o: Options) -> Motion:
    import mujoco
    import numpy as np

    spec = mujoco.MjSpec.from_file(path)
    spec.option.timestep = STEP_S
    if path.endswith("urdf"):  # MuJoCo does not look for meshes there by itself.
        for pair in ElementTree.parse(f"{path[:-5]}.srdf").iter("disable_collisions"):
            spec.add_exclude(bodyname1=pair.get("link1"), bodyname2=pair.get("link2"))
    if "scene" not in o:
        for key in list(spec.keys):
            spec.delete(key)
        root = next(b for b in spec.worldbody.bodies)
        if "joint" in o:
            for joint in [j for j in root.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
                spec.delete(joint)
        else:
            if not root.joints:
                root.add_freejoint()
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(type=plane, size=[5, 5, 0.1], pos=[0, 0, o["low"]])
    model = spec.compile()
    data = mujoco.MjData(model)
    if model.nkey and "scene" in o:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    steps = round(o["seconds"] / STEP_S)
    if "joint" in o:
        joint = model.joint(_find([model.joint(k).name for k in range(model.njnt)], o["joint"]))
        body = model.body(_find([model.body(k).name for k in range(model.nbody)], o["link"]))
        if not o.get("dry", True):
            model.dof_frictionloss[:] = 0
        force, offset = np.array(o["force"]), np.array(o["offset"])
        for _ in range(steps):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            point = data.xpos[body.id] + data.xmat[body.id].reshape(3, 3) @ offset
            data.qfrc_applied[:] = 0
            mujoco.mj_applyFT(
                model, data, force, np.zeros(3), point, body.id, data.qfrc_applied
            )  # fmt: skip
            mujoco.mj_step(model, data)
        return {"q": float(data.qpos[joint.qposadr[0]])}
    mujoco.mj_kinematics(model, data)
    start, turned = data.xpos.copy(), data.xquat.copy()
    mujoco.mj_step(model, data, steps)
    mujoco.mj_kinematics(model, data)
    return {"roots": {
        model.body(b).name: _between(start[b], data.xpos[b], _since(turned[b], data.xquat[b]))
        for b in range(1, model.nbody)
        if model.body_parentid[b] == 0
    }}  # fmt: skip


def drake(path: str, o: Options) -> Motion:
    import numpy as np
    from pydrake.geometry import (
        AddContactMaterial,
        AddRigidHydroelasticProperties,
        HalfSpace,
        ProximityProperties,
        SceneGraphConfig,
    )
    from pydrake.math import RigidTransform
    from pydrake.multibody.math import SpatialForce
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import (
        AddMultibodyPlantSceneGraph,
        CoulombFriction,
        ExternallyAppliedSpatialForce,
    )
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlantSceneGraph(builder, STEP_S)
    parser = Parser(plant)
    if path.endswith("xml"):  # MJCF lacks the contact properties of URDF and SDF.
        config = SceneGraphConfig()
        config.default_proximity_properties.compliance_type = "compliant"
        config.default_proximity_properties.hydroelastic_modulus = 1e8
        graph.set_config(config)
    if path.endswith("dmd.yaml"):
        folder = path.rpartition("/")[0]
        parser.package_map().AddPackageXml(f"{folder}/package.xml")
    instances = parser.AddModels(path)
    if "joint" in o:
        root = plant.get_body(plant.GetBodyIndices(instances[0])[0])
        plant.WeldFrames(plant.world_frame(), root.body_frame())
    elif "low" in o:
        at, ground = RigidTransform(p=[0, 0, o["low"]]), ProximityProperties()
        AddRigidHydroelasticProperties(ground)
        AddContactMaterial(friction=CoulombFriction(1.0, 1.0), properties=ground)
        plant.RegisterCollisionGeometry(plant.world_body(), at, HalfSpace(), "ground", ground)
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    inner = plant.GetMyMutableContextFromRoot(context)
    if "joint" in o:
        joints = [plant.get_joint(k) for k in plant.GetJointIndices()]
        joint = joints[_find([one.name() for one in joints], o["joint"])]
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = joint.child_body().index()
        applied.p_BoBq_B = np.array(o["offset"])
        applied.F_Bq_W = SpatialForce(tau=np.zeros(3), f=np.array(o["force"]))
        plant.get_applied_spatial_force_input_port().FixValue(inner, [applied])
        Simulator(diagram, context).AdvanceTo(o["seconds"])
        return {"q": float(plant.GetPositions(inner)[joint.position_start()])}
    bodies = [plant.get_body(k) for k in plant.GetFloatingBaseBodies()]
    own = [plant.GetModelInstanceName(b.model_instance()).rpartition("::")[2] for b in bodies]
    if len(set(own)) < len(own):  # In MJCF all objects are one model.
        own = [body.name() for body in bodies]
    floating = dict(zip(own, bodies, strict=True))
    places = [plant.EvalBodyPoseInWorld(inner, body) for body in floating.values()]
    before = [(p.translation().copy(), p.rotation().ToQuaternion().wxyz()) for p in places]
    Simulator(diagram, context).AdvanceTo(o["seconds"])
    result = {}
    for (name, body), (start, turned) in zip(floating.items(), before, strict=True):
        now = plant.EvalBodyPoseInWorld(inner, body)
        quat = _since(turned, now.rotation().ToQuaternion().wxyz())
        result[name] = _between(start, now.translation(), quat)
    return {"roots": result}


def pybullet(path: str, o: Options) -> Motion:
    import pybullet as bullet

    bullet.connect(bullet.DIRECT)
    try:
        return _bullet_motion(bullet, path, o)
    finally:
        bullet.disconnect()


def _bullet_motion(bullet: Any, path: str, o: Options) -> Motion:
    bullet.setGravity(0, 0, -9.81)
    bullet.setTimeStep(STEP_S)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    body = bullet.loadURDF(path, useFixedBase="joint" in o, flags=flags)
    info = [bullet.getJointInfo(body, k) for k in range(bullet.getNumJoints(body))]
    for joint in info:
        # Joints have motors by default; the motor's force acts as dry friction.
        bullet.setJointMotorControl2(body, joint[0], bullet.VELOCITY_CONTROL, force=joint[7])
    steps = round(o["seconds"] / STEP_S)
    if "joint" in o:
        k = next(joint[0] for joint in info if joint[1].decode() == o["joint"])
        for _ in range(steps):
            state = bullet.getLinkState(body, k, computeForwardKinematics=True)
            point, _ = bullet.multiplyTransforms(state[4], state[5], o["offset"], [0, 0, 0, 1])
            # Forces last for one step.
            bullet.applyExternalForce(body, k, o["force"], point, bullet.WORLD_FRAME)
            bullet.stepSimulation()
        return {"q": float(bullet.getJointState(body, k)[0])}
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
    ground = bullet.createMultiBody(0, plane, basePosition=[0, 0, o["low"]])
    bullet.changeDynamics(ground, -1, lateralFriction=1.0)

    # The base's pose is that of its center of mass and principal axes.
    inertia = bullet.getDynamicsInfo(body, -1)
    inner = bullet.invertTransform(inertia[3], inertia[4])

    def place() -> tuple[Any, list[float]]:
        pos, quat = bullet.getBasePositionAndOrientation(body)
        at, (x, y, z, w) = bullet.multiplyTransforms(pos, quat, *inner)
        return at, [w, x, y, z]

    start, turned = place()
    for _ in range(steps):
        bullet.stepSimulation()
    end, quat = place()
    return {"roots": {"object": _between(start, end, _since(turned, quat))}}


def sapien(path: str, o: Options) -> Motion:
    import numpy as np
    import sapien
    from reader_probe import sapien_object

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    scene.set_timestep(STEP_S)
    body = sapien_object(scene, path, fixed="joint" in o)
    steps = round(o["seconds"] / STEP_S)
    if "joint" in o:
        body.qpos = body.qpos * 0
        if not o.get("dry", True):
            for joint in body.active_joints:
                joint.set_friction(0.0)
        link = next(k for k in body.links if k.name == o["link"])
        at = [j.name for j in body.active_joints].index(o["joint"])
        offset = sapien.Pose(o["offset"])
        for _ in range(steps):
            point = (link.entity_pose * offset).p
            link.add_force_at_point(np.array(o["force"], np.float32), point)
            scene.step()
        return {"q": float(body.qpos[at])}
    scene.add_ground(o["low"], render=False)
    before = body.pose
    start, turned = np.array(before.p), np.array(before.q)
    for _ in range(steps):
        scene.step()
    return {"roots": {"object": _between(start, body.pose.p, _since(turned, body.pose.q))}}


def newton(path: str, o: Options) -> Motion:
    import newton
    import numpy as np
    import warp as wp

    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    suffix = path.rpartition(".")[2]
    # MJCF lacks newton.usda's contact settings: a 2 mm margin and several points per pair.
    several = True if suffix == "xml" else None
    if suffix == "xml":
        builder.rigid_gap = 0.002
    add: Callable[..., Any] = {"xml": builder.add_mjcf, "urdf": builder.add_urdf}.get(
        suffix, builder.add_usd
    )
    if "joint" in o:
        add(path, floating=False)
    elif "low" in o:
        add(path, floating=True)
        builder.add_ground_plane(height=o["low"])
    else:
        add(path)
    model = builder.finalize()
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, enable_multiccd=several)
    states, control = [model.state(), model.state()], model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, states[0])
    before = states[0].body_q.numpy().copy()
    names = [str(name).rpartition("/")[2] for name in model.body_label]
    pulled = _find(names, o["link"]) if "link" in o else -1
    for _ in range(round(o["seconds"] / LONG_STEP_S)):
        states[0].clear_forces()
        if pulled >= 0:
            at = wp.transform(*states[0].body_q.numpy()[pulled].tolist())
            point = wp.transform_point(at, wp.vec3(*o["offset"]))
            mass = wp.transform_point(at, wp.vec3(*model.body_com.numpy()[pulled].tolist()))
            force = np.array(o["force"])
            forces = np.zeros((model.body_count, 6), np.float32)
            forces[pulled] = [*force, *np.cross(np.array(point) - np.array(mass), force)]
            states[0].body_f.assign(forces)
        solver.step(states[0], states[1], control, None, LONG_STEP_S)
        states.reverse()
    if "joint" in o:
        k = _find([str(name) for name in model.joint_label], o["joint"])
        newton.eval_ik(model, states[0], model.joint_q, model.joint_qd)
        return {"q": float(model.joint_q.numpy()[model.joint_q_start.numpy()[k]])}
    after = states[0].body_q.numpy()
    parents, children = model.joint_parent.numpy(), model.joint_child.numpy()
    types = model.joint_type.numpy()
    roots = {}
    for parent, child, kind in zip(parents, children, types, strict=True):
        if parent < 0 and kind == int(newton.JointType.FREE):
            (*start, x, y, z, w), (*end, a, b, c, d) = before[child], after[child]
            label = str(model.body_label[child]).split("/")
            own = label[2] if label[0] == "" and len(label) > 3 else label[-1]
            roots[own] = _between(start, end, _since([w, x, y, z], [d, a, b, c]))
    return {"roots": roots}


def genesis(path: str, o: Options) -> Motion:
    import genesis as gs
    from reader_probe import genesis_morph

    if not gs._initialized:
        gs.init(backend=gs.cpu, logging_level="error")
    # Genesis ignores the MJCF's options, so its contacts are set here.
    contacts = gs.options.RigidOptions(
        friction_cone=gs.friction_cone.elliptic, impratio=10.0, constraint_timeconst=0.02
    )
    step = gs.options.SimOptions(dt=LONG_STEP_S)
    scene = gs.Scene(show_viewer=False, sim_options=step, rigid_options=contacts)
    if "low" in o:
        scene.add_entity(gs.morphs.Plane(pos=(0, 0, o["low"])))
    body = scene.add_entity(genesis_morph(gs, path, fixed="joint" in o))
    scene.build()
    steps = round(o["seconds"] / LONG_STEP_S)
    if "joint" in o:
        link = body.links[_find([one.name for one in body.links], o["link"])]
        joint = body.joints[_find([one.name for one in body.joints], o["joint"])]
        for _ in range(steps):
            link.apply_external_force(_turned(link, o["force"]), pos=o["offset"], local=True)
            scene.step()
        return {"q": float(body.get_dofs_position()[joint.dof_idx_local])}
    roots = [k for k in body.links if any(j.type.name == "FREE" for j in k.joints)]
    before = [(k.get_pos().tolist(), k.get_quat().tolist()) for k in roots]
    for _ in range(steps):
        scene.step()
    return {"roots": {
        k.name: _between(pos, k.get_pos().tolist(), _since(quat, k.get_quat().tolist()))
        for k, (pos, quat) in zip(roots, before, strict=True)
    }}  # fmt: skip


def _turned(link: Any, force: list[float]) -> list[float]:
    """Rotate a force from world to link axes."""
    import numpy as np

    w, *axis = (float(v) for v in link.get_quat().tolist())
    u, f = -np.array(axis), np.array(force)
    return (f + 2 * np.cross(u, np.cross(u, f) + w * f)).tolist()


def degrees(quat: list[float]) -> float:
    """Return the angle of a rotation (w, x, y, z)."""
    return 2 * math.degrees(math.atan2(math.hypot(*quat[1:]), abs(quat[0])))


MOVERS: dict[str, Callable[[str, Options], Motion]] = {
    "mujoco": mujoco, "drake": drake, "pybullet": pybullet, "sapien": sapien,
    "newton": newton, "genesis": genesis,
}  # fmt: skip
"""Simulation function of each program."""

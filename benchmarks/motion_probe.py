"""Let one foreign program simulate an object from a file, and print how it moved, as JSON.

Run in the environment that has the program; it needs nothing of this package:

    python benchmarks/motion_probe.py drake object.sdf '{"low": 0.0, "seconds": 2.0}'

`low` is the height [m] of the object's lowest point. With `joint` and `force` the base is fixed,
and the force [N or N m] acts on the joint for `seconds`; `dry` false takes its dry friction away
(MuJoCo). Without them the object rests on a plane for so long.
"""

import json
import math
import sys
from typing import Any

Motion = dict[str, Any]
"""pos [m] and quat (w, x, y, z) of the root at the end, beside its start; or q of the joint."""


def _turned(quat: list[float]) -> float:
    return 2 * math.degrees(math.acos(min(1.0, abs(quat[0]))))


def _moved(pos: list[float], quat: list[float]) -> Motion:
    return {"mm": 1e3 * math.dist(pos, (0, 0, 0)), "degrees": _turned(quat)}


def mujoco(path: str, o: dict[str, Any]) -> Motion:
    import mujoco

    spec = mujoco.MjSpec.from_file(path)
    spec.option.timestep = 0.001
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
    body = model.body(root.name)
    steps = round(o["seconds"] / 0.001)
    if "joint" in o:
        names = [model.joint(k).name for k in range(model.njnt)]
        joint = model.joint(next(n for n in names if n.rpartition("-")[2] == o["joint"]))
        data.qfrc_applied[joint.dofadr[0]] = o["force"]
        if not o.get("dry", True):
            model.dof_frictionloss[:] = 0
        mujoco.mj_step(model, data, steps)
        return {"q": float(data.qpos[joint.qposadr[0]])}
    mujoco.mj_kinematics(model, data)
    start = data.xpos[body.id].copy()
    mujoco.mj_step(model, data, steps)
    mujoco.mj_kinematics(model, data)
    return _moved((data.xpos[body.id] - start).tolist(), data.xquat[body.id].tolist())


def drake(path: str, o: dict[str, Any]) -> Motion:
    import numpy as np
    from pydrake.geometry import HalfSpace
    from pydrake.math import RigidTransform
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    (instance,) = Parser(plant).AddModels(path)
    root = plant.get_body(plant.GetBodyIndices(instance)[0])
    if "joint" in o:
        plant.WeldFrames(plant.world_frame(), root.body_frame())
    else:
        at = RigidTransform(p=[0, 0, o["low"]])
        plant.RegisterCollisionGeometry(
            plant.world_body(), at, HalfSpace(), "ground", CoulombFriction(1.0, 1.0)
        )
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    inner = plant.GetMyMutableContextFromRoot(context)
    joint = plant.GetJointByName(o["joint"]) if "joint" in o else None
    if joint is not None:
        tau = np.zeros(plant.num_velocities())
        tau[joint.velocity_start()] = o["force"]
        plant.get_applied_generalized_force_input_port().FixValue(inner, tau)
    Simulator(diagram, context).AdvanceTo(o["seconds"])
    if joint is not None:
        return {"q": float(plant.GetPositions(inner)[joint.position_start()])}
    pose = plant.EvalBodyPoseInWorld(inner, root)
    return _moved(pose.translation().tolist(), pose.rotation().ToQuaternion().wxyz().tolist())


def pybullet(path: str, o: dict[str, Any]) -> Motion:
    import pybullet as bullet

    bullet.connect(bullet.DIRECT)
    bullet.setGravity(0, 0, -9.81)
    bullet.setTimeStep(0.001)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    body = bullet.loadURDF(path, useFixedBase="joint" in o, flags=flags)
    joints = {bullet.getJointInfo(body, k)[1].decode(): k
              for k in range(bullet.getNumJoints(body))}  # fmt: skip
    for k in joints.values():
        # Its joints hold themselves unless told not to; dry friction is such a motor's force.
        dry = bullet.getJointInfo(body, k)[7]
        bullet.setJointMotorControl2(body, k, bullet.VELOCITY_CONTROL, force=dry)
    if "joint" not in o:
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
        ground = bullet.createMultiBody(0, plane, basePosition=[0, 0, o["low"]])
        bullet.changeDynamics(ground, -1, lateralFriction=1.0)
    start, turned = bullet.getBasePositionAndOrientation(body)
    for _ in range(round(o["seconds"] / 0.001)):
        if "joint" in o:
            k = joints[o["joint"]]
            # Forces of torque control are for one step.
            bullet.setJointMotorControl2(body, k, bullet.TORQUE_CONTROL, force=o["force"])
        bullet.stepSimulation()
    if "joint" in o:
        return {"q": float(bullet.getJointState(body, joints[o["joint"]])[0])}
    end, quat = bullet.getBasePositionAndOrientation(body)
    # Its frame is that of the base's principal axes.
    x, y, z, w = bullet.getDifferenceQuaternion(turned, quat)
    return _moved([b - a for a, b in zip(start, end, strict=True)], [w, x, y, z])


MOVERS = {
    "mujoco": (mujoco, "mujoco", ("xml", "urdf")),
    "drake": (drake, "pydrake", ("sdf", "urdf")),
    "pybullet": (pybullet, "pybullet", ("urdf",)),
}
"""Programs that simulate: how, the module that it needs, and suffixes of what it takes."""


if __name__ == "__main__":
    # A script's folder comes first on the path, where modules of ours would hide packages.
    sys.path.pop(0)
    try:
        result = MOVERS[sys.argv[1]][0](sys.argv[2], json.loads(sys.argv[3]))
    except Exception as error:  # a foreign program's border
        result = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]}
    print(f"\n{json.dumps(result)}")

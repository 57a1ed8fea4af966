"""Load the scene of a run folder in each installed simulator, and print what moves in 2 s.

    python examples/load_in_simulators.py out

Each `run_` function is short code that loads the scene in one simulator, with the settings of
docs/how-to/use-in-simulators.md; copy the one that you need. It returns the number of bodies, and
after 2 s of free fall the pose of each object (position [m], quaternion w x y z) and the position
of each joint [m or rad]. Only NumPy and MuJoCo are required.
"""

import json
import re
import shutil
import sys
import tempfile
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

SECONDS = 2.0


def urdf_objects(out, scene):
    """Yield the name, file, pose and mobility of each object; URDF has no poses of objects."""
    for item in scene["objects"]:
        name, pose = item["name"], scene["world_poses"][item["name"]]
        fixed = item["environment"] or item["fixed_base"] or item.get("held", False)
        yield name, out / "objects" / name / "object.urdf", pose["pos"], pose["quat"], fixed


def run_mujoco(out, scene, model=None):
    """Read MJCF; the keyframe has the positions of joints."""
    import mujoco

    model = model or mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
    poses = {name: (data.body(name).xpos, data.body(name).xquat) for name in scene["world_poses"]}
    return model.nbody - 1, poses, {k: data.joint("-".join(k)).qpos[0] for k in scene["joints"]}


def run_dm_control(out, scene):
    """Compile the scene with PyMJCF."""
    from dm_control import mjcf

    physics = mjcf.Physics.from_mjcf_model(mjcf.from_path(str(out / "scene.xml")))
    return run_mujoco(out, scene, physics.model.ptr)


def run_drake(out, scene, file="scene.xml"):
    """Read MJCF or SDF; all colliders are compliant, since one contact point for a pair slips."""
    import pydrake.all as drake

    builder = drake.DiagramBuilder()
    plant, graph = drake.AddMultibodyPlantSceneGraph(builder, 0.001)
    config = drake.SceneGraphConfig()
    config.default_proximity_properties.compliance_type = "compliant"
    config.default_proximity_properties.hydroelastic_modulus = 1e8
    config.default_proximity_properties.resolution_hint = 0.005  # Round shapes roll if coarser.
    graph.set_config(config)
    drake.Parser(plant).AddModels(str(out / file))
    plant.Finalize()
    simulator = drake.Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    names = {k: "-".join(k) if file == "scene.xml" else k[1] for k in scene["joints"]}
    joints = {k: plant.GetJointByName(name) for k, name in names.items()}
    q = plant.GetPositions(context)
    for k, joint in joints.items():
        q[joint.position_start()] = scene["joints"][k]
    plant.SetPositions(context, q)
    simulator.AdvanceTo(SECONDS)
    bodies = {name: plant.GetBodyByName(name) for name in scene["world_poses"]}
    poses = {name: body.EvalPoseInWorld(context) for name, body in bodies.items()}
    poses = {n: (x.translation(), x.rotation().ToQuaternion().wxyz()) for n, x in poses.items()}
    return plant.num_bodies() - 1, poses, {k: j.GetOnePosition(context) for k, j in joints.items()}


def run_pybullet(out, scene):
    """Read URDF; a base is placed by its center of mass."""
    import pybullet as p

    p.connect(p.DIRECT)
    p.setGravity(*scene["gravity"])
    roots, joints = {}, {}
    for name, file, pos, (w, x, y, z), fixed in urdf_objects(out, scene):
        body = p.loadURDF(str(file), useFixedBase=fixed, flags=p.URDF_USE_INERTIA_FROM_FILE)
        inertial = p.getDynamicsInfo(body, -1)[3:5]
        com = p.multiplyTransforms(pos, (x, y, z, w), *inertial)
        p.resetBasePositionAndOrientation(body, *com)
        roots[name] = body, p.invertTransform(*inertial)
        for j in range(p.getNumJoints(body)):
            k = name, p.getJointInfo(body, j)[1].decode()
            if k in scene["joints"]:  # Other joints are fixed: handles and sites.
                p.resetJointState(body, j, scene["joints"][k])
                joints[k] = body, j
    for _ in range(round(240 * SECONDS)):
        p.stepSimulation()
    poses = {}
    for name, (body, offset) in roots.items():
        pos, (x, y, z, w) = p.multiplyTransforms(*p.getBasePositionAndOrientation(body), *offset)
        poses[name] = pos, (w, x, y, z)
    positions = {k: p.getJointState(*at)[0] for k, at in joints.items()}
    return len(roots) + len(joints), poses, positions


def run_sapien(out, scene):
    """Read URDF without visuals, which need a Vulkan device."""
    import sapien

    sapien.physx.set_shape_config(contact_offset=0.002, rest_offset=0.0)
    sapien.physx.set_body_config(solver_position_iterations=64, solver_velocity_iterations=4)
    world = sapien.Scene([sapien.physx.PhysxCpuSystem()])  # With a Vulkan device: sapien.Scene().
    world.set_timestep(1 / 240)
    roots, joints = {}, {}
    for name, file, pos, quat, fixed in urdf_objects(out, scene):
        loader = world.create_urdf_loader()
        loader.fix_root_link = fixed
        with tempfile.TemporaryDirectory() as folder:
            shutil.copytree(file.parent, folder, dirs_exist_ok=True)
            bare = Path(folder, file.name)
            bare.write_text(re.sub(r"(?s)<visual.*?</visual>", "", file.read_text()))
            articulations, actors = loader.load_multiple(str(bare))[:2]
        (roots[name],) = [*articulations, *actors]
        roots[name].set_pose(sapien.Pose(p=pos, q=quat))
        for articulation in articulations:
            names = [(name, joint.name) for joint in articulation.active_joints]
            articulation.set_qpos([scene["joints"][k] for k in names])
            joints |= {k: (articulation, i) for i, k in enumerate(names)}
            for joint in articulation.active_joints:
                joint.set_friction(0)  # PhysX would take URDF's force for a coefficient.
        for actor in actors if fixed else ():
            actor.find_component_by_type(sapien.physx.PhysxRigidDynamicComponent).kinematic = True
    for _ in range(round(240 * SECONDS)):
        world.step()
    poses = {name: (root.pose.p, root.pose.q) for name, root in roots.items()}
    positions = {k: articulation.qpos[i] for k, (articulation, i) in joints.items()}
    return len(roots) + len(joints), poses, positions


def run_newton(out, scene):
    """Read USD, which has the positions of joints, and step with C MuJoCo."""
    import newton

    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_usd(str(out / "scene.usda"))
    model = builder.finalize()
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    state, following, control = model.state(), model.state(), model.control()
    for _ in range(round(500 * SECONDS)):
        solver.step(state, following, control, None, 0.002)
        state, following = following, state
    poses, q = {}, state.body_q.numpy()
    for i, label in enumerate(model.body_label):  # /scene/cup/links/body; the root link first.
        poses.setdefault(label.split("/")[2], (q[i, :3], q[i, [6, 3, 4, 5]]))
    joints = dict(zip(model.joint_label, model.joint_q_start.numpy(), strict=False))
    starts = {k: joints[f"/{scene['name']}/{k[0]}/joints/{k[1]}"] for k in scene["joints"]}
    return len(q), poses, {k: state.joint_q.numpy()[start] for k, start in starts.items()}


def run_genesis(out, scene):
    """Read MJCF, whose options and armatures are set again."""
    import genesis as gs

    gs.init(backend=gs.cpu, logging_level="error")
    cone, steps = gs.friction_cone.elliptic, gs.options.SimOptions(dt=0.002)
    rigid = gs.options.RigidOptions(friction_cone=cone, impratio=10.0, constraint_timeconst=0.01)
    world = gs.Scene(sim_options=steps, rigid_options=rigid)
    file = str(out / "scene.xml")
    entity = world.add_entity(gs.morphs.MJCF(file=file, default_armature=0.0))
    world.build()
    dofs = {k: entity.get_joint("-".join(k)).dofs_idx_local for k in scene["joints"]}
    for k, dof in dofs.items():
        entity.set_dofs_position([scene["joints"][k]], dof)
    for _ in range(round(500 * SECONDS)):
        world.step()
    links = {name: entity.get_link(name) for name in scene["world_poses"]}
    poses = {name: (x.get_pos().numpy(), x.get_quat().numpy()) for name, x in links.items()}
    positions = {k: entity.get_dofs_position(dof).item() for k, dof in dofs.items()}
    return len(entity.links) - 1, poses, positions


SIMULATORS = {
    "MuJoCo": ("mujoco", run_mujoco),
    "dm_control": ("dm-control", run_dm_control),
    "Drake, MJCF": ("drake", run_drake),
    "Drake, SDF": ("drake", partial(run_drake, file="scene.sdf")),
    "PyBullet": ("pybullet", run_pybullet),
    "SAPIEN": ("sapien", run_sapien),
    "Newton": ("newton", run_newton),
    "Genesis": ("genesis-world", run_genesis),
}
"""The distribution of each simulator on PyPI, and its function."""


def motion(scene, poses, joints):
    """Return how far objects [mm], their axes [deg] and joints [mm or mrad] are from the scene."""
    moved, turned = [], []
    for name, _, pos, quat, fixed in urdf_objects(Path(), scene):
        if name in poses or not fixed:  # Newton merges fixed objects with the world.
            moved.append(1e3 * np.linalg.norm(np.subtract(poses[name][0], pos)))
            turned.append(np.degrees(2 * np.arccos(min(1.0, abs(np.dot(poses[name][1], quat))))))
    shifted = [1e3 * abs(joints[k] - start) for k, start in scene["joints"].items()]
    values = np.array([max(moved), max(turned), max(shifted, default=0.0)])
    if not np.all(np.isfinite([*moved, *turned, *shifted])):
        raise FloatingPointError("a pose is not finite")
    return values


def row(label, out):
    """Return a line of the table; a failure is stated with its reason."""
    distribution, run = SIMULATORS[label]
    try:
        start = f"| {label} | {version(distribution)} |"
    except PackageNotFoundError:
        return f"| {label} | not installed |"
    try:
        scene = json.loads((out / "scene.json").read_text())
        states = {item["name"]: item["joint_state"] for item in scene["objects"]}
        scene["joints"] = {(name, k): q for name in states for k, q in states[name].items()}
        bodies, poses, joints = run(out, scene)
        values = " | ".join(f"{value:.1f}" for value in motion(scene, poses, joints))
    except Exception as error:
        return f"{start} failed: {type(error).__name__}: {' '.join(str(error).split())[:200]} |"
    return f"{start} {bodies} | {len(joints)} | {values} |"


if __name__ == "__main__":
    print("| simulator | version | bodies | joints | moved, mm | turned, deg | joint, mm or mrad |")
    print("|---|---|---|---|---|---|---|")
    for label in SIMULATORS:
        print(row(label, Path(sys.argv[1])), flush=True)

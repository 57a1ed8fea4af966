import math

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation
from scipy.spatial.distance import cdist

from neoworld_mjx.export import (
    mjcf_text,
    object_files,
    scene_files,
)
from neoworld_mjx.export.link_frames import link_names
from neoworld_mjx.physics.mjcf import START, body_name, to_mjspec
from neoworld_mjx.spec import (
    Box,
    GeomSpec,
    Material,
    ObjectSpec,
    PartSpec,
    inertial,
    joint_value,
    link_poses,
    world_poses,
)
from neoworld_mjx.spec.pose import Pose, angle_between, from_matrix, matrix, pose


def world_links_usd(path) -> dict[str, Pose]:
    """Return the world pose of every link of a USD stage by its path."""
    stage = Usd.Stage.Open(str(path))
    cache = UsdGeom.XformCache()
    result = {}
    for prim in stage.Traverse():
        if prim.GetParent().GetName() == "links" and prim.IsA(UsdGeom.Xform):
            # USD multiplies row vectors, so its matrices are the transposes of ours.
            m = np.array(cache.GetLocalToWorldTransform(prim)).T
            result[str(prim.GetPath())] = Pose(m[:3, 3], from_matrix(m[:3, :3]))
    return result


def mesh_corners(model, g):
    """Return the corners of a mesh geom in its body's frame."""
    m = model.geom_dataid[g]
    v = model.mesh_vertadr[m]
    turn = matrix(model.geom_quat[g])
    return model.mesh_vert[v : v + model.mesh_vertnum[m]] @ turn.T + model.geom_pos[g]


def test_usd_states_masses_joints_and_limits(folder, cabinet):
    stage = Usd.Stage.Open(str(folder / "alone" / "object.usda"))
    for part in cabinet.parts:
        link, want = stage.GetPrimAtPath(f"/cabinet/links/{part.name}"), inertial(cabinet, part)
        mass = UsdPhysics.MassAPI(link)
        assert mass.GetMassAttr().Get() == pytest.approx(want.mass, rel=1e-6)
        assert np.allclose(mass.GetDiagonalInertiaAttr().Get(), want.diagonal, rtol=1e-5)
    for joint in cabinet.joints:
        prim = stage.GetPrimAtPath(f"/cabinet/joints/{joint.name}")
        ends = [UsdPhysics.Joint(prim).GetBody0Rel(), UsdPhysics.Joint(prim).GetBody1Rel()]
        assert [end.GetTargets()[0].name for end in ends] == [joint.parent, joint.child]
        if joint.type in ("revolute", "prismatic"):
            unit = math.degrees(1.0) if joint.type == "revolute" else 1.0
            low, high = (prim.GetAttribute(f"physics:{k}Limit").Get() for k in ("lower", "upper"))
            assert (low, high) == pytest.approx((joint.lower * unit, joint.upper * unit), rel=1e-6)


def test_forward_kinematics_agree_between_formats(folder, cabinet):
    """MuJoCo on MJCF and on URDF, and yourdfpy, each by its own forward kinematics."""
    import yourdfpy

    robot = yourdfpy.URDF.load(str(folder / "alone" / "object.urdf"), load_meshes=False)
    mjcf = mujoco.MjModel.from_xml_path(str(folder / "alone" / "object.xml"))
    urdf = mujoco.MjModel.from_xml_path(str(folder / "alone" / "object.urdf"))
    origins = {joint.child: np.array(joint.pos) for joint in cabinet.joints}
    rng = np.random.default_rng(2)
    for _ in range(10):
        state = {j.name: rng.uniform(-1, 1) for j in cabinet.joints if j.mimic is None}
        values = {
            j.name: joint_value(cabinet, j, state) for j in cabinet.joints if j.type != "fixed"
        }
        moved = link_poses(cabinet, state)
        robot.update_cfg({name: values[name] for name in robot.actuated_joint_names})
        datas = []
        for model, prefix in ((mjcf, "cabinet-"), (urdf, "")):
            data = mujoco.MjData(model)
            for name, value in values.items():
                data.qpos[model.joint(prefix + name).qposadr[0]] = value
            mujoco.mj_kinematics(model, data)
            datas.append(data)
        for part in cabinet.parts:
            want = moved[part.name].then(pose(origins.get(part.name, np.zeros(3))))
            body = mjcf.body(body_name(cabinet, part.name)).id
            assert np.allclose(datas[0].xpos[body], want.pos, atol=1e-9)
            assert angle_between(datas[0].xquat[body], want.quat) < 1e-7
            if part.name != cabinet.root:  # MuJoCo makes a URDF's root link the world
                body = urdf.body(part.name).id
                assert np.allclose(datas[1].xpos[body], want.pos, atol=1e-7)
                assert angle_between(datas[1].xquat[body], want.quat) < 1e-6
            chain = {j.child: j for j in cabinet.joints}
            at, follows_a_mimic_of_a_mimic = part.name, False
            while at in chain:
                follows_a_mimic_of_a_mimic |= chain[at].name == "gear"
                at = chain[at].parent
            if not follows_a_mimic_of_a_mimic:  # which yourdfpy does not resolve
                frame = robot.get_transform(link_names(cabinet)[part.name], "cabinet")
                assert np.allclose(frame[:3, 3], want.pos, atol=1e-7), part.name
                assert np.allclose(frame[:3, :3], matrix(want.quat), atol=1e-7)


def test_scene_xml_compiles_to_the_same_model(folder, scene):
    read = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    built = to_mjspec(scene, visual=True).compile()
    for field in [
        "body_pos",
        "body_quat",
        "body_mass",
        "body_ipos",
        "body_iquat",
        "body_inertia",
        "geom_pos",
        "geom_quat",
        "geom_size",
        "geom_friction",
        "jnt_pos",
        "jnt_axis",
        "jnt_range",
        "dof_damping",
        "dof_armature",
        "dof_frictionloss",
        "jnt_stiffness",
        "eq_data",
        "exclude_signature",
        "key_qpos",
        "site_pos",
        "cam_pos",
        "cam_fovy",
    ]:
        one, other = getattr(read, field), getattr(built, field)
        if field.startswith("geom_"):
            # What has a texture is shown as a mesh.
            plain = read.geom_type != mujoco.mjtGeom.mjGEOM_MESH
            one, other = one[plain], other[plain]
        if field == "site_pos":
            named = [built.site(k).name for k in range(built.nsite)]
            one = one[[read.site(name).id for name in named]]
        assert np.array_equal(one, other), field
    # A mesh's own frame is any of several where it is round, so its corners are compared.
    for g in np.flatnonzero(built.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        near = cdist(mesh_corners(read, g), mesh_corners(built, g))
        assert max(near.min(axis=0).max(), near.min(axis=1).max()) < 1e-7, built.geom(g).name
    assert set(np.unique(read.geom_group)) == {1, 3}


def test_inertias_of_thin_plates_stay_valid_in_mjcf():
    """Six digits, as MuJoCo writes them, can break A + B >= C of a plate's inertia."""
    broken = 0
    for k in range(20):
        sheet = GeomSpec(
            name="sheet", shape=Box(size=(0.3 + 0.01 * k, 0.41, 1e-5)), material="paper"
        )
        plate = ObjectSpec(
            name="plate",
            materials=(Material(name="paper", density=800),),
            parts=(PartSpec(name="body", geoms=(sheet,)),),
        )
        mujoco.MjModel.from_xml_string(mjcf_text(plate))
        rounded = to_mjspec(plate)
        rounded.compile()
        try:
            mujoco.MjModel.from_xml_string(rounded.to_xml())
        except ValueError:
            broken += 1
    assert broken > 0


@pytest.mark.parametrize("name", ["physics", "box", "bowl", "fastened"])
def test_links_have_their_world_poses_in_mjcf_and_usd_scenes(name, folder, scene):
    obj = scene.object(name)
    at, moved = world_poses(scene)[name], link_poses(obj.spec, obj.joint_state)
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    mujoco.mj_kinematics(model, data)
    usd = world_links_usd(folder / "scene.usda")
    origins = {joint.child: joint.pos for joint in obj.spec.joints}
    for part in obj.spec.parts:
        want = at.then(moved[part.name]).then(pose(origins.get(part.name, (0, 0, 0))))
        body = model.body(body_name(obj, part.name)).id
        link = usd[f"/scene/{name}/links/{part.name}"]
        for pos, quat in ((data.xpos[body], data.xquat[body]), link):
            assert np.allclose(pos, want.pos, atol=1e-9)
            assert angle_between(quat, want.quat) < 1e-7


def test_usd_joint_frames_match_the_posed_scene(folder, scene):
    """The two frames of a joint differ by exactly its motion at the scene's joint state."""
    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    links = world_links_usd(folder / "scene.usda")
    checked = 0
    for prim in stage.Traverse():
        joint = UsdPhysics.Joint(prim)
        if not joint or "fixtures" in str(prim.GetPath()):
            continue
        owner = scene.object(str(prim.GetPath()).split("/")[2])
        spec = next(j for j in owner.spec.joints if j.name == prim.GetName())
        ends = []
        for body, at, turn in (
            (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
            (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
        ):
            q = turn.Get()
            local = pose(list(at.Get()), [q.GetReal(), *q.GetImaginary()])
            ends.append(links[str(body.GetTargets()[0])].then(local))
        between = ends[0].inverse().then(ends[1])
        value = joint_value(owner.spec, spec, owner.joint_state)
        along = np.zeros(3)
        if spec.type != "fixed":
            token = (
                (
                    UsdPhysics.PrismaticJoint(prim)
                    if spec.type == "prismatic"
                    else UsdPhysics.RevoluteJoint(prim)
                )
                .GetAxisAttr()
                .Get()
            )
            along["XYZ".index(token)] = 1.0
        if spec.type == "prismatic":
            assert np.allclose(between.pos, along * value, atol=1e-6)
            assert angle_between(between.quat, (1, 0, 0, 0)) < 1e-6
        else:
            turn = (
                (1, 0, 0, 0)
                if spec.type == "fixed"
                else (math.cos(value / 2), *(math.sin(value / 2) * along))
            )
            assert np.allclose(between.pos, 0, atol=1e-6)
            assert angle_between(between.quat, np.array(turn)) < 1e-6
        checked += 1
    assert checked == 12


def test_usd_has_no_static_rigid_bodies_and_fixes_bases(folder):
    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    rigid = {str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)}
    assert "/scene/physics/links/body" not in rigid
    assert stage.GetPrimAtPath("/scene/physics/links/body/collisions/body_0").HasAPI(
        UsdPhysics.CollisionAPI
    )
    assert "/scene/bowl/links/body" in rigid
    hold = UsdPhysics.FixedJoint(stage.GetPrimAtPath("/scene/fixtures/fastened"))
    assert not hold.GetBody0Rel().GetTargets()
    assert [str(t) for t in hold.GetBody1Rel().GetTargets()] == ["/scene/fastened/links/carcass"]
    gravity = UsdPhysics.Scene(stage.GetPrimAtPath("/scene/physics_"))
    assert gravity.GetGravityMagnitudeAttr().Get() == pytest.approx(9.81)


@pytest.mark.parametrize("file", ["alone/object.usda", "scene.usda", "objects/bowl/object.usda"])
def test_usd_passes_its_validators(file, folder):
    stage = Usd.Stage.Open(str(folder / file))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    context = UsdValidation.ValidationContext(validators)
    errors = [e.GetErrorAsString() for e in context.Validate(stage)]
    assert errors == []
    assert len(validators) > 20


def test_usd_physics_parses_every_joint_and_shape(folder, cabinet):
    stage = Usd.Stage.Open(str(folder / "alone" / "object.usda"))
    parsed = UsdPhysics.UsdPhysicsLoadStageFromPrimRange(stage, ["/"])
    kinds = {kind: descriptions for kind, (_, descriptions) in parsed.items()}
    count = {str(kind).split(".")[-1]: len(d) for kind, d in kinds.items()}
    assert count["RevoluteJoint"] == 4 and count["PrismaticJoint"] == 1 and count["FixedJoint"] == 1
    assert count["RigidBody"] == len(cabinet.parts) and count["Articulation"] == 1
    shapes = sum(n for kind, n in count.items() if kind.endswith("Shape"))
    pieces = sum(
        len(g.shape.pieces()) for p in cabinet.parts for g in p.geoms if g.role != "visual"
    )
    assert shapes == pieces
    for descriptions in kinds.values():
        assert all(d.isValid for d in descriptions)


def test_the_same_scene_gives_the_same_bytes(folder, scene, cabinet):
    again = scene_files(type(scene).model_validate_json(scene.to_json()))
    assert {name: (folder / name).read_bytes() for name in again} == again
    files = object_files(ObjectSpec.model_validate_json(cabinet.to_json()))
    assert {name: (folder / "alone" / name).read_bytes() for name in files} == files


def test_usd_mimics_are_applied_for_newton_and_physx(folder, cabinet):
    stage = Usd.Stage.Open(str(folder / "alone" / "object.usda"))
    gear = stage.GetPrimAtPath("/cabinet/joints/gear")
    applied = gear.GetMetadata("apiSchemas").GetAddedOrExplicitItems()
    assert {"NewtonMimicAPI", "PhysxMimicJointAPI:rotX"} <= set(applied)
    assert gear.GetAttribute("newton:mimicCoef1").Get() == pytest.approx(-2.0)
    # PhysX: q + gearing * q_leader + offset = 0, in degrees.
    assert gear.GetAttribute("physxMimicJoint:rotX:gearing").Get() == pytest.approx(2.0)
    offset = gear.GetAttribute("physxMimicJoint:rotX:offset").Get()
    assert offset == pytest.approx(-math.degrees(0.3))
    hinge = stage.GetPrimAtPath("/cabinet/joints/hinge")
    axis = "physxJointAxis:angular"
    assert hinge.GetAttribute(f"{axis}:staticFrictionEffort").Get() == pytest.approx(0.01)
    assert hinge.GetAttribute(f"{axis}:maxJointVelocity").Get() == pytest.approx(math.degrees(2))


def test_the_usd_scene_states_joints_and_contacts_for_physx_and_newton(folder):
    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    # An object is called "physics" here, so gravity's prim has another name.
    assert (
        stage.GetPrimAtPath("/scene/physics_").GetAttribute("mjc:option:cone").Get() == "elliptic"
    )
    for path, kind, value in (
        ("/scene/box/joints/hinge", "angular", math.degrees(0.8)),
        ("/scene/box/joints/slide", "linear", 0.1),
        ("/scene/fastened/joints/slide", "linear", 0.05),
    ):
        joint = stage.GetPrimAtPath(path)
        for name in (f"state:{kind}:physics:position", f"newton:{kind}:position"):
            assert joint.GetAttribute(name).Get() == pytest.approx(value), (path, name)
        # Joints end as stiffly as in MuJoCo.
        assert list(joint.GetAttribute("mjc:solreflimit").Get()) == [0.02, 1.0]
        applied = joint.GetMetadata("apiSchemas").GetAddedOrExplicitItems()
        assert f"PhysicsJointStateAPI:{kind}" in applied
    colliders = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(colliders) > 20
    for prim in colliders:
        assert prim.GetAttribute("newton:contactGap").Get() == pytest.approx(0.002)

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.mjcf import START, body_name, joint_order, to_mjspec
from neoworld_mjx.spec import Box, SceneObject, SceneSpec, inertial, link_poses, pieces, world_poses
from neoworld_mjx.spec.pose import matrix, pose
from tests.support import mechanisms as made
from tests.support.mechanisms import cabinet


def scene(**box) -> SceneSpec:
    """A cabinet on a table; more goes to the cabinet's place."""
    state = {"hinge": 0.8, "slide": 0.1, "spin": 2.0}
    place = {"parent": "table", "xy": (0.1, -0.2), "z": 0.05, "yaw": 0.7, "joint_state": state}
    place["base_tilt"] = (0.99, 0.1, 0.0, 0.0)
    table = made.single("table", Box(size=(1, 1, 0.04)), 0.02)
    return SceneSpec(
        objects=(
            SceneObject(name="table", spec=table, environment=True, yaw=0.2),
            SceneObject(name="box", spec=cabinet(), **place, **box),
        )
    )


def start(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


@pytest.mark.parametrize("fixed", [False, True])
def test_world_geometry_follows_the_description(fixed):
    items = scene(fixed_base=fixed)
    model = to_mjspec(items).compile()
    data = start(model)
    base = world_poses(items)
    for item in items.objects:
        moved = link_poses(item.spec, item.joint_state)
        for part in item.spec.parts:
            count: dict[str, int] = {}
            for geom, piece, at in pieces(part):
                k = count.get(geom.name, 0)
                count[geom.name] = k + 1
                g = model.geom(f"{item.name}-{geom.name}-{k}").id
                assert model.body(model.geom_bodyid[g]).name == body_name(item, part.name)
                world = base[item.name].then(moved[part.name]).then(at)
                if piece.kind != "mesh":
                    assert np.allclose(data.geom_xpos[g], world.pos, atol=1e-9)
                    assert np.allclose(
                        data.geom_xmat[g].reshape(3, 3), matrix(world.quat), atol=1e-9
                    )
                    continue
                mesh = model.geom_dataid[g]
                assert model.mesh(mesh).name == model.geom(g).name
                first = model.mesh_vertadr[mesh]
                vert = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
                got = vert @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
                want = world.apply(piece.vertices)
                assert len(got) == len(want)
                assert np.abs(got[:, None] - want[None]).max(axis=2).min(axis=0).max() < 1e-7
            inert = inertial(item.spec, part)
            body = model.body(body_name(item, part.name)).id
            assert model.body_mass[body] == pytest.approx(inert.mass, rel=1e-12)
            centre = base[item.name].then(moved[part.name]).then(pose(inert.pos, inert.quat))
            assert np.allclose(data.xipos[body], centre.pos, atol=1e-9)
            a = (
                data.ximat[body].reshape(3, 3)
                @ np.diag(model.body_inertia[body])
                @ data.ximat[body].reshape(3, 3).T
            )
            r = matrix(centre.quat)
            assert np.allclose(a, r @ np.diag(inert.diagonal) @ r.T, rtol=1e-9, atol=1e-15)


def test_joint_parameters_are_written():
    spec = cabinet()
    model = to_mjspec(spec).compile()
    names = [model.joint(j).name for j in range(model.njnt)]
    assert names == ["cabinet", *(f"cabinet-{joint.name}" for joint in joint_order(spec))]
    hinge = model.joint("cabinet-hinge")
    assert hinge.range.tolist() == [-0.2, 1.6]
    losses = (hinge.damping, hinge.frictionloss, hinge.stiffness, hinge.armature)
    assert losses == (0.02, 0.01, 0.1, 0.003)
    assert hinge.pos.tolist() == [0, 0, 0]
    assert model.jnt_actfrcrange[hinge.id].tolist() == [-3.0, 3.0]
    assert not model.jnt_limited[model.joint("cabinet-spin").id]
    assert model.geom_friction[model.geom("cabinet-tray-0").id][0] == 0.4
    data = start(model)
    site = data.site_xpos[model.site("cabinet-pull").id]
    assert np.allclose(site, (0.21, -0.18, 0.15))


def test_parts_that_a_joint_connects_never_collide_free_or_fixed():
    counts = []
    for fixed in (False, True):
        box = SceneObject(
            name="box", spec=cabinet(), fixed_base=fixed, z=0.05, joint_state={"hinge": 1.5}
        )
        model = to_mjspec(SceneSpec(objects=(box,))).compile()
        data = start(model)
        mujoco.mj_collision(model, data)
        pairs = {
            tuple(sorted(model.body(model.geom_bodyid[g]).name for g in pair))
            for pair in data.contact.geom
        }
        counts.append(pairs)
    assert counts[0] == counts[1]
    assert not any("box" in pair and "box/knob" in pair for pair in counts[0])


def test_visual_geoms_do_not_collide():
    items = scene()
    bare, seen = to_mjspec(items).compile(), to_mjspec(items, visual=True).compile()
    assert bare.ngeom == int(np.sum(bare.geom_group == 0)) == int(np.sum(seen.geom_group == 0))
    extra = np.flatnonzero(seen.geom_group == 1)
    assert {seen.geom(g).name for g in extra} == {
        "table-body-visual",
        *(
            f"box-{geom.name}-visual"
            for part in cabinet().parts
            for geom in part.geoms
            if geom.role != "collision"
        ),
    }
    assert not seen.geom_contype[extra].any() and not seen.geom_conaffinity[extra].any()
    assert np.array_equal(bare.body_mass, seen.body_mass)
    assert np.array_equal(bare.body_inertia, seen.body_inertia)

"""Mounts of robots, and scripted motions from them, without a model package."""

from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from neoworld_mjx.environments import task as tasks
from neoworld_mjx.environments.arm import scene_state
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.flying_gripper import facing_pose
from neoworld_mjx.environments.mjx_environment import MjxEnv
from neoworld_mjx.environments.policy_environment import PolicyEnv
from neoworld_mjx.environments.reach import propose_mount, reachable
from neoworld_mjx.environments.robots import Mount
from neoworld_mjx.environments.scripted_motion import arm_script
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import Box, HollowBox, ObjectSpec, SceneObject, SceneSpec
from neoworld_mjx.spec.pose import matrix
from tests.support.mechanisms import WOOD, geom, joint, part, single

ARM = Path(__file__).parents[2] / "examples" / "arm" / "arm.xml"


@pytest.fixture(scope="module")
def scene():
    """A chest with a drawer that has a bar on two posts to pull at, and a block beside it."""
    body = part("body", geom("body", Box(size=(0.3, 0.4, 0.3)), (0, 0, 0.15)))
    drawer = part(
        "drawer",
        geom("front", Box(size=(0.02, 0.3, 0.1)), (0.17, 0, 0.4)),
        geom("handle", Box(size=(0.012, 0.1, 0.012)), (0.226, 0, 0.4)),
        geom("handle_post", Box(size=(0.05, 0.01, 0.01)), (0.2, 0.045, 0.4)),
        geom("handle_post_2", Box(size=(0.05, 0.01, 0.01)), (0.2, -0.045, 0.4)),
    )
    slide = joint("slide", "prismatic", "body", "drawer", (0.17, 0, 0.4), (1, 0, 0), upper=0.2,
                  damping=5.0, friction=1.0)  # fmt: skip
    chest = ObjectSpec(name="chest", materials=(WOOD,), parts=(body, drawer), joints=(slide,))
    floor = single("floor", Box(size=(4, 4, 0.1)), 0.0)
    block = single("block", Box(size=(0.04, 0.04, 0.04)), 0.02)
    return SceneSpec(
        objects=(
            SceneObject(name="floor", spec=floor, environment=True, z=-0.05),
            SceneObject(name="chest", spec=chest, parent="floor", fixed_base=True, yaw=0.5, z=0.05),
            SceneObject(name="block", spec=block, parent="floor", z=0.0501, xy=(0.7, -0.7)),
        )
    )


def run(task, mount):
    """Follow the path of a task; return the rewards, shares done and successes of all steps."""
    controlled = controlled_scene(task.scene, robot=ARM, mount=mount)
    arm, on, rows = controlled.arm, task.on(controlled), []
    assert arm is not None
    data = controlled.initial_data()

    def follow(start, end, grip, steps):
        for k in range(1, steps + 1):
            pos = start.pos + k / steps * (end.pos - start.pos)
            action = arm.toward(scene_state(data), pos, end.quat, grip)
            data.ctrl[:] = controlled.controls(action, scene_state(data))
            mujoco.mj_step(controlled.model, data, 10)
            mujoco.mj_forward(controlled.model, data)
            state = scene_state(data)
            rows.append((on.reward(None, action, state), on.progress(state), on.success(state)))

    path = reachable(task, ARM, mount).path
    follow(path[0], path[1], 1, 30)
    follow(path[1], path[1], 1, 10)
    follow(path[1], path[1], -1, 20)
    for start, end in zip(path[1:], path[2:], strict=False):
        follow(start, end, -1, 15)
    follow(path[-1], path[-1], -1, 20)
    return (np.array(column, float) for column in zip(*rows, strict=True))


@pytest.mark.parametrize(
    "make", [lambda s: tasks.open_joint(s, "chest-drawer", 0.8), lambda s: tasks.lift(s, "block")]
)
def test_an_arm_does_a_task_from_the_proposed_mount_and_the_reward_rises(scene, make):
    task = make(scene)
    mount = propose_mount(task, ARM)
    rewards, progress, success = run(task, mount)
    assert success[-10:].all() and progress[-1] == 1.0
    # Forces and noise of contacts let the reward fall by no more than this for a moment.
    assert (np.maximum.accumulate(rewards) - rewards).max() < 0.03
    steps = rewards[::15]
    assert (np.diff(steps) > -0.003).all() and (np.diff(steps) > 0.01).sum() > 5


def test_a_lid_is_gripped_from_the_front_by_what_is_there(scene):
    """The lid opens upward, and has a knob on top and a plate in front."""
    body = part("body", geom("body", Box(size=(0.3, 0.4, 0.2)), (0, 0, 0.1)))
    lid = part(
        "lid",
        geom("lid", Box(size=(0.3, 0.4, 0.1)), (0, 0, 0.25)),
        geom("knob", Box(size=(0.02, 0.1, 0.01)), (0.1, 0, 0.305)),
        geom("plate", Box(size=(0.012, 0.03, 0.02)), (0.156, 0, 0.25)),
    )
    hinge = joint("hinge", "revolute", "body", "lid", (-0.15, 0, 0.2), (0, -1, 0), upper=1.5)
    chest = ObjectSpec(name="chest", materials=(WOOD,), parts=(body, lid), joints=(hinge,))
    item = SceneObject(name="chest", spec=chest, parent="floor", fixed_base=True)
    chests = SceneSpec(objects=(scene.objects[0], item))
    axes = lambda *at, **side: matrix(facing_pose(chests, "chest-lid_handle", *at, **side).quat)
    assert axes()[2, 2] < -0.9 and abs(axes()[0, 1]) > 0.9
    assert axes(from_side=True)[:, 2] == pytest.approx([0, 0, -1])
    plate = axes((0.156, 0.0, 0.25), from_side=True)
    assert plate[:, 2] == pytest.approx([-1, 0, 0]) and abs(plate[2, 1]) == pytest.approx(1.0)


def test_the_script_of_an_object_at_its_goal_is_let_go_there(scene):
    """The way to the goal has no direction."""
    there = scene.object("block").model_copy(update={"z": 0.0551})
    floor, chest, _ = scene.objects
    task = tasks.place(
        scene.model_copy(update={"objects": (floor, chest, there)}), "block", on="floor"
    )
    mount = propose_mount(task, ARM)
    script = arm_script(task.on(controlled_scene(task.scene, robot=ARM, mount=mount)), ARM, mount)
    assert script is not None and script.steps > 20


def test_places_from_which_an_arm_does_not_reach_are_told(scene):
    task = tasks.open_joint(scene, "chest-drawer")
    far = reachable(task, ARM, Mount((3.0, 0.0, 0.0)))
    assert not far.reaches and far.reason == "it is too far away"
    high = scene.object("block").model_copy(update={"z": 4.0})
    lifted = scene.model_copy(update={"objects": (*scene.objects[:2], high)})
    with pytest.raises(SpecError, match="reaches it from no place"):
        propose_mount(tasks.reach(lifted, "block"), ARM)


@pytest.mark.parametrize(
    ("shape", "words", "drops"),
    [
        (Box(size=(0.2, 0.2, 0.06)), {"on": "stand"}, False),
        # The hand does not fit between the walls, so the block falls the last bit.
        (HollowBox(size=(0.1, 0.1, 0.15), wall=0.006), {"in_": "stand"}, True),
    ],
)
def test_a_script_places_a_block_and_lets_go(scene, shape, words, drops):
    stand = single("stand", shape, shape.size[2] / 2)
    beside = SceneObject(name="stand", spec=stand, parent="floor", z=0.0501, xy=(0.7, -0.4))
    scene = scene.model_copy(update={"objects": (*scene.objects, beside)})
    task = tasks.place(scene, "block", **words)
    mount = propose_mount(task, ARM)
    end = reachable(task, ARM, mount).path[-1].pos - [0.7, -0.4, 0.05] - task.goal.target
    assert (end[2] > 0.05) == drops
    # What falls falls at the middle, other objects go to the nearest place well within the goal.
    assert np.hypot(*end[:2]) == pytest.approx(0.0 if drops else 0.6 * task.goal.radius, abs=0.01)
    on = task.on(controlled_scene(task.scene, robot=ARM, mount=mount))
    script = arm_script(on, ARM, mount)
    assert script is not None
    env = MjxEnv(on.controlled, task=on, engine="native", control_s=0.04)
    state = jax.jit(env.reset)(jax.random.key(0))
    first = scene_state(state.data)
    step = jax.jit(lambda s, t: env.step(s, script.action(scene_state(s.data), first, t)))
    for t in range(script.steps):
        state = step(state, t)
    assert bool(on.success(scene_state(state.data)))
    # Half of the initial states of a policy's episodes lie along it.
    starts = PolicyEnv(env, 10, script)
    states = jax.jit(jax.vmap(starts.reset))(jax.random.split(jax.random.key(1), 16))
    along = np.asarray(states.metrics["progress"])
    assert (along < 0.01).any() and (along > 0.5).any()

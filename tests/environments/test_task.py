"""Tasks on states of a scene: their goals, progress and rewards, in NumPy and in JAX."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import neoworld_mjx as nw
from neoworld_mjx.environments import task as tasks
from neoworld_mjx.environments.arm import scene_state
from neoworld_mjx.environments.controlled_scene import controlled_scene
from neoworld_mjx.environments.predicates import Located
from neoworld_mjx.errors import SpecError
from neoworld_mjx.spec import SceneObject
from tests.support import scenes

HAND = nw.Gripper((0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def scene():
    """A cabinet whose drawer is closed, with a block in it, and a leaning board."""
    made = scenes.furnished()
    objects = [
        item.model_copy(update={"joint_state": {}, "fixed_base": True})
        if item.name == "cabinet"
        else item
        for item in made.objects
    ]
    return made.model_copy(update={"objects": tuple(objects)})


def state_of(controlled, **values):
    """A state of a scene in which joints, or free bodies, have these coordinates."""
    data = controlled.initial_data()
    for name, value in values.items():
        where = controlled.model.joint(name.replace("__", "-")).qposadr[0]
        size = np.size(value)
        data.qpos[where : where + size] = value
    mujoco.mj_forward(controlled.model, data)
    return scene_state(data)


def test_opening_progresses_with_the_joint_and_succeeds(scene):
    task = tasks.open_joint(scene, "cabinet-drawer", 0.8)
    controlled = controlled_scene(task.scene, gripper=HAND)
    on = task.on(controlled)
    high = scene.object("cabinet").spec.joint("slide").upper
    shares = (0.0, 0.4, 0.7, 0.8001)
    states = [state_of(controlled, cabinet__slide=share * high) for share in shares]
    assert [float(on.progress(s)) for s in states] == pytest.approx([0, 0.5, 0.875, 1])
    assert [bool(on.success(s)) for s in states] == [False, False, False, True]
    rewards = [float(on.reward(None, np.zeros(7), s, None)) for s in states]
    assert np.all(np.diff(rewards) > 0.05) and rewards[-1] > 1.5


def test_jax_traces_tasks_and_agrees_with_numpy(scene):
    all_of = [
        tasks.open_joint(scene, "cabinet-drawer"),
        tasks.place(scene, "board", on="cabinet"),
        tasks.topple(scene, "block"),
        tasks.reach(scene, "board"),
    ]
    controlled = controlled_scene(scene, gripper=HAND)
    start = state_of(controlled)
    moved = state_of(controlled, cabinet__slide=0.1, board=[0.1, 0.0, 0.9, 0.9, 0.1, 0.0, 0.4])
    batch = jax.tree.map(lambda *leaf: jnp.asarray(np.stack(leaf), jnp.float32), start, moved)
    for task in all_of:
        on = task.on(controlled)
        given = jax.jit(
            jax.vmap(lambda s, on=on: (on.reward(None, jnp.zeros(7), s, s), on.success(s)))
        )(batch)
        for k, state in enumerate((start, moved)):
            reward = on.reward(None, np.zeros(7), state, state)
            assert float(given[0][k]) == pytest.approx(float(reward), abs=1e-4)
            assert bool(given[1][k]) == bool(on.success(state))


def test_a_placed_object_must_rest_and_be_let_go(scene):
    task = tasks.place(scene, "board", on="cabinet")
    controlled = controlled_scene(scene, gripper=HAND)
    on, goal = task.on(controlled), task.goal
    assert isinstance(goal, Located)
    at = tasks.StateView(controlled, state_of(controlled)).pose("cabinet")[0] + goal.target
    pose = [*(at - goal.point), 1, 0, 0, 0]
    there = state_of(controlled, board=pose)
    assert bool(on.success(there)) and float(on.progress(there)) == 1.0
    fast = there._replace(qvel=there.qvel + 0.05)
    assert not bool(on.success(fast))
    tool = controlled.model.body("end_effector-hand").id
    xpos = there.xpos.copy()
    xpos[tool] = there.xpos[controlled.model.body("board").id]
    closed = there.qpos.copy()
    closed[controlled.effector.fingers] = 0.01
    held = there._replace(xpos=xpos, qpos=closed)
    assert not bool(on.success(held))


def test_closing_starts_open(scene):
    task = tasks.close_joint(scene, "cabinet-drawer")
    spec = scene.object("cabinet").spec.joint("slide")
    assert task.scene.object("cabinet").joint_state["slide"] == pytest.approx(0.8 * spec.upper)


def test_names_that_do_not_exist_are_refused_with_the_choices(scene):
    with pytest.raises(SpecError, match="did you mean 'cabinet-drawer'"):
        tasks.open_joint(scene, "cabinet-drawr")
    with pytest.raises(SpecError, match=r"valid are: .*board"):
        tasks.lift(scene, "cup")
    with pytest.raises(SpecError, match="fixed and cannot be moved"):
        tasks.push(scene, "cabinet")
    with pytest.raises(SpecError, match="one of on and in_"):
        tasks.place(scene, "board")
    done = tasks.upright(scene, "block")
    with pytest.raises(SpecError, match="done from the start"):
        controlled = controlled_scene(scene, gripper=HAND)
        done.on(controlled).progress(state_of(controlled))


def test_goals_are_data(scene):
    goal = tasks.every(tasks.lift(scene, "board"), tasks.open_joint(scene, "cabinet-drawer")).goal
    assert type(goal).model_validate_json(goal.model_dump_json()) == goal
    assert "cabinet/slide at least 0.8" in goal.meaning()
    assert isinstance(scene.object("board"), SceneObject)


def test_what_is_placed_in_a_container_may_lie_above_its_bottom_but_not_in_it(scene):
    task = tasks.place(scene, "board", in_="cabinet")
    on = task.on(controlled_scene(scene, gripper=HAND))
    controlled = on.controlled
    at = tasks.StateView(controlled, state_of(controlled)).pose("cabinet")[0] + task.goal.target
    done = [
        bool(
            on.success(
                state_of(controlled, board=[*(at - task.goal.point + [0, 0, up]), 1, 0, 0, 0])
            )
        )
        for up in (-0.008, -0.003, 0.1, 0.3, 0.45)
    ]
    assert done == [False, True, True, True, False]


def test_a_joint_is_turned_from_where_it_is(scene):
    opened = scene.model_copy(
        update={
            "objects": tuple(
                o.model_copy(update={"joint_state": {"hinge": -1.2}}) if o.name == "cabinet" else o
                for o in scene.objects
            )
        }
    )
    task = tasks.turn(opened, "cabinet-door", 0.5)
    controlled = controlled_scene(task.scene, gripper=HAND)
    on = task.on(controlled)
    states = [state_of(controlled, cabinet__hinge=angle) for angle in (-1.2, -0.75, -0.65)]
    assert [bool(on.success(s)) for s in states] == [False, False, True]


def test_the_reward_at_the_goal_is_the_same_wherever_the_tool_is(scene):
    task = tasks.open_joint(scene, "cabinet-drawer", 0.8)
    slide = 0.9 * scene.object("cabinet").spec.joint("slide").upper
    rewards, place = [], HAND.pos
    for _ in range(2):
        on = task.on(controlled_scene(task.scene, gripper=nw.Gripper(place)))
        state = state_of(on.controlled, cabinet__slide=slide)
        rewards.append(float(on.reward(None, np.zeros(7), state, None)))
        place = tuple(tasks.StateView(on.controlled, state).point(task.point).tolist())
    assert rewards == pytest.approx([2.0, 2.0], abs=1e-3)


def test_violations_of_a_goal_add_up(scene):
    task = tasks.place(scene, "board", on="cabinet")
    controlled = controlled_scene(scene, gripper=HAND)
    cabinet = tasks.StateView(controlled, state_of(controlled)).pose("cabinet")[0]

    def distance(aside, up, goal=task.goal):
        at = cabinet + task.goal.target - task.goal.point + [aside, 0, up]
        view = tasks.StateView(controlled, state_of(controlled, board=[*at, 1, 0, 0, 0]))
        return float(goal.distance(view))

    aside, above = distance(task.goal.radius + 0.2, 0.0), distance(0.0, 0.1)
    assert distance(0.0, 0.0) == 0
    assert 0.15 < aside < 0.25 and above == pytest.approx(0.1 - task.goal.high)
    assert distance(task.goal.radius + 0.2, 0.1) == pytest.approx(aside + above)
    lying = task.goal.model_copy(update={"tilt": (1.5, 3.0)})
    assert distance(0.0, 0.1, lying) == pytest.approx(above + 0.1 * 1.5)

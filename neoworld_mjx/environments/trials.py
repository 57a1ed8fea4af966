"""Evaluation of a policy in scenes that it has not seen, simulated by C MuJoCo."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..errors import SpecError
from ..spec import SceneSpec, read_scene
from .mjx_environment import EnvState, MjxEnv
from .policy import Policy, Setting
from .policy_environment import PolicyEnv
from .randomization import Variants, scene_variants
from .task import SceneTask
from .training import task_scene

EVALUATION_SEED = 1_000_003
"""Added to the seed of evaluation, so that its draws are not those of training."""


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate (Wilson, 1927)."""
    from scipy.stats import binomtest

    if n == 0:
        return 0.0, 1.0
    low, high = binomtest(successes, n).proportion_ci(method="wilson")
    return float(low), float(high)


@dataclass(frozen=True, eq=False)
class Trials:
    """Outcome of one episode in each of several scenes."""

    success: Bool[np.ndarray, " n"]
    """True if the goal holds at the end of the episode."""
    progress: Float[np.ndarray, " n"]
    drawn: int
    """Number of draws, of which those that stand and agree with the photograph are kept."""

    @property
    def rate(self) -> float:
        """Share of the scenes in which the policy succeeds."""
        return float(np.mean(self.success))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the rate."""
        return wilson(int(np.sum(self.success)), len(self.success))

    def phrase(self) -> str:
        """Return one line, such as "succeeds in 61 of 62 scenes: 98 % (91 to 100 %)"."""
        low, high = self.interval
        return (
            f"succeeds in {int(np.sum(self.success))} of {len(self.success)} scenes: "
            f"{self.rate:.0%} ({low:.0%} to {high:.0%}); mean progress "
            f"{float(np.mean(self.progress)):.2f}"
        )


def evaluate(
    policy: Policy, run: Path | str | SceneSpec, *, samples: int = 256, seed: int = 0
) -> Trials:
    """Run a policy once in each of the draws of a scene.

    Actions are the most likely ones, and the time step is 2 ms, half of that in training.

    Args:
        policy: the policy.
        run: a run folder, a scene.json or a scene.
        samples: number of draws; 0 evaluates in the scene itself.
        seed: random seed of the draws, which differ from those of training.

    Raises:
        SpecError: the policy does not fit the scene, or no draw is kept.
    """
    scene = run if isinstance(run, SceneSpec) else read_scene(Path(run))
    task = task_scene(scene, policy.about.setting)
    variants = scene_variants(task.controlled, samples, EVALUATION_SEED + seed)
    ends = last(episodes(task, policy.about.setting, variants)(policy))
    lost = np.asarray(ends.done) > 0
    success = (np.asarray(ends.metrics["success"]) > 0) & ~lost
    progress = np.where(lost, 0.0, np.asarray(ends.metrics["progress"]))
    return Trials(success, progress, samples)


def episodes(
    task: SceneTask, setting: Setting, variants: Variants | None
) -> Callable[[Policy], Iterator[EnvState]]:
    """Return a function that runs a policy once in each variant, or in the scene itself.

    It yields the first states of the episodes, and those after each action, and raises SpecError if
    the policy does not fit the scene. It compiles once for all policies.
    """
    env = MjxEnv(
        task.controlled,
        task=task,
        variants=variants,
        engine="native",
        control_s=setting.control_s,
    )
    policy_env = PolicyEnv(env, setting.horizon, delay_steps=setting.delay_steps)
    if variants is None:
        start = jax.jit(jax.vmap(policy_env.reset))(jax.random.split(jax.random.key(0), 1))
    else:
        start = jax.jit(jax.vmap(policy_env.reset_to))(jnp.arange(len(variants)))

    @jax.jit
    @jax.vmap
    def step(state: EnvState, action: Array) -> EnvState:
        after = policy_env.step(state, action)
        # A world that has diverged stays so.
        return replace(after, done=jnp.maximum(after.done, state.done))

    def states_of(policy: Policy) -> Iterator[EnvState]:
        check_fit(policy, start.obs.shape[-1], policy_env.action_size)
        states = start
        yield states
        for _ in range(setting.horizon):
            action = policy.act(np.asarray(states.obs)).astype(np.float32)
            states = step(states, jnp.asarray(action))
            yield states

    return states_of


def last(states: Iterator[EnvState]) -> EnvState:
    """Return the states at the ends of episodes."""
    return deque(states, maxlen=1)[0]


def check_fit(policy: Policy, observations: int, actions: int) -> None:
    """Raise SpecError unless a policy has the sizes of an environment."""
    own = policy.observation_size, len(policy.actor.log_std)
    if own != (observations, actions):
        raise SpecError(
            f"the policy takes {own[0]} observations and gives {own[1]} actions; the scene has "
            f"{observations} and {actions}: it was trained in another scene or with another robot"
        )

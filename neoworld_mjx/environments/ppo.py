"""Proximal policy optimization (Schulman et al., 2017) over batches of worlds.

An episode that ends by time is continued by its value (Pardo et al., 2018). At its end, a world
continues from a stored initial state, so that a reset costs no simulation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from .networks import Actor, Layer, Normalizer, init_layers, mlp

LOG_STD = (-3.0, 0.5)
"""Bounds of the logarithm of the standard deviation of actions."""
RATES = (1e-5, 1e-3)
"""Bounds of the step size."""

STOP = 4.0
"""Divergence at which an update makes no further steps, relative to `PpoOptions.kl`."""


@dataclass(frozen=True)
class PpoOptions:
    """Settings of the optimization."""

    worlds: int = 2048
    unroll: int = 20
    """Steps of every world between two updates."""
    epochs: int = 4
    """Passes over the data of an update."""
    minibatches: int = 16
    learning_rate: float = 5e-4
    """Initial step size of Adam; it adapts to the divergence of the policy."""
    kl: float = 0.01
    """Kullback-Leibler divergence of an update near which the step size stays as it is."""
    discount: float = 0.98
    trace: float = 0.95
    """Weight of longer returns in the advantage (lambda of GAE)."""
    reward_scale: float = 0.1
    """Factor of rewards, so that values are about 1 in size."""
    clip: float = 0.2
    entropy: float = 2e-3
    log_std: float = -0.5
    """Initial logarithm of the standard deviation of actions."""
    actor: tuple[int, ...] = (128, 128, 64)
    critic: tuple[int, ...] = (256, 256, 128)


@runtime_checkable
class Trainable(Protocol):
    """Environment of one world, as the optimization calls it."""

    @property
    def action_size(self) -> int:
        """Length of an action, whose entries are about 1 in size."""
        ...

    @property
    def horizon(self) -> int:
        """Steps of an episode."""
        ...

    def reset(self, key: Array) -> Any:
        """Return an initial state with the fields `obs` (a vector), `reward`, `done`, `metrics`."""
        ...

    def step(self, state: Any, action: Array) -> Any:
        """Return the next state."""
        ...


class Networks(NamedTuple):
    """Networks that gradients change."""

    actor: Actor
    critic: tuple[Layer, ...]


class Learner(NamedTuple):
    """All that an update changes, apart from the worlds."""

    networks: Networks
    normalizer: Normalizer
    optimizer: Any
    key: Array
    steps: Array
    """Number of control steps of all worlds so far, in thousands."""


class Episodes(NamedTuple):
    """States of all worlds and the running sums of their episodes."""

    states: Any
    age: Array
    """Steps since the start of the episode, shape [world]."""
    returned: Array
    """Sum of rewards since the start of the episode, shape [world]."""


class Transitions(NamedTuple):
    """Transitions of all worlds in an unroll, shape [time, world, ...]."""

    obs: Array
    action: Array
    log_prob: Array
    mean: Array
    reward: Array
    value: Array
    next_value: Array
    terminated: Array
    ended: Array
    finished: dict[str, Array]
    """Metrics of episodes at their ends, and 0 elsewhere."""


def log_prob(actor: Actor, mean: Array, action: Array) -> Array:
    """Return the log-density of actions under the policy."""
    z = (action - mean) / jnp.exp(actor.log_std)
    return -0.5 * jnp.sum(z * z + 2 * actor.log_std + jnp.log(2 * jnp.pi), axis=-1)


def init(env: Trainable, options: PpoOptions, key: Array, obs: Array) -> Learner:
    """Return a learner with random networks, for observations like those given, [world, obs]."""
    a, b, c = jax.random.split(key, 3)
    obs_size = obs.shape[-1]
    actor = init_layers(a, (obs_size, *options.actor, env.action_size), 0.01)
    networks = Networks(
        Actor(actor, jnp.full(env.action_size, options.log_std, jnp.float32)),
        init_layers(b, (obs_size, *options.critic, 1), 1.0),
    )
    zero = jnp.zeros(obs_size)
    normalizer = Normalizer(jnp.zeros(()), zero, zero).update(obs)
    return Learner(networks, normalizer, _optimizer(options).init(networks), c, jnp.zeros(()))


def open_worlds(env: Trainable, options: PpoOptions, key: Array) -> tuple[Episodes, Any]:
    """Return worlds at random ages, and the initial states from which episodes start."""
    a, b = jax.random.split(key)
    pool = jax.jit(jax.vmap(env.reset))(jax.random.split(a, options.worlds))
    age = jax.random.randint(b, (options.worlds,), 0, env.horizon)
    # An update donates the worlds, but not the pool.
    states = jax.jit(lambda kept: jax.tree.map(jnp.copy, kept))(pool)
    return Episodes(states, age, jnp.zeros(options.worlds)), pool


Update = Callable[[Learner, Episodes, Any], tuple[Learner, Episodes, dict[str, Array]]]


def make_update(env: Trainable, options: PpoOptions) -> Update:
    """Return the compiled update: an unroll of all worlds, and gradient steps on its data."""
    optimizer = _optimizer(options)

    def act(carry: tuple[Any, ...], key: Array) -> tuple[tuple[Any, ...], Transitions]:
        learner, worlds, pool = carry
        networks, normalize = learner.networks, learner.normalizer
        obs = worlds.states.obs  # of worlds that have not diverged: those were replaced
        x = normalize(obs)
        mean = mlp(networks.actor.layers, x)
        noise, pick = jax.random.split(key)
        spread = jnp.exp(networks.actor.log_std)
        action = mean + spread * jax.random.normal(noise, mean.shape)
        states = jax.vmap(env.step)(worlds.states, action)
        value = lambda y: mlp(networks.critic, y)[..., 0]
        age, returned = worlds.age + 1, worlds.returned + states.reward
        terminated = states.done > 0
        ended = terminated | (age >= env.horizon)
        at_end = lambda v: jnp.where(ended, v, 0.0)
        finished = {"episodes": at_end(jnp.ones(())), "return": at_end(returned)}
        finished |= {name: at_end(v) for name, v in states.metrics.items()}
        step = Transitions(
            obs, action, log_prob(networks.actor, mean, action), mean,
            options.reward_scale * states.reward, value(x), value(normalize(states.obs)),
            terminated, ended, finished,
        )  # fmt: skip
        rows = jax.random.randint(pick, ended.shape, 0, options.worlds)
        fresh = lambda new, old: jnp.where(
            ended.reshape(-1, *[1] * (new.ndim - 1)), jnp.take(old, rows, axis=0), new
        )
        states = jax.tree.map(fresh, states, pool)
        zero = lambda v: jnp.where(ended, 0, v)
        return (learner, Episodes(states, zero(age), zero(returned)), pool), step

    def loss(networks: Networks, batch: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
        mean = mlp(networks.actor.layers, batch["x"])
        change = log_prob(networks.actor, mean, batch["action"]) - batch["log_prob"]
        ratio = jnp.exp(jnp.clip(change, -20.0, 20.0))
        gain = batch["advantage"]
        clipped = jnp.clip(ratio, 1 - options.clip, 1 + options.clip)
        policy = -jnp.mean(jnp.minimum(ratio * gain, clipped * gain))
        value = mlp(networks.critic, batch["x"])[..., 0]
        error = jnp.mean((value - batch["target"]) ** 2)
        entropy = jnp.sum(networks.actor.log_std)
        variance = jnp.exp(2 * networks.actor.log_std)
        kl = 0.5 * jnp.mean(jnp.sum((mean - batch["mean"]) ** 2 / variance, axis=-1))
        return policy + 0.5 * error - options.entropy * entropy, {"kl": kl, "value_loss": error}

    def descend(carry: tuple[Networks, Any], batch: dict[str, Array]) -> tuple[Any, Any]:
        networks, state = carry
        (_, losses), gradient = jax.value_and_grad(loss, has_aux=True)(networks, batch)
        changes, moved = optimizer.update(gradient, state, cast(Any, networks))
        better: Any = optax.apply_updates(cast(Any, networks), changes)
        low, high = LOG_STD
        better = better._replace(
            actor=better.actor._replace(log_std=jnp.clip(better.actor.log_std, low, high))
        )
        # A step that is not finite is left out, or nothing would be finite ever after. So are steps
        # of an update that has gone too far: a policy may never recover from it.
        sane = jnp.isfinite(optax.tree.norm(gradient)) & (losses["kl"] < STOP * options.kl)
        keep = lambda new, old: jnp.where(sane, new, old)
        return jax.tree.map(keep, (better, moved), (networks, state)), losses | {"left_out": ~sane}

    def update(learner: Learner, worlds: Episodes, pool: Any) -> Any:
        key, unroll, shuffle = jax.random.split(learner.key, 3)
        keys = jax.random.split(unroll, options.unroll)
        (_, worlds, _), data = jax.lax.scan(act, (learner, worlds, pool), keys)
        advantage = _advantages(data, options)
        batch = {
            "x": learner.normalizer(data.obs),
            "action": data.action,
            "log_prob": data.log_prob,
            "mean": data.mean,
            "target": advantage + data.value,
            "advantage": (advantage - advantage.mean()) / (advantage.std() + 1e-6),
        }
        batch = {k: v.reshape(-1, *v.shape[2:]) for k, v in batch.items()}
        size = options.worlds * options.unroll
        used = size // options.minibatches * options.minibatches

        def epoch(carry: Any, own: Array) -> Any:
            order = jax.random.permutation(own, size)[:used].reshape(options.minibatches, -1)
            split = jax.tree.map(lambda v: v[order], batch)
            return jax.lax.scan(descend, carry, split)

        carry = (learner.networks, learner.optimizer)
        (networks, state), losses = jax.lax.scan(
            epoch, carry, jax.random.split(shuffle, options.epochs)
        )
        rate, kl = state[1].hyperparams["learning_rate"], losses["kl"][-1].mean()
        factor = jnp.where(kl > 2 * options.kl, 1 / 1.5, jnp.where(kl < options.kl / 2, 1.5, 1.0))
        state[1].hyperparams["learning_rate"] = jnp.clip(rate * factor, *RATES)
        sums = {name: v.sum() for name, v in data.finished.items()}
        report = {k: v / jnp.maximum(sums["episodes"], 1) for k, v in sums.items()}
        report |= {
            "episodes": sums["episodes"],
            "reward": data.reward.mean() / options.reward_scale,
        }
        report |= {"diverged": data.terminated.sum()}
        report |= {name: v.mean() for name, v in losses.items()}
        report |= {
            "learning_rate": state[1].hyperparams["learning_rate"],
            "std": jnp.exp(networks.actor.log_std).mean(),
        }
        steps = learner.steps + size / 1000
        normalizer = learner.normalizer.update(data.obs)
        return Learner(networks, normalizer, state, key, steps), worlds, report

    return jax.jit(update, donate_argnums=(0, 1))


def _optimizer(options: PpoOptions) -> optax.GradientTransformation:
    return optax.chain(
        optax.clip_by_global_norm(1.0),
        optax.inject_hyperparams(optax.adam)(learning_rate=options.learning_rate),
    )


def _advantages(data: Transitions, options: PpoOptions) -> Float[Array, "time world"]:
    """Return generalized advantage estimates (Schulman et al., 2016)."""
    keep = options.discount * (1.0 - data.terminated)
    delta = data.reward + keep * data.next_value - data.value
    decay = options.discount * options.trace * (1.0 - data.ended)

    def back(later: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        own = now[0] + now[1] * later
        return own, own

    _, advantage = jax.lax.scan(back, jnp.zeros(delta.shape[1]), (delta, decay), reverse=True)
    return advantage

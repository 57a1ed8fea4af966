"""An optimizer of your own: hill climbing about the best candidate so far."""

import equinox as eqx
import jax
import jax.numpy as jnp

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.search.cem import draw, initial_sigma
from neoworld_mjx.sweeps import case


class HillClimbing(eqx.Module):
    sigma: nw.Layout

    def init(self, mean):
        return mean, jnp.asarray(-jnp.inf)

    def ask(self, key, state, population):
        return draw(key, state[0], self.sigma, population)

    def tell(self, state, layouts, reward, **_):
        k = jnp.argmax(reward)
        new = jax.tree.map(lambda leaf: leaf[k][None], layouts), reward[k]
        return jax.tree.map(lambda a, b: jnp.where(new[1] > state[1], a, b), new, state)


def open_hill_climbing(scene, cem):
    return HillClimbing(initial_sigma(scene, cem))


if __name__ == "__main__":
    cem = {"population": 16, "iterations": 3, "stop_gain": 0.0}
    rollout = {"engine": "native", "duration_s": 0.5}
    options = RefineOptions.model_validate({"cem": cem, "rollout": rollout})
    model = compile_scene(case("crowded:2").scene)
    refined = nw.refine(model, options, optimizer=open_hill_climbing(model, options.cem))
    print(f"{refined.iterations} iterations, passed: {refined.passed}")

"""A sweep by vmap: one program searches with three weights of D_drift at once."""

import equinox as eqx
import jax
import jax.numpy as jnp

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.sweeps import case

WEIGHTS, POPULATION, ITERATIONS = (0.0, 1.0, 4.0), 16, 3
scene = compile_scene(case("crowded:3").scene)
given = [{"reward": {"w_drift": w}, "cem": {"widest": 1}} for w in WEIGHTS]
options = [RefineOptions.model_validate(o) for o in given]
problems = nw.algorithm.stack([nw.algorithm.open_problem(scene, o) for o in options])
states = eqx.filter_vmap(nw.algorithm.init)(problems)
propose = eqx.filter_vmap(lambda p, s: nw.algorithm.propose(p, s, POPULATION))
evaluate = eqx.filter_vmap(lambda p, z, r: nw.algorithm.evaluate(scene, p, z, r))
update = eqx.filter_vmap(nw.algorithm.update)

for _ in range(ITERATIONS):
    layouts = propose(problems, states)  # [weight, candidate, object, ...]
    runs = [jax.tree.map(lambda leaf, k=k: leaf[k], layouts) for k in range(len(WEIGHTS))]
    fall = [nw.rollout(scene, run, duration=0.3, engine="native") for run in runs]
    rollouts = nw.algorithm.stack(fall)
    scores = evaluate(problems, layouts, rollouts)
    states = update(problems, states, layouts, scores)
    drifts = jnp.mean(scores.terms["d_drift"], axis=1)
    print(", ".join(f"w_drift {w:g}: {float(d):.2f}" for w, d in zip(WEIGHTS, drifts, strict=True)))

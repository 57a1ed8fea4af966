"""Ask and tell by hand: Algorithm 1 as a loop in which you can change every line."""

import numpy as np

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.sweeps import case

POPULATION, ITERATIONS = 32, 3
scene = compile_scene(case("crowded:3").scene)  # or nw.load_scene("run/")
options = RefineOptions.model_validate({"cem": {"sigma_xy": 0.08}, "reward": {"w_prior": 0.1}})
problem = nw.algorithm.open_problem(scene, options)
state = nw.algorithm.init(problem, seed=0)

for t in range(ITERATIONS):
    layouts = nw.algorithm.propose(problem, state, POPULATION)
    rollout = nw.rollout(scene, layouts, duration=0.3, engine="native")
    scores = nw.algorithm.evaluate(scene, problem, layouts, rollout)
    state = nw.algorithm.update(problem, state, layouts, scores)
    best = float(np.max(scores.reward))
    print(f"iteration {t + 1}: best {best:.3f}, {int(np.sum(scores.valid))} valid")

"""The Jacobian perturbs all objects of a level of the tree together."""

import json
import random

import numpy as np
import pytest

from neoworld_mjx.estimate.tree.fit_problem import STEP, fit_problem
from neoworld_mjx.mllm.requests import read_response
from neoworld_mjx.parse.schema import ParsedScene, to_tree
from tests.support import answers


@pytest.mark.parametrize("count", [1, 2, 9])
def test_the_jacobian_is_that_of_one_difference_at_a_time(count):
    draw, data = random.Random(count), answers.answer()
    for k in range(count):
        left, top = draw.choice([-20, 100, 740]), draw.choice([-10, 200, 560])
        box = {"left": max(left, 0), "top": max(top, 0), "right": left + 90, "bottom": top + 90}
        at = (draw.uniform(0.5, 1.2), draw.uniform(-0.3, 0.3), draw.uniform(0, 0.5))
        parent = "table" if k % 3 == 0 else f"o{k - 1}"
        data["objects"].append(answers.item(f"o{k}", at, parent=parent, box=box))
    tree = to_tree(read_response(json.dumps(data), ParsedScene), answers.photo())
    objects = [node for node in tree.top_down() if not node.environment]
    problem = fit_problem(tree, objects)
    assert len(objects) == count and problem.data.cut
    x = problem.data.initial_unknowns()
    x += np.random.default_rng(0).normal(0, 0.01, len(x))
    jacobian, residuals = problem.jacobian(x), problem.residuals(x)
    for column in range(len(x)):
        ahead = x.copy()
        ahead[column] += STEP
        change = (problem.residuals(ahead) - residuals) / STEP
        np.testing.assert_allclose(jacobian[:, column], change, rtol=1e-9, atol=1e-6)

"""The Jacobian evaluates all differences together, as copies of the objects."""

import json
import random

import numpy as np
import pytest

from neoworld_mjx.fit.fit_data import CAMERA
from neoworld_mjx.fit.fit_problem import STEP, fit_problem, outline_residuals
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


def test_copies_of_a_problem_are_independent():
    data = answers.answer(answers.item("a"), answers.item("b", parent="a"))
    tree = to_tree(read_response(json.dumps(data), ParsedScene), answers.photo())
    problem = fit_problem(tree, [tree.node("a"), tree.node("b")])
    x = problem.data.initial_unknowns()
    copies = problem.data.repeated(3)
    assert copies.parents.tolist() == [-1, 0, -1, 2, -1, 4]
    unknowns = np.tile(x[CAMERA:], 3)
    unknowns[14] += 0.1
    found = outline_residuals(copies, np.concatenate([x[:CAMERA], unknowns]))
    expected = outline_residuals(problem.data, x)
    np.testing.assert_array_equal(found[[0, 1, 3, 4, 5]], expected[[0, 1, 1, 0, 1]])
    assert not np.array_equal(found[2], expected[0])

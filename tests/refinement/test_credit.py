"""Credit assignment by contact component: elites are selected per object."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.config import CEMOptions, RefineOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.refinement import open_cem, refine
from neoworld_mjx.refinement.credit import assigned_credit, contact_components
from tests.support import scenes


def test_credit_is_shared_by_objects_in_contact():
    scene = compile_scene(scenes.blocks())
    spec = scene.spec
    near = contact_components(scene, CEMOptions(credit="object"))
    assert np.array_equal(near, near.T) and np.all(np.diag(near) == 1)
    table = spec.index("table")
    for k, obj in enumerate(spec.objects):
        if obj.parent not in (None, "table"):
            assert near[k, spec.index(obj.parent)] == 1
        assert near[k, table] == (k == table)
    wider = contact_components(scene, CEMOptions(credit="island"))
    assert np.all(wider >= near)
    apart = contact_components(scene, CEMOptions(credit="island", sigma_xy=0.0))
    assert apart.sum() <= wider.sum()


def test_elites_are_selected_per_object():
    scene = compile_scene(scenes.blocks())
    cem = open_cem(scene, CEMOptions(elite_ratio=0.1))
    state = cem.init()
    layouts = cem.ask(jax.random.key(0), state, 64)
    # The first object gains by moving right, the second left; no candidate is best at both.
    first, second = np.flatnonzero(np.asarray(scene.optimised))[:2]
    credit = jnp.zeros((64, len(scene.names)))
    credit = (
        credit.at[:, first]
        .set(layouts.xy[:, first, 0])
        .at[:, second]
        .set(-layouts.xy[:, second, 0])
    )
    fitted = cem.tell(state, layouts, jnp.zeros(64), credit=credit)
    best = np.sort(np.asarray(layouts.xy[:, first, 0]))[-6:]
    assert float(fitted.mean.xy[0, first, 0]) == pytest.approx(best.mean(), rel=1e-4)
    assert float(fitted.mean.xy[0, second, 0]) < 0 < float(fitted.mean.xy[0, first, 0])


def test_failed_candidates_get_no_credit():
    credit = jnp.array([[0.1, 0.2, 0.3], [-jnp.inf, 0.5, 0.5]])
    reward, contacts = jnp.array([0.7, -jnp.inf]), jnp.ones((3, 3))
    assigned = assigned_credit(credit, reward, contacts)
    assert np.allclose(assigned[0], 0.6) and np.all(assigned[1] == -np.inf)
    assert np.array_equal(assigned_credit(credit, reward, contacts, False)[:, 0], reward)


def test_per_object_credit_excludes_user_defined_terms():
    options = RefineOptions(cem=CEMOptions(credit="object"))
    bad = options.model_copy(
        update={"reward": options.reward.model_copy(update={"terms": {"math:sin": 1.0}})}
    )
    with pytest.raises(ConfigError, match=r"refine\.cem\.credit"):
        refine(scenes.blocks(), bad)

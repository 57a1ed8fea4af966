"""The search, the final check and the exported scene simulate one physics."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.export import export_scene
from neoworld_mjx.measure import measured
from neoworld_mjx.physics import rest
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.mjcf import CONTACT_TIME_S
from neoworld_mjx.physics.native import open_batch
from neoworld_mjx.search.searched_scene import compile_for_search
from tests.support import scenes

GEOM_FIELDS = ("size", "pos", "quat", "friction", "solref", "solimp", "condim", "solmix", "margin")
GEOM_FIELDS += ("gap", "priority", "contype", "conaffinity", "type")
NO_RESET = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
"""The search and the check detect divergence, where a user's simulation starts over."""


@pytest.fixture(scope="module", params=[scenes.furnished, scenes.lamp])
def models(request, tmp_path_factory):
    """The three models of a scene, by use."""
    scene, o = request.param(), RefineOptions(check_duration_s=0.01)
    searched = compile_for_search(scene, o)
    batch = open_batch(searched, searched.place_exactly(Layout.zero(1, len(searched.names))))
    checked = []
    with pytest.MonkeyPatch.context() as patch:
        simulate = rest._simulate
        patch.setattr(
            rest,
            "_simulate",
            lambda batch, steps: [checked.append(batch.get_model(0)), simulate(batch, steps)][1],
        )
        measured(scene, o)
    folder = tmp_path_factory.mktemp("exported")
    export_scene(scene, folder)
    exported = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    return {"search": batch.get_model(0), "check": checked[0], "export": exported}


@pytest.mark.parametrize("use", ["check", "export"])
def test_all_options_except_the_time_step_are_equal(models, use):
    one, other = models["search"].opt, models[use].opt
    names = [name for name in dir(one) if not name.startswith("_")]
    names = [name for name in names if not callable(getattr(one, name)) and name != "timestep"]
    assert {"cone", "impratio", "integrator", "gravity", "solver", "o_solref"} < set(names)
    for name in names:
        a, b = getattr(one, name), getattr(other, name)
        if name == "disableflags":
            a, b = a & ~NO_RESET, b & ~NO_RESET
        np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.parametrize("use", ["check", "export"])
def test_colliding_geoms_are_equal(models, use):
    one, other = models["search"], models[use]
    colliding = [
        {m.geom(g).name: g for g in range(m.ngeom) if m.geom_contype[g] or m.geom_conaffinity[g]}
        for m in (one, other)
    ]
    assert colliding[0].keys() == colliding[1].keys() and colliding[0]
    for name, g in colliding[0].items():
        for field in GEOM_FIELDS:
            a, b = (
                getattr(m, f"geom_{field}")[k] for m, k in ((one, g), (other, colliding[1][name]))
            )
            # Files have fewer digits, and vertices are single precision.
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6, err_msg=f"{name} {field}")
    assert all(
        np.allclose(one.geom_solref[g], [CONTACT_TIME_S, 1.0]) for g in colliding[0].values()
    )


@pytest.mark.parametrize("use", ["check", "export"])
def test_bodies_and_joints_are_equal(models, use):
    one, other = models["search"], models[use]
    for k in range(one.nbody):
        same = other.body(one.body(k).name).id
        for field in ("mass", "inertia", "pos", "quat"):
            a, b = getattr(one, f"body_{field}")[k], getattr(other, f"body_{field}")[same]
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7, err_msg=one.body(k).name)
    assert (one.nq, one.nv, one.neq, one.nexclude) == (
        other.nq,
        other.nv,
        other.neq,
        other.nexclude,
    )
    for field in ("damping", "frictionloss", "armature"):
        a, b = getattr(one, f"dof_{field}"), getattr(other, f"dof_{field}")
        np.testing.assert_allclose(a, b, rtol=1e-5, err_msg=field)
    start = lambda m: m.key("start").qpos
    np.testing.assert_allclose(start(one), start(other), atol=1e-6)

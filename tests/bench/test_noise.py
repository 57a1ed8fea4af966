"""Initial scenes of the thirty scenes: each kind of noise, and missed and extra objects."""

import numpy as np
import pytest
from neoworld_bench.dataset.declaration import (
    ObjectDeclaration,
    declarations,
    program_of,
)
from neoworld_bench.dataset.truth_scene import built, truth_scene
from neoworld_bench.fidelity.rendered_responses import (
    exact_response,
)
from neoworld_bench.fidelity.rendered_scenes import see
from neoworld_bench.measures.surface_measure import geometry_measure, surface_points
from neoworld_bench.methods.layout_errors import displaced, layout_errors, unmatched
from neoworld_bench.noise import joint_noise
from neoworld_bench.noise.initial_scenes import (
    initial_scene,
)
from neoworld_bench.noise.parse_noise import (
    NoiseLog,
)
from neoworld_bench.noise.program_noise import (
    wrong_program,
)

from neoworld_mjx.spec import ObjectSpec, SceneTree, bounds


def test_missed_and_extra_objects_do_not_affect_errors():
    truth = truth_scene(declarations()["dominoes"])
    first, *others = truth.objects[1:]
    doubled = others[0].model_copy(update={"name": "ghost", "xy": (9.0, 9.0)})
    wrong = truth.model_copy(update={"objects": (truth.objects[0], *others, doubled)})
    assert unmatched(wrong, truth) == ([first.name], ["ghost"])
    assert unmatched(truth, truth) == ([], [])
    assert displaced(wrong, truth) == []
    assert layout_errors(wrong, truth) == layout_errors(truth, truth)
    # Of what is found, an error is not thinned by what is missing.
    pushed = others[0].model_copy(update={"xy": (others[0].xy[0] + 0.03, others[0].xy[1])})
    scene = wrong.model_copy(update={"objects": (truth.objects[0], pushed, *others[1:])})
    found = [item for item in others if not item.static]
    assert layout_errors(scene, truth)["xy_error_m"] == pytest.approx(0.03 / len(found))


@pytest.fixture(scope="module")
def desk():
    """Photograph a scene in few pixels: a drawer open with a die in it, books, leaning things."""
    scene = truth_scene(declarations()["desk_drawers"])
    camera = declarations()["desk_drawers"].camera.camera(320, 240)
    return see(scene.model_copy(update={"camera": camera}))


@pytest.fixture(scope="module")
def answer(desk) -> SceneTree:
    return exact_response(desk)


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def test_initial_scene_without_noise_has_no_errors(desk, answer):
    log = NoiseLog()
    start = initial_scene(desk, answer, 5, noise="exact", log=log).scene
    assert log == NoiseLog()
    assert unmatched(start, desk) == ([], []) and displaced(start, desk) == []
    errors = layout_errors(start, desk)
    assert errors["xy_error_m"] < 1e-3 and errors["scale_error"] < 1e-6
    assert errors["yaw_error_deg"] < 0.1
    for item in desk.objects:
        joint = start.object(item.name).joint_state
        assert joint == pytest.approx(item.joint_state)


def program(name: str, **values: float | str) -> ObjectSpec:
    item = ObjectDeclaration(name="it", program=name, set=values, parent="table", at=(0, 0, 0))
    return built(program_of(item))


@pytest.mark.slow
def test_program_noise_has_the_measured_surface_error():
    kinds = ("desk", "dishwasher", "drawer_cabinet", "microwave", "oven", "wardrobe")
    distances = []
    for name in kinds:
        item = ObjectDeclaration(name="it", program=name, set={}, parent="table", at=(0, 0, 0))
        true = surface_points(built(program_of(item)), seed=1)
        for number in range(4):
            drawn = wrong_program(item, number, frozenset(), NoiseLog())
            distances.append(geometry_measure(drawn, true).aligned.chamfer_x10)
    # The twelve objects' mean; the truth against itself has .08 to .11.
    assert np.mean(distances) == pytest.approx(0.139, rel=0.12)


def test_each_kind_of_joint_noise():
    chest = program("treasure_chest")
    (lid, *_) = [joint for joint in chest.joints if joint.type == "revolute"]
    name, axis = lid.name, np.array(lid.axis)
    assert joint_noise.fastened(chest, name).type == "fixed"
    across = joint_noise.across_axis(chest, name, rng())
    assert abs(axis @ across.axis) < 1e-9 and across.pos == lid.pos
    slanted = joint_noise.slanted_axis(chest, name, rng())
    assert np.degrees(np.arccos(axis @ slanted.axis)) == pytest.approx(joint_noise.SLANT_DEG)
    diagonal = float(np.linalg.norm(np.subtract(*bounds(chest))))
    steps = np.array(
        [
            np.subtract(joint_noise.off_pivot(chest, name, np.random.default_rng(k)).pos, lid.pos)
            for k in range(80)
        ]
    )
    assert np.abs(steps @ axis).max() < 1e-9
    # What was measured: the mean distance of lines over the diagonal.
    assert np.linalg.norm(steps, axis=1).mean() / diagonal == pytest.approx(0.0128, rel=0.15)
    ranges = [joint_noise.off_range(chest, name, np.random.default_rng(k)) for k in range(100)]
    overlap = [min(j.upper, lid.upper) / max(j.upper, lid.upper) for j in ranges]
    assert np.mean(overlap) == pytest.approx(0.82, abs=0.03)
    slides = joint_noise.of_other_type(chest, name)
    assert (slides.type, slides.parent, slides.child) == ("prismatic", lid.parent, lid.child)


@pytest.mark.slow
def test_initial_scene_with_all_noise_composes(desk):
    # Few objects, since a fit costs most of the time.
    names = ("table", "chest", "dice", "carton", "tin", "cup")
    few = desk.model_copy(update={"objects": tuple(desk.object(name) for name in names)})
    log = NoiseLog()
    start = initial_scene(few, exact_response(few), 0, noise="all", log=log).scene
    missed, extra = unmatched(start, few)
    split = log.injected.count("split")
    assert len(missed) == log.injected.count("missed") + split
    assert len(extra) == log.injected.count("extra") + 2 * split
    assert "joint missing" in log.injected
    assert layout_errors(start, few)["scale_error"] > 1e-3

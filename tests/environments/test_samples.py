"""Draws about a scene: their spread, their physics, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest

import neoworld_mjx as nw
from neoworld_mjx.commands.object_commands import CheckCommand
from neoworld_mjx.commands.policy_commands import SampleCommand
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.environments.contact_draws import SceneContacts
from neoworld_mjx.environments.samples import MAX_PX, SceneSamples
from neoworld_mjx.errors import RunError, SpecError
from neoworld_mjx.measure import measured
from neoworld_mjx.physics.model import compile_for_simulation, compile_scene
from neoworld_mjx.physics.model_fields import model_fields
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.posterior import PhysicalPrior, draw, draw_again
from neoworld_mjx.spec import Camera, SceneSpec, read_scene
from neoworld_mjx.spec.correlation import PoseCorrelation
from neoworld_mjx.spec.object import AuthoredInertia
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.support import scenes

OPTIONS = RefineOptions(check_duration_s=0.5)
CAMERA = Camera(width=640, height_px=480, fovy=0.7, height=0.6, pitch=0.5)


def known(along=0.0, across=0.0, yaw=0.0, log_scale=0.0):
    return PoseUncertainty(along=along, across=across, yaw=yaw, log_scale=log_scale)


def two(first, second, correlation=None, **fields):
    """Two blocks on a table in front of a camera, with their uncertainties."""
    scene = scenes.on_table(
        (scenes.block("one"), (0.0, 0.1), 0.0, {"uncertainty": first}),
        (scenes.block("two"), (0.0, -0.1), 0.0, {"uncertainty": second, **fields}),
    )
    table = scene.objects[0].model_copy(update={"xy": (1.0, 0.0)})
    objects = (table, *scene.objects[1:])
    return scene.model_copy(
        update={"objects": objects, "camera": CAMERA, "correlation": correlation}
    )


def correlated(rho):
    """Two objects whose distances along the view have this correlation."""
    matrix = np.eye(12)
    matrix[4, 8] = matrix[8, 4] = rho
    return PoseCorrelation.of(("one", "two"), matrix).model_copy(update={"camera": (0.0,) * 4})


@pytest.mark.parametrize("rho", [None, 0.9])
def test_draws_have_the_deviations_and_correlations_of_the_estimate(rho):
    given = known(along=0.02, across=0.002, yaw=0.1, log_scale=0.05)
    scene = two(given, given, None if rho is None else correlated(rho))
    rng = np.random.default_rng(0)
    draws = draw(compile_for_simulation(scene), rng, 4000, spread=np.ones(4000))
    xy = np.asarray(draws.layouts.xy)[:, 1:]
    ahead = np.array([1.0, 0.1]) / np.hypot(1.0, 0.1)
    along, across = xy[:, 0] @ ahead, xy[:, 0] @ [-ahead[1], ahead[0]]
    assert along.std() == pytest.approx(0.02, rel=0.05)
    assert across.std() == pytest.approx(0.002, rel=0.05)
    assert draws.layouts.yaw[:, 1].std() == pytest.approx(0.1, rel=0.05)
    assert draws.layouts.log_scale[:, 2].std() == pytest.approx(0.05, rel=0.05)
    gap = (xy[:, 1] - xy[:, 0]) @ [1.0, 0.0]
    assert gap.std() == pytest.approx(0.02 * np.sqrt(2 * (1 - (rho or 0.0))), rel=0.08)
    assert not draws.layouts.xy[:, 0].any()


def test_draws_have_heavy_tails_and_the_intervals_of_the_estimate():
    """Most draws are nearer than those of a normal distribution, with the same 90 % interval."""
    given = known(along=0.02, yaw=0.1)
    model = compile_for_simulation(two(given, given))
    draws = draw(model, np.random.default_rng(0), 8000)
    deviations = np.abs(np.asarray(draws.layouts.yaw)[:, 1:]) / 0.1
    assert np.quantile(deviations, 0.9) == pytest.approx(1.645, rel=0.05)
    assert np.median(deviations) == pytest.approx(0.53, rel=0.05)
    assert np.quantile(deviations, 0.98) == pytest.approx(0.70 * 4.54, rel=0.1)
    wide = deviations.max(axis=1) > 2.5
    assert draws.spread[wide].mean() > 2 * draws.spread[~wide].mean()
    again = draw_again(model, draws, np.ones((8000, 3), bool), np.random.default_rng(1))
    np.testing.assert_array_equal(again.spread, draws.spread)
    assert np.std(again.normals / again.spread[:, None]) == pytest.approx(1.0, rel=0.01)


def test_an_object_on_a_wall_varies_along_the_wall():
    wall = scenes.block("wall", (2.0, 0.1, 1.0))
    stands = scenes.SceneObject(name="wall", spec=wall, environment=True, xy=(1.0, 0.5))
    on_wall = {"parent": "wall", "relation": "attached", "fixed_base": True, "xy": (0.0, -0.08)}
    board = scenes.SceneObject(
        name="board", spec=scenes.block("board"), uncertainty=known(across=0.02), **on_wall
    )
    scene = SceneSpec(objects=(stands, board), camera=CAMERA)
    rng = np.random.default_rng(0)
    draws = draw(compile_for_simulation(scene), rng, 500, spread=np.ones(500))
    x, y = draws.layouts.xy[:, 1].std(axis=0)
    assert x == pytest.approx(0.02, rel=0.1) and y == 0.0


@pytest.fixture(scope="module")
def samples():
    given = known(along=0.004, across=0.004, yaw=0.05, log_scale=0.03)
    return nw.sample(two(given, given, fixed_base=True), 12, seed=3, options=OPTIONS)


def test_draws_stand_and_fixed_objects_vary_with_the_others(samples):
    assert isinstance(samples, SceneSamples) and len(samples) == 12
    assert samples.stands.all() and samples.phrase().startswith("stands in 12 of 12")
    spread = np.asarray(samples.poses.pos).std(axis=0)[:, :2].max(axis=1)
    assert spread[0] == 0.0 and (spread[1:] > 0.002).all() and (spread < 0.008).all()
    assert samples.weights.sum() == pytest.approx(1.0)
    assert samples.weights[samples.kept] == pytest.approx(1 / len(samples.kept))


def test_the_scene_of_a_draw_is_the_simulated_model(samples):
    fields = model_fields(samples.model, samples.poses, np)
    for k in (0, 5):
        scene = SceneSpec.model_validate_json(samples.scene(k).to_json())
        model = compile_for_simulation(scene).static.mjm
        for name in ("body_mass", "body_inertia", "geom_friction", "body_pos", "body_quat"):
            given = np.reshape(np.asarray(fields[name])[k], getattr(model, name).shape)
            np.testing.assert_allclose(given, getattr(model, name), rtol=1e-5, atol=1e-9)
    masses = np.asarray(samples.poses.variation.mass)
    assert np.log(masses).std() == pytest.approx(PhysicalPrior().density, rel=0.4)


def test_a_stated_inertia_varies_with_the_mass():
    inertia = AuthoredInertia(pos=(0, 0, 0.03), moments=(1e-3, 2e-3, 2.5e-3), products=(1e-4, 0, 0))
    spec = scenes.block("one")
    part = spec.parts[0].model_copy(update={"mass": 0.8, "inertia": inertia})
    spec = spec.model_copy(update={"parts": (part,)})
    samples = nw.sample(scenes.on_table((spec, (0, 0), 0.0, {})), 2, options=OPTIONS)
    for k, mass in enumerate(np.asarray(samples.poses.variation.mass)[:, 1]):
        drawn = samples.scene(k).object("one").spec.parts[0]
        assert abs(mass - 1) > 1e-3 and drawn.mass == pytest.approx(0.8 * mass)
        assert np.allclose(drawn.inertia.tensor(), mass * inertia.tensor())


def test_openings_vary_within_their_ranges_unless_another_joint_follows():
    near_end, upper = 0.084, 0.1
    state = {"fixed_base": True, "joint_state": {"hinge": near_end, "slide": 0.1}}
    cabinet = (scenes.cabinet(), (0, 0), 0.0, state)
    drawn = nw.sample(scenes.on_table(cabinet), 12, seed=1, options=OPTIONS)
    names = drawn.model.static.joint_names
    at = [names.index(f"cabinet-{name}") for name in ("hinge", "slide")]
    change = np.asarray(drawn.poses.variation.opening)[:, at]
    assert change[:, 0].std() > 0.02
    assert change[:, 0].max() == pytest.approx(upper - near_end)
    assert not change[:, 1].any() and drawn.stands.all()
    scene = drawn.scene(3)
    position = near_end + change[3, 0]
    assert scene.object("cabinet").joint_state["hinge"] == pytest.approx(position)
    start = compile_for_simulation(scene).static.start
    np.testing.assert_allclose(
        model_fields(drawn.model, drawn.poses, np)["qpos"][3], start, atol=1e-6
    )


def test_a_draw_is_measured_like_its_scene_alone():
    """The batch scales the meshes of its draws; a scene alone is compiled at its size."""
    given = known(along=0.002, across=0.002, yaw=0.05, log_scale=0.08)
    objects = [
        item if item.environment else item.model_copy(update={"uncertainty": given})
        for item in scenes.coffee().objects
    ]
    scene = scenes.coffee().model_copy(update={"objects": tuple(objects)})
    samples = nw.sample(scene, 3, options=OPTIONS)
    assert np.ptp(samples.poses.scale[:, 1:]) > 0.05
    for k, measure in enumerate(samples.measures):
        alone = measured(samples.scene(k), OPTIONS)
        assert measure.depths_m == pytest.approx(alone.depths_m, abs=2e-6)
        assert measure.drift_m == pytest.approx(alone.drift_m, abs=2e-4)


def test_losses_and_joints_of_a_draw_are_those_of_the_simulated_model():
    scene = scenes.furnished()
    objects = [
        item.model_copy(update={"joint_state": {"slide": 0.1}}) if item.name == "cabinet" else item
        for item in scene.objects
    ]
    scene = scene.model_copy(update={"objects": tuple(objects)})
    samples = nw.sample(scene, 2, options=OPTIONS)
    fields = model_fields(samples.model, samples.poses, np)
    compiled = compile_for_simulation(samples.scene(1)).static
    for name in ("dof_damping", "dof_frictionloss"):
        given = np.reshape(np.asarray(fields[name])[1], getattr(compiled.mjm, name).shape)
        np.testing.assert_allclose(given, getattr(compiled.mjm, name), rtol=1e-6)
    slide = compiled.mjm.joint("cabinet-slide").qposadr[0]
    assert fields["qpos"][1, slide] == pytest.approx(compiled.start[slide], abs=1e-7)


def test_the_same_seed_draws_the_same(samples, tmp_path):
    again = nw.sample(samples.model.spec, 12, seed=3, options=OPTIONS)
    other = nw.sample(samples.model.spec, 12, seed=4, options=OPTIONS)
    np.testing.assert_array_equal(again.poses.pos, samples.poses.pos)
    assert not np.array_equal(other.poses.pos, samples.poses.pos)
    again.write(tmp_path / "samples.npz")
    stored = np.load(tmp_path / "samples.npz")
    assert list(stored["objects"]) == ["table", "one", "two"]
    np.testing.assert_array_equal(stored["pos"], samples.poses.pos)


def bridge():
    """A plank on two blocks; it falls if the second block moves away from under it."""
    scene = two(known(), known(across=0.08))
    plank = scenes.SceneObject(
        name="plank",
        spec=scenes.block("plank", (0.04, 0.26, 0.01)),
        parent="one",
        xy=(0.0, -0.1),
        z=0.06,
    )
    return scene.model_copy(update={"objects": (*scene.objects, plank), "camera": None})


def test_a_draw_that_falls_is_refused_with_the_reason():
    samples = nw.sample(bridge(), 16, options=OPTIONS, redraws=0)
    assert 2 < samples.stands.sum() < 16
    assert (samples.weights[~samples.stands] == 0).all()
    refused = {reason for reason in samples.reasons if reason}
    assert refused and all(reason.startswith("plank ") for reason in refused)
    assert f"stands in {samples.stands.sum()} of 16" in repr(samples)


def test_what_falls_is_drawn_again_and_the_rest_stays():
    """The group that is drawn again is the plank and what it touches; the can stands apart."""
    scene = bridge()
    can = scene.object("one").model_copy(
        update={"name": "can", "xy": (0.15, 0.3), "uncertainty": known(0.01)}
    )
    scene = scene.model_copy(update={"objects": (*scene.objects, can)})
    once = nw.sample(scene, 12, options=OPTIONS, redraws=0)
    again = nw.sample(scene, 12, options=OPTIONS)
    assert len(once.kept) < len(again.kept) and again.refused[0].startswith("plank ")
    assert "refused and drawn again: plank" in again.phrase()
    assert "others" not in again.phrase()
    first = [reason for reason in once.reasons if reason]
    assert list(again.refused[: len(first)]) == first
    np.testing.assert_array_equal(again.layouts.xy[:, 4], once.layouts.xy[:, 4])
    moved = (again.layouts.xy[:, 2] != once.layouts.xy[:, 2]).any(axis=1)
    assert moved.tolist() == [bool(reason) for reason in once.reasons]


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_an_object_is_drawn_again_given_the_others(rho):
    given = known(along=0.02, across=0.002)
    scene = compile_for_simulation(two(given, given, correlated(rho)))
    rng = np.random.default_rng(0)
    first = draw(scene, rng, 3000)
    chosen = np.tile([False, False, True], (3000, 1))
    second = draw_again(scene, first, chosen, rng)
    np.testing.assert_allclose(second.layouts.xy[:, 1], first.layouts.xy[:, 1], atol=1e-12)
    np.testing.assert_array_equal(second.variation.mass[:, 1], first.variation.mass[:, 1])
    assert (second.variation.mass[:, 2] != first.variation.mass[:, 2]).all()
    x = [d.layouts.xy[:, k, 0] for d, k in ((first, 1), (first, 2), (second, 2))]
    found = np.corrcoef(x)
    assert found[0, 1] == pytest.approx(rho, abs=0.05) and found[0, 2] == pytest.approx(
        rho, abs=0.05
    )
    assert found[1, 2] == pytest.approx(rho**2, abs=0.05)


def test_draws_keep_apart_and_over_their_supports():
    """Neighbors 10 mm apart do not overlap, and a block at the edge of the table stays on it."""
    apart = known(across=0.02, along=0.001)
    scene = two(apart, apart)
    table, one, other = scene.objects
    one, other = (
        item.model_copy(update={"xy": (0.0, y)}) for item, y in ((one, 0.035), (other, -0.035))
    )
    edge = one.model_copy(update={"name": "edge", "xy": (0.2, 0.38)})
    scene = compile_scene(scene.model_copy(update={"objects": (table, one, other, edge)}))
    drawn = draw(scene, np.random.default_rng(0), 64)
    kept = SceneContacts(scene).kept(drawn)
    y = lambda draws: draws.layouts.xy[..., 1] + [0.0, 0.035, -0.035, 0.38]
    gap = lambda draws: y(draws)[:, 1] - y(draws)[:, 2] - 0.06
    assert (gap(drawn) < -0.005).sum() > 8 and gap(kept).min() > -0.001
    assert y(drawn)[:, 3].max() > 0.41 and y(kept)[:, 3].max() < 0.395
    free = (gap(drawn) > 0.002) & (y(drawn)[:, 3] < 0.38)
    assert free.sum() > 10
    np.testing.assert_array_equal(kept.normals[free], drawn.normals[free])
    # The nearest: both neighbors give way by the same amount.
    shift = (y(kept) - y(drawn))[gap(drawn) < -0.005]
    np.testing.assert_allclose(shift[:, 1], -shift[:, 2], atol=2e-3)


def test_a_wall_gives_way():
    """A block 10 mm in front of a wall is drawn behind it; another block does not stop there."""
    given = known(along=0.04)
    scene = two(given, given, correlated(0.95))
    wall = scenes.block("wall", (0.1, 0.3, 1.0))
    behind = scenes.SceneObject(name="wall", spec=wall, environment=True, xy=(1.09, 0.25))
    scene = scene.model_copy(update={"objects": (*scene.objects, behind)})
    samples = nw.sample(scene, 12, options=OPTIONS, redraws=0, max_px=np.inf)
    assert samples.stands.all()
    ahead, pushed = samples.layouts.xy[:, 1:3, 0], samples.layouts.xy[:, 3, 0]
    assert ahead.max() > 0.04 and pushed.min() > -1e-9 and pushed.max() > 0.02
    assert not samples.layouts.xy[pushed == 0, 3].any()
    assert np.abs(ahead[:, 1]).max() > 0.04
    k = int(pushed.argmax())
    assert samples.scene(k).object("wall").xy[0] == pytest.approx(1.09 + pushed[k], abs=1e-6)


def test_a_draw_that_leaves_its_pixels_is_refused():
    scene = two(known(across=0.03), known())
    samples = nw.sample(scene, 12, options=OPTIONS, redraws=0)
    assert samples.stands.all() and 0 < len(samples.kept) < 12
    refused = np.setdiff1d(np.arange(12), samples.kept)
    assert {samples.reasons[k] for k in refused} == {"one leaves its pixels"}
    assert samples.shift_px[refused, 1].min() > samples.shift_px[samples.kept, 1].max()
    assert len(nw.sample(scene, 12, options=OPTIONS, max_px=1e3).kept) == 12
    for more in range(3):  # Among them a draw that leaves them by less than a pixel.
        found = nw.sample(scene, 12, options=OPTIONS, redraws=0, max_px=MAX_PX + more)
        assert found.at_fault[:, 1].tolist() == [bool(reason) for reason in found.reasons]


def test_each_draw_has_its_camera_if_the_camera_is_uncertain():
    scene = two(known(across=0.01), known(across=0.01))
    assert nw.sample(scene, 2, options=OPTIONS).scene(0).camera == CAMERA
    deviations = {"camera": (0.02, 0.0, 0.05, 0.0)}
    correlation = correlated(0.0).model_copy(update=deviations)
    samples = nw.sample(scene.model_copy(update={"correlation": correlation}), 32, options=OPTIONS)
    cameras = [camera for k in range(32) if (camera := samples.scene(k).camera)]
    assert len(cameras) == 32
    assert np.std([c.pitch for c in cameras]) == pytest.approx(0.02, rel=0.4)
    assert np.std([np.log(c.focal) for c in cameras]) == pytest.approx(0.05, rel=0.4)
    assert {c.roll for c in cameras} == {0.0}


def test_a_focal_length_moves_the_camera_by_the_depth_of_the_aligned_scene():
    """The parsed depths of the objects are three times too large."""
    scene = two(known(), known())
    objects = [item.model_copy(update={"depth": 3.6}) for item in scene.objects]
    correlation = correlated(0.0).model_copy(update={"camera": (0.0, 0.0, 0.1, 0.0)})
    update = {"objects": tuple(objects), "correlation": correlation}
    samples = nw.sample(scene.model_copy(update=update), 12, options=OPTIONS, redraws=0)
    assert np.std([np.log(c.focal) for c in samples.cameras if c]) > 0.05
    assert samples.shift_px.max() < 4.0


class Counting(NativeEngine):
    """C MuJoCo that counts the candidates that it settles and lets fall."""

    def __init__(self):
        super().__init__()
        self.candidates = 0

    def simulate(self, scene, poses, schedule):
        self.candidates += len(poses.scale)
        return super().simulate(scene, poses, schedule)


def test_a_draw_that_leaves_its_pixels_is_drawn_again_before_it_is_settled():
    engine = Counting()
    scene = two(known(across=0.03), known())
    samples = nw.sample(scene, 16, options=OPTIONS, engine=engine, redraws=12)
    assert samples.stands.all() and len(samples.kept) == 16
    assert samples.refused.count("one leaves its pixels") > 8
    assert engine.candidates == 2 * 16


def test_an_object_that_is_held_refuses_no_draw_and_is_reported(samples):
    scene = scenes.changed(samples.model.spec, "one", held=True, fixed_base=True)
    drawn = nw.sample(scene, 4, options=OPTIONS, redraws=0)
    assert drawn.stands.all() and len(drawn.kept) == 4
    assert drawn.phrase() == "stands in 4 of 4; held in place: one"


def test_bad_input_gets_one_line(samples):
    with pytest.raises(SpecError, match="n is 0"):
        nw.sample(samples.model.spec, 0)
    with pytest.raises(ValueError, match="2 objects need 66 values below the diagonal, got 1"):
        PoseCorrelation(objects=("one", "two"), lower=(0.5,))
    with pytest.raises(ValueError, match="from -1 to 1"):
        PoseCorrelation(objects=(), lower=(1.5,))


def test_the_code_of_the_page_runs(tmp_path, monkeypatch, capsys):
    """docs/how-to/sample-scenes.md"""
    page = Path(__file__).parents[2] / "docs/how-to/sample-scenes.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    assert code.count("\n") <= 12
    scene = two(known(across=0.004), known(across=0.004))
    objects = [
        item.model_copy(update={"name": {"one": "cup", "two": "spoon"}.get(item.name, item.name)})
        for item in scene.objects
    ]
    scene = scene.model_copy(update={"objects": tuple(objects)})
    (tmp_path / "out").mkdir()
    (tmp_path / "out/scene.json").write_text(scene.to_json(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(code.replace("64", "8"), {})
    printed = capsys.readouterr().out
    assert "stands in 8 of 8" in printed
    ((low, high),) = re.findall(r"interval (\S+) to (\S+) mm", printed)
    low, high = float(low), float(high)
    assert 120 < low < high < 160


def test_the_command_writes_draws_and_scenes(tmp_path):
    scene = two(known(across=0.004), known(across=0.004))
    (tmp_path / "scene.json").write_text(scene.to_json(), encoding="utf-8")
    command = SampleCommand(target=tmp_path / "scene.json", n=3, export=tmp_path / "scenes")
    result = command.run()
    assert result["draws"] == result["kept"] == 3 and result["refused"] == {}
    assert command.lines(result)[0] == "stands in 3 of 3"
    assert len(np.load(tmp_path / "samples.npz")["weights"]) == 3
    stored = read_scene(tmp_path / "scenes/0001/scene.json")
    assert stored.object("one").xy != scene.object("one").xy
    assert (tmp_path / "scenes/0002/scene.xml").is_file()
    with pytest.raises(RunError, match="not an empty folder"):
        command.run()
    bare = scenes.blocks().to_json()
    (tmp_path / "scene.json").write_text(bare, encoding="utf-8")
    assert "not aligned" in SampleCommand(target=tmp_path, n=1).run()["note"]


def test_a_check_counts_the_draws_in_which_the_scene_stands(tmp_path):
    (tmp_path / "scene.json").write_text(bridge().to_json(), encoding="utf-8")
    command = CheckCommand(target=tmp_path / "scene.json", samples=16)
    result = command.run()
    assert result["passed"]
    drawn = result["samples"]
    assert drawn["draws"] == 16 and 2 < drawn["stand"] < 16
    assert sum(drawn["failing"].values()) == 16 - drawn["stand"]
    (line,) = (line for line in command.lines(result) if line.startswith("samples:"))
    assert line.startswith(f"samples: stands in {drawn['stand']} of 16; plank ")
    (tmp_path / "scene.json").write_text(scenes.blocks().to_json(), encoding="utf-8")
    with pytest.raises(SpecError, match="was not aligned"):
        command.run()
    with pytest.raises(SpecError, match="name a positive number"):
        CheckCommand(target=tmp_path, samples=-1).run()

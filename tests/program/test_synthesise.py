import asyncio
import io
from functools import partial
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.mllm import Picture
from neoworld_mjx.program import build, stages, views
from neoworld_mjx.program import synthesise as module
from neoworld_mjx.program.ask import ProgramResponse, SynthesisResult
from neoworld_mjx.program.critique import (
    ArticulationCritique,
    ExportCritique,
    GeometryCritique,
    ProgramFault,
    Subject,
)
from neoworld_mjx.program.views import draw
from neoworld_mjx.spec import Box2D, Box3D, Camera, PartState, TreeNode, bounds
from tests.support.scripted_model import ScriptedModel

HEAD = "from neoworld_mjx.program.sdk import Object, box, hollow_box\n"
BODY = (
    HEAD
    + "o = Object('cabinet')\n"
    + "body = o.part('body', material='oak')\n"
    + "body.add(hollow_box((0.38, 0.6, 0.6), 0.02, open='+x'), at=(0, 0, 0.3))\n"
)
DOOR = (
    "door = o.part('door', material='oak')\n"
    "door.add(box((0.02, 0.6, 0.6)), at=body.anchor('front'), by='back')\n"
)
HINGE = (
    "o.revolute('hinge', body, door, at=door.anchor('left.back'), axis=(0, 0, {sign}), "
    "range=(0, 1.6))\n"
)
GOOD = BODY + DOOR + HINGE.format(sign=1)
WRONG_WAY = BODY + DOOR + HINGE.format(sign=-1)
BROKEN = BODY + "door.add(box((1, 1, 1)))\n"
DOORLESS = BODY.replace("0.38", "0.4")

OPTIONS = ProgramOptions(debug_rounds=1, critic_rounds=1)
UNJUDGED = ProgramOptions(debug_rounds=1, critic_rounds=0)


@pytest.fixture(autouse=True, scope="module")
def _each_program_is_built_and_drawn_once():
    """Share what depends on a program alone: all tests build variants of the same cabinet."""
    built: dict[Any, Any] = {}

    def once(work: Any, key_of: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            key = key_of(*args, **options)
            if key not in built:
                built[key] = work(*args, **options)
            return built[key]

        return call

    drawn_by = lambda spec, item, camera, opened=False: (
        spec.to_json(),
        item.model_dump_json(),
        camera and camera.model_dump_json(),
        opened,
    )
    with pytest.MonkeyPatch.context() as patch:
        one = stages.STAGES["one"][0]
        once_built = one._replace(build=once(one.build, lambda text, options: text))
        patch.setitem(stages.STAGES, "one", (once_built,))
        patch.setattr(module, "draw", once(module.draw, drawn_by))
        # Shadows take half of the time, and change colors only.
        patch.setattr(views, "render", partial(views.render, shadows=False))
        yield


def node(**more: Any) -> TreeNode:
    given: dict[str, Any] = {
        "name": "cabinet",
        "label": "cabinet",
        "parent": "floor",
        "box2d": Box2D(x0=0, y0=0, x1=64, y1=64),
        "box3d": Box3D(position=(2, 0.3, 0), size=(0.4, 0.6, 0.6), yaw=3.0),
        "articulation": (PartState(part="door", type="revolute"),),
    }
    return TreeNode(**(given | more))


def crop() -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.full((8, 8, 3), (200, 100, 50), np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def written(text: str, *removed: str) -> ProgramResponse:
    return ProgramResponse(program=text, removed=list(removed))


FAULT = ProgramFault(part="door", what="too thin", change="make it 3 cm thick")


def shape_verdict(geometry: float, accept: bool = False) -> GeometryCritique:
    faults, decision = ([], "accept") if accept else ([FAULT], "revise")
    return GeometryCritique(geometry=geometry, colour=6, faults=faults, verdict=decision)


JOINTS_GOOD = ArticulationCritique(articulation=8, verdict="accept")


def verdict(geometry: float, accept: bool = False) -> list[Any]:
    """Return the verdicts of both critics; only that about geometry varies."""
    return [shape_verdict(geometry, accept), JOINTS_GOOD]


def synthesised(
    script: ScriptedModel, options: ProgramOptions = OPTIONS, **more: Any
) -> SynthesisResult:
    camera = Camera(width=640, height_px=480, fovy=0.8, height=1.2, pitch=0.4)
    subject = Subject(node(**more), Picture("crop", crop()), camera=camera)
    return asyncio.run(module.synthesise(subject, script, options))


def test_a_valid_program_takes_one_request_and_one_critique():
    script = ScriptedModel(written(GOOD), *verdict(9, accept=True))
    outcome = synthesised(script)
    assert outcome.spec is not None and outcome.signals == () and outcome.reason == ""
    names = [request.name for request in script.requests]
    assert names == ["program:cabinet", "judge-geometry:cabinet", "judge-articulation:cabinet"]
    labels = [[picture.label for picture in each.pictures] for each in script.requests[1:]]
    assert labels == [["crop", "made"], ["crop", "made", "opened"]]
    assert outcome.score == pytest.approx(0.5 * 9 + 0.3 * 8 + 0.2 * 6)
    assert "0.400 m (x, front to back)" in script.requests[0].prompt
    assert "door (revolute)" in script.requests[0].prompt


def test_signals_return_to_the_programmer_with_their_lines():
    script = ScriptedModel(written(BROKEN), written(GOOD), *verdict(9, accept=True))
    outcome = synthesised(script)
    assert outcome.spec is not None and outcome.text.strip() == GOOD.strip()
    assert "line 5" in script.requests[1].prompt and BROKEN.strip() in script.requests[1].prompt


def test_deleting_the_joint_is_no_repair():
    script = ScriptedModel(written(WRONG_WAY), written(DOORLESS), *verdict(6, accept=True))
    outcome = synthesised(script, articulation=())
    assert outcome.spec is not None and outcome.text.strip() == WRONG_WAY.strip()
    assert outcome.fallbacks and "overlap_in_motion" in outcome.fallbacks[0][1]
    lost = outcome.rounds[1].built.signals
    assert [signal.code for signal in lost if signal.severity == "error"] == ["lost", "lost"]


def test_a_moving_part_of_the_photo_is_required():
    script = ScriptedModel(written(DOORLESS), written(GOOD), *verdict(9, accept=True))
    assert synthesised(script).text.strip() == GOOD.strip()
    assert "missing_joint" in script.requests[1].prompt


def test_an_open_part_enters_the_request_and_the_measured_box():
    # In the photo the door is open by half of 1.6 rad, so the box is deeper than the closed one.
    spec = synthesised(ScriptedModel(written(GOOD), *verdict(9, accept=True))).spec
    assert spec is not None
    low, high = bounds(spec, {"hinge": 0.8})
    part = PartState(part="door", type="revolute", opening=0.5)
    box = Box3D(position=(2, 0.3, 0), size=tuple((high - low).tolist()), yaw=3.0)
    script = ScriptedModel(written(GOOD), *verdict(9, accept=True))
    outcome = synthesised(script, UNJUDGED, box3d=box, articulation=(part,))
    assert outcome.signals == ()
    assert (
        "with door at 50% of the range as in the photo (draw all joints at 0"
        in script.requests[0].prompt
    )
    closed = ScriptedModel(written(GOOD), written(GOOD))
    wrong = synthesised(closed, UNJUDGED, box3d=box)
    assert {signal.code for signal in wrong.signals} == {"proportions", "wrong_size"}
    assert "box, measured in the photo: " in closed.requests[0].prompt


def test_a_revision_is_requested_with_the_picture_of_what_the_program_builds():
    better = GOOD.replace("'oak'", "'pine'")
    script = ScriptedModel(written(GOOD), *verdict(5), written(better), *verdict(9, accept=True))
    synthesised(script)
    judged, revised = script.requests[1], script.requests[3]
    assert [picture.label for picture in revised.pictures] == ["crop", "made"]
    assert revised.pictures[1].data == judged.pictures[1].data
    assert 'The picture "made" shows what it builds.' in revised.prompt


def test_a_programmer_may_correct_the_measured_box():
    flat = GOOD.replace("0.6, 0.6", "0.6, 0.3").replace("(0, 0, 0.3)", "(0, 0, 0.15)")
    answer = written(flat).model_copy(update={"box": [0.4, 0.6, 0.3]})
    outcome = synthesised(ScriptedModel(answer, *verdict(9, accept=True)))
    assert outcome.size == (0.4, 0.6, 0.3)
    assert outcome.signals == ()
    absurd = written(GOOD).model_copy(update={"box": [0.4, 0.6, 6.0]})
    kept = synthesised(ScriptedModel(absurd, *verdict(9, accept=True)))
    assert kept.size is None
    assert "a factor of over 4" in kept.fallbacks[0][1]


def test_the_built_object_is_rendered_in_the_frame_of_its_crop():
    spec = synthesised(ScriptedModel(written(GOOD), *verdict(9, accept=True))).spec
    assert spec is not None
    camera = Camera(width=640, height_px=480, fovy=0.8, height=1.2, pitch=0.4, roll=0.1)
    obj = node()
    corners, _ = camera.project(obj.box3d.corners())
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    window = (float(x0) - 40, float(y0) - 20, float(x1) + 40, float(y1) + 20)
    crop = Picture("crop", np.full((round(window[3] - window[1]), 300, 3), 70, np.uint8))
    (picture,) = views.compare(crop, spec, obj, camera, window)
    assert picture.label == "compared"
    image = picture.rgb.astype(int)
    half = (image.shape[1] - views.GAP_PX) // 2
    scale = half / (window[2] - window[0])
    assert max(half, image.shape[0]) == views.HALF_PX
    assert image.shape[0] == round((window[3] - window[1]) * scale)
    assert (image[:, :half] == 70).all()  # The crop fills its half.
    # The cabinet's brown reaches from edge to edge of its projected box, and not beyond.
    image = image[:, -half:]
    brown = image[..., 0] > image[..., 2] + 15
    columns, rows = (np.flatnonzero(brown.any(axis=axis)) for axis in (0, 1))
    assert columns[[0, -1]] == pytest.approx([40 * scale, half - 40 * scale], abs=4)
    assert rows[[0, -1]] == pytest.approx([20 * scale, image.shape[0] - 20 * scale], abs=4)
    # What reaches beyond the crop is shown, with the crop's frame; the crop keeps its place.
    cut = (window[0], window[1], (window[0] + window[2]) / 2, window[3])
    (wider,) = views.compare(crop, spec, obj, camera, cut)
    half = (wider.size[0] - views.GAP_PX) // 2
    left, right = wider.rgb[:, :half], wider.rgb[:, -half:]
    assert (right == 255).all(axis=2).sum() > wider.size[1]
    shown = np.flatnonzero((left[half // 8] == 70).all(axis=1))
    framed = np.flatnonzero((right[half // 8] == 255).all(axis=1))
    assert shown[-1] == pytest.approx(framed[-1], abs=2) and shown[-1] < 0.7 * half
    assert (left[:, -1] == views.AROUND).all()
    # What would not be in the picture at all is drawn by itself.
    apart = views.compare(crop, spec, obj, camera, (0.0, 0.0, 10.0, 10.0))
    assert apart[0] is crop and apart[1].pixels == draw(spec, obj, camera).pixels
    assert not views.why_apart(spec, obj, camera, window)
    assert "the crop shows 0%" in views.why_apart(spec, obj, camera, (0.0, 0.0, 10.0, 10.0))
    assert "unknown" in views.why_apart(spec, obj, None, window)
    inside = obj.model_copy(
        update={"box3d": obj.box3d.model_copy(update={"position": (0.0, 0.0, 0.5)})}
    )
    assert "to the camera" in views.why_apart(spec, inside, camera, window)


def test_the_best_round_wins_over_the_last():
    worse = GOOD.replace("material='oak'", "material='steel', mass=3")
    script = ScriptedModel(written(GOOD), *verdict(7), written(worse), *verdict(4))
    outcome = synthesised(script)
    assert outcome.text.strip() == GOOD.strip()
    assert "too thin" in script.requests[3].prompt
    assert [attempt.stage for attempt in outcome.rounds] == ["program", "revise"]


@pytest.mark.parametrize(
    ("label", "size", "geoms"),
    [("wooden table", (0.6, 1.2, 0.7), 5), ("kitchen counter", (0.6, 1.2, 0.03), 1)],
)
def test_slabs_are_programmed_without_a_model(
    label: str, size: tuple[float, float, float], geoms: int
):
    box = Box3D(position=(1, 0, 0), size=size)
    outcome = synthesised(
        ScriptedModel(), environment=True, parent=None, label=label, box3d=box, articulation=()
    )
    assert outcome.spec is not None and len(outcome.spec.parts[0].geoms) == geoms
    low, high = bounds(outcome.spec)
    assert np.allclose(high - low, size)


GEOMETRY = BODY + DOOR
ARTICULATION = HINGE.format(sign=1).replace("o.revolute", "hinge = o.revolute")
EXPORT = "door.set_mass(4.0)\nhinge.set_dynamics(damping=0.4)\n"
THREE = ProgramOptions(stages="three", debug_rounds=1, critic_rounds=1)
EXPORT_GOOD = ExportCritique(masses=9, dynamics=8, verdict="accept")
IN_THREE = [
    *(written(GEOMETRY), shape_verdict(9, accept=True)),
    *(written(ARTICULATION), JOINTS_GOOD),
    *(written(EXPORT), EXPORT_GOOD),
]


def test_three_stages_are_requested_in_turn_and_form_one_program():
    script = ScriptedModel(*IN_THREE)
    outcome = synthesised(script, THREE)
    assert [request.name.split(":")[0] for request in script.requests] == [
        *("geometry", "judge-geometry", "articulation", "judge-articulation"),
        *("export", "judge-export"),
    ]
    assert list(outcome.texts) == ["geometry", "articulation", "export"]
    assert GEOMETRY.strip() in script.requests[2].prompt
    assert "This is the articulation program" in script.requests[4].prompt
    labels = [picture.label for picture in script.requests[5].pictures]
    assert labels == ["crop", "exported", "opened"]
    assert "door: 4 kg" in script.requests[5].prompt
    spec = outcome.spec
    assert spec is not None and outcome.fallbacks == () and not outcome.signals
    assert spec.parts[1].mass == 4.0 and spec.joint("hinge").damping == 0.4
    # The texts joined are one program of the same meaning.
    one = build(GEOMETRY + ARTICULATION + EXPORT).spec
    assert one is not None and build(outcome.text).spec == spec == one


def test_a_failed_export_keeps_the_accepted_object():
    broken = written("door.set_mass(-1)\n")
    outcome = synthesised(ScriptedModel(*IN_THREE[:4], broken, broken), THREE)
    assert outcome.spec is not None and list(outcome.texts) == ["geometry", "articulation"]
    assert outcome.fallbacks[0][0] == "cabinet: no export program"
    assert "mass must be positive" in outcome.fallbacks[0][1]

import asyncio
import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import MissingAnswerError, ModelError
from neoworld_mjx.mllm import Picture
from neoworld_mjx.program import synthesise as module
from neoworld_mjx.program.ask import (
    ProgramAnswer,
    ProgramCritique,
    ProgramFault,
    Subject,
    judge_request,
    program_request,
)
from neoworld_mjx.program.synthesise import Programmed, unfenced
from neoworld_mjx.program.views import draw, opened_state, view_from
from neoworld_mjx.spec import Box2D, Box3D, Camera, PartState, TreeNode, bounds
from neoworld_mjx.spec.pose import from_axis_angle
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
        patch.setattr(module, "build", once(module.build, lambda text, options: text))
        patch.setattr(module, "draw", once(module.draw, drawn_by))
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


def written(text: str, *removed: str) -> ProgramAnswer:
    return ProgramAnswer(program=text, removed=list(removed))


def verdict(geometry: float, accept: bool = False) -> ProgramCritique:
    faults = (
        [] if accept else [ProgramFault(part="door", what="too thin", change="make it 3 cm thick")]
    )
    return ProgramCritique(
        geometry=geometry,
        articulation=8,
        colour=6,
        faults=faults,
        verdict="accept" if accept else "revise",
    )


def synthesised(
    script: ScriptedModel, options: ProgramOptions = OPTIONS, **more: Any
) -> Programmed:
    camera = Camera(width=640, height_px=480, fovy=0.8, height=1.2, pitch=0.4)
    return asyncio.run(module.synthesise(node(**more), crop(), script, options, camera=camera))


def test_a_good_program_takes_one_question_and_one_judgement():
    script = ScriptedModel(written(GOOD), verdict(9, accept=True))
    outcome = synthesised(script)
    assert outcome.spec is not None and outcome.signals == () and outcome.reason == ""
    assert [request.role for request in script.requests] == ["programmer", "critic"]
    labels = [picture.label for picture in script.requests[1].pictures]
    assert labels == ["crop", "made", "opened"]
    assert outcome.score == pytest.approx(0.5 * 9 + 0.3 * 8 + 0.2 * 6)
    assert "0.400 m (x, front to back)" in script.requests[0].prompt
    assert "door (revolute)" in script.requests[0].prompt


def test_signals_go_back_with_their_lines():
    script = ScriptedModel(written(BROKEN), written(GOOD), verdict(9, accept=True))
    outcome = synthesised(script)
    assert outcome.spec is not None and outcome.text.strip() == GOOD.strip()
    assert "line 5" in script.requests[1].prompt and BROKEN.strip() in script.requests[1].prompt


def test_a_code_fence_is_removed():
    assert unfenced("```python\nx = 1\n```") == "x = 1\n"
    assert unfenced("x = 1") == "x = 1\n"


def test_deleting_the_joint_is_no_repair():
    script = ScriptedModel(written(WRONG_WAY), written(DOORLESS), verdict(6, accept=True))
    outcome = synthesised(script, articulation=())
    assert outcome.spec is not None and outcome.text.strip() == WRONG_WAY.strip()
    assert outcome.fallbacks and "overlap_in_motion" in outcome.fallbacks[0][1]
    lost = outcome.rounds[1].built.signals
    assert [signal.code for signal in lost if signal.severity == "error"] == ["lost", "lost"]


def test_parts_named_as_removed_may_go():
    script = ScriptedModel(
        written(WRONG_WAY), written(DOORLESS, "door", "hinge"), verdict(6, accept=True)
    )
    outcome = synthesised(script, articulation=())
    assert outcome.spec is not None and outcome.spec.joints == ()


def test_a_moving_part_of_the_photo_is_required():
    script = ScriptedModel(written(DOORLESS), written(GOOD), verdict(9, accept=True))
    assert synthesised(script).text.strip() == GOOD.strip()
    assert "missing_joint" in script.requests[1].prompt


def test_asserts_of_the_program_may_not_go():
    checked = GOOD + "assert door.anchor('front')[0] < 0.3\n"
    script = ScriptedModel(
        written(checked), verdict(6), written(GOOD), written(checked), verdict(6.5)
    )
    outcome = synthesised(script)
    assert [a.stage for a in outcome.rounds] == ["program", "revise", "debug"]
    assert [s.code for s in outcome.rounds[1].built.signals] == ["lost"]
    assert "1 assert statements, this one has 0" in script.requests[3].prompt
    assert outcome.text.strip() == checked.strip()
    said = ScriptedModel(written(checked), verdict(6), written(GOOD, "assert"), verdict(7))
    assert synthesised(said).text.strip() == GOOD.strip()


def test_an_object_without_moving_parts_needs_no_joint():
    script = ScriptedModel(written(DOORLESS))
    outcome = synthesised(script, UNJUDGED, articulation=())
    assert outcome.spec is not None and outcome.spec.joints == () and outcome.signals == ()
    assert "moving parts seen: none noted" in script.requests[0].prompt
    assert "a thing without moving\nparts has none" in script.requests[0].system


def test_the_request_names_hidden_parts():
    class Half:
        data, note = crop(), "cut off at the left; the vase hides its foot"

    script = ScriptedModel(written(GOOD))
    asyncio.run(module.synthesise(node(), Half(), script, UNJUDGED))
    assert "the vase hides its foot: complete it as such things are" in script.requests[0].prompt
    assert "Draw also what cannot be seen but must be there" in script.requests[0].system


def test_an_open_part_enters_the_request_and_the_measured_box():
    # In the photo the door is open by half of 1.6 rad, so the box is deeper than the closed one.
    spec = synthesised(ScriptedModel(written(GOOD), verdict(9, accept=True))).spec
    assert spec is not None
    low, high = bounds(spec, {"hinge": 0.8})
    part = PartState(part="door", type="revolute", opening=0.5)
    box = Box3D(position=(2, 0.3, 0), size=tuple((high - low).tolist()), yaw=3.0)
    script = ScriptedModel(written(GOOD), verdict(9, accept=True))
    outcome = synthesised(script, UNJUDGED, box3d=box, articulation=(part,))
    assert outcome.signals == ()
    assert "with door 50% open as in the photo (draw it closed" in script.requests[0].prompt
    closed = ScriptedModel(written(GOOD), written(GOOD))
    wrong = synthesised(closed, UNJUDGED, box3d=box)
    assert {signal.code for signal in wrong.signals} == {"proportions", "wrong_size"}
    assert "measured box: " in closed.requests[0].prompt


@pytest.mark.parametrize(
    ("axis", "degrees", "words"),
    [
        ((0, 1, 0), 90, "tilted by 90 degrees, its top towards its own front"),
        ((0, 1, 0), -12, "tilted by 12 degrees, its top towards its own back"),
        ((1, 0, 0), -90, "tilted by 90 degrees, its top towards its own left"),
        ((1, 0, 0), 180, "it stands upside down"),
        ((0, 0, 1), 40, ""),
    ],
)
def test_programmer_and_critic_are_told_the_tilt(axis, degrees, words):
    tilt = tuple(from_axis_angle(axis, np.radians(degrees)).tolist())
    seen = node(base_tilt=tilt)
    asked = program_request(Subject(seen, Picture("crop", crop())))
    judged = judge_request(seen, [], {"parts": "-", "joints": "-"}, (1.0, 1.0, 1.0), OPTIONS)
    for request in (asked, judged):
        assert ("turned over" in request.prompt) == bool(words)
        assert words in request.prompt
    assert ("draw it upright" in asked.prompt) == bool(words)


def test_the_best_round_is_kept_not_the_last():
    worse = GOOD.replace("material='oak'", "material='steel', mass=3")
    script = ScriptedModel(written(GOOD), verdict(7), written(worse), verdict(4))
    outcome = synthesised(script)
    assert outcome.text.strip() == GOOD.strip()
    assert "too thin" in script.requests[2].prompt
    assert [attempt.stage for attempt in outcome.rounds] == ["program", "revise"]


def test_proportions_are_compared_with_the_box():
    flat = GOOD.replace("0.6, 0.6", "0.6, 0.3")
    script = ScriptedModel(written(flat), written(GOOD), verdict(9, accept=True))
    assert synthesised(script).text.strip() == GOOD.strip()
    assert "proportions" in script.requests[1].prompt


def test_a_program_that_cannot_be_built_gives_the_reason():
    outcome = synthesised(ScriptedModel(written("1 / 0"), written("1 / 0")))
    assert outcome.spec is None and "ZeroDivisionError" in outcome.reason


def test_a_failing_critic_is_a_fallback():
    outcome = synthesised(ScriptedModel(written(GOOD), ModelError("server is down")))
    assert outcome.spec is not None
    assert outcome.fallbacks == (("cabinet: no judge round", "server is down"),)


def test_a_missing_answer_is_no_fallback():
    with pytest.raises(MissingAnswerError):
        synthesised(ScriptedModel(written(GOOD), MissingAnswerError("no answer for judge:cabinet")))


@pytest.mark.parametrize(
    ("geometry", "articulation", "pictures"), [(True, False, 2), (False, True, 3)]
)
def test_each_critic_can_be_switched_off(geometry: bool, articulation: bool, pictures: int):
    options = OPTIONS.model_copy(
        update={"geometry_critic": geometry, "articulation_critic": articulation}
    )
    script = ScriptedModel(written(GOOD), verdict(9, accept=True))
    synthesised(script, options)
    assert len(script.requests[1].pictures) == pictures
    none = OPTIONS.model_copy(update={"geometry_critic": False, "articulation_critic": False})
    assert synthesised(ScriptedModel(written(GOOD)), none).spec is not None


@pytest.mark.parametrize(
    ("label", "size", "geoms"),
    [("wooden table", (0.6, 1.2, 0.7), 5), ("kitchen counter", (0.6, 1.2, 0.03), 1)],
)
def test_supports_are_made_without_a_model(
    label: str, size: tuple[float, float, float], geoms: int
):
    box = Box3D(position=(1, 0, 0), size=size)
    outcome = synthesised(
        ScriptedModel(), environment=True, parent=None, label=label, box3d=box, articulation=()
    )
    assert outcome.spec is not None and len(outcome.spec.parts[0].geoms) == geoms
    assert outcome.spec.materials[0].rgba[:3] == pytest.approx((0.784, 0.392, 0.196))
    low, high = bounds(outcome.spec)
    assert np.allclose(high - low, size)


def test_the_record_holds_all_rounds():
    import json

    outcome = synthesised(ScriptedModel(written(BROKEN), written(GOOD), verdict(9, accept=True)))
    data = json.loads(outcome.to_json())
    assert [one["stage"] for one in data["rounds"]] == ["program", "debug"]
    assert [one["kept"] for one in data["rounds"]] == [False, True]
    assert data["rounds"][1]["verdict"]["geometry"] == 9


def test_the_object_is_drawn_from_the_side_that_the_photo_shows():
    spec = synthesised(ScriptedModel(written(GOOD), verdict(9, accept=True))).spec
    assert spec is not None
    camera = Camera(width=640, height_px=480, fovy=0.8, height=1.2, pitch=0.4)
    item = node()
    view = view_from(spec, {}, item, camera)
    # The camera is at the world's origin; from the object, which faces it by 3.0 rad, it is
    # ahead and a little to the side.
    azimuth = np.arctan2(view.eye[1], view.eye[0])
    wanted = np.arctan2(-0.3, -2.0) - 3.0
    assert np.cos(azimuth - wanted) == pytest.approx(1, abs=0.02)
    first, second = (draw(spec, item, camera, opened=True) for _ in range(2))
    assert first.pixels == second.pixels and first.data == second.data
    assert draw(spec, item, camera).pixels != first.pixels
    assert isinstance(first, Picture) and opened_state(spec) == {"hinge": pytest.approx(1.28)}

import pytest

from neoworld_mjx.program import build

HEAD = (
    "from neoworld_mjx.program.sdk import Object, box, cylinder, hollow_box, lathe, sphere\n"
    "o = Object('thing')\n"
    "body = o.part('body', material='oak')\n"
)
FRAME = "body.add(hollow_box((0.4, 0.6, 0.6), 0.02, open='+x'), at=(0, 0, 0.3))\n"
DOOR = "door = o.part('door', material='oak')\n"
HUNG = HEAD + FRAME + DOOR + "door.add(box((0.02, 0.6, 0.6)), at=body.anchor('front'), by='back')\n"
HINGE = "o.revolute('hinge', body, door, at={at}, axis={axis}, range={range})\n"


def hinge(at: str = "door.anchor('left.back')", axis: str = "(0, 0, 1)", range: str = "(0, 1.6)"):
    return HUNG + HINGE.format(at=at, axis=axis, range=range)


def codes(text: str) -> set[str]:
    built = build(text)
    assert built.spec is not None, built.signals
    return {signal.code for signal in built.signals}


def test_a_valid_door_has_no_signals():
    assert codes(hinge()) == set()
    assert build(hinge()).ok


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (hinge(axis="(0, 0, -1)"), "overlap_in_motion"),
        (hinge(at="(0.2, 0.5, 0)"), "axis_off"),
        (hinge(range="(0, 0.001)"), "range_small"),
        (hinge(range="(0, 7)"), "range_large"),
        (hinge(range="(0.2, 1.6)"), "rest_outside"),
        (
            HEAD + FRAME + DOOR + "door.add(box((0.02, 0.6, 0.6)), at=(0.25, 0, 0.3))\n"
            "o.fixed('f', body, door)",
            "detached_part",
        ),
        (
            HEAD + FRAME + DOOR + "door.add(box((0.02, 0.6, 0.6)), at=(0.195, 0, 0.3))\n"
            "o.prismatic('s', body, door, axis=(1, 0, 0), range=(0, 0.2))",
            "overlap_at_rest",
        ),
        (HEAD + FRAME + "body.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.8))", "loose_shape"),
        (HEAD + "body.add(cylinder(0.15, 0.03), material='steel')", "too_heavy"),
        (HEAD + "body.add(cylinder(0.15, 0.03), material='steel', at=(30, 0, 0))\n", "too_heavy"),
        (HEAD + "body.add(box((30, 1, 1)))", "size"),
        (HEAD + "body.add(box((0.001, 0.001, 0.001)))", "size"),
    ],
)
def test_each_fault_has_its_signal(text: str, code: str):
    assert code in codes(text)


def test_depth_and_line_of_an_overlap():
    text = HEAD + FRAME + DOOR
    text += "door.add(box((0.02, 0.6, 0.6)), at=(0.205, 0, 0.3))\n"
    text += "o.prismatic('s', body, door, axis=(1, 0, 0), range=(0, 0.2))"
    (signal,) = build(text).signals
    assert signal.code == "overlap_at_rest"
    assert signal.value == pytest.approx(0.005, abs=1e-6)
    assert (signal.part, signal.line) == ("door", 5)


def test_combinations_of_joints_are_tried():
    text = HEAD + "body.add(box((0.02, 1, 0.4)), at=(0, 0, 0.2))\n"
    # Two flaps hinged at the ends, each free by itself: together they meet in the middle.
    for name, side, inner, sign in (("a", "left", "right", 1), ("b", "right", "left", -1)):
        text += (
            f"{name} = o.part('{name}', material='oak')\n"
            f"{name}.add(box((0.6, 0.02, 0.4)), at=body.anchor('{side}.front.bottom'), "
            f"by='{side}.back.bottom')\n"
            f"o.revolute('turn_{name}', body, {name}, at={name}.anchor('{inner}.back'), "
            f"axis=(0, 0, {-sign}), range=(0, 1))\n"
        )
    result = build(text).signals
    assert {signal.code for signal in result} == {"overlap_in_combination"}


def test_mimic_joints_move_in_the_sweep():
    text = HEAD + "body.add(box((0.1, 0.4, 0.02)), at=(0, 0, 0.01))\n"
    for name, y in (("a", 0.1), ("b", -0.1)):
        text += (
            f"{name} = o.part('{name}', material='oak')\n"
            f"{name}.add(box((0.1, 0.02, 0.1)), at=(0, {y}, 0.0201), by='bottom')\n"
        )
    text += "lead = o.prismatic('lead', body, a, axis=(0, -1, 0), range=(0, 0.08))\n"
    follow = "o.prismatic('follow', body, b, axis=(0, {sign}, 0), range=(0, 0.12), mimic=lead, "
    apart = text + follow.format(sign=1) + "multiplier=0.5)"
    meet = text + follow.format(sign=1) + "multiplier=1.5)"
    assert codes(apart) == set()
    assert codes(meet) == {"overlap_in_motion"}
    assert all("allow_overlap" in signal.hint for signal in build(meet).signals)


LID = HEAD + "steel = o.material('lid_steel', like='stainless_steel')\n"
KNOB = "body.add(cylinder(0.015, 0.03), at=(0, 0, {z}), by='bottom', material=steel)\n"


def test_a_solid_pot_lid_of_17_kg_is_an_error_and_a_shell_is_not():
    solid = LID + "body.add(lathe([(0.145, 0), (0.145, 0.02), (0.10, 0.04)]), material=steel)\n"
    result = build(solid + KNOB.format(z=0.035)).signals
    (heavy,) = [signal for signal in result if signal.code == "too_heavy"]
    assert "weighs 17" in heavy.message
    assert heavy.severity == "error" and "shell" in heavy.hint and heavy.line == 3
    shell = LID + (
        "body.add(lathe([(0.15, 0), (0.15, 0.02), (0.10, 0.04), (0.012, 0.045)], 0.001), "
        "material=steel)\n"
    )
    assert codes(shell + KNOB.format(z=0.043)) == set()


PANEL = "body.add(box((0.01, 0.1, 0.1)), at=({x}, 0, 0.1), material={material!r})\n"


@pytest.mark.parametrize(
    ("x", "material", "warned"),
    [
        (0.195, "steel", True),  # ends at the front of the block, x = 0.2
        (0.1955, "steel", False),  # stands out by half a millimeter
        (0.195, "oak", False),  # of one material
        (0.15, "steel", False),  # inside
    ],
)
def test_faces_of_two_materials_in_one_plane_are_named(x: float, material: str, warned: bool):
    text = HEAD + "body.add(box((0.4, 0.6, 0.6)), by='bottom')\n"
    built = build(text + PANEL.format(x=x, material=material))
    found = [signal for signal in built.signals if signal.code == "coplanar_faces"]
    assert bool(found) == warned
    if warned:
        assert found[0].severity == "warning"
        assert "body_0 (oak) and body_1 (steel)" in found[0].message
        assert "at the front" in found[0].message

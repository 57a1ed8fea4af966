import json
import math
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest
from neoworld_mjx.view.report.changes import changes
from neoworld_mjx.view.report.charts import Series, bars, line_chart, nice_ticks
from PIL import Image

from neoworld_mjx.checks.verdict import Verdict
from neoworld_mjx.config import Config, load_config
from neoworld_mjx.errors import RunError
from neoworld_mjx.refinement import rounds
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.view.report import convergence
from neoworld_mjx.view.report.run_report import write_report
from tests.support import scenes

EVIL = '<script>alert("x")</script><img src=http://evil/a.png>'


def _tree(label="a saucer"):
    camera = {"width": 60, "height_px": 40, "fovy": 0.8, "height": 0.4, "pitch": 0.6, "roll": 0.0}
    box = {"position": [0.4, 0, 0], "size": [0.15, 0.15, 0.02], "yaw": 0.5}
    node = {"name": "saucer", "label": label, "parent": "table", "relation": "on", "box3d": box}
    return {"camera": camera, "nodes": [node | {"articulation": []}]}


def _scene():
    joint = {
        **{"name": "lid_hinge", "type": "revolute", "parent": "body", "child": "lid"},
        **{"axis": [0, 1, 0], "lower": 0.0, "upper": 1.5707963, "damping": 0.01},
    }
    obj = {"name": "jar", "parent": "table", "xy": [0.1, 0.02], "z": 0.0, "yaw": 0.1}
    obj |= {"scale_residual": [0.0, 0.1, -0.05], "spec": {"joints": [joint]}}
    return {"objects": [obj | {"joint_state": {"lid_hinge": 0.7853982}}]}


def _history(path, iterations=5, population=16, objects=3):
    draw = np.random.default_rng(0)
    shape = (iterations, population)
    absolute = draw.normal(size=shape) * 0.2 + np.linspace(-2, 0.5, iterations)[:, None]
    absolute[:, 0] = -np.inf
    np.savez(
        path,
        xy=np.zeros((*shape, objects, 2)),
        yaw=np.zeros((*shape, objects)),
        log_scale=np.full((*shape, objects), -0.02),
        reward=absolute,
        absolute=absolute,
        d_pen=np.abs(draw.normal(size=shape)) * 1e-3,
        d_drift=np.abs(draw.normal(size=shape)),
        s_sem=draw.uniform(size=shape),
        status=np.zeros(shape, int),
        valid=draw.uniform(size=shape) < np.linspace(0.1, 0.9, iterations)[:, None],
        object_names=np.array(["cup", "saucer", "spoon"][:objects]),
    )


@pytest.fixture
def finished(tmp_path):
    """A complete run folder with synthetic files."""
    out = tmp_path / "out"
    with RunFolder(out, load_config(None, {"refine": {"cem": {"population": 16}}})) as run:
        with run.step("parse", {}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text(json.dumps(_tree()))
            Image.new("RGB", (60, 40), "teal").save(stage / "photo.png")
            (stage / "pictures").mkdir()
            Image.new("RGB", (60, 40), "tan").save(stage / "pictures" / "parse.png")
        with run.step("verify/jar", {}) as stage:
            assert stage is not None
            (stage / "objects" / "jar").mkdir(parents=True)
            fell = {"name": "drift", "value": 0.0021, "threshold": 0.01, "unit": "m"}
            fell |= {"scenario": "free_fall", "outcome": "PASS"}
            pushed = {"scenario": "force_perturbation", "name": "energy", "outcome": "SKIP"}
            result = {"object": "jar", "passed": True, "mass_kg": 0.3, "checks": [fell, pushed]}
            verdict = Verdict.model_validate(result)
            (stage / "objects" / "jar" / "verify.json").write_text(verdict.to_json())
        with run.step("compose", {}) as stage:
            assert stage is not None
            (stage / "scene.json").write_text(json.dumps(_scene()))
        with run.step("refine", {}) as stage:
            assert stage is not None
            (stage / "refine").mkdir()
            _history(stage / "refine" / "history.npz")
        run.fallback("refine", "native", "no GPU here")
        before = {"depths_m": {"cup|saucer": 0.004}, "drift_m": {"cup": 0.05}}
        run.record("metrics", s_pen=0, max_depth_m=0.0, s_stab=True, max_drift_m=0.0004)
        run.record("metrics", max_tilt_deg=0.1, mean_log_scale=-0.01, objects=4, movable=3)
        run.record("metrics", depths_m={}, drift_m={"cup": 0.0004}, tilt_deg={"cup": 0.1})
        run.record("metrics", before=before)
        ious = {"parsed": 0.9, "composed": 0.8, "refined": 0.85}
        objects = {"cup": ious | {"parsed": None, "refined": 0.61}, "jar": ious}
        worst = {"name": "cup", "value": 0.61}
        run.record("metrics", box_iou=ious | {"worst": worst, "objects": objects})
        run.finish()
    return out


class _Page(HTMLParser):
    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.links = [], [], []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def _words(html):
    return " ".join(re.sub(r"<style>.*?</style>|<[^>]+>", " ", html, flags=re.S).split())


def test_a_whole_run_shows_its_numbers_pictures_and_verdicts(finished):
    html = write_report(finished).read_text()
    page, words = _Page(html), _words(html)
    assert page.tags.count("img") >= 2
    assert page.tags.count("polyline") >= 6
    for message in (
        *("1 fallback was used", "refine : native — no GPU here", "0.40 mm", "limit 10 mm in 2 s"),
        *("free fall drift 2.1 mm ≤ 10.0 mm ✓ pass", "cup – saucer 4.00 0.00 ✓ pass", "stable"),
        "force perturbation energy skipped",
        "cup 50.00 0.40 0.10°",
        "mean 0.90 0.80 0.85 cup 0.80 0.61 jar 0.90 0.80 0.85",
        *("lid_hinge revolute body → lid (0.00, 1.00, 0.00) 0 to 90 ° 45 °", "a saucer"),
        *("refine.cem.population 16 64", "+0 / +10 / -5", "3 movable objects of 4"),
    ):
        assert message in words, message


def test_the_page_loads_nothing_from_the_network(finished):
    html = write_report(finished).read_text()
    assert all(link.startswith("data:image/") for link in _Page(html).links)
    assert "script" not in _Page(html).tags
    assert not re.search(r"url\(|@import|https?://", html)


def test_failed_numbers_are_shown_as_failed(finished):
    with RunFolder(finished, Config(), "resume") as run:
        run.record("metrics", s_pen=1, max_depth_m=0.005, s_stab=False, max_drift_m=float("nan"))
    html = write_report(finished).read_text()
    assert 'class="value bad">5.00 mm' in html
    assert 'class="value bad">not stable' in html
    assert 'class="value bad">unknown' in html


def test_failing_objects_are_listed_in_the_header_and_their_rows_are_open(finished):
    with RunFolder(finished, Config(), "resume") as run:
        run.record("metrics", passed=False, drift_m={"cup": 0.0004, "jar": 0.05})
        run.record("metrics", depths_m={"jar|cup": 0.004})
        run.data["status"] = "finished"
    html = write_report(finished).read_text()
    head, _, rest = html.partition("</header>")
    assert 'class="good"' not in head
    reasons = "jar penetrates cup by 4.00 mm (limit 1.00 mm), moves by 50.00 mm (limit 10.00 mm)"
    assert f"Not valid: {reasons}" in _words(head) and "but the scene is not valid" in _words(head)
    assert '<details class="object" open>' in rest
    assert "1 of 1 fail" in _words(rest)


def test_failed_object_tests_of_a_valid_scene_are_explained_and_bounds_have_a_direction(
    finished,
):
    path = next((finished / "objects").glob("*/verify.json"))
    verdict = json.loads(path.read_text())
    check = {
        "scenario": "joint_drive", "name": "drive:lid", "outcome": "FAIL", "value": 0.5,
        "threshold": 0.9, "unit": "of its range",
    }  # fmt: skip
    verdict |= {"passed": False, "checks": [*verdict["checks"], check]}
    path.write_text(json.dumps(verdict))
    with RunFolder(finished, Config(), "resume") as run:
        run.record("metrics", passed=True)
    words = _words(write_report(finished).read_text())
    assert "1 of 1 fail the object tests, in which each object is simulated alone; the" in words
    assert "joint drive drive:lid 50 % of its range ≥ 90 % of its range" in words


def test_values_of_checks_have_the_digits_that_the_terminal_shows(finished):
    path = next((finished / "objects").glob("*/verify.json"))
    verdict = json.loads(path.read_text())
    given = [
        ("tilt", "FAIL", 8.215548565693807, 5.0, "deg"),
        ("resting_speed:fall", "PASS", 7.156e-08, 0.01, "m/s"),
        ("drive:lid", "PASS", 11.2618, 0.9, "of its range"),
    ]
    verdict["checks"] = [
        {
            "scenario": "free_fall", "name": name, "outcome": outcome, "value": value,
            "threshold": threshold, "unit": unit,
        }
        for name, outcome, value, threshold, unit in given
    ]  # fmt: skip
    path.write_text(json.dumps(verdict))
    words = _words(write_report(finished).read_text())
    assert "free fall tilt 8.2 degrees ≤ 5.0 degrees" in words
    assert "free fall resting speed:fall 0 m/s ≤ 0.01 m/s" in words
    assert "free fall drive:lid 1126 % of its range ≥ 90 % of its range" in words


def test_a_row_shows_photograph_and_render_in_one_frame(finished):
    tree = _tree()
    jar = tree["nodes"][0] | {"name": "jar", "box2d": {"x0": 20, "y0": 10, "x1": 40, "y1": 30}}
    (finished / "tree.json").write_text(json.dumps(tree | {"nodes": [jar]}))
    (finished / "pictures").mkdir(exist_ok=True)
    Image.new("RGB", (120, 80), "red").save(finished / "pictures" / "after.png")
    with RunFolder(finished, Config(), "resume") as run:
        ious = {"parsed": 0.9, "composed": 0.8, "refined": 0.85}
        run.record("metrics", passed=True, box_iou=ious | {"objects": {"jar": ious}})
        run.data["status"] = "finished"
    html = write_report(finished).read_text()
    row = html.partition('<details class="object">')[2].partition("</summary>")[0]
    assert row.count("data:image/jpeg") == 2
    assert "parsed cuboid 0.90, composed 0.80, refined 0.85" in _words(row)
    assert "finished, valid" in _words(html)


def test_allowed_overlaps_are_listed_with_their_reason(finished):
    home = next((finished / "objects").iterdir())
    signal = {
        "severity": "warning",
        "code": "allowed_overlap",
        "message": "'body' and 'lid' may enter each other: the rebate <of the lid>",
        "value": 0.004,
        "threshold": 0.001,
    }
    (home / "program.json").write_text(json.dumps({"signals": [signal]}))
    page = write_report(finished).read_text()
    assert "allowed overlap" in page and "the rebate &lt;of the lid&gt;" in page
    assert "0.004" in page


def test_unstable_objects_of_the_composed_scene_are_listed_in_the_header(finished):
    assert "not stay" not in _words(write_report(finished).read_text())
    phrase = "frame falls 1.6 m: it is attached to wall, but not fastened there"
    (finished / "compose").mkdir(exist_ok=True)
    text = json.dumps({"unstable": [{"phrase": phrase}]})
    (finished / "compose" / "check.json").write_text(text)
    head = write_report(finished).read_text().partition("</header>")[0]
    assert f"Before the search 1 object does not stay in place: {phrase}" in _words(head)


def test_borderline_checks_and_critic_findings_are_listed(finished):
    check = {"scenario": "static", "name": "part_depth:a:b", "outcome": "PASS", "value": 0.002}
    reported = {
        "passed": True,
        "checks": [
            {**check, "evidence": "a and b, granted: a groove"},
            {**check, "doubtful": True, "evidence": "run fall"},
        ],
        "seen": ["door: rattles"],
    }
    (finished / "objects" / "jar" / "verify.json").write_text(json.dumps(reported))
    page = write_report(finished).read_text()
    assert page.count("pass</span>, borderline") == 1
    assert "a and b, granted: a groove" in page
    assert "door: rattles" in page


def test_text_from_models_is_escaped(finished):
    (finished / "tree.json").write_text(json.dumps(_tree(label=EVIL)))
    (finished / "objects" / "jar" / "verify.json").write_text(
        json.dumps(
            {
                "passed": False,
                "checks": [
                    {"name": EVIL, "value": EVIL, "hint": EVIL},
                    {"name": "x", "outcome": "PASS", "doubtful": True, "evidence": EVIL},
                ],
                "seen": [EVIL],
            }
        )
    )
    with RunFolder(finished, Config(), "resume") as run:
        run.fallback(EVIL, EVIL, EVIL)
        run.record("mllm", provider=EVIL, by_role_and_model=[{"model": EVIL}])
        run.record("device", engine=EVIL)
    html = write_report(finished).read_text()
    assert "<script" not in html
    assert "evil/a.png" in html
    assert all(link.startswith("data:") for link in _Page(html).links)


def test_the_report_of_an_unfinished_run_names_what_is_missing(tmp_path):
    with RunFolder(tmp_path / "out", Config()) as run:
        with run.step("parse", {}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text(json.dumps(_tree()))
        run.finish(until="parse")
    html = write_report(tmp_path / "out").read_text()
    words = _words(html)
    assert "stopped after parse" in words
    assert "No refine/history.npz yet." in words
    assert "No objects yet." in words
    assert "finished steps: parse" in words
    _Page(html)


def test_damaged_files_affect_only_their_section(finished):
    (finished / "refine" / "history.npz").write_bytes(b"PK\x03\x04 not a zip")
    (finished / "tree.json").write_text('{"nodes": [{"name": "cup"}], "camera": 3}')
    (finished / "scene.json").write_text("{half")
    (finished / "photo.png").write_bytes(b"no picture")
    words = _words(write_report(finished).read_text())
    assert "refine/history.npz cannot be read" in words
    assert "A file of this run has an unexpected structure: KeyError" in words
    assert "photo.png cannot be read" in words
    assert "4.00 0.00 ✓ pass" in words


def _place(evidence, reason="", **change):
    deviations = {"along": 0.0064, "across": 0.0012, "yaw": 0.03, "log_scale": 0.031}
    known = {name: change.pop(name, value) for name, value in deviations.items()}
    place = {"evidence": evidence, "reason": reason, "shift_m": [0.003, -0.004], "yaw_deg": 3.549}
    return place | {"size_ratio": 0.9926} | change | {"uncertainty": known}


def _align(folder, objects, **more):
    unmoved = dict.fromkeys(("pitch_deg", "roll_deg", "fovy_deg", "height_m"), 0.0)
    (folder / "compose").mkdir(exist_ok=True)
    text = json.dumps(unmoved | more | {"objects": objects})
    (folder / "compose" / "align.json").write_text(text)


def _photograph(folder):
    """Return the words of the section on the alignment; empty if there is none."""
    html = write_report(folder).read_text()
    _Page(html)
    section = html.partition("<h2>The photograph</h2>")[2].partition("</section>")[0]
    return _words(section)


def test_openings_of_joints_are_listed(finished):
    joint = {"value": 0.121, "change": 0.014, "deviation": 0.004}
    phrase = "opens 12.1 cm, 1.4 cm more than composed (± 0.4 cm)"
    chest = _place("pixels", joints={"slide_2": joint | {"phrase": phrase}})
    _align(finished, {"chest": chest, "cup": _place("pixels")})
    assert f"chest: slide_2 {phrase}." in _photograph(finished)


def test_the_alignment_with_the_photograph_is_shown(finished):
    objects = {
        "cup": _place("pixels"),
        "jar": _place("box", "it is see-through", yaw=0.0472, yaw_deg=0.0001),
        "lid": _place("none", "it has no visible contour", yaw=0.0471, across=0.0004),
        "clock": _place("pixels", along=0.0, across=0.00002, yaw=1e-4, yaw_deg=0.0),
    }
    _align(finished, objects, pitch_deg=0.36, roll_deg=-0.64, fovy_deg=-0.01, height_m=0.0043)
    Image.new("RGB", (120, 40), "green").save(finished / "pictures" / "outlines.png")
    words = _photograph(finished)
    for message in (
        "Outlines of the composed scene, orange, and of the aligned scene, green",
        "pitch (down) by +0.4°, its roll by -0.6°, its vertical field of view by 0.0° and its "
        "height by +4 mm.",
        "cup pixels 5 +4 -1 along the view ±6 mm, across ±1 mm, heading ±2°, size ±3 %",
        "jar 2D box: it is see-through 5 0 -1 along the view ±6 mm, across ±1 mm, heading not seen",
        "lid composition: it has no visible contour 5.0 +4 -1 along the view ±6 mm, "
        "across ±0.4 mm, heading ±3°, size ±3 %",
        "clock pixels 5.0 0.0 -1 along the wall ±0.1 mm, size ±3 %",
    ):
        assert message in words, message


def test_the_evidence_of_the_pixels_is_shown_with_each_outline_s_distance(finished):
    outlines = {
        "cup": {"composed": 6.14, "aligned": 0.72},
        "jar": {"composed": 3.0, "aligned": None},
    }
    _align(finished, {name: _place("pixels") for name in outlines}, outlines_px=outlines)
    Image.new("RGB", (120, 40), "green").save(finished / "pictures" / "evidence.png")
    words = _photograph(finished)
    assert "Pixels of the aligned scene: green where" in words
    assert "cup pixels 5 +4 -1 6.1 0.7 along" in words
    assert "jar pixels 5 +4 -1 3.0 unknown along" in words
    assert "Outline off: median distance" in words


def test_a_camera_that_the_alignment_leaves_is_not_listed(finished):
    _align(finished, {"cup": _place("pixels")}, height_m=-0.0001)
    words = _photograph(finished)
    assert "The alignment did not change the camera." in words
    assert "not there yet" in words


@pytest.mark.parametrize(
    ("on", "words"),
    [
        (["cup"], "The photograph itself is printed on flat faces of cup."),
        (["cup", "jar", "lid"], "printed on flat faces of cup, jar, lid."),
        ([], None),
    ],
)
def test_the_objects_that_carry_the_photographs_print_are_named(finished, on, words):
    _align(finished, {"cup": _place("pixels")})
    objects = [
        {"name": name, "spec": {"materials": [{}, {"photo": {} if name in on else None}]}}
        for name in ("cup", "jar", "lid")
    ]
    (finished / "compose" / "scene.json").write_text(json.dumps({"objects": objects}))
    said = _photograph(finished)
    assert words in said if words else "printed" not in said


def test_a_run_without_alignment_has_no_section_about_it(finished):
    assert _photograph(finished) == ""
    _align(finished, {})
    assert "Nothing was aligned" in _photograph(finished)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{half", "compose/align.json cannot be read"),
        ("[]", "compose/align.json cannot be read"),
        ("{}", "unexpected structure: KeyError"),
        ('{"objects": {"cup": {}}}', "unexpected structure: KeyError"),
        (
            '{"pitch_deg": 0, "roll_deg": 0, "fovy_deg": 0, "height_m": 0, '
            '"objects": {"cup": {"uncertainty": 3}}}',
            "unexpected structure: TypeError",
        ),
    ],
)
def test_a_damaged_alignment_affects_only_its_section(finished, text, message):
    (finished / "compose").mkdir(exist_ok=True)
    (finished / "compose" / "align.json").write_text(text)
    assert message in _photograph(finished)
    assert "4.00 0.00 ✓ pass" in _words(write_report(finished).read_text())


def test_text_of_the_alignment_is_escaped(finished):
    _align(finished, {EVIL: _place("box", EVIL)})
    html = write_report(finished).read_text()
    assert "<script" not in html
    assert html.count("evil/a.png") == 2
    _align(finished, {"cup": _place(EVIL)})
    assert "<script" not in write_report(finished).read_text()


def test_large_pictures_are_reduced(finished):
    noise = np.random.default_rng(0).integers(0, 255, (1500, 2000, 3), np.uint8)
    Image.fromarray(noise).save(finished / "photo.png")
    assert write_report(finished).stat().st_size < 2_500_000


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="not a run folder"):
        write_report(tmp_path)


@pytest.mark.parametrize(
    "values",
    [[1.0], [2.0, 2.0, 2.0], [np.nan, np.inf], [0.0, np.nan, 3.0, -1e-9], [1e9, 1e-9, -1e9]],
)
def test_charts_are_well_formed_and_stay_inside(values):
    drawn = line_chart([Series("<a>", np.array(values))], y_label="y & z")
    root = ET.fromstring(drawn)
    for circle in root.iter("circle"):
        assert 0 <= float(circle.get("cx", "nan")) <= 460
        assert 0 <= float(circle.get("cy", "nan")) <= 260
    assert len(list(root.iter("circle"))) == np.isfinite(values).sum()


def test_bars_are_proportional():
    root = ET.fromstring(bars([("a", 1.0), ("b", 2.0)], "s"))
    a, b = (float(rect.get("width", "nan")) for rect in root.iter("rect"))
    assert b == pytest.approx(2 * a, rel=0.01)


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1.0), (-3.2, 0.7), (0.00012, 0.00013), (5.0, 9000.0)]
)
def test_ticks_are_round_and_cover(low, high):
    ticks = nice_ticks(low, high)
    assert 2 <= len(ticks) <= 8
    assert ticks[0] <= low + 1e-12
    assert ticks[-1] >= high - 1e-12
    steps = np.diff(ticks)
    assert np.allclose(steps, steps[0])


def test_every_reward_term_is_shown_by_name(tmp_path):
    path = tmp_path / "history.npz"
    _history(path, iterations=3, population=8)
    with np.load(path) as data:
        history = {key: data[key] for key in data.files}
    words = _words(str(convergence.convergence(path)))
    assert "S_sem" in words and "weight" not in words and "upright" not in words
    history["term_names"] = np.array(["d_pen", "s_sem", "upright"])
    history["term_weights"] = np.array([1.0, 2.0, 0.25])
    history["upright"] = np.full((3, 8), 0.625)
    np.savez(path, **history)
    words = _words(str(convergence.convergence(path)))
    assert "upright, weight 0.25" in words and "S_sem, weight 2" in words
    assert "D_drift" not in words
    assert "s_sem of best upright of best" in words and "0.625" in words


def test_failed_candidates_are_counted(tmp_path):
    assert convergence.NOT_SAMPLED == rounds.NOT_SAMPLED
    path = tmp_path / "history.npz"
    _history(path, iterations=2, population=8)
    with np.load(path) as data:
        history = {key: data[key] for key in data.files}
    history["absolute"][:] = 0.1
    history["status"] = np.zeros((2, 8), int)
    history["status"][0, 3:] = rounds.NOT_SAMPLED
    history["absolute"][0, 3:] = history["absolute"][1, 0] = -np.inf
    np.savez(path, **history)
    page = str(convergence.convergence(path))
    rows = re.findall(r"<tr>(.*?)</tr>", page, re.S)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.S) for row in rows]
    first, second = [c for c in cells if c][-2:]
    assert first[3] == "3" and first[5] == "0"
    assert second[3] == "8" and second[5] == "1"


def _change(name, place, scale=1.0, refused=""):
    box = {"position": [0.5, 0.1, 0.0], "size": [0.1, 0.2, 0.3], "yaw": 0.5}
    change = {"before": box, "after": box, "distance_m": place, "size_ratio": [scale] * 3}
    change |= {"yaw_deg": 0.0, "hidden": [False, True, False, False], "refused": refused}
    return {name: change}


def test_changes_by_each_step_are_listed(tmp_path):
    """The accepted round is shown; the column of an unfinished step is empty."""
    said = _change("cup", 0.0123, 0.95) | _change("jug", 0.0, refused="checks would report gap_m")
    rounds = [
        {"kept": False, "fit": {"objects": _change("cup", 0.9)}},
        {"kept": True, "fit": {"objects": said}},
    ]
    (tmp_path / "parse.json").write_text(json.dumps({"rounds": rounds}))
    table = changes(tmp_path)
    assert "50.0, 10.0, 0.0" in table
    assert "1.2 cm, -5.0 %, +0.0°" in table
    assert "90.0 cm" not in table
    assert "unchanged: the fit was rejected" in table
    (tmp_path / "compose").mkdir()
    refit = {"objects": _change("cup", 0.0) | _change("jug", 0.02)}
    (tmp_path / "compose" / "fit.json").write_text(json.dumps(refit))
    before = scenes.coffee()
    moved = [
        obj.model_copy(update={"xy": (obj.xy[0] + 0.01, obj.xy[1]), "yaw": obj.yaw + 0.1})
        if obj.name == "cup"
        else obj
        for obj in before.objects
    ]
    after = before.model_copy(update={"objects": tuple(moved)})
    (tmp_path / "compose" / "scene.json").write_text(before.to_json())
    (tmp_path / "scene.json").write_text(after.to_json())
    table = changes(tmp_path)
    assert "2.0 cm, +0.0 %, +0.0°" in table
    assert "1.0 cm, +0.0 %, +5.7°" in table
    assert ">top<" in table


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"base_tilt": (math.cos(0.1), math.sin(0.1), 0.0, 0.0)},
            ">0.0 cm, +0.0 %, +0.0°, 11.5° wit",
        ),
        ({"xy": (0.0004, 0.0)}, ">unchanged<"),
    ],
)
def test_a_search_that_tips_an_object_is_stated_and_one_below_the_last_digit_is_not(
    tmp_path, change, words
):
    rounds = [{"kept": True, "fit": {"objects": _change("cup", 0.0123, 0.95)}}]
    (tmp_path / "parse.json").write_text(json.dumps({"rounds": rounds}))
    (tmp_path / "compose").mkdir()
    before = scenes.coffee()
    cup = before.object("cup")
    start = cup.model_copy(update={"xy": (0.0, 0.0)})
    end = start.model_copy(update=change)
    for path, item in (("compose/scene.json", start), ("scene.json", end)):
        objects = tuple(item if o.name == "cup" else o for o in before.objects)
        scene = before.model_copy(update={"objects": objects})
        (tmp_path / path).write_text(scene.to_json())
    assert words in changes(tmp_path)


def test_objects_that_were_not_tested_do_not_pass(finished):
    """The report counts as passing only objects that were tested alone."""
    for name in ("cup", "saucer"):
        (finished / "objects" / name).mkdir(exist_ok=True)
    words = _words(write_report(finished).read_text())
    assert "2 of 3 were not tested alone" in words and "All 3 pass" not in words
    (finished / "objects" / "jar" / "verify.json").unlink()
    words = _words(write_report(finished).read_text())
    assert "3 of 3 were not tested alone" in words
    assert "the object tests, in which" not in words

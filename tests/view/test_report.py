"""The report of a run: verdict, checks, objects, agreement with the photograph, damaged files."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.checks.verdict import Verdict
from neoworld_mjx.config import Config, RefineOptions, load_config
from neoworld_mjx.errors import RunError
from neoworld_mjx.measure import measured, scene_checks
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.run_folder import RunFolder, read_run, verdict_line
from neoworld_mjx.view.report.run_report import write_report
from tests.support import scenes

EVIL = '<script>alert("x")</script><img src=http://evil/a.png>'


def _tree(label="a saucer"):
    camera = {"width": 60, "height_px": 40, "fovy": 0.8, "height": 0.4, "pitch": 0.6, "roll": 0.0}
    box = {"position": [0.4, 0, 0], "size": [0.15, 0.15, 0.02], "yaw": 0.5}
    node = {"name": "saucer", "label": label, "parent": "table", "relation": "on", "box3d": box}
    return {"camera": camera, "nodes": [node | {"articulation": []}]}


def _history(path, iterations=5, population=16):
    draw = np.random.default_rng(0)
    shape = (iterations, population)
    absolute = draw.normal(size=shape) * 0.2 + np.linspace(-2, 0.5, iterations)[:, None]
    absolute[:, 0] = -np.inf
    np.savez(
        path,
        reward=absolute,
        d_pen=np.abs(draw.normal(size=shape)) * 1e-3,
        d_drift=np.abs(draw.normal(size=shape)),
        s_sem=draw.uniform(size=shape),
        status=np.zeros(shape, int),
        valid=draw.uniform(size=shape) < np.linspace(0.1, 0.9, iterations)[:, None],
        term_names=np.array(["d_pen", "d_drift", "s_sem"]),
        term_weights=np.array([1.0, 1.0, 2.0]),
    )


def _scene_checks(**changes):
    """The checks of a stable scene, with other measures."""
    measure = measured(snap_exactly(scenes.blocks()), RefineOptions(check_duration_s=0.1))
    checks = scene_checks(measure.model_copy(update=changes), RefineOptions())
    return [check.to_json() for check in checks]


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
        with run.step("refine", {}) as stage:
            assert stage is not None
            (stage / "scene.json").write_text("{}")
            (stage / "refine").mkdir()
            _history(stage / "refine" / "history.npz")
        run.fallback("refine", "native", "no GPU here")
        run.record("metrics", objects=4, movable=3, passed=True, checks=_scene_checks())
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
    for message in (
        *("1 fallback was used", "refine : native — no GPU here", "valid: all 6 checks pass"),
        *("free fall: drift 2.1 mm, at most 10.0 mm", "force perturbation: energy"),
        *("tilt 0.0", "degrees, at most 5.0 degrees", "3 movable objects of 4"),
        "refine.cem.population 16 64",
    ):
        assert message in words, message


def test_a_run_that_is_not_valid_says_so_with_its_reasons_in_every_place(finished, capsys):
    """In the header, the table of checks, the rows of the objects, and the terminal."""
    checks = _scene_checks(
        max_drift_m=0.05,
        drift_m={"cup": 0.0004, "jar": 0.05},
        displacement={"cup": 0.2, "jar": 3.4},
    )
    reasons = [check["phrase"] for check in checks if not check["passed"]]
    assert reasons == [
        "jar: drift 50.0 mm, at most 10.0 mm",
        "jar: settled away from its place by 340 % of the limit, at most 100 % of the limit",
    ]
    with RunFolder(finished, Config(), "resume") as run:
        run.record("metrics", passed=False, checks=checks)
        run.data["status"] = "finished"
    html = write_report(finished).read_text()
    head, _, rest = html.partition("</header>")
    line = f"not valid: {'; '.join(reasons)}"
    assert line in _words(head) and 'class="good"' not in head
    assert all(f"✗ fail {reason}" in _words(rest) for reason in reasons)
    assert '<details class="object" open>' in rest and "1 of 1 fail" in _words(rest)
    assert verdict_line(read_run(finished)["metrics"]) == line


def test_checks_and_signals_of_objects_are_listed(finished):
    home = finished / "objects" / "jar"
    given = [
        ("joint_drive", "drive:lid", "FAIL", 0.5, 0.9, "of its range", {}),
        ("static", "part_depth", "PASS", 0.002, 0.003, "m", {"doubtful": True, "evidence": "x"}),
    ]
    keys = ("scenario", "name", "outcome", "value", "threshold", "unit")
    checks = [dict(zip(keys, row[:6], strict=True)) | row[6] for row in given]
    reported = {"passed": False, "checks": checks, "seen": ["door: rattles"]}
    (home / "verify.json").write_text(json.dumps(reported))
    signal = {"severity": "warning", "code": "allowed_overlap", "message": "a rebate <of the lid>"}
    (home / "program.json").write_text(json.dumps({"signals": [signal]}))
    html = write_report(finished).read_text()
    words = _words(html)
    assert "1 of 1 fail the object tests, in which each object is simulated alone; the" in words
    assert "drive:lid 50 % of its range, at least 90 % of its range" in words
    assert html.count("pass</span>, borderline") == 1 and "door: rattles" in words
    assert "allowed overlap a rebate &lt;of the lid&gt;" in words


def test_the_page_loads_nothing_from_the_network(finished):
    html = write_report(finished).read_text()
    assert all(link.startswith("data:image/") for link in _Page(html).links)
    assert "script" not in _Page(html).tags
    assert not re.search(r"url\(|@import|https?://", html)


def test_text_from_models_is_escaped(finished):
    (finished / "tree.json").write_text(json.dumps(_tree(label=EVIL)))
    (finished / "objects" / "jar" / "verify.json").write_text(
        json.dumps(
            {
                "passed": False,
                "checks": [{"scenario": "static", "name": EVIL, "outcome": "FAIL", "hint": EVIL}],
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
    (finished / "tree.json").write_text('{"nodes": [{}], "camera": 3}')
    (finished / "scene.json").write_text("{half")
    (finished / "photo.png").write_bytes(b"no picture")
    words = _words(write_report(finished).read_text())
    assert "refine/history.npz cannot be read" in words
    assert "A file of this run has an unexpected structure: KeyError" in words
    assert "photo.png cannot be read" in words
    assert "✓ pass table and ball: penetration" in words


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


def test_the_alignment_with_the_photograph_is_shown(finished):
    assert _photograph(finished) == ""
    objects = {
        "cup": _place("pixels"),
        "jar": _place("box", "it is see-through", yaw=0.0472, yaw_deg=0.0001),
        "lid": _place("none", "it has no visible contour", yaw=0.0471, across=0.0004),
        "can": _place("pixels", yaw=None, yaw_deg=0.0),
        "clock": _place("pixels", along=0.0, across=0.00002, yaw=1e-4, yaw_deg=0.0),
    }
    pitch = {"value": 0.5, "deviation": 0.01, "source": "the response"}
    _align(finished, objects, camera={"pitch": pitch})
    Image.new("RGB", (120, 40), "green").save(finished / "pictures" / "outlines.png")
    words = _photograph(finished)
    for message in (
        "Outlines of the composed scene, orange, and of the aligned scene, green",
        "pitch 28.65 ° ±0.57 ° the response",
        "cup pixels 5 +4 -1 along the view ±6 mm, across ±1 mm, heading ±2°, size ±3 %",
        "jar 2D box: it is see-through 5 0 -1 along the view ±6 mm, across ±1 mm, heading not seen",
        "lid composition: it has no visible contour 5.0 +4 -1 along the view ±6 "
        "mm, across ±0.4 mm, heading ±3°, size ±3 %",
        "can pixels 5 0.0 -1 along the view ±6 mm, across ±1 mm, heading not seen",
        "clock pixels 5.0 0.0 -1 along the wall ±0.1 mm, size ±3 %",
    ):
        assert message in words, message
    _align(finished, {})
    assert "Nothing was aligned" in _photograph(finished)
    _align(finished, {EVIL: _place("box", EVIL)})
    assert "<script" not in write_report(finished).read_text()


def _evidence_of(folder, name):
    """Return the words of an object's row."""
    html = write_report(folder).read_text()
    row = html.partition(f"<b>{name}</b>")[2].partition("</summary>")[0]
    return _words(row)


def test_each_kind_of_evidence_has_a_line_for_each_object(finished):
    depth = {"pixels": 345, "before_m": 0.0123, "after_m": 0.0021, "rise_m": 0.0192}
    jar = _tree()["nodes"][0] | {"name": "jar"}
    (finished / "tree.json").write_text(json.dumps(_tree() | {"nodes": [jar]}))
    outlines = {"jar": {"composed": 6.14, "aligned": 0.72}}
    masks = {"jar": {"composed": 0.8, "aligned": 0.953}}

    def row(evidence, reason="", change=None, **more):
        change = {} if change is None else {"depth": depth | change}
        _align(finished, {"jar": _place(evidence, reason, **change)}, **more)
        return _evidence_of(finished, "jar")

    words = row("pixels", change={}, outlines_px=outlines, masks_iou=masks)
    assert "2D box IoU parsed 0.90, composed 0.80, refined 0.85" in words
    assert "contour off by composed 6.1 px, aligned 0.7 px" in words
    assert (
        "depth median residual 12 mm before and 2.1 mm after, 345 pixels; puts it 19 mm above table"
    ) in words
    assert "mask IoU composed 0.80, aligned 0.95" in words
    words = row("box", "it is see-through", masks_iou={})
    assert "contour not used: it is see-through" in words
    assert "above" not in words and "mask none" in words
    assert "puts it 4 mm below table" in row("pixels", change={"rise_m": -0.0041})
    words = row("pixels", change={"pixels": 0})
    assert "depth not used: no pixel is measured" in words and "residual" not in words
    assert "depth" not in row("pixels") and "mask" not in row("pixels")


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="not a run folder"):
        write_report(tmp_path)

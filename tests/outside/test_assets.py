"""Assets of few bytes that ask for gigabytes or hours, or that name files outside their folder."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from neoworld_mjx.config import Config, FileOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.export import import_mjcf
from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.export.importing_scene import import_file
from neoworld_mjx.io import bounded_by
from neoworld_mjx.io.limited_worker import call_limited
from neoworld_mjx.verify.checking import check_object
from tests.support.hostile_assets import ASSETS, mjcf, star

# Of the pictures, one of each kind: the others differ in size or format.
LARGER = [name for name in ASSETS if name.startswith(("texture,", "height field,"))]
CASES = [pytest.param(name, marks=[pytest.mark.slow] if name in LARGER else []) for name in ASSETS]


@pytest.mark.parametrize("name", CASES)
def test_a_small_asset_that_asks_for_much(tmp_path, name):
    path = tmp_path / ASSETS[name](tmp_path)
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(SpecError) as caught:
        import_file(path)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert path.name.split(".")[0] in str(caught.value)
    assert len(str(caught.value)) < 600
    assert (after.ru_maxrss - before.ru_maxrss) / 1000 < 500


def _touch_all(path: Path) -> int:
    return int(np.ones(1 << 30, np.uint8).sum())


def _spin(path: Path) -> None:
    while True:
        pass


def _sleep(path: Path) -> None:
    time.sleep(1000)


def _crash(path: Path) -> None:
    import ctypes

    ctypes.string_at(0)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (_touch_all, "takes over 500 MiB of memory to read; .*files.memory_mib"),
        (_spin, r"takes over 0\.5 s to read; .*files\.timeout_s"),
        (_sleep, r"takes over 0\.5 s to read"),
        (_crash, r"crashes its reader \(status -11\)"),
    ],
)
def test_the_death_of_a_reader_is_one_message(tmp_path, function, said):
    with bounded_by(FileOptions(timeout_s=0.5)), pytest.raises(SpecError, match=said):
        call_limited(function, tmp_path / "a")


def _spin_and_tell(path: Path) -> None:
    path.write_text(str(os.getpid()))
    _spin(path)


@pytest.mark.parametrize("end", [pytest.param("interrupt", marks=pytest.mark.slow), "kill"])
def test_a_reader_ends_with_its_caller(tmp_path, end):
    code = (
        "import sys\nfrom pathlib import Path\nfrom neoworld_mjx.config import FileOptions\n"
        "from neoworld_mjx.io import bounded_by\n"
        "from neoworld_mjx.io.limited_worker import call_limited\n"
        "from tests.outside.test_assets import _spin_and_tell\n"
        "with bounded_by(FileOptions(timeout_s=90.0)):\n"
        "    call_limited(_spin_and_tell, Path(sys.argv[1]))\n"
    )
    note = tmp_path / "reader"
    command = [sys.executable, "-c", code, str(note)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as caller:
        try:
            while not note.exists() or not note.read_text():
                time.sleep(0.02)
                assert caller.poll() is None
            reader = int(note.read_text())
            caller.send_signal(signal.SIGINT if end == "interrupt" else signal.SIGKILL)
            assert caller.wait(60) < 0
        finally:
            caller.kill()
    for _ in range(500):
        state = Path(f"/proc/{reader}/stat")
        if not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.02)
    os.kill(reader, signal.SIGKILL)
    raise AssertionError("the reader runs on")


def test_a_reader_after_a_dead_one(tmp_path):
    with bounded_by(FileOptions(timeout_s=0.5)), pytest.raises(SpecError):
        call_limited(_crash, tmp_path / "a")
    assert call_limited(Path.exists, tmp_path) is True
    (tmp_path / "a.urdf").write_text("<robot/>")
    with pytest.raises(SpecError, match="has no links"):
        import_file(tmp_path / "a.urdf")


def test_relative_paths_are_those_of_the_caller(tmp_path, monkeypatch):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.urdf").write_text(
            f'<robot name="{name}"><link name="a"><collision><geometry><sphere radius="1"/>'
            "</geometry></collision></link></robot>"
        )
        monkeypatch.chdir(tmp_path / name)
        assert import_file(Path("a.urdf")).spec.name == name


CUBE = '#usda 1.0\n(\ndefaultPrim = "secret"\n)\ndef Cube "secret"\n{\n}\n'


@pytest.fixture
def home(tmp_path):
    """A folder with a secret next to it."""
    folder = tmp_path / "home"
    folder.mkdir()
    (tmp_path / "secret.usda").write_text(CUBE)
    (tmp_path / "secret.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    return folder


def test_usd_with_a_bracket_in_its_name_that_is_no_package(home):
    (home / "x.usda").write_text(CUBE)
    (home / "x.usda[").symlink_to(home.parent)
    path = home / "a.usda"
    path.write_text('#usda 1.0\ndef "b" (references = @./x.usda[/secret.usda@)\n{\n}\n')
    with pytest.raises(SpecError, match="outside its folder"):
        import_file(path)


@pytest.mark.parametrize("where", ["prim", "variant"])
def test_usd_value_clips(home, where):
    clips = (
        "clips = {\ndictionary default = {\nasset[] assetPaths = [@../secret.usda@]\n"
        'string primPath = "/secret"\ndouble2[] active = [(0, 0)]\n}\n}'
    )
    prim = f'def Cube "b" (\n{clips}\n)\n{{\n}}\n'
    if where == "variant":
        prim = (
            'def Cube "b" (\nvariants = {\nstring v = "x"\n}\nprepend variantSets = "v"\n)\n{\n'
            f'variantSet "v" = {{\n"x" (\n{clips}\n) {{\n}}\n}}\n}}\n'
        )
    path = home / "a.usda"
    path.write_text(f"#usda 1.0\n{prim}")
    with pytest.raises(SpecError, match="value clips, which are not read"):
        import_file(path)


MESH = (
    '<asset><mesh name="m" file="{}"/></asset>'
    '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody>'
)


@pytest.mark.parametrize("folder", ["..", "/", "sub/../.."])
@pytest.mark.parametrize("strip", ["true", "false"])
def test_the_meshdir_of_any_include(home, folder, strip):
    (home / "secret.obj").write_bytes((home.parent / "secret.obj").read_bytes())
    (home / "sub").mkdir()
    (home / "mesh.xml").write_text(f"<mujoco>{MESH.format('secret.obj')}</mujoco>")
    (home / "dir.xml").write_text(
        f'<mujoco><compiler meshdir="{folder}" strippath="{strip}"/></mujoco>'
    )
    path = home / "a.xml"
    path.write_text('<mujoco><include file="mesh.xml"/><include file="dir.xml"/></mujoco>')
    with pytest.raises(SpecError, match="outside its folder"):
        import_file(path)
    path.write_text(
        f'<mujoco><compiler meshdir="{folder}" strippath="{strip}"/>{MESH.format("x/secret.obj")}'
        "</mujoco>"
    )
    with pytest.raises(SpecError, match="outside its folder"):
        import_file(path)


def test_a_meshdir_within_the_folder(home):
    (home / "sub").mkdir()
    (home / "sub" / "m.obj").write_bytes((home.parent / "secret.obj").read_bytes())
    (home / "mesh.xml").write_text(f"<mujoco>{MESH.format('m.obj')}</mujoco>")
    path = home / "a.xml"
    path.write_text('<mujoco><compiler meshdir="sub"/><include file="mesh.xml"/></mujoco>')
    assert len(import_mjcf(path).spec.parts) == 1


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.slow
def test_a_mechanism_of_as_many_links_as_are_read(tmp_path):
    """Writers took the third power of the number of links, and glTF refused colliders alone."""
    spec = import_file(_written(tmp_path / "a.xml", star(398, '<geom size=".1"/>'))).spec
    assert len(spec.parts) == 399
    write_formats(spec, tmp_path / "out", ["mjcf", "urdf", "usd", "usdz", "sdf", "glb"])
    assert (tmp_path / "out" / "object.glb").stat().st_size > 100_000
    for name, tag in (("object.urdf", "<link"), ("object.sdf", "<link"), ("object.xml", "<body")):
        assert (tmp_path / "out" / name).read_text().count(tag) >= 399


def test_a_mechanism_beyond_the_bounds(tmp_path):
    geoms = _written(tmp_path / "geoms.xml", mjcf('<geom size=".1"/>' * 2001))
    with pytest.raises(SpecError, match="2001 shapes; the limit is 2000"):
        import_file(geoms)
    with pytest.raises(SpecError, match="401 links; the limit is 400"):
        import_file(_written(tmp_path / "star.xml", star(400, '<geom size=".1"/>')))
    chain = "".join(f'<body name="b{k}"><joint/><geom size=".1"/>' for k in range(1000))
    with pytest.raises(SpecError, match="nested more than 100 elements deep"):
        import_file(_written(tmp_path / "chain.xml", mjcf(f"{chain}{'</body>' * 1000}")))


def test_a_mechanism_of_many_joints_is_not_checked(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(star(80, '<geom size=".1"/>'))
    assert len(import_file(path).spec.joints) == 80
    with pytest.raises(SpecError, match="80 joints that move; at most 64 are checked"):
        check_object(path, Config())


def test_an_imported_object_named_world_is_renamed(tmp_path):
    path = tmp_path / "a.urdf"
    path.write_text(
        '<robot name="world"><link name="world"><collision><geometry><sphere radius="1"/>'
        "</geometry></collision></link></robot>"
    )
    imported = import_file(path)
    assert imported.spec.name == "world_1"
    assert "the object is named world_1 because MuJoCo reserves 'world'" in imported.notes

"""Commands replace regular files only, write through no link, and name what the system refuses."""

import os
import shutil
import stat
import subprocess
import sys

import pytest

from neoworld_mjx.errors import ExportError, system_refusal
from neoworld_mjx.export import export_object
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.spec import Box, single_object_scene
from tests.support.mechanisms import single

PROGRAM = """from neoworld_mjx.program.sdk import Object, box
o = Object("thing", "a thing")
p = o.part("body", material=o.material("oak", like="oak"))
p.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.05))
"""


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "p.py"
    path.write_text(PROGRAM)
    return path


def test_a_target_that_is_no_regular_file_is_refused(tmp_path, program, neoworld):
    pipe = tmp_path / "pipe.py"
    os.mkfifo(pipe)
    with pytest.raises(OSError, match="not a regular file"):
        write_atomic(pipe, b"x")
    with pytest.raises(OSError, match="folder"):
        write_atomic(tmp_path, b"x")
    for words in (
        ("render", program, "--out", pipe, "--width", 64),
        ("render", program, "--out", "/dev/full", "--width", 64),
        ("template", "tool_box", "--out", pipe),
        ("export", program, "--out", pipe),
        ("build", program, "--out", tmp_path / ("x" * 300)),
    ):
        code, _, message = neoworld(*words)
        assert code == 2, (words, message)
        assert message.count("\n") == 1, message
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


def test_an_export_follows_no_link(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("precious")
    thing = single("thing", Box(size=(0.1, 0.1, 0.1)))
    (tmp_path / "object.urdf").symlink_to(precious)
    export_object(thing, tmp_path)
    assert not (tmp_path / "object.urdf").is_symlink()
    (tmp_path / "object.sdf").unlink()
    os.mkfifo(tmp_path / "object.sdf")
    with pytest.raises(ExportError, match=r"object\.sdf: it is a pipe or device"):
        export_object(thing, tmp_path)
    assert precious.read_text() == "precious"


@pytest.mark.parametrize("redirection", [">&-", "> /dev/full", "--json > /dev/full"])
def test_stdout_that_cannot_be_written(redirection):
    command = f"{sys.executable} -m neoworld_mjx.cli examples {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: cannot write to stdout")
    assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.parametrize("words", ["--help", "--version", "render --help", "doctor --help"])
def test_a_reader_that_stops_reading_gets_no_traceback(words):
    command = f"{sys.executable} -m neoworld_mjx.cli {words} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


LIMITS = {
    "NOFILE": (12, ["Too many open files", "ulimit -n"]),
    "FSIZE": (0, ["File too large", "No usable temporary directory"]),
}


@pytest.mark.parametrize("limit", LIMITS)
def test_a_command_that_the_system_limits_leaves_no_partial_file(program, tmp_path, limit):
    number, messages = LIMITS[limit]
    code = f"""
import resource
from neoworld_mjx import cli
import neoworld_mjx.commands.object_commands, neoworld_mjx.program.sandbox
resource.setrlimit(resource.RLIMIT_{limit}, ({number}, {number}))
cli.main(["build", {str(program)!r}, "--out", {str(tmp_path / "out")!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert any(message in done.stderr for message in messages), done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".part", ".json")]


def test_a_full_disk_for_temporary_files_is_one_message(tmp_path):
    scene = tmp_path / "scene.json"
    scene.write_text(single_object_scene(single("thing", Box(size=(0.1, 0.1, 0.1)))).to_json())
    code = f"""
import resource, sys
sys.dont_write_bytecode = True  # Python does not notice a file that the limit cuts off.
from neoworld_mjx import cli
words = ["export", {str(scene)!r}, "--out", {str(tmp_path / "out")!r}, "--format", "usdz"]
resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
cli.main(words)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "USD cannot write to" in done.stderr and "; free some space" in done.stderr
    assert done.stderr.count("\n") == 1 and len(done.stderr) < 300, done.stderr


ENVIRONMENTS = {
    "JAX_PLATFORMS=nonsense": "JAX cannot start with JAX_PLATFORMS='nonsense'",
    "JAX_PLATFORMS=cuda": "JAX cannot start with JAX_PLATFORMS='cuda'",
    "JAX_ENABLE_X64=1": "JAX is set to double precision (JAX_ENABLE_X64)",
    "MUJOCO_GL=bogus": "MuJoCo accepts no such value of MUJOCO_GL; unset it",
}


@pytest.mark.parametrize("setting", ENVIRONMENTS)
def test_an_environment_in_which_nothing_can_run_is_one_message(tmp_path, setting):
    """The folder of the run is not touched."""
    if setting == "JAX_PLATFORMS=cuda" and shutil.which("nvidia-smi"):
        pytest.skip("this machine may have such a device")
    name, _, value = setting.partition("=")
    command = [sys.executable, "-m", "neoworld_mjx.cli", "reconstruct", "coffee", "--out"]
    done = subprocess.run(
        [*command, str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {name: value},
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: {ENVIRONMENTS[setting]}"), done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "out").exists()


REFUSALS = {
    "address space": ImportError("/lib/x.so: failed to map segment from shared object"),
    "static memory": ImportError("libx.so: cannot allocate memory in static TLS block"),
    "threads": RuntimeError("can't start new thread"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_limits_of_the_system_that_libraries_report_are_no_bugs(name):
    message = system_refusal(REFUSALS[name])
    assert message is not None and "ulimit" in message
    assert system_refusal(ImportError("No module named 'x'")) is None

"""Commands replace regular files only, write through no link, and name what the system refuses."""

import os
import stat
import subprocess
import sys

import pytest

from neoworld_mjx.errors import ExportError
from neoworld_mjx.export import export_object
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.spec import Box
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
        ("export", program, "--out", tmp_path / ("x" * 300)),
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
import neoworld_mjx.commands.object_commands, neoworld_mjx.export.formats
import neoworld_mjx.program.building
resource.setrlimit(resource.RLIMIT_{limit}, ({number}, {number}))
cli.main(["export", {str(program)!r}, "--out", {str(tmp_path / "out")!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert any(message in done.stderr for message in messages), done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".part", ".json")]

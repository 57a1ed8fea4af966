"""Commands replace regular files only, write through no link, and name what the system refuses."""

import itertools
import os
import stat
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from neoworld_mjx.errors import ExportError
from neoworld_mjx.export import export_object
from neoworld_mjx.io.files import write_atomic, write_inside
from neoworld_mjx.io.names import repeated
from neoworld_mjx.program import build
from neoworld_mjx.spec import ObjectSpec
from tests.faults.strikes import EXAMPLES

PROGRAM = """from neoworld_mjx.program.sdk import Object, box
o = Object("thing", "a thing")
p = o.part("body", material=o.material("oak", like="oak"))
p.add(box((0.1, 0.1, 0.1)), at=(0, 0, 0.05))
"""


def thing() -> ObjectSpec:
    spec = build(PROGRAM).spec
    assert spec is not None
    return spec


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "p.py"
    path.write_text(PROGRAM)
    return path


def test_an_existing_target_that_is_no_regular_file_is_refused(tmp_path):
    for name, make in (("pipe", os.mkfifo), ("folder", os.mkdir)):
        make(tmp_path / name)
        mode = (tmp_path / name).stat().st_mode
        with pytest.raises(OSError, match=r"not a regular file|folder"):
            write_atomic(tmp_path / name, b"x")
        assert (tmp_path / name).stat().st_mode == mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]


def test_commands_refuse_a_pipe_or_device_as_target(tmp_path, program, neoworld):
    pipe = tmp_path / "pipe.py"
    os.mkfifo(pipe)
    for words in (
        ("render", program, "--out", pipe, "--width", 64),
        ("render", program, "--out", "/dev/full", "--width", 64),
        ("template", "tool_box", "--out", pipe),
        ("export", program, "--out", pipe),
        ("build", program, "--out", pipe),
    ):
        code, _, said = neoworld(*words)
        assert code == 2, (words, said)
        assert said.count("\n") == 1, said
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


def test_the_target_of_an_image_is_checked_before_rendering(tmp_path, program, neoworld):
    pipe = tmp_path / "pipe.gif"
    os.mkfifo(pipe)
    for out in ("/dev/full", pipe, tmp_path / "nowhere" / "a.png", tmp_path):
        # Each would be refused, had it begun.
        for words in (("--open", 7), ("--turntable", "--frames", 0)):
            code, _, said = neoworld("render", program, "--out", out, *words)
            assert code == 2, said
            assert said.startswith(f"error: cannot write {out}: "), said


def test_an_export_follows_no_link(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("precious")
    for name in ("object.urdf", "object.xml"):
        out = tmp_path / name.replace(".", "_")
        out.mkdir()
        (out / name).symlink_to(precious)
        export_object(thing(), out)
        assert not (out / name).is_symlink()
    os.mkfifo(tmp_path / "object.sdf")
    with pytest.raises(ExportError, match=r"object\.sdf: it is a pipe or device"):
        export_object(thing(), tmp_path)
    assert precious.read_text() == "precious"


def test_a_path_that_is_too_long(tmp_path, program, neoworld):
    long = tmp_path / ("x" * 300)
    for words in (
        ("render", program, "--out", long, "--width", 64),
        ("export", program, "--out", long),
        ("template", "tool_box", "--out", long),
        ("reconstruct", long, "--out", tmp_path / "out"),
        ("build", program, "--out", long),
        ("report", long),
        ("check", long),
    ):
        code, _, said = neoworld(*words)
        assert code == 2, (words, said[-300:])
        assert "File name too long" in said
        assert said.count("\n") == 1


def test_numbers_that_no_command_can_use(program, neoworld):
    for words, expected in (
        (("template", "tool_box", "--seed", -1), "--seed: got -1"),
        (("check", program, "--set", "verify.duration_s=1e-320"), "verify.duration_s"),
        (("check", program, "--set", "refine.check_duration_s=1e-320"), "check_duration_s"),
    ):
        code, _, said = neoworld(*words)
        assert code == 2, said
        assert expected in said
    code, _, said = neoworld(
        *("check", program, "--set", "verify.duration_s=0.5"),
        *("--set", "verify.timestep_s=0.02", "--set", "verify.push_duration_s=0.25"),
    )
    assert code in (0, 1), said


@pytest.mark.parametrize("redirection", [">&-", "> /dev/full", "--json > /dev/full", "--json >&-"])
def test_stdout_that_cannot_be_written(redirection):
    command = f"{sys.executable} -m neoworld_mjx.cli examples {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: cannot write to stdout")
    assert done.stderr.count("\n") == 1, done.stderr


def test_the_limit_of_open_files_is_named(program):
    code = f"""
import resource, sys
from neoworld_mjx import cli
import neoworld_mjx.commands.object_commands, neoworld_mjx.program.sandbox
resource.setrlimit(resource.RLIMIT_NOFILE, (12, 12))
cli.main(["build", {str(program)!r}, "--out", {str(program.parent / "out")!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "Too many open files" in done.stderr
    assert "ulimit -n" in done.stderr


def limited(kib: int, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a command that may write files of some KiB, as on a disk that fills up."""
    code = f"""
import resource
from neoworld_mjx import cli
resource.setrlimit(resource.RLIMIT_FSIZE, ({kib * 1024}, {kib * 1024}))
cli.main({[str(word) for word in words]!r})
"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.slow  # tests/faults fills the disk of a run.
def test_a_run_whose_files_cannot_grow_is_resumed(tmp_path):
    words = ("reconstruct", EXAMPLES / "coffee.png", "--out", tmp_path / "out", "--until", "parse")
    done = limited(60, *words)
    assert done.returncode == 2
    assert done.stderr.startswith("error: cannot write ")
    assert done.stderr.count("\n") == 1
    left = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert left == {".lock", "answers.tape.json", "run.json", "run.log"}
    done = limited(1 << 20, *words, "--resume")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out/tree.json").exists()


@pytest.mark.parametrize(
    "words", [pytest.param(("render", "--width", "256"), marks=pytest.mark.slow), ("export",)]
)
def test_a_command_whose_files_cannot_grow_leaves_none(program, tmp_path, words):
    out = tmp_path / ("out.png" if words[0] == "render" else "out")
    done = limited(0, words[0], program, "--out", out, *words[1:])
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert "File too large" in done.stderr or "No usable temporary directory" in done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".part", ".png", ".json")]


def test_a_folder_that_becomes_a_link_during_writes(tmp_path):
    """The parent is opened once, without following links; nothing is written where a link leads."""
    precious, stop = tmp_path / "precious", threading.Event()
    precious.mkdir()
    out = tmp_path / "out"
    (out / "sub").mkdir(parents=True)

    def swap():
        for k in itertools.count():
            if stop.is_set():
                return
            with suppress(OSError):  # The writer makes the folder again.
                (out / "sub").rename(out / f"aside{k}")
                (out / "sub").symlink_to(precious)
            with suppress(OSError):
                (out / "sub").unlink()

    thread = threading.Thread(target=swap)
    thread.start()
    ended = set()
    for k in range(1000):
        try:
            write_inside(out, "sub/file", str(k), sync=False)
            ended.add("written")
        except OSError:
            ended.add("refused")
    stop.set()
    thread.join()
    assert "written" in ended
    assert not list(precious.iterdir())


def test_repeated_names_are_found_in_one_pass():
    part = thing().parts[0]
    sites = [{"name": f"s{i}", "part": part.name, "pos": (0, 0, 0)} for i in range(30_000)]
    data = thing().model_dump() | {"sites": sites}
    ObjectSpec.model_validate(data)
    assert repeated(iter("abcbca")) == ["a", "b", "c"]
    with pytest.raises(ValueError, match="site names must be unique, repeated: s1"):
        ObjectSpec.model_validate(data | {"sites": [*sites, sites[1]]})

import contextlib
import json
import logging
import signal
import subprocess
import sys
import threading
import time

import pytest

from neoworld_mjx import cli
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.watch import watch
from neoworld_mjx.verify.patch import Patch, patch_path, write_patch
from neoworld_mjx.verify.patched import build_patched

CUP = """
from neoworld_mjx.program.sdk import Object, box, sphere
o = Object("thing")
p = o.part("body", material="oak")
p.add({shape})
"""


@pytest.fixture
def saved(tmp_path):
    program = tmp_path / "thing.py"

    def save(text: str) -> None:
        # A plain write first empties the file, which the watcher may build.
        new = tmp_path / "thing.py.new"
        new.write_text(text)
        new.replace(program)

    save(CUP.format(shape="box((0.1, 0.1, 0.1))"))
    return program, save


def plain(program):
    return build_patched(program, ProgramOptions())


@pytest.fixture
def watching(saved, tmp_path, monkeypatch, caplog):
    """Watch the program into a folder in a thread: the folder, and what tells of a build."""
    program, _ = saved
    out, stop = tmp_path / "out", threading.Event()

    def sleep(_: float) -> None:
        if stop.wait(0.02):
            raise KeyboardInterrupt

    monkeypatch.setattr("neoworld_mjx.program.watch.time.sleep", sleep)
    caplog.set_level(logging.INFO, "neoworld_mjx")
    reported = lambda count: any(r.message.startswith(f"build {count} in") for r in caplog.records)
    builds: list[int] = []
    beside = (patch_path(program),)
    thread = threading.Thread(target=lambda: builds.append(watch(program, out, plain, beside)))

    @contextlib.contextmanager
    def running():
        thread.start()
        try:
            yield out, reported
        finally:
            stop.set()
            thread.join(20)

    return running, builds


def test_every_save_rebuilds_and_errors_keep_the_files(saved, watching, caplog):
    program, save = saved
    running, builds = watching
    with running() as (out, reported):
        wait_for(lambda: reported(1))
        first = (out / "render.png").read_bytes()
        save("1 / 0")
        wait_for(lambda: reported(2))
        assert (out / "render.png").read_bytes() == first
        wait_for(lambda: any("ZeroDivisionError" in r.message for r in caplog.records))
        program.unlink()
        wait_for(lambda: any("cannot read" in r.message for r in caplog.records))
        save(CUP.format(shape="sphere(0.1), name='ball'"))
        wait_for(lambda: reported(3))
        assert (out / "render.png").read_bytes() != first
        assert "sphere" in (out / "program.py").read_text()
        assert '"ball"' in (out / "spec.json").read_text()
    assert builds == [3]


def test_the_patch_of_a_program_applies_to_every_build(saved, watching, caplog):
    program, _ = saved
    heavy = lambda mass: Patch.model_validate({"parts": {"body": {"mass": mass}}})
    weighs = lambda out: json.loads((out / "spec.json").read_text())["parts"][0]["mass"]
    write_patch(program, heavy(3.0))
    running, builds = watching
    with running() as (out, reported):
        wait_for(lambda: reported(1))
        assert weighs(out) == 3.0
        wait_for(lambda: any("patch: part body: mass = 3" in r.message for r in caplog.records))
        # The patch is a reason to build, and goes with the program.
        write_patch(program, heavy(4.0))
        wait_for(lambda: reported(2))
        assert weighs(out) == 4.0
        assert (out / "program.patch.json").read_text() == heavy(4.0).to_json()
        patch_path(program).write_text("{")
        wait_for(lambda: any("waiting" in r.message for r in caplog.records))
        assert weighs(out) == 4.0
        patch_path(program).unlink()
        wait_for(lambda: reported(4))
        assert weighs(out) is None
        assert not (out / "program.patch.json").exists()
    assert builds == [4]


def test_plain_and_watched_builds_write_the_same_files(saved, watching, tmp_path):
    program, _ = saved
    write_patch(program, Patch.model_validate({"parts": {"body": {"mass": 3.0}}}))
    with pytest.raises(SystemExit):
        cli.main(["build", str(program), "--out", str(tmp_path / "plain"), "--json"])
    running, _ = watching
    with running() as (out, reported):
        wait_for(lambda: reported(1))
    files = lambda folder: {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    assert files(out) == files(tmp_path / "plain")
    assert "program.patch.json" in files(out)


def wait_for(found) -> None:
    stop, pause = time.monotonic() + 20, threading.Event()
    while not found():
        assert time.monotonic() < stop, "waited in vain"
        pause.wait(0.02)


def test_ctrl_c_ends_watching_with_exit_code_0(saved, tmp_path, request):
    program, _ = saved
    # What runs in the background of a shell ignores Ctrl-C, and so would what it starts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    command = [sys.executable, "-m", "neoworld_mjx.cli", "build", str(program)]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path / "out"), "--watch"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stderr is not None and running.stdout is not None
        assert running.stderr.readline().startswith("build 1 in")
        running.send_signal(signal.SIGINT)
        try:
            assert running.wait(20) == 0
        finally:
            running.kill()
        assert "builds: 1" in running.stdout.read()

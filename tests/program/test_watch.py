import logging
import signal
import subprocess
import sys
import threading
import time

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program.watch import watch

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
        program.write_text(text)

    save(CUP.format(shape="box((0.1, 0.1, 0.1))"))
    return program, save


def test_every_save_builds_again_and_errors_leave_what_was_there(
    saved, tmp_path, monkeypatch, caplog
):
    program, save = saved
    out, stop = tmp_path / "out", threading.Event()

    def sleep(_: float) -> None:
        if stop.wait(0.02):
            raise KeyboardInterrupt

    monkeypatch.setattr("neoworld_mjx.program.watch.time.sleep", sleep)
    caplog.set_level(logging.INFO, "neoworld_mjx")
    told = lambda count: any(r.message.startswith(f"build {count} in") for r in caplog.records)
    builds: list[int] = []
    thread = threading.Thread(target=lambda: builds.append(watch(program, out, ProgramOptions())))
    thread.start()
    try:
        wait_for(lambda: told(1))
        first = (out / "render.png").read_bytes()
        save("1 / 0")
        wait_for(lambda: told(2))
        assert (out / "render.png").read_bytes() == first
        assert any("ZeroDivisionError" in r.message for r in caplog.records)
        program.unlink()
        wait_for(lambda: any("cannot be read" in r.message for r in caplog.records))
        save(CUP.format(shape="sphere(0.1), name='ball'"))
        wait_for(lambda: told(3))
        assert (out / "render.png").read_bytes() != first
        assert "sphere" in (out / "program.py").read_text()
        assert '"ball"' in (out / "spec.json").read_text()
    finally:
        stop.set()
        thread.join(20)
    assert builds == [3]


def wait_for(found) -> None:
    stop, pause = time.monotonic() + 20, threading.Event()
    while not found():
        assert time.monotonic() < stop, "waited in vain"
        pause.wait(0.02)


def test_ctrl_c_ends_it_well(saved, tmp_path):
    program, _ = saved
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
        assert running.wait(20) == 0
        assert "builds: 1" in running.stdout.read()

"""Hostile programs in Blender, run where it is installed."""

import os
import socket
import time

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from neoworld_mjx.program.blender.blender_availability import unavailable
from tests.support.hostile_blender import FINE_BLENDER, HOSTILE_BLENDER

OPTIONS = ProgramOptions(language="blender", blender_timeout_s=3)
SECONDS = 60.0
"""Wall time on a busy machine; the processor time is 8 s."""


@pytest.fixture(scope="module", autouse=True)
def blender():
    why = unavailable()
    if why is not None:
        pytest.skip(why)


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.setblocking(False)
        yield listening


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE_BLENDER)
def test_every_hostile_blender_program_is_contained(name, tmp_path, server, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_API_KEY", "sk-secret")
    kept = tmp_path / "kept.txt"
    kept.write_text("kept")
    before = kept.stat()
    text, codes = HOSTILE_BLENDER[name]
    text = text.replace("FOLDER", str(tmp_path)).replace("PARENT", str(os.getpid()))
    start = time.monotonic()
    built = build(text.replace("PORT", str(server.getsockname()[1])), OPTIONS)
    assert time.monotonic() - start < SECONDS
    errors = [signal for signal in built.signals if signal.severity == "error"]
    if codes == {"no_error"}:
        assert not errors
        assert built.spec.parts[0].name.isidentifier()
    else:
        assert built.spec is None
        assert {signal.code for signal in errors} <= codes, errors
        assert errors
    # Nothing happened outside.
    assert [path.name for path in tmp_path.iterdir()] == ["kept.txt"]
    assert kept.read_text() == "kept"
    assert (kept.stat().st_mode, kept.stat().st_mtime) == (before.st_mode, before.st_mtime)
    with pytest.raises(BlockingIOError):
        server.accept()
    assert "secret" not in built.printed
    assert len(built.printed) < 30_000


@pytest.mark.slow
def test_a_valid_blender_program_builds_after_hostile_ones():
    assert build(FINE_BLENDER, OPTIONS).ok

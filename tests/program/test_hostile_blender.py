"""Hostile programs in Blender, run where it is installed, and the message of each."""

import os
import re
import socket

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build
from neoworld_mjx.program.blender.blender_process import unavailable

OPTIONS = ProgramOptions(language="blender", blender_timeout_s=3)
DENIED = "forbidden|runtime"
FAKE = (
    "import os, json, base64\nimport numpy as np\n"
    "array = lambda kind, *v: base64.b64encode(np.array(v, kind).tobytes()).decode()\n"
    "shape = dict(name='x', part='x', role='both', convex=True, mass=None, materials=[],\n"
    "    vertices=array('<f8', 0, 0, 0, 1, 0, 0, 0, 1, 0), faces=array('<i4', 0, 1, 2000000),\n"
    "    slots=array('<i4', 0))\n"
    "scene = dict(name='x', label='', materials=[], shapes=[shape], joints=[], sites=[])\n"
    "for k in range(3, 64):\n    try:\n        os.write(k, json.dumps(scene).encode())\n"
    "    except OSError: pass\nos._exit(0)"
)
"""A program that writes a scene of its own making, with a face of vertices that do not exist."""

# FOLDER, PORT and PARENT stand for a folder with a file kept.txt, a port that listens, and this
# process.
HOSTILE: dict[str, tuple[str, str]] = {
    "read_file": ("print(open('FOLDER/kept.txt').read())", DENIED),
    "write_file": ("open('FOLDER/made.txt', 'w').write('x')", DENIED),
    "remove_file": ("import os\nos.remove('FOLDER/kept.txt')", DENIED),
    "save_blend": ("bpy.ops.wm.save_as_mainfile(filepath='FOLDER/made.blend')", DENIED),
    "environment_of_parent": ("print(open('/proc/PARENT/environ').read())", DENIED),
    "socket": ("import socket\nsocket.create_connection(('127.0.0.1', PORT))", DENIED),
    "subprocess": ("import subprocess\nsubprocess.run(['/bin/sh', '-c', 'id'])", DENIED),
    "kill_parent": ("import os\nos.kill(PARENT, 9)", DENIED),
    "trace_parent": (
        "import ctypes\nn = ctypes.CDLL(None).ptrace(16, PARENT, 0, 0)\nassert n == 0, 'refused'",
        DENIED,
    ),
    "segfault": ("import ctypes\nctypes.string_at(0)", "crashed"),
    "endless": ("while True: pass", "timeout: the program took over 3 s"),
    "growing": ("x = []\nwhile True: x.append(bytearray(10**7))", "memory|crashed"),
    "recursion": ("def f(): f()\nf()", "recursion"),
    "print_bomb": ("while True: print('x' * 100000)", "timeout|crashed|forbidden"),
    "silent_exit": ("import os\nos._exit(0)", "too_big: the scene could not be read back"),
    "face_of_nobody": (FAKE, "value"),
}


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
@pytest.mark.parametrize("name", HOSTILE)
def test_every_hostile_blender_program_is_contained(name, tmp_path, server, monkeypatch):
    monkeypatch.setenv("ANTHROPIC_API_KEY", "sk-secret")
    kept = tmp_path / "kept.txt"
    kept.write_text("kept")
    text, message = HOSTILE[name]
    text = text.replace("FOLDER", str(tmp_path)).replace("PARENT", str(os.getpid()))
    text = text.replace("PORT", str(server.getsockname()[1]))
    built = build(f"import bpy\n{text}", OPTIONS)
    assert built.spec is None
    messages = [signal.phrase() for signal in built.signals if signal.severity == "error"]
    assert re.search(message, messages[0]), messages[0]
    # Nothing happened outside.
    assert [path.name for path in tmp_path.iterdir()] == ["kept.txt"]
    assert kept.read_text() == "kept"
    with pytest.raises(BlockingIOError):
        server.accept()
    assert "secret" not in built.printed
    assert len(built.printed) < 30_000

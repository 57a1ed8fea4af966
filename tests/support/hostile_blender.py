"""Hostile Blender programs, each with the signals that it may end in.

FOLDER, PORT and PARENT in a text stand for a folder with a file `kept.txt`, a port of this machine
that listens, and this process.
"""

DENIED, STOPPED = {"forbidden", "runtime"}, {"timeout", "crashed", "memory"}
_BPY = "import bpy\n"
_FAKE = (
    "import os, json, base64\n"
    "import numpy as np\n"
    "array = lambda kind, *v: base64.b64encode(np.array(v, kind).tobytes()).decode()\n"
    "shape = dict(name='x', part='x', role='both', convex=True, mass=None, materials=[],\n"
    "    vertices=array('<f8', *VERTICES), faces=array('<i4', *FACES), slots=array('<i4', 0))\n"
    "scene = dict(name='x', label='', materials=[], shapes=[shape], joints=[], sites=[])\n"
    "answer = json.dumps(scene)\n"
    "for k in range(3, 64):\n"
    "    try:\n"
    "        os.write(k, answer.encode())\n"
    "    except OSError: pass\n"
    "os._exit(0)"
)
"""An answer of the program's own making."""

HOSTILE_BLENDER: dict[str, tuple[str, set[str]]] = {
    # Files.
    "read_passwd": ("print(open('/etc/passwd').read())", DENIED),
    "read_file": ("print(open('FOLDER/kept.txt').read())", DENIED),
    "list_home": ("import os\nprint(os.listdir('FOLDER'))", DENIED),
    "write_file": ("open('FOLDER/made.txt', 'w').write('x')", DENIED),
    "append_file": ("import os\nos.open('FOLDER/kept.txt', os.O_WRONLY | os.O_APPEND)", DENIED),
    "truncate_software": ("import os, sys\nos.truncate(os.__file__, 0)", DENIED),
    "remove_file": ("import os\nos.remove('FOLDER/kept.txt')", DENIED),
    "rename_file": ("import os\nos.rename('FOLDER/kept.txt', 'FOLDER/made.txt')", DENIED),
    "chmod_file": ("import os\nos.chmod('FOLDER/kept.txt', 0)", DENIED),
    "link_file": ("import os\nos.symlink('/etc', 'FOLDER/made.txt')", DENIED),
    "save_blend": ("bpy.ops.wm.save_as_mainfile(filepath='FOLDER/made.blend')", DENIED),
    "load_blend": ("bpy.ops.wm.open_mainfile(filepath='FOLDER/kept.txt')", DENIED),
    "environment_of_parent": ("print(open('/proc/PARENT/environ').read())", DENIED),
    "memory_file": ("print(open('/proc/self/mem', 'rb').read(1))", DENIED),
    # Network, processes and signals.
    "socket": ("import socket\nsocket.create_connection(('127.0.0.1', PORT))", DENIED),
    "urllib": ("import urllib.request\nurllib.request.urlopen('http://127.0.0.1:PORT')", DENIED),
    "unix_socket": ("import socket\nsocket.socketpair()", DENIED),
    "subprocess": ("import subprocess\nsubprocess.run(['/bin/sh', '-c', 'id'])", DENIED),
    "fork": ("import os\nwhile True:\n    os.fork()", DENIED),
    "execute": ("import os\nos.execv('/bin/sh', ['sh', '-c', 'id'])", DENIED),
    "kill_parent": ("import os\nos.kill(PARENT, 9)", DENIED),
    "kill_all": ("import os\nos.kill(-1, 9)", DENIED),
    "named_pipe": ("import os\nos.mkfifo('FOLDER/made')", DENIED),
    # Below Python.
    "raw_call": (
        "import ctypes\nn = ctypes.CDLL(None, use_errno=True).syscall(41, 2, 1, 0)\n"
        "assert n >= 0, PermissionError(ctypes.get_errno())",
        DENIED,
    ),
    "trace_parent": (
        "import ctypes\nn = ctypes.CDLL(None).ptrace(16, PARENT, 0, 0)\nassert n == 0, 'refused'",
        DENIED,
    ),
    "unshare": (
        "import ctypes\nassert ctypes.CDLL(None).unshare(0x10000000) == 0, 'refused'",
        DENIED,
    ),
    "memory_of_nobody": (
        "import ctypes\nassert ctypes.CDLL(None).memfd_create(b'x', 0) >= 0, 'refused'",
        DENIED,
    ),
    "segfault": ("import ctypes\nctypes.string_at(0)", STOPPED),
    "raise_limits": (
        "import resource\nresource.setrlimit(resource.RLIMIT_CPU, (-1, -1))",
        DENIED,
    ),
    "outlive": ("import ctypes\nassert ctypes.CDLL(None).prctl(1, 0) == 0, 'refused'", DENIED),
    # Time and memory.
    "endless": ("while True: pass", STOPPED),
    "endless_deaf": (
        "import signal\nfor k in (15, 24, 2): signal.signal(k, signal.SIG_IGN)\nwhile True: pass",
        STOPPED,
    ),
    "endless_in_c": ("sum(iter(int, 1))", STOPPED),
    "threads": (
        "import threading\nfor _ in range(100000):\n"
        "    threading.Thread(target=threading.Event().wait).start()",
        DENIED,
    ),
    "bytes": ("x = bytearray(10**11)", {"memory", "crashed"}),
    "growing": ("x = []\nwhile True: x.append(bytearray(10**7))", {"memory", "crashed"}),
    "subdivided": (
        "bpy.ops.mesh.primitive_cube_add()\nm = bpy.context.object.modifiers.new('s', 'SUBSURF')\n"
        "m.levels = m.render_levels = 11",
        STOPPED | {"value"},
    ),
    "recursion": ("def f(): f()\nf()", {"recursion"}),
    # What comes back.
    "print_bomb": ("while True: print('x' * 100000)", {"timeout", "crashed", "forbidden"}),
    "silent_exit": ("import os\nos._exit(0)", {"too_big"}),
    "no_triangles": (_FAKE.replace("VERTICES", "(0,)").replace("FACES", "(0, 1, 2)"), {"value"}),
    "far_vertex": (
        _FAKE.replace("VERTICES", "(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, float('nan'))").replace(
            "FACES", "(0, 1, 2)"
        ),
        {"value"},
    ),
    "face_of_nobody": (
        _FAKE.replace("VERTICES", "(0, 0, 0, 1, 0, 0, 0, 1, 0)").replace(
            "FACES", "(0, 1, 2000000)"
        ),
        {"value"},
    ),
    "answer_of_lists": (
        "import os\nfor k in range(3, 64):\n    try:\n        os.write(k, b'[' * 10**6)\n"
        "    except OSError: pass\nos._exit(0)",
        {"too_big"},
    ),
    "answer_bomb": (
        "import os\nfor k in range(3, 64):\n    try:\n"
        "        while True: os.write(k, b'[' * 10**6)\n"
        "    except OSError: pass\nos._exit(0)",
        {"too_big", "crashed"},
    ),
    "names": (
        "bpy.ops.mesh.primitive_cube_add(size=0.1)\n"
        "bpy.context.object['part'] = '../../<script>' * 9",
        {"no_error"},
    ),
}
HOSTILE_BLENDER = {name: (_BPY + text, codes) for name, (text, codes) in HOSTILE_BLENDER.items()}
FINE_BLENDER = (
    _BPY + "bpy.ops.mesh.primitive_cube_add(size=0.1)\n"
    "bpy.context.object.data.materials.append(bpy.data.materials.new('oak'))\n"
)
"""A valid program that must build after each of them."""

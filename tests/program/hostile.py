"""Programs that mean harm, each with the codes that may come back for it."""

SDK = (
    "from neoworld_mjx.program.sdk import Object, box, cylinder, extrusion, lathe, sphere, sweep\n"
)
BODY = SDK + "o = Object('thing')\np = o.part('body', material='oak')\n"

DENIED = {"type", "import", "forbidden", "runtime", "unsupported", "value", "no_object"}
STOPPED = {"timeout", "crashed", "memory", "too_many_calls", "too_big", "recursion", "output"}

HOSTILE: dict[str, tuple[str, set[str]]] = {
    # Files.
    "open_file": ("print(open('/etc/passwd').read())", DENIED),
    "write_file": ("open('/tmp/hostile', 'w').write('x')", DENIED),
    "pathlib": ("from pathlib import Path\nprint(Path('/etc/passwd').read_text())", DENIED),
    "listdir": ("import os\nprint(os.listdir('/'))", DENIED),
    "environ": ("import os\nprint(os.environ['HOME'])", DENIED),
    "getcwd": ("import os\nos.remove('/tmp/x')", DENIED),
    # Network and processes.
    "socket": ("import socket\nsocket.create_connection(('127.0.0.1', 80))", DENIED),
    "urllib": ("import urllib.request\nurllib.request.urlopen('http://127.0.0.1')", DENIED),
    "subprocess": ("import subprocess\nsubprocess.run(['id'])", DENIED),
    "system": ("import os\nos.system('id')", DENIED),
    "thread": ("import threading\nthreading.Thread(target=print).start()", DENIED),
    # Imports.
    "import_host": ("import neoworld_mjx.config", DENIED),
    "import_host_inside": ("from neoworld_mjx.program import sandbox", DENIED),
    "import_numpy": ("import numpy", DENIED),
    "import_ctypes": ("import ctypes\nctypes.string_at(0)", DENIED),
    "dunder_import": ("__import__('os').system('id')", DENIED),
    "importlib": ("import importlib\nimportlib.import_module('os')", DENIED),
    # Introspection.
    "subclasses": ("().__class__.__bases__[0].__subclasses__()", DENIED),
    "globals_of_sdk": (BODY + "print(p.add.__globals__)", DENIED),
    "private": (BODY + "print(p._owner._parts)", DENIED),
    "getattr_private": (BODY + "print(getattr(p, '_owner'))", DENIED),
    "setattr": (BODY + "o._joints = 5\nsetattr(p, '_geoms', 5)", DENIED | {"empty_part"}),
    "class_of_handle": (BODY + "print(type(p)('x'))", DENIED),
    "eval_hidden": ("eval('__imp' + 'ort__(\"os\").getcwd()')", DENIED),
    "exec_hidden": ("exec('imp' + 'ort subprocess')", DENIED),
    "frames": ("import sys\nprint(sys._getframe(0))", DENIED),
    "gc": ("import gc\nprint(gc.get_objects())", DENIED),
    # Time.
    "endless_loop": ("while True:\n    pass", STOPPED),
    "endless_catch": (
        "while True:\n    try:\n        1 / 0\n    except Exception:\n        pass",
        STOPPED,
    ),
    "catch_everything": (
        "while True:\n    try:\n        while True:\n            pass\n    except BaseException:\n"
        "        pass",
        STOPPED,
    ),
    "squaring": ("x = 7\nwhile True:\n    x = x * x", STOPPED),
    "power": ("print(10 ** 10 ** 8)", STOPPED),
    "slow_regex": ("import re\nre.match('(a+)+$', 'a' * 64 + 'b')\n" * 3, STOPPED | DENIED),
    "sleep": ("import time\ntime.sleep(1000)", DENIED),
    "sleep_loop": ("import time\nwhile True:\n    time.sleep(1)", STOPPED | DENIED),
    "input": ("input('name? ')", DENIED),
    # Memory, recursion, output.
    "doubling": ("x = [0]\nwhile True:\n    x = x + x", STOPPED),
    "long_string": ("x = 'x' * 10 ** 10", STOPPED),
    "big_range": ("sorted(range(10 ** 9))", STOPPED),
    "nested_list": ("x = []\nwhile True:\n    x = [x]", STOPPED),
    "dictionary": ("d = {}\nwhile True:\n    d[len(d)] = 'x' * 100", STOPPED),
    "recursion": ("def f(n):\n    return f(n + 1)\nf(0)", STOPPED | {"runtime"}),
    "deep_parens": ("x = " + "(" * 5000 + "1" + ")" * 5000, {"syntax", "recursion", "crashed"}),
    "deep_blocks": (
        "".join(" " * i + "if 1:\n" for i in range(300)) + " " * 300 + "x = 1",
        {"syntax", "crashed", "no_object", "recursion"},
    ),
    "print_bomb": ("while True:\n    print('x' * 1000)", STOPPED),
    "long_text": ("# " + "x" * 300_000, {"too_long"}),
    "nul": ("x = '\0'", {"syntax"}),
    "lone_surrogate": ("x = '\ud800'", {"syntax"}),
    # Floods of calls.
    "call_flood": (BODY + "while True:\n    p.anchor('top') if False else box((1, 1, 1))", STOPPED),
    "call_flood_caught": (
        BODY + "while True:\n    try:\n        box((1, 1, 1))\n    except Exception:\n        pass",
        STOPPED,
    ),
    "part_flood": (SDK + "o = Object('x')\nfor i in range(10 ** 6):\n    o.part(f'p{i}')", STOPPED),
    "object_flood": (
        SDK + "for i in range(10 ** 6):\n    Object(f'o{i}')",
        STOPPED | {"many_objects"},
    ),
    "material_flood": (
        SDK + "o = Object('x')\nfor i in range(10 ** 6):\n    o.material(f'm{i}', like='oak')",
        STOPPED,
    ),
    # Huge geometry.
    "million_boxes": (BODY + "for i in range(10 ** 6):\n    p.add(box((1, 1, 1)))", STOPPED),
    "million_boxes_caught": (
        BODY + "s = box((1, 1, 1))\nfor i in range(10 ** 6):\n    try:\n        p.add(s)\n"
        "    except BaseException:\n        pass",
        STOPPED,
    ),
    "sectors": (BODY + "p.add(lathe([(0, 0), (1, 1)], 0.1, sectors=10 ** 9))", {"value"}),
    "heavy_lathes": (
        BODY + "for i in range(10 ** 6):\n"
        "    q = [(0.1 + 0.001 * k, 0.01 * k + 0.00001 * i) for k in range(18)]\n"
        "    p.add(lathe(q, 0.01, sectors=64))",
        STOPPED,
    ),
    "long_outline": (BODY + "extrusion([(i, i * i) for i in range(10 ** 5)], 1)", {"value"}),
    "comb_extrusions": (
        BODY + "for i in range(10 ** 6):\n"
        "    q = [(k + 0.0001 * i, 5 + 4 * (k % 2)) for k in range(100)] + [(100, 0), (0, 0)]\n"
        "    p.add(extrusion(q, 1))",
        STOPPED | {"value"},
    ),
    "tangled_extrusion": (
        BODY + "import random\nq = [(random.random(), random.random()) for k in range(128)]\n"
        "p.add(extrusion(q, 1))",
        {"value"},
    ),
    "long_path": (BODY + "p.add(sweep([(0, 0, i) for i in range(10 ** 5)], 0.1))", {"value"}),
    "all_overlapping": (
        SDK + "o = Object('x')\nfor i in range(250):\n    p = o.part(f'p{i}', material='oak')\n"
        "    for k in range(10):\n        p.add(sphere(0.5 + 0.01 * k), at=(0, 0, 0.0001 * i))\n"
        "    if i:\n        o.prismatic(f'j{i}', q, p, axis=(1, 0, 0), range=(0, 1))\n    q = p\n",
        {"too_intricate", "too_many_calls", "overlap_at_rest"},
    ),
    # Numbers.
    "nan": (BODY + "p.add(box((float('nan'), 1, 1)))", {"value"}),
    "infinite": (BODY + "p.add(box((float('inf'), 1, 1)))", {"value"}),
    "huge_integer": (BODY + "p.add(box((10 ** 5000, 1, 1)))", {"value"}),
    "negative": (BODY + "p.add(cylinder(-1, 1))", {"value"}),
    "denormal": (BODY + "p.add(box((5e-324, 1, 1)))", {"value"}),
    "far_away": (BODY + "p.add(box((1, 1, 1)), at=(1e300, 0, 0))", {"value"}),
    "complex": (BODY + "p.add(sphere(1j))", DENIED),
    "boolean": (BODY + "x: bool = True\np.add(sphere(x))", {"value", "type"}),
    # Wrong things in the SDK's hands.
    "own_class": (BODY + "class S:\n    size = 1\np.add(S())", DENIED),
    "function": (BODY + "p.add(lambda: 1)", DENIED),
    "part_as_shape": (BODY + "p.add(p)", DENIED),
    "foreign_part": (
        BODY + "q = Object('other').part('q')\no.fixed('f', p, q)",
        {"value", "many_objects"},
    ),
    "cyclic_list": (BODY + "x = [0, 0, 0]\nx[0] = x\np.add(box(x))", DENIED),
    "own_parent": (BODY + "o.fixed('f', p, p)", {"value"}),
    "markup_name": (BODY + "o.part('\"/><script>')", {"value"}),
    "path_name": (SDK + "Object('../../etc/passwd')", {"value"}),
    "exit": ("import sys\nsys.exit(0)", DENIED),
    "raise_exit": ("raise SystemExit(0)", DENIED),
    "keyboard": ("raise KeyboardInterrupt", DENIED),
    "del_builtin": ("print = None\nlen = None", DENIED),
}

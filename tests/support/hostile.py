"""Hostile programs, each with the signals that it may end in, and a check of the sandbox."""

import os
import time
from pathlib import Path
from typing import NamedTuple

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build

SECONDS, MEGABYTES = 3.0, 100.0
"""Time in which a hostile program must end, and growth of this process's memory."""

SDK = (
    "from neoworld_mjx.program.sdk import Object, box, cylinder, difference, extrusion, lathe, "
    "sphere, sweep, union\n"
)
BODY = SDK + "o = Object('thing')\np = o.part('body', material='oak')\n"
SHARED = "x = [1.0] * 6\nfor i in range(15):\n    x = [x, x, x, x, x, x]\n"
"""A list of 6^16 leaves in a few bytes."""
FINE = BODY + "p.add(box((0.1, 0.1, 0.1)))\n"
"""A valid program that must build after each of them."""
ASIDE = {"loose_shape", "heavy"}
"""Codes that may accompany any other."""

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
        {"too_intricate", "too_many_calls", "overlap_at_rest", "timeout"},
    ),
    "long_chain": (
        SDK + "o = Object('x')\nq = o.part('p', material='oak')\nq.add(box((0.02, 0.02, 0.02)))\n"
        "for i in range(1, 299):\n    p = o.part(f'p{i}', material='oak')\n"
        "    p.add(box((0.02, 0.02, 0.02)), at=(0.021 * i, 0, 0))\n"
        "    o.revolute(f'j{i}', q, p, at=(0.021 * i - 0.01, 0, 0), axis=(0, 1, 0), "
        "range=(-3, 3))\n    q = p\n",
        {"too_intricate", "overlap_in_motion"},
    ),
    "million_holes": (
        BODY + "p.add(difference(box((10, 10, 1)), *[cylinder(0.01, 9).moved((0.02 * i, 0, 0)) "
        "for i in range(10 ** 6)]))",
        STOPPED | {"value", "type"},
    ),
    "sieve": (
        BODY + "h = [cylinder(0.04, 9).moved((0.1 * (i % 8), 0.1 * (i // 8), 0)) "
        "for i in range(63)]\np.add(difference(box((10, 10, 1)), *h, sectors=64))",
        {"value"},
    ),
    "sieve_again_and_again": (
        BODY + "for k in range(10 ** 6):\n    try:\n"
        "        h = [sphere(0.04 + 1e-6 * k).moved((0.1 * (i % 8), 0.1 * (i // 8), 0)) "
        "for i in range(63)]\n        difference(box((10, 10, 1)), *h)\n"
        "    except ValueError:\n        pass",
        STOPPED,
    ),
    "csg_of_csg": (
        BODY + "s = sphere(0.1)\nfor k in range(10 ** 4):\n"
        "    s = union(s, s.moved((0.05, 0.01 * k, 0)))\np.add(s)",
        STOPPED | {"value"},
    ),
    "lathe_without_lathe": (
        BODY + "q = [(0.1 + 0.01 * (k % 2), 0.01 * k) for k in range(18)]\n"
        "s = lathe(q, 0.004, sectors=64)\np.add(difference(s, s.moved((0.01, 0, 0))))",
        {"value"},
    ),
    "distance_flood": (
        BODY + "s = lathe([(0, 0), (0.1, 0.1)], 0.004, oval=0.7)\nwhile True:\n"
        "    s.distance((0, 0, 1))",
        STOPPED,
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
    # Values that are small in the sandbox and large written out.
    "shared_list": (BODY + SHARED + "p.add(box((x, 1, 1)))", {"type", "value"}),
    "shared_lists_everywhere": (
        BODY + SHARED + "for f in (box, sphere, lathe, extrusion, sweep, union, difference):\n"
        "    try:\n        f(x)\n    except Exception:\n        pass\n"
        "    try:\n        f(*x, at=x)\n    except Exception:\n        pass\n"
        "for f in (o.part, o.material, p.add, p.anchor):\n"
        "    try:\n        f(x)\n    except Exception:\n        pass\n",
        DENIED | STOPPED | {"empty_part"},
    ),
    "shared_tuples": (
        BODY + SHARED.replace("[", "(").replace("]", ",)") + "o.part(x)",
        {"type", "value"},
    ),
    "shared_dictionary": (
        BODY + "x = {}\nfor i in range(40):\n    x = {'a': x, 'b': x, 'c': x}\no.part(x)",
        {"type", "value"},
    ),
    "long_name": (BODY + "o.part('x' * 10 ** 7)", {"value"} | STOPPED),
    "digits": (BODY + "p.add(box((10 ** 100000, 1, 1)))", {"value"} | STOPPED),
    # Arguments of wrong types.
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


class Contained(NamedTuple):
    """The outcome of one hostile program."""

    name: str
    codes: tuple[str, ...]
    seconds: float
    grown_mb: float
    why: str
    """Faults of the sandbox; empty if it contained the program."""


def contain(
    name: str, options: ProgramOptions | None = None, *, within_s: float = SECONDS
) -> Contained:
    """Run a hostile program, and a valid one after it.

    Args:
        name: one of `HOSTILE`.
        options: by default without the type check, which would refuse many programs.
        within_s: time [s] in which it must end.
    """
    text, allowed = HOSTILE[name]
    before, start = resident_mb(), time.monotonic()
    built = build(text, options or ProgramOptions(type_check=False))
    seconds, grown = time.monotonic() - start, resident_mb() - before
    codes = tuple(signal.code for signal in built.signals)
    faults = {
        "no signal": not codes,
        "an object that passes": built.ok,
        f"signals {', '.join(codes)}": not set(codes) <= allowed | ASIDE,
        f"{seconds:.1f} s": seconds >= within_s,
        f"{grown:.0f} MB": grown >= MEGABYTES,
        "the next program does not run": not build(FINE).ok,
    }
    return Contained(
        name, codes, seconds, grown, "; ".join(fault for fault, wrong in faults.items() if wrong)
    )


def resident_mb() -> float:
    """Return the resident memory of this process [MB]; 0 where the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

"""Hostile programs: each ends in an error, within its limits, and the next program runs."""

import re

import pytest

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.program import build

SDK = (
    "from neoworld_mjx.program.sdk import Object, box, cylinder, difference, extrusion, lathe, "
    "sphere, sweep, union\n"
)
BODY = SDK + "o = Object('thing')\np = o.part('body', material='oak')\n"
SHARED = "x = [1.0] * 6\nfor i in range(15):\n    x = [x, x, x, x, x, x]\n"
"""A list of 6^16 leaves in a few bytes."""
FINE = BODY + "p.add(box((0.1, 0.1, 0.1)))\n"

HOSTILE: dict[str, tuple[str, str]] = {
    # Files, network and processes.
    "open_file": ("print(open('/etc/passwd').read())", "forbidden: line 1: .*programs have no"),
    "write_file": ("open('/tmp/hostile', 'w').write('x')", "forbidden: line 1"),
    "pathlib": ("from pathlib import Path\nprint(Path('/etc/passwd').read_text())", "forbidden"),
    "environ": ("import os\nprint(os.environ['HOME'])", "runtime: line 2: .*not supported"),
    "socket": ("import socket\nsocket.create_connection(('127.0.0.1', 80))", "import: line 1"),
    "input": ("input('name? ')", "runtime: .*'input' is not defined"),
    # Imports and introspection.
    "import_host": ("import neoworld_mjx.config", "import: line 1"),
    "dunder_import": ("__import__('os').system('id')", "'__import__' is not defined"),
    "subclasses": ("().__class__.__bases__[0].__subclasses__()", "no attribute '__class__'"),
    "frames": ("import sys\nprint(sys._getframe(0))", "no attribute '_getframe'"),
    "private": (BODY + "print(getattr(p, '_owner'))", "no attribute '_owner'"),
    "globals_of_sdk": (BODY + "print(p.add.__globals__)", "runtime: line 4"),
    "class_of_handle": (BODY + "print(type(p)('x'))", "cannot instantiate host class 'Part'"),
    "setattr": (BODY + "o._joints = 5\nsetattr(p, '_geoms', 5)", "empty_part"),
    # Time.
    "endless_loop": ("while True:\n    pass", "timeout: .*look for an endless loop"),
    "catch_everything": (
        "while True:\n    try:\n        while True:\n            pass\n    except BaseException:\n"
        "        pass",
        "timeout: .*look for an endless loop",
    ),
    "endless_shapes": (
        BODY + "h = [sphere(0.04).moved((0.1 * (i % 8), 0.1 * (i // 8), 0)) for i in range(63)]\n"
        "for k in range(10 ** 6):\n    try:\n"
        "        difference(box((10, 10, 1 + 1e-6 * k)), *h)\n"
        "    except ValueError:\n        pass",
        "timeout: line \\d: building the shapes took over 1 s; use fewer",
    ),
    # Memory, recursion and output.
    "power": ("print(10 ** 10 ** 8)", "memory: line 1: .*holds too much at once"),
    "doubling": ("x = [0]\nwhile True:\n    x = x + x", "memory: line 3"),
    "recursion": ("def f(n):\n    return f(n + 1)\nf(0)", "recursion: line 2: .*write a loop"),
    "deep_parens": ("x = " + "(" * 5000 + "1" + ")" * 5000, "syntax: .*too deeply nested"),
    # The interpreter's and the worker's limits are reached at about the same time.
    "print_bomb": (
        "while True:\n    print('x' * 1000)",
        "output: .*print at most 20000 bytes|timeout: building the shapes took over 1 s",
    ),
    "long_text": ("# " + "x" * 300_000, "too_long: the program's text is too long"),
    "nul": ("x = '\0'", "syntax: the text holds a NUL character"),
    "lone_surrogate": ("x = '\ud800'", "syntax: the text is not valid Unicode"),
    # Many calls and large geometry.
    "call_flood": (
        BODY + "while True:\n    try:\n        box((1, 1, 1))\n    except Exception:\n        pass",
        "too_many_calls: .*make at most 5000 calls",
    ),
    "part_flood": (
        SDK + "o = Object('x')\nfor i in range(10 ** 6):\n    o.part(f'p{i}')",
        "too_big: line 4: the object needs over 300 parts",
    ),
    "million_boxes_caught": (
        BODY + "s = box((1, 1, 1))\nfor i in range(10 ** 6):\n    try:\n        p.add(s)\n"
        "    except BaseException:\n        pass",
        "too_big: line 7: the object needs over 3000 geoms",
    ),
    "heavy_lathes": (
        BODY + "for i in range(10 ** 6):\n"
        "    q = [(0.1 + 0.001 * k, 0.01 * k + 0.00001 * i) for k in range(18)]\n"
        "    p.add(lathe(q, 0.01, sectors=64))",
        "too_big: line 6: the object needs over 16000 pieces built",
    ),
    "sectors": (
        BODY + "p.add(lathe([(0, 0), (1, 1)], 0.1, sectors=10 ** 9))",
        "lathe sectors must lie between 6 and 64, got 1000000000",
    ),
    "long_outline": (
        BODY + "extrusion([(i, i * i) for i in range(10 ** 5)], 1)",
        "extrusion outline must have 3 to 128 entries, got 100000",
    ),
    "sieve": (
        BODY + "h = [cylinder(0.04, 9).moved((0.1 * (i % 8), 0.1 * (i // 8), 0)) "
        "for i in range(63)]\np.add(difference(box((10, 10, 1)), *h, sectors=64))",
        "value: line 5: .*csg needs more than 600 convex pieces",
    ),
    "long_chain": (
        SDK + "o = Object('x')\nq = o.part('p', material='oak')\nq.add(box((0.02, 0.02, 0.02)))\n"
        "for i in range(1, 299):\n    p = o.part(f'p{i}', material='oak')\n"
        "    p.add(box((0.02, 0.02, 0.02)), at=(0.021 * i, 0, 0))\n"
        "    o.revolute(f'j{i}', q, p, at=(0.021 * i - 0.01, 0, 0), axis=(0, 1, 0), "
        "range=(-3, 3))\n    q = p\n",
        "too_intricate: the object could not be checked in the time allowed",
    ),
    # Numbers, and values that are small in the sandbox and large written out.
    "nan": (BODY + "p.add(box((float('nan'), 1, 1)))", "box size must be finite, got nan"),
    "huge_integer": (BODY + "p.add(box((10 ** 5000, 1, 1)))", "got an integer of 16610 bits"),
    "far_away": (BODY + "p.add(box((1, 1, 1)), at=(1e300, 0, 0))", r"at must lie within \+-100"),
    "shared_list": (BODY + SHARED + "p.add(box((x, 1, 1)))", "box size must be a number"),
    "cyclic_list": (BODY + "x = [0, 0, 0]\nx[0] = x\np.add(box(x))", "must be a number"),
    # Arguments of wrong types.
    "own_class": (BODY + "class S:\n    size = 1\np.add(S())", "needs a shape such as box"),
    "foreign_part": (
        BODY + "q = Object('other').part('q')\no.fixed('f', p, q)",
        "child 'q' belongs to another object",
    ),
    "own_parent": (BODY + "o.fixed('f', p, p)", "parent and child are both 'body'"),
    "path_name": (SDK + "Object('../../etc/passwd')", "Object name must start with a letter"),
    "raise_exit": ("raise SystemExit(0)", "runtime"),
}
"""Programs, each with a pattern of the message that it ends in."""


# The type check stops many programs before they start, so all run without it.
@pytest.mark.parametrize("name", HOSTILE)
def test_every_hostile_program_ends_in_one_clear_message(name: str):
    text, message = HOSTILE[name]
    options = ProgramOptions(type_check=False)
    built = build(text, options)
    assert not built.ok
    assert len(built.printed) < 30_000
    messages = [signal.phrase() for signal in built.signals if signal.severity == "error"]
    assert re.search(message, messages[0]), messages[0]
    assert build(FINE, options).ok


def test_an_endless_program_ends_with_its_type_check():
    (signal,) = build(SDK + "while True:\n    pass").signals
    assert signal.code == "timeout"


CHANGING = {
    "clock": "import time\nv = [time.time(), time.monotonic(), time.perf_counter()]",
    "nanoseconds": "import time\nv = [time.time_ns() % 1000, time.monotonic_ns() % 1000]",
    "processor time": "import time\nv = [time.process_time()]",
    "date": "from datetime import datetime\nv = [datetime.now().isoformat()]",
    "local time": "import time\nv = [time.ctime(), time.localtime().tm_yday]",
    "random": "import random\nv = [random.random(), random.Random().random()]",
    "seed": "import random\nrandom.seed()\nv = [random.random()]",
    "addresses": "v = [id(p), str(lambda: 1), hash('abc'), list({'a', 'b', 'long'})]",
}


@pytest.mark.parametrize("name", CHANGING)
def test_equal_texts_see_equal_clocks_and_random_numbers(name: str):
    """A resumed run would build another object otherwise."""
    text = FINE + CHANGING[name] + "\nprint(v)\n"
    first, second = (build(text, ProgramOptions(type_check=False)) for _ in range(2))
    assert first.ok and first.printed and first.printed == second.printed

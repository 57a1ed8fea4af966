"""Hostile inputs of every kind from a seed, and a watcher of what reading them does.

    python -m tests.support.hostile_inputs FIRST COUNT

prints one JSON line for each input: its kind, its outcome, seconds, growth of memory, and what is
wrong with it; empty is good.
"""

import copy
import json
import os
import random
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from neoworld_mjx.config import Config, ProgramOptions, load_config
from neoworld_mjx.errors import NeoWorldError
from neoworld_mjx.io.limited_worker import call_limited
from neoworld_mjx.mllm.responses import InvalidResponse, read_response
from tests.support import answers
from tests.support.hostile import BODY, FINE, HOSTILE
from tests.support.hostile_assets import grown
from tests.support.hostile_servers import server
from tests.support.processor_time import processor_s

SECONDS, MEGABYTES = 10.0, 500.0
"""Processor time and growth of memory that reading one input may take."""
PRECIOUS = {"precious.txt": "precious", "photos/parse.png": "precious too"}

WORDS = [
    *("1e308", "-1e308", "5e-324", "NaN", "Infinity", "-1", "0", "1e17", "9" * 400, "null", "true"),
    *('""', "[]", "{}", "[" * 5000, "{" * 500, '"\\ud800"', "\u202e", "\0", "\n", "&xxe;"),
    *("../../outside/precious.txt", "/etc/passwd", "/dev/zero", "<script>", "]]>", "*a", "&a "),
    "<!DOCTYPE x>",
    *("x" * 10_000, "count='1000'", "<replicate count='1000'>", "!!python/name:os.system"),
]  # fmt: skip
VALUES: list[Any] = [
    *(None, True, -1, 0, 1e308, -1e308, 5e-324, 1e17, 10**400, "", "x" * 10_000, [], {}, [[]] * 50),
    *("../../outside/precious.txt", "/etc/passwd", "a\n\u202e<b>", {"a": {"a": {}}}, [1e999]),
]
NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


class Outcome(NamedTuple):
    """What reading one input did."""

    seed: int
    kind: str
    outcome: str
    """The error's class, or "read"."""
    seconds: float
    """Processor time, that of workers included."""
    wall_s: float
    grown_mb: float
    wrong: str
    """Empty if it is contained."""


def mutated_text(draw: random.Random, text: str) -> str:
    """Change a text in up to four places."""
    for _ in range(draw.randint(1, 4)):
        at, to = sorted(draw.randrange(len(text) + 1) for _ in range(2))
        to = min(to, at + draw.choice([1, 10, 200]))
        kind = draw.randrange(5)
        numbers = list(NUMBER.finditer(text))
        if kind == 0 and numbers:
            found = draw.choice(numbers)
            text = text[: found.start()] + draw.choice(WORDS) + text[found.end() :]
        elif kind == 1:
            text = text[:at] + draw.choice(WORDS) + text[at:]
        elif kind == 2:
            text = text[:at] + text[to:]
        elif kind == 3:
            text = text[:at] + text[at:to] * draw.choice([2, 50]) + text[to:]
        elif draw.random() < 0.3:
            text = text[:at]
    return text


def mutated_json(draw: random.Random, value: Any) -> Any:
    """Replace, drop or repeat some values of a tree."""
    value = json.loads(json.dumps(value))
    for _ in range(draw.randint(1, 3)):
        at = value
        while isinstance(at, dict | list) and at:
            key = draw.choice(list(at)) if isinstance(at, dict) else draw.randrange(len(at))
            inner = at[key]
            if not isinstance(inner, dict | list) or not inner or draw.random() < 0.25:
                if draw.random() < 0.2:
                    del at[key]
                elif isinstance(at, list) and draw.random() < 0.2:
                    at.extend([inner] * draw.choice([1, 300]))
                else:
                    at[key] = copy.deepcopy(draw.choice(VALUES))
                break
            at = inner
    return value


def mutated_bytes(draw: random.Random, data: bytes) -> bytes:
    """Change bytes, mostly near the head, where sizes are."""
    changed = bytearray(data)
    for _ in range(draw.randint(1, 12)):
        near = len(changed) if draw.random() < 0.5 else min(len(changed), 200)
        at = draw.randrange(max(near, 1))
        four = draw.choice([b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", os.urandom(0)])
        changed[at : at + len(four)] = four or bytes([draw.randrange(256)])
    if draw.random() < 0.2:
        del changed[draw.randrange(len(changed)) :]
    return bytes(changed)


def _answer(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.parse.schema import ParsedScene, to_tree
    from neoworld_mjx.program.ask import ProgramResponse

    data = mutated_json(draw, answers.desk())
    text = json.dumps(data)
    text = mutated_text(draw, text) if draw.random() < 0.3 else text
    if draw.random() < 0.2:
        read_response(text, ProgramResponse)
    tree = to_tree(read_response(text, ParsedScene), answers.photo())
    (home / "tree.json").write_text(tree.to_json(), encoding="utf-8")


def _program(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.program import build

    # Flooding the SDK takes its whole time by design, and has a test of its own.
    short = [text for text, _ in HOSTILE.values() if "while" not in text and "range" not in text]
    text = mutated_text(draw, draw.choice([FINE, BODY, *short]))
    built = build(text, ProgramOptions(type_check=draw.random() < 0.2, timeout_s=1.0))
    internal = [signal.message for signal in built.signals if signal.code == "internal"]
    assert not internal, internal


def _run_folder(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.run_folder import RunFolder
    from neoworld_mjx.spec import read_scene
    from neoworld_mjx.view.report.run_report import write_report

    out = home / "out"
    with RunFolder(out, Config()) as run:
        with run.step("parse", {"a": 1}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text(answers.exact().to_json(), encoding="utf-8")
        with run.step("refine", {"a": 1}) as stage:
            assert stage is not None
            (stage / "refine").mkdir()
            np.savez_compressed(stage / "refine" / "history.npz", absolute=np.ones((2, 3)))
            (stage / "scene.json").write_text('{"objects": []}', encoding="utf-8")
        run.record("metrics", s_pen=0, max_depth_m=0.1)
        run.finish()
    for file in draw.sample(["run.json", "tree.json", "scene.json"], draw.randint(0, 2)):
        data = json.loads((out / file).read_text(encoding="utf-8"))
        text = json.dumps(mutated_json(draw, data))
        text = mutated_text(draw, text) if draw.random() < 0.2 else text
        (out / file).write_bytes(text.encode("utf-8", "replace"))
    if draw.random() < 0.3:
        history = out / "refine" / "history.npz"
        history.write_bytes(mutated_bytes(draw, history.read_bytes()))
    if draw.random() < 0.4:
        name = draw.choice([".lock", ".staging", "pictures", "report.html", "tree.json", "new"])
        (out / name).unlink(missing_ok=True)
        target = draw.choice(["precious.txt", "photos", "missing"])
        if draw.random() < 0.8:
            (out / name).symlink_to(home.parent / "outside" / target)
        else:
            os.mkfifo(out / name)
    errors = []
    for act in (
        lambda: write_report(out),
        lambda: read_scene(out),
        lambda: _again(out, draw.choice(["resume", "overwrite"])),
        lambda: write_report(out),
    ):
        try:
            act()
        except NeoWorldError as error:
            errors.append(error)
    if errors:
        raise errors[0]


def _again(out: Path, mode: Any) -> None:
    from neoworld_mjx.run_folder import RunFolder

    with RunFolder(out, Config(), mode) as run:
        with run.step("parse", {"a": 2}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text("{}", encoding="utf-8")
        run.finish()


URDF = """<?xml version="1.0"?><robot name="r"><material name="m"><color rgba="1 0 0 1"/></material>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial><visual><geometry><box size="1 1 1"/></geometry></visual><collision><geometry>
<cylinder radius="0.1" length="1"/></geometry></collision></link><link name="b"><collision>
<geometry><sphere radius="0.2"/></geometry></collision></link><link name="c"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 1" rpy="0 0 1"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint><joint name="k"
type="fixed"><parent link="b"/><child link="c"/></joint></robot>"""
MJCF = """<mujoco model="m"><compiler angle="radian"/><asset><material name="m" rgba="1 0 0 1"/>
</asset>
<worldbody><body name="a" pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .3" material="m"/>
<body name="b" pos="0 0 .3"><joint name="j" type="hinge" axis="0 0 1" range="0 1" damping=".1"/>
<geom type="capsule" size=".05 .1" mass="1"/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
</body></body></worldbody><equality/></mujoco>"""


def _urdf(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.export import import_urdf

    path = home / "a.urdf"
    path.write_bytes(mutated_text(draw, URDF).encode("utf-8", "replace"))
    import_urdf(path)


def _mjcf(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.export import import_mjcf

    path = home / "a.xml"
    path.write_bytes(mutated_text(draw, MJCF).encode("utf-8", "replace"))
    import_mjcf(path)


USD = """#usda 1.0
(
    defaultPrim = "a"
    metersPerUnit = 1
)
def Xform "a" (prepend references = @./b.usda@)
{
    def Cube "one" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
    {
        double size = 0.2
    }
    def Mesh "two" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
    {
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
        float3 xformOp:scale = (0.1, 0.2, 0.3)
        uniform token[] xformOpOrder = ["xformOp:scale"]
    }
    def PhysicsRevoluteJoint "j" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])
    {
        rel physics:body0 = </a/one>
        rel physics:body1 = </a/two>
        float physics:lowerLimit = -90
        float physics:upperLimit = 30
        float drive:angular:physics:damping = 2
    }
}
"""


def _usd(draw: random.Random, home: Path) -> None:
    from pxr import Sdf

    from neoworld_mjx.export.importing_scene import import_file

    path = home / "a.usda"
    (home / "b.usda").write_text('#usda 1.0\n(\ndefaultPrim = "b"\n)\ndef Xform "b"\n{\n}\n')
    if draw.random() < 0.7:
        path.write_text(mutated_text(draw, USD), encoding="utf-8")
    else:
        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(USD)
        path = home / "a.usdc"
        layer.Export(str(path))
        path.write_bytes(mutated_bytes(draw, path.read_bytes()))
    import_file(path)


POSES = """{"frame": "camera", "up": [0, -1, 0], "objects": {"box": {"file": "a.obj",
 "fixed": false, "pose": [[1, 0, 0, 0.1], [0, 1, 0, -2.5], [0, 0, 1, 0.3], [0, 0, 0, 1]]}}}"""


def _mesh(draw: random.Random, home: Path) -> None:
    import trimesh

    from neoworld_mjx.export.importing_scene import import_file
    from neoworld_mjx.export.load_mesh import load_mesh

    suffix = draw.choice(["obj", "stl", "ply", "off", "glb", "dae", "poses"])
    if suffix == "poses":
        trimesh.creation.box().export(home / "a.obj")
        (home / "poses.json").write_bytes(mutated_text(draw, POSES).encode("utf-8", "replace"))
        import_file(home / "poses.json")
        return
    path = home / f"a.{suffix}"
    trimesh.creation.box().export(path)
    data = path.read_bytes()
    if suffix in ("obj", "off", "dae") and draw.random() < 0.7:
        path.write_bytes(mutated_text(draw, data.decode()).encode("utf-8", "replace"))
    else:
        path.write_bytes(mutated_bytes(draw, data))
    call_limited(load_mesh, path, needs=("trimesh",))
    if suffix == "glb":
        import_file(path)


def _picture(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.parse.photo import load_photo
    from neoworld_mjx.view.report.page import picture

    suffix = draw.choice(["png", "jpg", "webp", "tif", "bmp", "gif", "ppm", "tga", "ico", "jp2"])
    path = home / f"a.{suffix}"
    Image.effect_noise((32, 32), 90).convert("RGB").save(path)
    path.write_bytes(mutated_bytes(draw, path.read_bytes()))
    picture(path, "a")
    load_photo(path)


def _crowd(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.fit.fit_tree import fit_tree
    from neoworld_mjx.fit.tree_checks import check_tree
    from neoworld_mjx.parse.schema import ParsedScene, to_tree

    names = [f"o{k}" for k in range(round(10 ** draw.uniform(0, 2.1)))]
    data = answers.answer()
    for k, name in enumerate(names):
        parent = draw.choice(["table", names[max(k - 1, 0)], draw.choice(names)])
        left, top = draw.randrange(700), draw.randrange(500)
        box = {"left": left, "top": top, "right": left + 90, "bottom": top + 90}
        at = (draw.uniform(0.5, 1.2), draw.uniform(-0.3, 0.3), draw.uniform(0, 0.5))
        extra = {"parent": "table" if parent == name else parent, "box": box}
        data["objects"].append(answers.item(name, at, **extra))
    tree = to_tree(read_response(json.dumps(data), ParsedScene), answers.photo())
    check_tree(fit_tree(tree)[0])


YAML = """seed: 3
refine: {cem: {population: 32, sigma_xy: 0.02}, rollout: {duration_s: 0.5}, reward: {terms: {}}}
mllm: {headers: {"x-a": "${A}"}, timeout_s: 3.0}
render:
  width: 96
"""
PLAN = """scenes: [a.json]
seeds: [0, 1, 2]
base: {refine: {cem: {population: 16}}}
axes:
  refine.reward.w_drift: [0.0, 1.0]
  refine.cem.sigma_xy: [0.01, 0.02]
"""


def _yaml(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.sweeps.plan import Plan, points, read_plan

    path = home / "a.yaml"
    plan = draw.random() < 0.4
    path.write_bytes(mutated_text(draw, PLAN if plan else YAML).encode("utf-8", "replace"))
    if plan:
        points(read_plan(path, Plan))
    else:
        load_config(path)


def _tape(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.mllm.replay import Tape

    entry = {"role": "reasoner", "name": "parse", "answer": answers.desk()}
    data = mutated_json(draw, {"format": 1, "photo": "0" * 64, "answers": {"k": entry}})
    path = home / "a.tape.json"
    text = json.dumps(data)
    text = mutated_text(draw, text) if draw.random() < 0.3 else text
    path.write_bytes(text.encode("utf-8", "replace"))
    Tape.load(path).save(home / "b.tape.json")


def _results(draw: random.Random, home: Path) -> None:
    from neoworld_mjx.sweeps.run_rows import read_runs, write_runs

    path = home / "results.parquet"
    row = {"scene": "a", "point": "base", "seed": 0, "fingerprint": "x"}
    write_runs(path, [row] * 3, [])
    path.write_bytes(mutated_bytes(draw, path.read_bytes()))
    read_runs(path)


KINDS: dict[str, Callable[[random.Random, Path], None]] = {
    "answer": _answer,
    "program": _program,
    "run folder": _run_folder,
    "urdf": _urdf,
    "mjcf": _mjcf,
    "usd": _usd,
    "mesh": _mesh,
    "picture": _picture,
    "yaml": _yaml,
    "tape": _tape,
    "results": _results,
    "growing asset": grown,
    "crowd": _crowd,
    "server": server,
}


class Watcher:
    """Notes what this process writes, renames, deletes or starts outside of the folders allowed.

    It sees Python's audit events; files beside the input are compared besides, so that what a C
    library writes there is seen, too.
    """

    def __init__(self) -> None:
        self.allowed: list[str] = []
        self.seen: list[str] = []
        sys.addaudithook(self._note)

    @contextmanager
    def watching(self, *folders: Path) -> Iterator[list[str]]:
        """Watch while the block runs; the list fills with what is outside of the folders."""
        self.seen = []
        self.allowed = [os.path.realpath(folder) for folder in folders]
        if sys.pycache_prefix:
            # A library that is imported meanwhile leaves its bytecode there.
            self.allowed.append(os.path.realpath(sys.pycache_prefix))
        try:
            yield self.seen
        finally:
            self.allowed = []

    def _note(self, event: str, details: tuple[Any, ...]) -> None:
        if not self.allowed:
            return
        if event == "open":
            path, mode, flags = details
            writes = isinstance(mode, str) and set(mode) & set("wax+")
            if not writes and not (isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR)):
                return
            self._check(event, path)
        elif event in ("os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.chmod"):
            self._check(event, details[0])
        elif event in ("os.rename", "os.link", "os.symlink"):
            self._check(event, details[1])
            if event == "os.rename":
                self._check(event, details[0])
        elif event in ("os.system", "os.exec", "os.posix_spawn", "subprocess.Popen"):
            self._started(event, str(details))

    def _started(self, event: str, command: str) -> None:
        """Note a program that is started, but for readers, the sandbox and an SDK's uname."""
        if not re.search(r"limited_worker|monty|uname", command):
            self.seen.append(f"{event} {command}"[:200])

    def _check(self, event: str, path: Any) -> None:
        if isinstance(path, bytes):
            path = os.fsdecode(path)
        # A bare name is below a folder that was opened without following links.
        if not isinstance(path, str) or "/" not in path:
            return
        real = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
        device = real.startswith("/dev/") and not real.startswith("/dev/shm/")
        if not device and not any(real.startswith(folder) for folder in self.allowed):
            self.seen.append(f"{event} {path}")


_watcher: list[Watcher] = []


def peak_mb() -> float:
    """Return the largest resident memory of this process since it was last reset [MB]."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1000


def contained(seed: int) -> Outcome:
    """Make the input of a seed, read it, and tell what that did."""
    if not _watcher:
        _watcher.append(Watcher())
    draw = random.Random(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        home, outside = root / "home", root / "outside"
        home.mkdir()
        for name, text in PRECIOUS.items():
            (outside / name).parent.mkdir(parents=True, exist_ok=True)
            (outside / name).write_text(text, encoding="utf-8")
        with suppress(OSError):  # The peak is that of this input alone.
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        before, start, began = peak_mb(), processor_s(os.getpid()), time.monotonic()
        wrong, outcome = "", "read"
        from neoworld_mjx.cache import cache_folder

        with _watcher[0].watching(home, cache_folder()) as seen:
            try:
                KINDS[kind](draw, home)
            except (NeoWorldError, InvalidResponse) as error:
                outcome = type(error).__name__
                if len(str(error)) > 20_000:
                    wrong = f"a message of {len(str(error))} characters"
            except Exception as error:
                outcome = type(error).__name__
                wrong = f"{outcome}: {error}"[:300]
        seconds, wall_s = processor_s(os.getpid()) - start, time.monotonic() - began
        grown = max(0.0, peak_mb() - before)
        files = {
            path.relative_to(outside).as_posix(): path.read_text(encoding="utf-8")
            for path in outside.rglob("*")
            if path.is_file()
        }
    if files != PRECIOUS:
        wrong = f"files outside changed: {sorted(files)}"
    if seen:
        wrong = f"touched outside of the folder: {seen[0]}"
    if seconds > SECONDS:
        wrong = f"{seconds:.1f} s"
    if grown > MEGABYTES:
        wrong = f"{grown:.0f} MB"
    return Outcome(seed, kind, outcome, round(seconds, 2), round(wall_s, 2), round(grown, 1), wrong)


def main(first: int, count: int) -> None:
    """Print the outcome of some seeds, one JSON line for each."""
    for seed in range(len(KINDS)):
        contained(seed)  # What each kind imports and starts is not the cost of an input.
    for seed in range(first, first + count):
        print(json.dumps(contained(seed)._asdict()), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))

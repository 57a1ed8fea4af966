"""Write the data set: objects of all categories, and scenes with images and annotations.

    DIR/dataset.json                        version, counts and the content hash
    DIR/categories/NAME/program.py, spec.json
    DIR/scenes/NAME/scene.json, scene.usda, objects/, tree.json, joints.json,
                    picture.png, masks.png, depth.npz

Folders with the same content are not written again, so a run continues where it stopped. The hash
covers programs, objects, poses, cameras, and scene, condition and reference plan of every task,
with numbers rounded to six digits; pictures and what is read off them follow from these.
"""

import io
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.errors import RunError
from neoworld_mjx.io.files import content_hash, write_atomic
from neoworld_mjx.machines import Machines, run_tasks
from neoworld_mjx.spec import ObjectSpec, SceneSpec
from neoworld_mjx.templates import template, templates

from ..fidelity.rendered_responses import exact_response
from ..rows import log
from .declaration import declaration, declarations
from .truth_scene import built, photographed, truth_scene

SUMMARY, DONE = "dataset.json", "content.json"
DIGITS = 6
"""Significant digits of numbers in hashes, so that machines agree."""
TASKS = "neoworld_bench.tasks.catalogue"
"""Module of the tasks, which use the scenes of this package."""
VERSION = 2
"""Version of the data set. 1: eleven true scenes of tasks did not pass the final check."""


def make_dataset(
    out: Path, *, seed: int | None = None, workers: int = 1, scenes: Sequence[str] = ()
) -> dict[str, Any]:
    """Write the data set into a folder.

    Args:
        out: the folder.
        seed: draws one instance of each category; None takes every program's own parameters.
        workers: processes.
        scenes: names of the scenes to write, without categories and tasks; all by default.

    Returns:
        "version", "categories", "joints" that move, "scenes", "tabletop", "tasks", "hash",
        "seconds".

    Raises:
        RunError: a file cannot be written.
        SpecError: there is no such scene.
    """
    began = time.perf_counter()
    chosen = {name: declaration(name) for name in scenes} or declarations()
    categories = [] if scenes else list(templates())
    jobs = [("categories", name, str(out), seed) for name in categories]
    jobs += [("scenes", name, str(out), seed) for name in chosen]
    jobs += [] if scenes else [("tasks", name, str(out), seed) for name in task_names()]
    done = run_tasks(_write_part, jobs, Machines(workers=workers))
    order = {job[:2]: k for k, job in enumerate(jobs)}
    parts = sorted(done, key=lambda part: order[part["kind"], part["name"]])
    summary = {
        "version": VERSION,
        "categories": len(categories),
        "joints": sum(part["joints"] for part in parts if part["kind"] == "categories"),
        "scenes": len(chosen),
        "tabletop": sum(d.tabletop for d in chosen.values()),
        "tasks": sum(part["kind"] == "tasks" for part in parts),
        "hash": _hash_of(parts),
    }
    _write(out / SUMMARY, json.dumps(summary | {"seed": seed}, indent=1) + "\n")
    return summary | {"seconds": time.perf_counter() - began}


def _hash_of(parts: Iterable[dict[str, Any]]) -> str:
    return content_hash([VERSION, *(f"{p['kind']}/{p['name']}:{p['hash']}" for p in parts)])


def task_names() -> list[str]:
    """Return the names of the benchmark's tasks."""
    return list(import_module(TASKS).task_names())


def _write_part(job: tuple[str, str, str, int | None]) -> Iterator[dict[str, Any]]:
    kind, name, out, seed = job
    folder = Path(out) / kind / name
    part = _part(kind, name, seed)
    content = {key: part[key] for key in ("kind", "name", "joints", "hash")}
    text = json.dumps(content, indent=1) + "\n"
    done = folder / DONE
    if kind == "tasks":
        yield content  # Tasks are part of the package: only their hash is listed.
        return
    if not done.is_file() or done.read_text(encoding="utf-8") != text:
        for path, data in part["files"]().items():
            _write(folder / path, data)
        _write(done, text)
        log.info(f"{kind}/{name}")
    yield content


def _part(kind: str, name: str, seed: int | None) -> dict[str, Any]:
    if kind == "categories":
        part = _category(name, seed)
    else:
        part = _scene(name) if kind == "scenes" else _task(name)
    return {"kind": kind, "name": name, **part}


def _task(name: str) -> dict[str, Any]:
    task = import_module(TASKS).find_task(name)
    parts = (rounded(p.model_dump(mode="json")) for p in (task.scene, task.predicate, task.plan))
    return {"joints": 0, "hash": content_hash([task.instruction, *parts])}


def _category(name: str, seed: int | None) -> dict[str, Any]:
    chosen = template(name)
    text = chosen.program({} if seed is None else chosen.draw(seed))
    spec = built(text)
    return {
        "joints": sum(joint.type != "fixed" for joint in spec.joints),
        "hash": content_hash([text, rounded(spec.model_dump(mode="json"))]),
        "files": lambda: {"program.py": text, "spec.json": spec.model_dump_json(indent=1) + "\n"},
    }


def _scene(name: str) -> dict[str, Any]:
    scene = truth_scene(declaration(name))
    joints = sum(j.type != "fixed" for item in scene.objects for j in item.spec.joints)
    return {
        "joints": joints,
        "hash": content_hash(rounded(scene.model_dump(mode="json"))),
        "files": lambda: _scene_files(name),
    }


def _scene_files(name: str) -> dict[str, str | bytes]:
    from neoworld_mjx.export.formats import scene_files
    from neoworld_mjx.render import render_scene, to_png

    scene = photographed(declaration(name))
    tree = exact_response(scene)
    image = render_scene(scene)
    depth = io.BytesIO()
    np.savez_compressed(depth, depth_m=image.depth.astype(np.float32))
    owners = (image.segmentation + 1).astype(np.uint8)
    return {
        **scene_files(scene),
        "tree.json": tree.to_json(),
        "joints.json": json.dumps(_joints(scene), indent=1) + "\n",
        "masks.json": json.dumps(["", *image.names], indent=1) + "\n",
        "picture.png": to_png(image),
        "masks.png": to_png(owners),
        "depth.npz": depth.getvalue(),
    }


def _joints(scene: SceneSpec) -> list[dict[str, Any]]:
    return [
        {
            "object": item.name,
            **joint.model_dump(mode="json"),
            "value": item.joint_state.get(joint.name, 0.0),
        }
        for item in scene.objects
        for joint in _moving(item.spec)
    ]


def _moving(spec: ObjectSpec) -> list[Any]:
    return [joint for joint in spec.joints if joint.type != "fixed"]


def rounded(value: Any) -> Any:
    """Return a JSON value with its numbers rounded to DIGITS significant digits."""
    if isinstance(value, float):
        short = float(f"{value:.{DIGITS - 1}e}")
        # Rounding errors count as 0.
        return 0.0 if abs(short) < 1e-9 else short
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [rounded(inner) for inner in value]
    return value


def _write(path: Path, data: str | bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, data)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror}") from None

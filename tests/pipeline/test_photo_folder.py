"""A folder of photographs: one run folder each, one ledger, one cost cap."""

import json
import shutil
import signal
import subprocess
import sys
import time

import pytest

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import PhotoError, RunError
from neoworld_mjx.pipeline import photo_folder
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.pipeline.photo_folder import PhotoOutcome, photographs, reconstruct_folder
from neoworld_mjx.run_folder.run_json import FORMAT

CONFIG = load_config(None, {"provider": "replay", "mllm": {"max_cost_usd": 3.0}})


@pytest.fixture
def photos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for example in bundled_examples().values():
        shutil.copy(example.photo, folder)
    (folder / "notes.txt").write_text("no picture")
    return folder


def test_photographs_are_listed_by_name(photos, tmp_path):
    assert [p.name for p in photographs(photos)] == ["coffee.png", "drawers.png", "microwave.jpg"]
    shutil.copy(photos / "coffee.png", photos / "microwave.png")
    with pytest.raises(PhotoError, match="several photographs named microwave"):
        photographs(photos)
    with pytest.raises(PhotoError, match="has no photographs"):
        photographs(tmp_path)


def paid(monkeypatch, costs):
    """Replace reconstructions by runs that cost money, and return the caps that they got."""
    caps = []

    def work(task):
        cost, name = costs[task.photo.stem], task.photo.stem
        cap = task.config.mllm.max_cost_usd
        caps.append((name, round(cap, 6)))
        stopped = cost > cap
        row = {"role": "parser", "model": "m", "calls": 1, "failed_calls": 0,
               "tokens": {"input": 1, "output": 1}, "cost_usd": min(cost, cap)}  # fmt: skip
        mllm = {"by_role_and_model": [row], "fallbacks": {}, "known_cost_usd": min(cost, cap)}
        task.out.mkdir(exist_ok=True)
        run = {"format": FORMAT, "status": "running" if stopped else "finished", "mllm": mllm}
        (task.out / "run.json").write_text(json.dumps(run | {"steps": {}, "fallbacks": []}))
        yield PhotoOutcome(task.photo, None if stopped else {"passed": True},
                           "cost cap reached" if stopped else "", stopped)  # fmt: skip

    monkeypatch.setattr(photo_folder, "reconstruct_photo", work)
    return caps


def test_one_cap_covers_all_photographs(photos, tmp_path, monkeypatch):
    caps = paid(monkeypatch, {"coffee": 0.2, "drawers": 1.5, "microwave": 0.3})
    about = reconstruct_folder(photos, tmp_path / "out", CONFIG)
    # A third each; then what the two others leave is for the one that was stopped at 1.
    assert caps == [("coffee", 1.0), ("drawers", 1.0), ("microwave", 1.0), ("drawers", 2.5)]
    assert about["passed"] and about["mllm"]["known_cost_usd"] == pytest.approx(2.0)
    assert json.loads((tmp_path / "out" / "photos.json").read_text()) == about


def test_the_cap_is_never_exceeded(photos, tmp_path, monkeypatch):
    caps = paid(monkeypatch, {"coffee": 9.0, "drawers": 9.0, "microwave": 0.5})
    about = reconstruct_folder(photos, tmp_path / "out", CONFIG)
    assert about["mllm"]["known_cost_usd"] <= 3.0 and not about["passed"]
    assert [p["error"] for p in about["photos"]] == ["cost cap reached", "cost cap reached", ""]
    assert caps[3:] == [("coffee", 1.25), ("drawers", 1.25)]


def test_runs_that_are_there_are_not_lost(photos, tmp_path, monkeypatch):
    paid(monkeypatch, dict.fromkeys(("coffee", "drawers", "microwave"), 0.1))
    out = tmp_path / "out"
    reconstruct_folder(photos, out, CONFIG)
    with pytest.raises(RunError, match="contains runs of photographs: continue them with --resume"):
        reconstruct_folder(photos, out, CONFIG)
    assert reconstruct_folder(photos, out, CONFIG, resume=True)["passed"]
    with pytest.raises(RunError, match="give one of them"):
        reconstruct_folder(photos, out, CONFIG, resume=True, overwrite=True)
    with pytest.raises(RunError, match="is not empty and contains no runs of photographs"):
        reconstruct_folder(photos, photos, CONFIG)


@pytest.mark.slow
def test_three_photographs_are_reconstructed_from_their_tapes(photos, tmp_path):
    about = reconstruct_folder(photos, tmp_path / "out", CONFIG, until="program")
    assert [p["error"] for p in about["photos"]] == ["", "", ""] and about["finished"]
    for name in ("coffee", "drawers", "microwave"):
        assert (tmp_path / "out" / name / "tree.json").is_file()
    assert about["mllm"]["calls"] > 3 and about["mllm"]["max_cost_usd"] == 3.0


def reconstruction(photos, out, *words):
    line = [sys.executable, "-m", "neoworld_mjx.cli", "reconstruct", photos, "--out", out]
    line += ["--provider", "replay", "--until", "compose", "--set", "verify.duration_s=0.5", *words]
    return subprocess.Popen([*map(str, line)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def composed(out):
    return {p.parts[-3]: p.read_bytes() for p in sorted(out.glob("*/compose/scene.json"))}


@pytest.mark.slow
def test_ray_loses_a_worker_and_its_driver_and_the_scenes_are_those_of_one_process(
    photos, tmp_path
):
    pytest.importorskip("ray")
    psutil = pytest.importorskip("psutil")
    assert reconstruction(photos, tmp_path / "alone").wait(900) == 0
    out, on_ray = tmp_path / "ray", ("--ray", "local", "--workers", 2)
    driver = reconstruction(photos, out, *on_ray)

    def await_one(pattern):
        while driver.poll() is None and not any(out.glob(pattern)):
            time.sleep(0.05)

    await_one("*/tree.json")
    workers = [p for p in psutil.Process(driver.pid).children(recursive=True)
               if any("run_in_worker" in word for word in p.cmdline())]  # fmt: skip
    assert workers
    workers[0].kill()
    await_one("*/compose/scene.json")
    # Ray's own processes end when the driver's socket closes.
    driver.send_signal(signal.SIGKILL)
    assert driver.wait() == -signal.SIGKILL and len(composed(out)) < 3
    assert reconstruction(photos, out, "--resume", *on_ray).wait(900) == 0
    assert composed(out) == composed(tmp_path / "alone") and len(composed(out)) == 3
    assert json.loads((out / "photos.json").read_text())["finished"]

"""Configurations, plans and results from elsewhere end in one message before anything runs."""

import os
import subprocess
import sys

import pytest

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.refinement.objective import named_terms
from neoworld_mjx.sweeps.folder import SweepFolder, read_rows
from neoworld_mjx.sweeps.plan import Plan, points, read_plan


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("refine.rollout.duration_s", float("inf")),
        ("refine.rollout.duration_s", 1e12),
        ("refine.rollout.timestep_s", 1e-30),
        ("refine.check_duration_s", 1e9),
        ("refine.check_timestep_s", 1e-9),
        ("refine.reward.w_sem", float("nan")),
        ("refine.cem.population", 10**12),
        ("verify.duration_s", float("inf")),
        ("verify.timestep_s", 1e-12),
        ("program.timeout_s", float("inf")),
        ("render.width", 10**9),
        ("mllm.timeout_s", float("nan")),
    ],
)
def test_absurd_numbers_are_rejected(path, value):
    *heads, last = path.split(".")
    options: dict = {last: value}
    for head in reversed(heads):
        options = {head: options}
    with pytest.raises(ConfigError, match=path.replace(".", r"\.")):
        load_config(None, options)


def test_a_sweep_of_too_many_points_or_seeds_is_an_error_at_once():
    axes = {
        f"refine.reward.{name}": [float(i) for i in range(1000)]
        for name in ("w_sem", "w_pen", "w_drift", "w_prior")
    }
    with pytest.raises(ConfigError, match="axes: 1000000000000 points, at most 10000"):
        points(read_plan({"axes": axes}, Plan))
    with pytest.raises(ConfigError, match="10000000 seeds, at most 10000"):
        read_plan({"seeds": tuple(range(10**7))}, Plan)


@pytest.mark.parametrize(
    "path", [".:x", "os:", ":", "os:sep", "this_module_is_not_there:f", "os.path:..", "a b:c"]
)
def test_invalid_reward_terms_are_rejected(path):
    config = load_config(None, {"refine": {"reward": {"terms": {path: 1.0}}}})
    with pytest.raises(ConfigError, match=r"refine\.reward\.terms"):
        named_terms(config.refine)


def test_a_module_that_ends_the_process_is_an_error(tmp_path, monkeypatch):
    (tmp_path / "ends_the_process.py").write_text("raise SystemExit(3)")
    monkeypatch.syspath_prepend(tmp_path)
    config = load_config(None, {"refine": {"reward": {"terms": {"ends_the_process:f": 1.0}}}})
    with pytest.raises(ConfigError, match="cannot import 'ends_the_process:f'"):
        named_terms(config.refine)


def test_damaged_results_are_rejected(tmp_path):
    row = {"scene": "a", "point": "base", "seed": 0, "fingerprint": "x", "history": []}
    with SweepFolder(tmp_path, "sweep", resume=False, overwrite=False) as folder:
        folder.write_rows([row], [])
    assert read_rows(tmp_path)[0]["scene"] == "a"
    path = tmp_path / "results.parquet"
    whole = path.read_bytes()
    for cut in (20, len(whole) // 3, len(whole) // 2):
        for data in (whole[:cut] + whole[-8:], whole[:4] + whole[cut:], whole[:cut]):
            path.write_bytes(data)
            with pytest.raises(RunError, match=r"results\.parquet (is|has)"):
                read_rows(tmp_path)


def test_a_foreign_sweep_with_links_is_refused(tmp_path):
    out = tmp_path / "sweep"
    out.mkdir()
    (tmp_path / "precious.txt").write_text("precious")
    (out / "sweep.json").symlink_to(tmp_path / "precious.txt")
    for options in ({"resume": True}, {"overwrite": True}):
        with pytest.raises(RunError, match=r"contains 'sweep\.json', which is a link"):
            SweepFolder(out, "sweep", **{"resume": False, "overwrite": False} | options)
    assert (tmp_path / "precious.txt").read_text() == "precious"


def test_a_terminal_in_ascii(tmp_path):
    code = (
        "import logging\n"
        "from neoworld_mjx import cli\n"
        "from neoworld_mjx.commands.base_command import Command\n"
        "from neoworld_mjx.commands.doctor_command import DoctorCommand\n"
        "def run(self):\n"
        "    logging.getLogger('neoworld_mjx').info('чашка')\n"
        "    return {'label': 'чашка \\u202e'}\n"
        "DoctorCommand.run = run\n"
        "DoctorCommand.lines = Command.lines\n"
        "raise SystemExit(cli.run(DoctorCommand()))\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code, encoding="utf-8")
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-X", "utf8=0", str(script)],
        capture_output=True,
        env=environment | {"PYTHONIOENCODING": "ascii"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode() == "label: чашка \\u202e\n"
    assert b"Traceback" not in done.stderr

import ctypes
import gc
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest
from neoworld_mjx.commands.listing_lines import bench_lines, doctor_lines
from PIL import Image

from neoworld_mjx import cli
from neoworld_mjx.commands import COMMANDS, interrupts
from neoworld_mjx.commands.doctor_command import COMPONENTS, DoctorCommand
from neoworld_mjx.commands.object_commands import CheckCommand
from neoworld_mjx.config import Config, list_options
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.mllm import PROVIDERS
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.run_folder import RunFolder
from neoworld_mjx.templates import templates


def assert_refused(ended, *expected):
    assert ended.returncode == 2, ended.stderr
    assert "Traceback" not in ended.stderr
    for words in expected:
        assert words in ended.stderr


def test_help_names_the_commands(neoworld):
    completed = neoworld("--help")
    assert completed.returncode == 0
    said = " ".join(completed.stdout.split())
    for name, entry in COMMANDS.items():
        documented = " ".join(entry.load().__doc__.partition("\n\n")[0].split())
        assert entry.summary == documented
        assert f"{name} {entry.summary}" in said


def test_a_closed_pipe_is_not_an_error(tmp_path):
    with RunFolder(tmp_path / "out", Config()):
        pass
    command = [sys.executable, "-m", "neoworld_mjx.cli", "report", str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        log = running.stderr.read().decode()
    assert running.returncode == 0
    assert "BrokenPipe" not in log and "Traceback" not in log


@pytest.mark.parametrize(("words", "heavy"), [((), ("tyro",)), (("reconstruct",), ())])
def test_help_imports_nothing_heavy(words, heavy):
    names = {"jax", "mujoco", "pydantic", "numpy", "pxr", "PIL", *heavy}
    code = (
        "import sys; from neoworld_mjx import cli\n"
        f"try: cli.main({[*words, '--help']})\n"
        "except SystemExit: pass\n"
        f"print(sorted({names} & set(sys.modules)))"
    )
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert completed.stdout.splitlines()[-1] == "[]", completed.stderr


def test_help_and_the_pages_of_options_name_every_provider(neoworld):
    provider = next(option for option in list_options(Config) if option.path == "provider")
    text = neoworld("reconstruct", "--help").stdout
    for name in PROVIDERS:
        assert name in provider.meaning
        assert name in text


def test_a_misspelt_flag_names_its_neighbour(neoworld):
    assert_refused(neoworld("reconstruct", "a.png", "--out", "x", "--resum"), "--resume")


def test_a_misspelt_command_names_the_commands(neoworld):
    assert_refused(neoworld("reconstrut", "a.png"), "did you mean 'reconstruct'?", "doctor")
    assert_refused(neoworld(), "name a command: reconstruct")
    assert_refused(neoworld("--json", "doctor"), "the command comes before its options")


def test_a_misspelt_step_names_the_steps(neoworld):
    completed = neoworld("reconstruct", "a.png", "--out", "x", "--until", "pars")
    assert_refused(completed, "parse", "export")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("refine.cem.popluation=3", "did you mean 'population'"),
        ("refine.cem.population=many", "refine.cem.population: Input should be a valid integer"),
        ("seed", "KEY=VALUE"),
        ("seed=[1", "not a YAML value"),
    ],
)
def test_wrong_settings_are_one_message(neoworld, tmp_path, setting, said):
    completed = neoworld("render", tmp_path, "--set", setting)
    assert_refused(completed, said)
    assert len(completed.stderr.strip().splitlines()) == 1


def test_a_misspelt_key_in_a_config_file_names_file_and_neighbour(neoworld, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("refine:\n  rewards:\n    w_pen: 3\n")
    completed = neoworld("check", tmp_path, "--config", file)
    assert_refused(completed, str(file), "refine.rewards", "did you mean 'reward'")


def test_flags_win_over_settings_and_settings_over_the_file(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("seed: 1\nrefine: {cem: {population: 4, iterations: 2}}\n")
    settings = ("refine.cem.population=8", "seed=2")
    config = CheckCommand(target=tmp_path, config=file, set=settings).load_config({"seed": 3})
    assert (config.seed, config.refine.cem.population, config.refine.cem.iterations) == (3, 8, 2)
    with pytest.raises(ConfigError, match="set to a value already"):
        CheckCommand(target=tmp_path, set=("seed=1", "seed.x=1")).load_config()


@pytest.mark.parametrize("out_is_a_file", [True, False])
def test_bad_input_is_one_message_and_leaves_no_folder(neoworld, tmp_path, out_is_a_file):
    photo, out = tmp_path / "photo.png", tmp_path / "out"
    if out_is_a_file:
        Image.new("RGB", (64, 64)).save(photo)
        out.write_text("precious")
    else:
        photo.write_text("no picture")
    completed = neoworld("reconstruct", photo, "--out", out, "--json", "--provider", "mailbox")
    assert_refused(completed, str(out if out_is_a_file else photo))
    assert json.loads(completed.stdout).keys() == {"error"}
    assert out.exists() == out_is_a_file


PROGRAM = """
from neoworld_mjx.program.sdk import Object, box

block = Object("block", "a block")
wood = block.material("wood", like="oak")
block.part("body", material=wood).add(box((0.04, 0.04, 0.03)), at=(0, 0, 0), by="bottom")
"""


def test_a_program_becomes_its_files(neoworld, tmp_path):
    program = tmp_path / "block.py"
    program.write_text(PROGRAM)
    completed = neoworld("build", program, "--out", tmp_path / "out", "--json")
    assert completed.returncode == 0, completed.stdout + completed.stderr
    assert json.loads(completed.stdout)["object"] == "block"
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files >= {"object.urdf", "object.usda", "object.xml", "program.py", "spec.json"}
    assert_refused(neoworld("build", program, "--out", tmp_path / "out"), "--overwrite")
    assert neoworld("check", program).returncode == 0


def test_a_program_that_fails_writes_nothing_and_exits_1(neoworld, tmp_path):
    program = tmp_path / "block.py"
    program.write_text(PROGRAM.replace("box(", "bax("))
    completed = neoworld("build", program, "--out", tmp_path / "out", "--json")
    assert completed.returncode == 1, completed.stderr
    assert "bax" in json.loads(completed.stdout)["signals"][0]["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (None, None, "no such file or folder"),
        ("scene.txt", "x", "expected a run folder or a scene.json"),
        ("scene.json", "{", "is not a scene"),
        ("scene.json", '{"objects": []}', "is not a scene: objects"),
    ],
)
def test_an_invalid_target_of_check_is_one_message(neoworld, tmp_path, name, content, said):
    target = tmp_path / (name or "nothing.json")
    if content is not None:
        target.write_text(content)
    assert_refused(neoworld("check", target), said, str(target))


def test_an_invalid_target_of_view_is_one_short_message(neoworld, tmp_path):
    assert_refused(neoworld("view", tmp_path / "nothing"), "no such file or folder")
    assert_refused(neoworld("check", tmp_path), f"{tmp_path} is no run folder with a scene")
    (tmp_path / "notes.txt").write_text("x")
    assert_refused(neoworld("view", tmp_path / "notes.txt"), "a program (.py), a URDF or an MJCF")
    misspelt = neoworld("template", "nightstnd", "--out", tmp_path / "x.py")
    assert_refused(misspelt, "did you mean 'nightstand'?")
    assert len(misspelt.stderr) < 160


def test_json_puts_an_error_on_stdout_and_on_stderr(neoworld, tmp_path):
    completed = neoworld("report", tmp_path, "--json")
    assert_refused(completed, "error: ", "not a run folder")
    answer = json.loads(completed.stdout)
    assert "not a run folder" in answer["error"]


def test_report_of_an_unfinished_run(neoworld, tmp_path):
    with RunFolder(tmp_path / "out", Config()):
        pass
    completed = neoworld("report", tmp_path / "out", "--json")
    assert completed.returncode == 0, completed.stderr
    assert json.loads(completed.stdout) == {"report": str(tmp_path / "out" / "report.html")}
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000


def test_output_of_other_code_is_not_mixed_with_the_json(capfd, monkeypatch):
    def noisy(_):
        print("from Python")
        os.system("echo from C")
        return {"a": 1}

    monkeypatch.setattr(DoctorCommand, "run", noisy)
    sys.stdout.flush()
    assert cli.run(DoctorCommand(json=True)) == 0
    out, err = capfd.readouterr()
    assert json.loads(out) == {"a": 1}
    assert "from C" in err


def test_a_ctrl_c_that_python_ignores_is_repeated(monkeypatch, capfd):
    """JAX collects its garbage in a callback, where an exception is reported and dropped."""

    def strike(phase, info):
        gc.callbacks.remove(strike)
        signal.raise_signal(signal.SIGINT)
        sum(range(3))  # Python looks for signals between operations.

    def works(command):
        gc.callbacks.append(strike)
        gc.collect()
        for _ in range(500):
            time.sleep(0.01)
        return {"passed": True}

    monkeypatch.setattr(DoctorCommand, "run", works)
    # A process that ended itself would take the tests along.
    monkeypatch.setattr(interrupts, "GRACE_S", 60.0)
    hook = sys.unraisablehook
    assert cli.run(DoctorCommand(json=True)) == 130
    assert sys.unraisablehook is hook
    assert capfd.readouterr().err == "error: interrupted; continue with --resume\n"


def test_a_ctrl_c_that_native_code_prints_is_repeated(monkeypatch, capfd):
    """`PyErr_Print` hands an exception to `sys.excepthook` and forgets it."""

    def works(command):
        assert ctypes.pythonapi.PyRun_SimpleString(b"raise KeyboardInterrupt") == -1
        for _ in range(500):
            time.sleep(0.01)
        return {"passed": True}

    hook = sys.excepthook
    monkeypatch.setattr(DoctorCommand, "run", works)
    monkeypatch.setattr(interrupts, "GRACE_S", 60.0)
    assert cli.run(DoctorCommand()) == 130
    assert sys.excepthook is hook
    assert capfd.readouterr().err == "error: interrupted; continue with --resume\n"


def test_a_ctrl_c_that_becomes_another_error(monkeypatch, capfd):
    """Modules of USD raise a TypeError if Ctrl-C strikes while they are imported."""

    def work(command):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise TypeError("no converter found") from None

    monkeypatch.setattr(DoctorCommand, "run", work)
    assert cli.run(DoctorCommand()) == 130
    assert capfd.readouterr().err == "error: interrupted; continue with --resume\n"


LONG_NATIVE_CALL = """
import hashlib, sys, threading
from neoworld_mjx import cli
from neoworld_mjx.commands.doctor_command import DoctorCommand

def work(command):
    # By then the main thread is in the call, which Python's handler would wait for.
    threading.Timer(0.5, print, ["started"], {"file": sys.stderr, "flush": True}).start()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 1 << 30)

DoctorCommand.run = work
cli.main(["doctor", "--json"])
"""


def test_a_ctrl_c_during_native_code_is_obeyed():
    command = [sys.executable, "-c", LONG_NATIVE_CALL]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as running:
        try:
            assert running.stderr is not None and running.stdout is not None
            assert running.stderr.readline() == "started\n"
            running.send_signal(signal.SIGINT)
            assert running.wait(60) == 130
        finally:
            running.kill()
        message = "interrupted; continue with --resume"
        assert running.stderr.read() == f"error: {message}\n"
        assert json.loads(running.stdout.read()) == {"error": message}


@pytest.mark.parametrize(
    ("raised", "code"), [(KeyboardInterrupt(), 130), (ConfigError("bad"), 2), (ValueError(), 70)]
)
def test_exit_codes_of_errors(monkeypatch, capsys, raised, code):
    def fails(_):
        raise raised

    monkeypatch.setattr(DoctorCommand, "run", fails)
    assert cli.run(DoctorCommand()) == code
    assert capsys.readouterr().err.startswith("error: ")


@pytest.mark.parametrize(("raised", "code"), [(ConfigError("bad"), 2), (ValueError("odd"), 70)])
def test_only_debug_shows_the_traceback(monkeypatch, capsys, raised, code):
    def fails(_):
        raise raised

    monkeypatch.setattr(DoctorCommand, "run", fails)
    assert cli.run(DoctorCommand()) == code
    message = capsys.readouterr().err
    assert "Traceback" not in message
    assert ("--debug" in message and "--resume" in message) == (code == 70)
    assert cli.run(DoctorCommand(debug=True)) == code
    assert capsys.readouterr().err.startswith("Traceback")


def test_a_memory_error_is_one_message_with_a_remedy(monkeypatch, capsys):
    def fails(_):
        raise MemoryError("Unable to allocate 3 PiB")

    monkeypatch.setattr(DoctorCommand, "run", fails)
    assert cli.run(DoctorCommand()) == 2
    assert "not enough memory: use fewer candidates" in capsys.readouterr().err


def test_error_messages_escape_control_characters(monkeypatch, capsys):
    def fails(_):
        raise ConfigError("no file \x1b[2J\u202e\ud800.png")

    monkeypatch.setattr(DoctorCommand, "run", fails)
    cli.run(DoctorCommand())
    assert capsys.readouterr().err == "error: no file \\x1b[2J\\u202e\\ud800.png\n"


def test_a_scene_that_fails_exits_1(monkeypatch):
    monkeypatch.setattr(DoctorCommand, "run", lambda _: {"passed": False})
    assert cli.run(DoctorCommand(quiet=True, json=True)) == 1


def test_doctor_lists_what_is_installed_and_shows_no_key(neoworld, tmp_path, monkeypatch):
    secret = "sk-ant-very-secret"
    monkeypatch.setenv("ANTHROPIC_API_KEY", secret)
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path))
    completed = neoworld("doctor", "--json")
    assert completed.returncode == 0, completed.stderr
    answer = json.loads(completed.stdout)
    assert answer["keys"]["ANTHROPIC_API_KEY"] is True
    assert secret not in completed.stdout + completed.stderr
    assert answer["cache"]["folder"] == str(tmp_path)
    assert answer["engines"]["native"] == "ready"
    assert answer["versions"]["mujoco"]
    missing = {entry["what"] for entry in answer["missing"]}
    assert "a model's key" not in missing and ("extra warp" in missing) == (
        answer["engines"]["warp"] != "ready"
    )


@pytest.mark.parametrize("part", COMPONENTS, ids=lambda part: part.name)
def test_doctor_names_extras_that_exist(part):
    extras = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert isinstance(part.present(), bool)
    assert "pip install" not in part.remedy, "the package is on no index"
    named = re.findall(r"--extra (\w+)", part.remedy)
    assert named == [part.name.split()[-1]] or not part.name.startswith("extra ")
    assert set(named) <= extras.keys()


def test_listings_are_short(neoworld, tmp_path):
    said = neoworld("doctor").stdout.splitlines()
    assert "Python 3" in said[0] and said[1].startswith("engines: ") and "native" in said[1]
    assert len(said) <= 3 + 2 * len(COMPONENTS) and all(len(line) < 160 for line in said)
    said = neoworld("template").stdout.splitlines()
    assert said[0] == f"{len(templates())} templates:" and len(said) < 20
    listed = " ".join(said[1:-1]).replace(" ", "").split(",")
    assert listed == list(templates())
    program = tmp_path / "chest.py"
    said = neoworld("template", "drawer_cabinet", "--out", program).stdout
    assert "drawers 3 (2 to 5)" in said and f"next: neoworld view {program}" in said
    assert len(said.splitlines()) <= 6
    said = neoworld("examples").stdout.splitlines()
    assert [line.split(":")[0] for line in said] == [*bundled_examples(), "next"]
    table = neoworld("examples", "-v").stdout.splitlines()
    assert table[0] == "examples:" and table[1].split()[:2] == ["name", "objects"]
    assert [line.split()[0] for line in table[2:]] == list(bundled_examples())


def test_an_installation_is_reported_in_one_line():
    installed = {"installed": "blender", "folder": "cache/blender"}
    assert doctor_lines(installed) == ["installed: blender in cache/blender"]


def test_the_summary_of_a_benchmark_omits_its_rows():
    rows = [{"objects": 3, "ms": 0.1}] * 4
    answer = {"suite": "kernels", "command": "x", "machine": {"cores": 2}, "rows": rows}
    said = bench_lines(answer | {"mean": 1.23456, "valid": True, "worst": {"name": "cup"}})
    assert said[0] == "kernels: 4 rows"
    assert said[1] == "  mean 1.235, valid yes, worst name cup"
    assert len(said) == 3


def test_the_version_is_that_of_the_package(neoworld):
    completed = neoworld("--version")
    version = tomllib.loads(Path("pyproject.toml").read_text())["project"]["version"]
    assert (completed.returncode, completed.stdout) == (0, f"neoworld {version}\n")
    assert f"version: {version}" in Path("CITATION.cff").read_text()

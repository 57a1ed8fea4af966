import json
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from neoworld_mjx import cli
from neoworld_mjx.commands import COMMANDS, load
from neoworld_mjx.commands.doctor_command import EXTRAS, DoctorCommand
from neoworld_mjx.commands.object_commands import CheckCommand
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.pipeline.bundled_examples import bundled_examples
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
    for name in COMMANDS:
        documented = " ".join(load(name).__doc__.partition("\n\n")[0].split())
        assert f"{name} {documented}" in said


def imported(*commands, names):
    """Return the modules of `names` that commands import, and what they print on stderr."""
    code = (
        "import sys; from neoworld_mjx import cli\n"
        f"for words in {commands}:\n"
        "    try: cli.main(words)\n"
        "    except SystemExit: pass\n"
        f"print(sorted({names} & set(sys.modules)))"
    )
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return completed.stdout.splitlines()[-1], completed.stderr


@pytest.mark.parametrize(("words", "heavy"), [((), ("tyro",)), (("reconstruct",), ())])
def test_help_imports_nothing_heavy(words, heavy):
    names = {"jax", "mujoco", "pydantic", "numpy", "pxr", "PIL", *heavy}
    modules, said = imported([*words, "--help"], names=names)
    assert modules == "[]", said


def test_a_missing_file_is_reported_before_slow_imports():
    commands = (
        ["check", "no.json"],
        ["view", "no.json"],
        ["reconstruct", "no.jpg", "--out", "out"],
        ["annotate", "no.jpg", "--out", "out"],
        ["reconstruct", "coffee", "--out", "out", "--depth", "no.png"],
        ["refine", "out", "--from", "no.glb"],
        ["evaluate", "no.npz", "out"],
    )
    modules, said = imported(*commands, names={"jax", "mujoco"})
    assert modules == "[]"
    for words, line in zip(commands, said.splitlines(), strict=True):
        assert "no such file" in line and "no." in line, words


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "name a command: reconstruct"),
        (("reconstrut", "a.png"), "did you mean 'reconstruct'?"),
        (("--json", "doctor"), "the command comes before its options"),
        (("reconstruct", "a.png", "--out", "x", "--resum"), "--resume"),
        (("reconstruct", "a.png", "--out", "x", "--until", "pars"), "export"),
        (("report", "{folder}"), "not a run folder"),
        (("view", "{folder}/nothing"), "no such file or folder"),
        (("view", "{folder}/notes.txt"), "a program (.py), a URDF, MJCF or glTF"),
        (("check", "{folder}/nothing.json"), "no such file or folder"),
        (("check", "{folder}/notes.txt"), "expected a run folder or a scene.json"),
        (("check", "{folder}/half.json"), "is not a scene"),
        (("check", "{folder}"), "is no run folder with a scene"),
        (("template", "nightstnd", "--out", "{folder}/x.py"), "did you mean 'nightstand'?"),
    ],
)
def test_bad_words_are_one_message_with_valid_choices(neoworld, tmp_path, words, said):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "half.json").write_text("{")
    assert_refused(neoworld(*(word.format(folder=tmp_path) for word in words)), said)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("refine.cem.popluation=3", "did you mean 'population'"),
        ("refine.cem.sigma_yaw=3", "did you mean 'sigma_yaw_deg'"),
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


PROGRAM = """
from neoworld_mjx.program.sdk import Object, box

block = Object("block", "a block")
wood = block.material("wood", like="oak")
block.part("body", material=wood).add(box((0.04, 0.04, 0.03)), at=(0, 0, 0), by="bottom")
"""


def test_a_program_becomes_its_files(neoworld, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    completed = neoworld("export", program, "--out", tmp_path / "out", "--json")
    assert completed.returncode == 0, completed.stdout + completed.stderr
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files >= {"object.urdf", "object.usdc", "object.xml", "object.sdf"}
    assert_refused(neoworld("export", program, "--out", tmp_path / "out"), "--overwrite")
    assert "valid: block passes" in neoworld("check", tmp_path).stdout


LONG_NATIVE_CALL = """
import hashlib, signal, sys, threading
from neoworld_mjx import cli

signal.signal(signal.SIGINT, signal.default_int_handler)  # Shells ignore it in background jobs.
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
    ("raised", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted; continue with --resume"),
        (ConfigError("bad \x1b[2J\u202e.png"), 2, "bad \\x1b[2J\\u202e.png"),
        (MemoryError("Unable to allocate 3 PiB"), 2, "not enough memory: use fewer candidates"),
        (ValueError("odd"), 70, "--debug"),
    ],
)
def test_errors_are_one_message_and_only_debug_shows_the_traceback(
    monkeypatch, capsys, raised, code, said
):
    def fails(_):
        raise raised

    monkeypatch.setattr(DoctorCommand, "run", fails)
    assert cli.run(DoctorCommand()) == code
    message = capsys.readouterr().err
    assert message.startswith("error: ") and said in message and "Traceback" not in message
    if code != 130:
        assert cli.run(DoctorCommand(debug=True)) == code
        assert capsys.readouterr().err.startswith("Traceback")


def test_doctor_lists_what_is_installed_and_shows_no_key(neoworld, tmp_path, monkeypatch):
    secret = "sk-ant-very-secret"
    monkeypatch.setenv("ANTHROPIC_API_KEY", secret)
    monkeypatch.setenv("NEOWORLD_CACHE", str(tmp_path))
    completed = neoworld("doctor", "--json")
    assert completed.returncode == 0, completed.stderr
    answer = json.loads(completed.stdout)
    assert answer["keys"]["ANTHROPIC_API_KEY"] is True
    assert secret not in completed.stdout + completed.stderr
    assert answer["cache"] == str(tmp_path)
    assert answer["engines"]["native"] == "ready"
    assert answer["versions"]["mujoco"]
    missing = {entry["name"] for entry in answer["missing"]}
    assert "a model's key" not in missing and ("extra warp" in missing) == (
        answer["engines"]["warp"] != "ready"
    )


def test_doctor_names_extras_that_exist():
    extras = tomllib.loads(Path("pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert EXTRAS.keys() <= extras.keys()


def test_listings_are_short(neoworld, tmp_path):
    said = neoworld("doctor").stdout.splitlines()
    assert "Python 3" in said[0] and said[1].startswith("engines: ") and "native" in said[1]
    assert len(said) < 20 and all(len(line) < 160 for line in said)
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
    listed = yaml.safe_load("\n".join(neoworld("examples", "-v").stdout.splitlines()[len(said) :]))
    assert [example["name"] for example in listed["examples"]] == list(bundled_examples())


def test_the_version_is_that_of_the_package(neoworld):
    completed = neoworld("--version")
    version = tomllib.loads(Path("pyproject.toml").read_text())["project"]["version"]
    assert (completed.returncode, completed.stdout) == (0, f"neoworld {version}\n")

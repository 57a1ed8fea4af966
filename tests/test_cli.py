import json
import os
import subprocess
import sys

import pytest
from PIL import Image

from neoworld_mjx import arguments, cli, commands, run_folder
from neoworld_mjx.config import Config
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.run_folder import RunFolder


def _neoworld(*args, **environment):
    return subprocess.run(
        [sys.executable, "-m", "neoworld_mjx.cli", *map(str, args)],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=120,
    )


def _fails(done, *said):
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    for words in said:
        assert words in done.stderr
    return done


def test_help_names_the_commands():
    done = _neoworld("--help")
    assert done.returncode == 0
    for command in ("reconstruct", "check", "build", "render", "report", "doctor"):
        assert command in done.stdout


@pytest.mark.parametrize("how", [(), ("--json",)])
def test_a_reader_that_has_read_enough_is_no_error(how):
    command = [sys.executable, "-m", "neoworld_mjx.cli", "doctor", *how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        said = running.stderr.read().decode()
    assert running.returncode == 0
    assert "BrokenPipe" not in said and "Traceback" not in said


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from neoworld_mjx import cli\n"
        "try: cli.main(['reconstruct', '--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'jax', 'mujoco', 'pydantic', 'numpy', 'pxr', 'PIL'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


def test_steps_are_those_of_a_run():
    assert arguments.Step.__args__ == run_folder.STEPS


def test_a_misspelt_flag_names_its_neighbour():
    _fails(_neoworld("reconstruct", "a.png", "--out", "x", "--resum"), "--resume")


def test_a_misspelt_command_names_the_commands():
    _fails(_neoworld("reconstrut", "a.png"), "reconstruct", "doctor")


def test_a_misspelt_step_names_the_steps():
    done = _neoworld("reconstruct", "a.png", "--out", "x", "--until", "pars")
    _fails(done, "parse", "export")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("refine.cem.popluation=3", "did you mean 'population'"),
        ("refine.cem.population=many", "refine.cem.population: Input should be a valid integer"),
        ("seed", "KEY=VALUE"),
        ("seed=[1", "not a YAML value"),
    ],
)
def test_wrong_settings_are_one_message(tmp_path, setting, said):
    done = _neoworld("render", tmp_path, "--set", setting)
    _fails(done, said)
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_misspelt_key_in_a_config_file_names_file_and_neighbour(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("refine:\n  rewards:\n    w_pen: 3\n")
    done = _neoworld("check", tmp_path, "--config", file)
    _fails(done, str(file), "refine.rewards", "did you mean 'reward'")


def test_flags_win_over_settings_and_settings_over_the_file(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("seed: 1\nrefine: {cem: {population: 4, iterations: 2}}\n")
    settings = ("refine.cem.population=8", "seed=2")
    command = arguments.Check(target=tmp_path, config=file, set=settings)
    config = commands._config(command, seed=3)
    assert (config.seed, config.refine.cem.population, config.refine.cem.iterations) == (3, 8, 2)
    with pytest.raises(ConfigError, match="set to a value already"):
        commands._config(arguments.Check(target=tmp_path, set=("seed=1", "seed.x=1")))


@pytest.mark.parametrize("out_is_a_file", [True, False])
def test_bad_input_is_one_message_and_leaves_no_folder(tmp_path, out_is_a_file):
    photo, out = tmp_path / "photo.png", tmp_path / "out"
    if out_is_a_file:
        Image.new("RGB", (64, 64)).save(photo)
        out.write_text("precious")
    else:
        photo.write_text("no picture")
    done = _neoworld("reconstruct", photo, "--out", out, "--json", "--provider", "mailbox")
    _fails(done, str(out if out_is_a_file else photo))
    assert json.loads(done.stdout).keys() == {"error"}
    assert out.exists() == out_is_a_file


PROGRAM = """
from neoworld_mjx.program.sdk import Object, box

block = Object("block", "a block")
wood = block.material("wood", like="oak")
block.part("body", material=wood).add(box((0.04, 0.04, 0.03)), at=(0, 0, 0), by="bottom")
"""


def test_a_program_becomes_its_files(tmp_path):
    program = tmp_path / "block.py"
    program.write_text(PROGRAM)
    done = _neoworld("build", program, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["object"] == "block"
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files >= {"object.urdf", "object.usda", "object.xml", "program.py", "spec.json"}
    _fails(_neoworld("build", program, "--out", tmp_path / "out"), "--overwrite")
    assert _neoworld("check", program).returncode == 0


def test_a_program_that_fails_writes_nothing_and_exits_1(tmp_path):
    program = tmp_path / "block.py"
    program.write_text(PROGRAM.replace("box(", "bax("))
    done = _neoworld("build", program, "--out", tmp_path / "out", "--json")
    assert done.returncode == 1, done.stderr
    assert "bax" in json.loads(done.stdout)["signals"][0]["message"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (None, None, "cannot read"),
        ("scene.txt", "x", "expected a run folder or a scene.json"),
        ("scene.json", "{", "is not a scene"),
        ("scene.json", '{"objects": []}', "is not a scene: objects"),
    ],
)
def test_what_cannot_be_checked_is_one_message(tmp_path, name, content, said):
    target = tmp_path / (name or "nothing.json")
    if content is not None:
        target.write_text(content)
    _fails(_neoworld("check", target), said, str(target))


def test_json_puts_an_error_on_stdout_and_on_stderr(tmp_path):
    done = _neoworld("report", tmp_path, "--json")
    _fails(done, "error: ", "not a run folder")
    answer = json.loads(done.stdout)
    assert "not a run folder" in answer["error"]


def test_report_of_an_unfinished_run(tmp_path):
    with RunFolder(tmp_path / "out", Config()):
        pass
    done = _neoworld("report", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"report": str(tmp_path / "out" / "report.html")}
    assert (tmp_path / "out" / "report.html").stat().st_size > 1000


def test_whatever_prints_meanwhile_stays_out_of_the_json(capfd):
    command = arguments.Doctor(json=True)

    def noisy(_):
        print("from Python")
        os.system("echo from C")
        return {"a": 1}

    before = commands.COMMANDS[arguments.Doctor]
    commands.COMMANDS[arguments.Doctor] = noisy
    try:
        sys.stdout.flush()
        assert cli.run(command) == 0
    finally:
        commands.COMMANDS[arguments.Doctor] = before
    out, err = capfd.readouterr()
    assert json.loads(out) == {"a": 1}
    assert "from C" in err


@pytest.mark.parametrize(
    ("raised", "code"), [(KeyboardInterrupt(), 130), (ConfigError("bad"), 2), (ValueError(), 70)]
)
def test_exit_codes_of_errors(monkeypatch, capsys, raised, code):
    def fails(_):
        raise raised

    monkeypatch.setitem(commands.COMMANDS, arguments.Doctor, fails)
    assert cli.run(arguments.Doctor()) == code
    assert capsys.readouterr().err.startswith("Traceback" if code == 70 else "error: ")


def test_a_scene_that_fails_exits_1(monkeypatch):
    monkeypatch.setitem(commands.COMMANDS, arguments.Doctor, lambda _: {"passed": False})
    assert cli.run(arguments.Doctor(quiet=True)) == 1


def test_doctor_says_what_is_here_and_shows_no_key(tmp_path):
    secret = "sk-ant-very-secret"
    done = _neoworld("doctor", "--json", ANTHROPIC_API_KEY=secret, NEOWORLD_CACHE=tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["keys"]["ANTHROPIC_API_KEY"] is True
    assert secret not in done.stdout + done.stderr
    assert answer["cache"]["folder"] == str(tmp_path)
    assert answer["engines"]["native"] == "ready"
    assert answer["versions"]["mujoco"]

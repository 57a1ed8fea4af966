"""`neoworld template`: the list, a program by seed, size and values, and what is refused."""

import json
import re
from pathlib import Path

import pytest

from neoworld_mjx import cli


@pytest.fixture
def answer(capfd):
    def command(*args, code=0):
        with pytest.raises(SystemExit) as end:
            cli.main(["template", *args, "--json"])
        assert end.value.code == code
        return json.loads(capfd.readouterr().out)

    return command


def test_a_program_has_the_requested_values(answer, tmp_path):
    out = tmp_path / "chest.py"
    size = ["--size", "0.5", "9", "0.9"]
    given = answer("drawer_cabinet", "--out", str(out), *size, "--set", "drawers=4")
    text = out.read_text()
    assert given["program"] == str(out)
    # 9 m is held to the widest that the range allows.
    for line in ("depth = 0.5  #", "width = 1.2  #", "height = 0.9  #", "drawers = 4  #"):
        assert line in text
    assert given["parameters"]["drawers"] == {"value": 4.0, "range": [2.0, 5.0]}
    assert given["parameters"]["width"]["unit"] == "m"


def test_the_page_s_commands_run():
    page = (Path(__file__).parents[2] / "docs" / "programs.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page.partition("## Templates")[2], re.S)
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "docs/programs.md", "exec"), {})


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("drawer_cabinets",), "did you mean 'drawer_cabinet'"),
        (("drawer_cabinet", "--set", "drawer=4"), "did you mean 'drawers'"),
        (("drawer_cabinet", "--set", "drawers=40"), "drawers: 40.0 is outside 2 to 5"),
        (("drawer_cabinet", "--set", "drawers"), "NAME=VALUE"),
        (("drawer_cabinet", "--set", "pull=rope"), "valid are: bar, knob"),
        (("--seed", "3"), "name a template"),
        (("drawer_cabinet", "--out", "no/such/folder/x.py"), "cannot write no/such/folder/x.py"),
    ],
)
def test_wrong_arguments_are_named(answer, args, message):
    assert message in answer(*args, code=2)["error"]

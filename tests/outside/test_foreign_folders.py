"""A run folder from a stranger: nothing outside of it is read, written, renamed or deleted."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from neoworld_mjx.config import Config, FileOptions
from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.io import bounded_by
from neoworld_mjx.io.files import write_atomic, write_inside
from neoworld_mjx.pipeline import refine_again
from neoworld_mjx.run_folder import FORMAT, RunFolder, run_options
from neoworld_mjx.search.user_terms import import_function
from neoworld_mjx.view.report.run_report import write_report


@pytest.fixture
def outside(tmp_path) -> Iterator[Path]:
    """A folder with files that must stay as they are."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "precious.txt").write_text("precious")
    (folder / "photos").mkdir()
    (folder / "photos" / "parse.png").write_text("precious")
    yield folder
    assert _texts(folder) == {"precious.txt": "precious", "photos/parse.png": "precious"}


def _texts(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def _run(out: Path, **changes: object) -> Path:
    """Write a run folder with one finished step, with other values in run.json."""
    with RunFolder(out, Config()) as run:
        with run.step("parse", {}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text("{}")
        run.finish()
    data = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(data | changes))
    return out


@pytest.mark.parametrize(
    "name", ["../outside/precious.txt", "{outside}/precious.txt", "a/../../outside/precious.txt"]
)
@pytest.mark.parametrize("mode", ["resume", "redo", "overwrite"])
def test_outputs_outside_of_the_folder_are_refused(tmp_path, outside, name, mode):
    step = {"inputs": {}, "outputs": {name.format(outside=outside): "0" * 64}}
    out = _run(tmp_path / "out", steps={"parse": step})
    with pytest.raises(RunError, match=r"run\.json is damaged.*leads out of the folder"):
        with RunFolder(out, Config(), mode, step="parse") as run:
            with run.step("parse", {"new": "input"}):
                pass


NOT_OUTPUTS = {
    ".lock": "refine does not write '.lock'",
    "run.json": "refine does not write 'run.json'",
    "photo.png": "refine does not write 'photo.png'",
    "notes.txt": "refine does not write 'notes.txt'",
    "history/parse/tree.json": "refine does not write",
    "objects/cup/program.py": "refine does not write",
    "tree.json": "refine does not write",
}


@pytest.mark.parametrize("name", NOT_OUTPUTS)
@pytest.mark.parametrize("mode", ["resume", "redo", "overwrite"])
def test_outputs_that_a_step_does_not_write_are_refused_and_nothing_is_moved(tmp_path, name, mode):
    """A lock that is moved away would let a second process start in the same folder."""
    out = _run(tmp_path / "out")
    (out / name).parent.mkdir(parents=True, exist_ok=True)
    if not (out / name).exists():
        (out / name).write_text("mine")
    data = json.loads((out / "run.json").read_text())
    data["steps"]["refine"] = {"inputs": {}, "outputs": {name: "0" * 64}}
    (out / "run.json").write_text(json.dumps(data))
    before = sorted(out.rglob("*"))
    with pytest.raises(RunError, match=rf"run\.json is damaged: steps: .*({NOT_OUTPUTS[name]})"):
        RunFolder(out, Config(), mode, step="refine")
    assert sorted(out.rglob("*")) == before


LINKS = [".lock", ".staging", ".run.json.part", ".report.html.part", "pictures", "report.html"]


@pytest.mark.parametrize("name", [*LINKS, "refine/history.npz", "objects/cup/spec.json", "tree"])
def test_links_in_a_folder_are_refused(tmp_path, outside, name):
    out = _run(tmp_path / "out")
    link = out / name
    link.parent.mkdir(parents=True, exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(outside / ("photos" if name in (".staging", "pictures") else "precious.txt"))
    for act in (
        lambda: RunFolder(out, Config(), "resume").__exit__(None, None, None),
        lambda: RunFolder(out, Config(), "overwrite").__exit__(None, None, None),
        lambda: write_report(out),
    ):
        with pytest.raises(RunError, match=f"contains {name!r}, which is a link; a run folder"):
            act()


def test_writing_follows_no_link(tmp_path, outside):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "a.txt").symlink_to(outside / "precious.txt")
    (folder / "photos").symlink_to(outside / "photos")
    write_atomic(folder / "a.txt", "new")
    assert (folder / "a.txt").read_text() == "new"
    assert not (folder / "a.txt").is_symlink()
    for name in ("photos/parse.png", "../outside/precious.txt", "photos/../x", "/etc/x", "a.txt/x"):
        with pytest.raises(OSError, match=r"leads out of the folder|is a link or a file"):
            write_inside(folder, name, "bad")
    write_inside(folder, "deep/below/b.txt", "b")
    assert (folder / "deep" / "below" / "b.txt").read_text() == "b"


OPTIONS_OF_CODE = {
    "optimizer": lambda name: {"optimizer": name},
    "terms": lambda name: {"reward": {"terms": {name: 1.0}}},
}


WITHOUT_STATUS = json.dumps({"format": FORMAT, "steps": {}, "fallbacks": []})


@pytest.mark.parametrize("text", ["", "[" * 100_000, "{}", "\0", WITHOUT_STATUS])
def test_an_invalid_run_json_is_one_message(tmp_path, text):
    out = tmp_path / "out"
    out.mkdir()
    (out / "run.json").write_text(text)
    with pytest.raises(RunError, match=r"run\.json"):
        write_report(out)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"refine": {"reward": {"terms": {"os:getcwd": 1.0}}}}, "names code.*os:getcwd.*--set"),
        ({"refine": {"optimizer": "os:getcwd"}}, "names code.*os:getcwd.*--set"),
        (
            {
                "refine": {"semantic": {"scorer": "mllm"}},
                "mllm": {"base_url": "http://evil.example"},
            },
            "names a server for models .http://evil.example.*key",
        ),
        ({"refine": 3}, r"run\.json: options: refine"),
        (
            {"refine": {"cem": {"iterations": 10_000, "population": 2000}}},
            r"requests a search of 5e\+09 simulated steps \(10000 iterations of 2000 candidates\); "
            r"the limit is 2e\+07.*--set",
        ),
    ],
)
def test_options_of_a_foreign_run_run_no_code_and_send_no_key(tmp_path, options, said):
    out = _run(tmp_path / "out", config=options)
    (out / "compose").mkdir()
    (out / "compose" / "scene.json").write_text("{}")
    with pytest.raises(ConfigError, match=said):
        refine_again(out)


def test_limits_of_a_foreign_run_do_not_apply_and_other_options_are_told(tmp_path, caplog):
    files = {"memory_mib": 65536, "timeout_s": 80000, "max_file_mib": 16384}
    options = {"files": files, "refine": {"max_drift_m": 1e-12}, "seed": 3}
    out = _run(tmp_path / "out", config=options)
    with bounded_by(FileOptions(timeout_s=3.0)):
        config = run_options(out, {"refine": {"finalists": 2}})
    assert config.files == FileOptions(timeout_s=3.0)
    assert (config.seed, config.refine.finalists, config.refine.max_drift_m) == (3, 2, 1e-12)
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warnings == [f"options of {out / 'run.json'} that apply: refine.max_drift_m=1e-12"]


@pytest.mark.parametrize("name", ["evilmod", "objects.evilmod", "evilmod:f", "objects.evilmod:"])
@pytest.mark.parametrize("option", ["optimizer", "terms"])
def test_no_module_of_a_foreign_run_is_imported(tmp_path, monkeypatch, option, name):
    """Neither by `refine`, which refuses the folder, nor by whoever reads such an option."""
    out = _run(tmp_path / "out", config={"refine": OPTIONS_OF_CODE[option](name)})
    (out / "compose").mkdir()
    (out / "compose" / "scene.json").write_text("{}")
    for folder in (out, out / "objects"):
        folder.mkdir(exist_ok=True)
        (folder / "evilmod.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\nf = dict")
    monkeypatch.syspath_prepend(out)
    with pytest.raises(ConfigError, match=f"names code to run .{name}"):
        refine_again(out)
    if not name.endswith(":f"):
        with pytest.raises(ConfigError, match=f"{name}' is unknown; write it as package.module"):
            import_function("refine.optimizer", name, {})
    assert not (tmp_path / "imported").exists()

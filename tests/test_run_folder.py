import os
import subprocess

import pytest

from neoworld_mjx.config import CEMOptions, Config, RefineOptions
from neoworld_mjx.errors import RunError
from neoworld_mjx.run_folder import RunFolder, read_run


def _two_steps(out, mode="new", *, text="tree", step=None):
    """A small pipeline: compose upper-cases what parse wrote."""
    ran = []
    with RunFolder(out, Config(), mode, step=step) as run:
        with run.step("parse", {"text": text}) as stage:
            if stage is not None:
                ran.append("parse")
                (stage / "tree.json").write_text(text)
        with run.step("compose", {"tree": out / "tree.json"}) as stage:
            if stage is not None:
                ran.append("compose")
                (stage / "compose").mkdir()
                (stage / "compose" / "scene.json").write_text((out / "tree.json").read_text() * 2)
        run.finish()
    return ran


def test_a_run_records_its_files_options_and_versions(tmp_path):
    out = tmp_path / "deep" / "out"
    _two_steps(out)
    data = read_run(out)
    assert (out / "compose" / "scene.json").read_text() == "treetree"
    assert data["status"] == "finished"
    assert data["fingerprint"] == Config().fingerprint()
    assert data["config"]["refine"]["cem"]["population"] == 64
    assert {"python", "mujoco", "jax", "numpy"} <= set(data["versions"])
    assert set(data["steps"]) == {"parse", "compose"}
    assert not (out / ".staging").exists()


def test_resume_repeats_only_changed_steps(tmp_path):
    out = tmp_path / "out"
    assert _two_steps(out) == ["parse", "compose"]
    assert _two_steps(out, "resume") == []
    assert _two_steps(out, "resume", text="bush") == ["parse", "compose"]
    (out / "compose" / "scene.json").unlink()
    assert _two_steps(out, "resume", text="bush") == ["compose"]


def test_an_edited_output_is_rewritten_and_the_edit_set_aside(tmp_path):
    out = tmp_path / "out"
    _two_steps(out)
    for edit in ("mine", "mine too"):
        (out / "tree.json").write_text(edit)
        assert _two_steps(out, "resume") == ["parse"]
    assert (out / "tree.json").read_text() == "tree"
    assert (out / "replaced" / "tree.json").read_text() == "mine"
    assert (out / "replaced" / "tree.json.old").read_text() == "mine too"


def test_redo_keeps_edits_of_earlier_steps_and_so_does_a_later_resume(tmp_path):
    out = tmp_path / "out"
    _two_steps(out)
    (out / "tree.json").write_text("edited")
    assert _two_steps(out, "redo", step="compose") == ["compose"]
    assert (out / "compose" / "scene.json").read_text() == "editededited"
    assert read_run(out)["steps"]["parse"]["edited"] == ["tree.json"]
    assert _two_steps(out, "resume") == []


def _three_steps(out, mode="new", *, step=None, text="tree", compose="fitted"):
    """A pipeline in which program and compose replace the tree; return the steps that ran."""
    ran = []
    with RunFolder(out, Config(), mode, step=step) as run:
        for name, content in (("parse", text), ("program/cup", "sized"), ("compose", compose)):
            before = name.partition("/")[0]
            inputs = {"text": content}
            if name != "parse":
                inputs["tree"] = run.before(before, "tree.json").read_text()
            with run.step(name, inputs) as stage:
                if stage is not None:
                    ran.append(name)
                    earlier = "" if name == "parse" else f"{inputs['tree']} "
                    (stage / "tree.json").write_text(earlier + content)
        run.finish()
    return ran


def test_a_replaced_file_stays_in_the_history_and_is_restored(tmp_path):
    out, steps = tmp_path / "out", ["parse", "program/cup", "compose"]
    assert _three_steps(out) == steps
    texts = lambda: [
        (out / name).read_text()
        for name in ("history/parse/tree.json", "history/program/tree.json", "tree.json")
    ]
    assert texts() == ["tree", "tree sized", "tree sized fitted"]
    assert _three_steps(out, "resume") == []
    assert _three_steps(out, "resume", compose="refitted") == ["compose"]
    assert texts() == ["tree", "tree sized", "tree sized refitted"]
    assert _three_steps(out, "resume", text="bush", compose="refitted") == steps
    assert texts() == ["bush", "bush sized", "bush sized refitted"]
    assert _three_steps(out, "redo", step="program") == steps[1:]
    with RunFolder(out, Config(), "redo", step="program"):
        assert (out / "tree.json").read_text() == "bush"
        assert not (out / "history").exists()
    assert not (out / "replaced").exists()


def test_an_edit_of_a_replaced_file_counts_for_the_step_before_from(tmp_path):
    out = tmp_path / "out"
    _three_steps(out)
    (out / "tree.json").write_text("mine")
    assert _three_steps(out, "redo", step="program") == ["program/cup", "compose"]
    assert (out / "tree.json").read_text() == "mine sized fitted"
    assert read_run(out)["steps"]["parse"]["edited"] == ["tree.json"]
    assert _three_steps(out, "resume") == []
    (out / "tree.json").write_text("lost?")
    assert _three_steps(out, "resume") == ["compose"]
    assert (out / "replaced" / "tree.json").read_text() == "lost?"
    assert (out / "tree.json").read_text() == "mine sized fitted"


def test_an_existing_run_is_refused_by_default(tmp_path):
    out = tmp_path / "out"
    _two_steps(out)
    before = (out / "run.json").read_bytes()
    with pytest.raises(RunError, match=r"--resume.*--from STEP.*--overwrite"):
        RunFolder(out, Config())
    assert (out / "run.json").read_bytes() == before


def test_a_run_without_finished_steps_restarts_and_keeps_its_costs(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(RunError), RunFolder(out, Config()) as run:
        run.record("mllm", cost_usd=1.5)
        raise RunError("no key")
    assert _two_steps(out) == ["parse", "compose"]
    assert read_run(out)["mllm"] == {"cost_usd": 1.5}
    assert "error" not in read_run(out)


def test_overwrite_deletes_what_the_run_wrote_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    _two_steps(out)
    (out / "notes.txt").write_text("mine")
    with RunFolder(out, Config(), "overwrite"):
        assert not (out / "tree.json").exists()
        assert not (out / "compose").exists()
    assert (out / "notes.txt").read_text() == "mine"
    assert _two_steps(out, "overwrite") == ["parse", "compose"]


def test_files_of_removed_objects_are_deleted(tmp_path):
    out = tmp_path / "out"
    for names in (["cup", "spoon"], ["cup"]):
        with RunFolder(out, Config(), "resume") as run:
            for name in names:
                with run.step(f"program/{name}", {"name": name}) as stage:
                    if stage is not None:
                        (stage / "objects" / name).mkdir(parents=True)
                        (stage / "objects" / name / "spec.json").write_text(name)
            run.finish()
    assert [path.name for path in (out / "objects").iterdir()] == ["cup"]


@pytest.mark.parametrize("what", ["file", "foreign", "foreign run.json", "below a file"])
def test_refused_folders_are_unchanged(tmp_path, what):
    out = tmp_path / "out"
    if what == "file":
        out.write_text("precious")
    elif what == "below a file":
        (tmp_path / "file").write_text("precious")
        out = tmp_path / "file" / "out"
    else:
        out.mkdir()
        (out / ("photos.txt" if what == "foreign" else "run.json")).write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RunError) as caught:
        RunFolder(out, Config(), "resume")
    assert str(out if what != "below a file" else out.parent) in str(caught.value)
    assert [p for p in sorted(tmp_path.rglob("*")) if p.name != ".lock"] == before


def test_a_second_run_in_the_same_folder_is_refused_until_the_first_ends(tmp_path):
    with RunFolder(tmp_path / "out", Config()):
        with pytest.raises(RunError, match=f"in use by another run .process {os.getpid()}"):
            RunFolder(tmp_path / "out", Config(), "resume")
    with RunFolder(tmp_path / "out", Config(), "resume"):
        pass


def test_a_failed_step_leaves_no_file_and_sets_the_status(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), RunFolder(out, Config()) as run:
        with run.step("parse", {}) as stage:
            assert stage is not None
            (stage / "tree.json").write_text("half")
            1 / 0  # noqa: B018
    assert sorted(p.name for p in out.iterdir()) == [".lock", "run.json"]
    assert read_run(out)["status"] == "failed"
    assert read_run(out)["steps"] == {}
    assert _two_steps(out, "resume") == ["parse", "compose"]


def test_fallbacks_are_deleted_when_their_step_is_repeated(tmp_path):
    out = tmp_path / "out"
    with RunFolder(out, Config()) as run:
        for step in ("parse", "refine"):
            with run.step(step, {}):
                run.fallback(step, "native", "no GPU")
                run.fallback(step, "native", "no GPU")
    assert len(read_run(out)["fallbacks"]) == 2
    with RunFolder(out, Config(), "redo", step="refine") as run:
        with run.step("parse", {}), run.step("refine", {}):
            pass
    assert read_run(out)["fallbacks"] == [{"step": "parse", "what": "native", "why": "no GPU"}]


def test_a_full_file_system(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("only root may mount a small tmpfs")
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", disk]).returncode != 0:
        pytest.skip("mounting is not allowed here")
    try:
        with (
            pytest.raises(RunError, match=f"no space left on the disk of {disk}"),
            RunFolder(disk / "out", Config()) as run,
            run.step("parse", {}) as stage,
        ):
            assert stage is not None
            (stage / "tree.json").write_text("x" * 1_000_000)
        assert read_run(disk / "out")["status"] == "failed"
        assert not (disk / "out" / "tree.json").exists()
        assert _two_steps(disk / "out", "resume") == ["parse", "compose"]
    finally:
        subprocess.run(["umount", disk], check=True)


CHANGED_INPUTS = {
    "options": (RefineOptions(), RefineOptions(finalists=9)),
    "nested options": (Config().refine, RefineOptions(cem=CEMOptions(population=9))),
    "seed": (1, 2),
    "value": ({"a": [1, None]}, {"a": [1, 0]}),
    "bytes": (b"a", b"b"),
}


@pytest.mark.parametrize("kind", CHANGED_INPUTS)
@pytest.mark.parametrize("key", ["options", "seed", "anything"])
def test_every_input_of_a_step_decides_whether_it_runs_again(tmp_path, kind, key):
    ran = []
    for value in (0, 0, 1, 1, 0):
        with RunFolder(tmp_path / "out", Config(), "resume") as run:
            inputs = {"before": 1, key: CHANGED_INPUTS[kind][value], "text": "same"}
            with run.step("parse", inputs) as stage:
                ran.append(stage is not None)
            run.finish()
    assert ran == [True, False, True, False, True]

"""Trackers in their offline modes, as they are read back by their own packages."""

import subprocess
import sys

import pytest

from neoworld_mjx.errors import ConfigError, EngineError
from neoworld_mjx.sweeps.trackers import TrackedRun, open_tracker

RUNS = [TrackedRun("bench:tents", "w 0.5", seed, {"refine.reward.w_drift": 0.5}) for seed in (0, 1)]
STEPS = [
    {"iteration": 1, "rollouts": 8, "best": 0.25, "merit": None, "s_sem": 0.5},
    {"iteration": 2, "rollouts": 16, "best": 0.75, "merit": 0.5, "s_sem": 0.5},
]


def track(text):
    with open_tracker(text) as on_iteration:
        for run in RUNS:
            for step in STEPS:
                on_iteration(run, step)


def test_an_unknown_tracker_is_one_message(monkeypatch):
    with pytest.raises(ConfigError, match="did you mean 'tensorboard'"):
        open_tracker("tensorbord:logs")
    with pytest.raises(ConfigError, match="takes KIND:PLACE"):
        open_tracker("wandb")
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(EngineError, match="needs wandb: uv sync --inexact --extra wandb"):
        open_tracker("wandb:sweeps")


def test_no_tracker_is_imported_unless_it_is_named():
    code = (
        "import sys, neoworld_mjx.sweeps.run, neoworld_mjx.sweeps.trackers; "
        "print([m for m in ('wandb', 'mlflow', 'tensorboardX', 'ray', 'submitit') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.filterwarnings("ignore")
def test_tensorboard_gets_every_iteration(tmp_path):
    pytest.importorskip("tensorboardX")
    from tensorboardX.proto.event_pb2 import Event
    from tensorboardX.record_writer import RecordWriter  # noqa: F401

    track(f"tensorboard:{tmp_path}")
    folders = sorted(tmp_path.iterdir())
    assert [f.name for f in folders] == [f"bench:tents, w 0.5, seed {k}" for k in (0, 1)]
    (file,) = folders[0].iterdir()
    data, found = file.read_bytes(), []
    while data:  # Length, its checksum, the record, its checksum.
        size = int.from_bytes(data[:8], "little")
        event = Event.FromString(data[12 : 12 + size])
        found += [(v.tag, event.step, v.simple_value) for v in event.summary.value]
        data = data[16 + size :]
    assert [row for row in found if row[0] == "best"] == [("best", 1, 0.25), ("best", 2, 0.75)]
    assert [row for row in found if row[0] == "merit"] == [("merit", 2, 0.5)]


@pytest.mark.filterwarnings("ignore")
def test_mlflow_gets_every_iteration(tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    mlflow = pytest.importorskip("mlflow")
    uri = (tmp_path / "store").as_uri()
    track(f"mlflow:{uri}")
    client = mlflow.MlflowClient(tracking_uri=uri)
    experiment = client.get_experiment_by_name("neoworld")
    runs = sorted(client.search_runs([experiment.experiment_id]), key=lambda r: r.info.run_name)
    assert [run.info.run_name for run in runs] == [run.title for run in RUNS]
    assert runs[0].data.params["refine.reward.w_drift"] == "0.5"
    assert runs[0].info.status == "FINISHED"
    best = client.get_metric_history(runs[1].info.run_id, "best")
    assert [(m.step, m.value) for m in best] == [(1, 0.25), (2, 0.75)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_wandb_gets_every_iteration_offline(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    from wandb.proto.wandb_internal_pb2 import Record

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    track("wandb:sweeps")
    files = sorted((tmp_path / "wandb").glob("offline-run-*/*.wandb"))
    assert len(files) == 2
    names, best = set(), []
    for file in files:
        data = file.read_bytes()[7:]  # Behind the head of the file.
        while data:  # Checksum, length and type, and the record: one block of a log of LevelDB.
            size = int.from_bytes(data[4:6], "little")
            record, data = Record.FromString(data[7 : 7 + size]), data[7 + size :]
            if record.WhichOneof("record_type") == "run":
                names.add(record.run.display_name)
            for item in record.history.item:
                if "best" in (item.key, *item.nested_key):
                    best.append(float(item.value_json))
    assert names == {run.title for run in RUNS}
    assert best == [0.25, 0.75] * 2

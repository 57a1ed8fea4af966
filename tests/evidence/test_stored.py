"""Evidence that a run keeps."""

import numpy as np

from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.evidence.stored import evidence_files, read_stored


def test_evidence_that_a_run_keeps_is_read_back(tmp_path):
    labels = np.zeros((60, 80), int)
    labels[:20, :30], labels[40:, 50:] = 7, 300
    kept = Evidence(masks=Masks(labels, {"cup": 300, "can": 7}, "masks.png"))
    for name, content in evidence_files(kept).items():
        (tmp_path / name).write_bytes(content)
    masks = read_stored(tmp_path).masks
    assert masks.source == "masks.png" and set(masks.names) == {"cup", "can"}
    for name in masks.names:
        assert np.array_equal(masks.of(name), kept.masks.of(name))

"""Evidence of a run: read from the user's files, kept in the run folder, applied to the photo."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import ConfigError, EvidenceError
from ..evidence.consistency import check_evidence
from ..evidence.depth_files import check_aspect
from ..evidence.evidence import Evidence
from ..evidence.evidence_file import StatedEvidence, evidence_of, read_stated, undistorted
from ..evidence.exif import exif_camera
from ..evidence.stored import evidence_digest, evidence_files, evidence_lines, read_stored
from ..parse.photo import Photo, load_photo
from ..run_folder import RunFolder
from ..run_folder.staging import refuse_links

FOLDER = "evidence"
"""Folder of the evidence in a run."""
PART = "parse/evidence"
"""Part of the step `parse` that keeps the evidence."""
UNLIKE = 1.2
"""Ratio of focal lengths from which on EXIF data contradict a calibration."""
Given = Evidence | StatedEvidence | Path | str
"""Evidence as a caller gives it; a path is that of an evidence file."""


@dataclass(frozen=True)
class RunEvidence:
    """Evidence of a run, in the pixels of the photograph as it was taken."""

    evidence: Evidence
    refused: tuple[str, ...] = ()
    """Evidence that is not used, each with the reason."""

    @property
    def empty(self) -> bool:
        """True if nothing is known."""
        e = self.evidence
        return e.camera is None and e.depth is None and e.masks is None


def read_evidence(file: Path | str, photo: Path | str) -> Evidence:
    """Read an evidence file, and check it against the photograph.

    Args:
        file: the evidence file (YAML), whose paths are relative to it.
        photo: the photograph.

    Returns:
        Evidence for `reconstruct(photo, out, evidence=...)`.

    Raises:
        EvidenceError: a file cannot be read, or contradicts the photograph.
        PhotoError: the photograph cannot be read.
    """
    picture = load_photo(Path(photo))
    return evidence_of(
        read_stated(Path(file)), picture.path.name, picture.rgb, picture.original_size
    )


def evidence_of_run(photo: Photo, given: Given | None, folder: Path | None = None) -> RunEvidence:
    """Return the evidence of a run: what is given or kept, and the EXIF data of the photograph.

    Args:
        photo: the photograph as it was taken.
        given: evidence, or a file that states it; if None, the run's own.
        folder: folder of a run that continues, whose evidence is used if none is given.

    Raises:
        EvidenceError: a file cannot be read, or contradicts the photograph.
        RunError: the run's folder contains links.
    """
    # A folder that cannot be read is reported when it is opened.
    if given is None and folder is not None and os.path.isdir(folder / FOLDER):
        refuse_links(folder)
        return RunEvidence(read_stored(folder / FOLDER))
    if isinstance(given, Path | str):
        given = read_stated(Path(given))
    if isinstance(given, StatedEvidence):
        given = evidence_of(given, photo.path.name, photo.rgb, photo.original_size)
    if not isinstance(given, Evidence | None):
        raise ConfigError(
            f"evidence must be an Evidence or the path of a file, got {type(given).__name__}"
        )
    if given is not None:
        _check_sizes(given, photo.original_size)
        check_evidence(given, photo.rgb, edges=False)
    return _with_exif(given or Evidence(), photo)


def _check_sizes(evidence: Evidence, size: tuple[int, int]) -> None:
    """Refuse evidence that shows another view than a photograph of `size`, by its aspect ratio."""
    taken = evidence.lens or evidence.camera
    if taken is not None:
        check_aspect(taken.size[::-1], size, "the image of the known camera")
    if evidence.depth is not None:
        check_aspect(evidence.depth.values.shape, size, evidence.depth.source or "the depth image")
    if evidence.masks is not None:
        check_aspect(evidence.masks.labels.shape, size, evidence.masks.source or "masks")


def _with_exif(evidence: Evidence, photo: Photo) -> RunEvidence:
    """Add the focal length of the EXIF data if no other is known."""
    camera = evidence.camera
    try:
        exif = exif_camera(photo.path, photo.original_size)
    except EvidenceError as error:
        return RunEvidence(evidence, (str(error),))
    if exif is None or exif.focal is None:
        return RunEvidence(evidence)
    if camera is not None and camera.focal is not None:
        ratio = exif.focal / camera.focal
        if 1 / UNLIKE < ratio < UNLIKE:
            return RunEvidence(evidence)
        reason = (
            f"{exif.source} makes the focal length {ratio:.2f} times that of {camera.source}, "
            "which is used"
        )
        return RunEvidence(evidence, (reason,))
    if camera is not None:
        own = {"focal": exif.focal, "focal_sd": exif.focal_sd, "focal_source": exif.source}
        exif = replace(camera, **own)
    return RunEvidence(replace(evidence, camera=exif))


def undistorted_photo(photo: Photo, evidence: Evidence) -> Photo:
    """Return the photograph without the distortion of its lens."""
    if evidence.lens is None or evidence.camera is None:
        return photo
    rgb = undistorted(Evidence(photo=photo.rgb, lens=evidence.lens)).photo
    assert rgb is not None
    rgb.flags.writeable = False
    return replace(photo, rgb=rgb, original_size=evidence.camera.size)


def keep_evidence(run: RunFolder, given: RunEvidence) -> None:
    """Write the evidence into the run folder, and record what is used and what is refused."""
    run.record("evidence", used=evidence_lines(given.evidence), refused=list(given.refused))
    if given.empty and not given.refused:
        return
    inputs = {"files": evidence_digest(given.evidence), "refused": list(given.refused)}
    with run.step(PART, inputs) as out:
        if out is None:
            return
        if not given.empty:
            (out / FOLDER).mkdir()
            for name, data in evidence_files(given.evidence).items():
                (out / FOLDER / name).write_bytes(data)
        for kind, line in evidence_lines(given.evidence).items():
            run.note(PART, f"known: {kind}", line)
        for reason in given.refused:
            run.note(PART, "evidence is not used", reason)


def kept_inputs(run: RunFolder) -> dict[str, object]:
    """Return the inputs of the steps that use the evidence in a run folder; empty without any."""
    folder = run.path / FOLDER
    return {FOLDER: folder} if folder.is_dir() else {}


def kept_evidence(run: RunFolder) -> Evidence:
    """Return the evidence in a run folder, undistorted like the run's photograph."""
    return undistorted(read_stored(run.path / FOLDER))

"""Evidence of a run: read from the user's files, kept in the run folder, applied to the photo."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

from ..config import Config
from ..errors import ConfigError, EvidenceError, SpecError
from ..evidence.consistency import check_evidence
from ..evidence.depth_files import check_aspect
from ..evidence.evidence import Evidence
from ..evidence.evidence_file import StatedEvidence, evidence_of, read_stated, undistorted
from ..evidence.exif import exif_camera
from ..evidence.known_objects import KnownObjects
from ..evidence.stored import evidence_files, evidence_lines, read_stored
from ..io import read_model
from ..parse.photo import MODEL_MIN_SIDE_PX, Photo, load_photo
from ..run_folder import RunFolder
from ..run_folder.staging import refuse_links
from ..spec import ObjectSpec, SceneTree
from .further_photos import VIEWS, further_files, kept_further, read_further
from .step_context import GIVEN, PHOTO, write_files

FOLDER = "evidence"
"""Folder of the evidence in a run."""
PART = "parse/evidence"
"""Part of the step `parse` that keeps the evidence."""
KNOWN = "known.json"
"""File of the known objects in a run."""
EXPECTED_UNIT = "Write the file in meters, or give the object's size under sizes in --evidence"
"""Remedy for an asset of unusual size."""
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
    return _read(read_stated(Path(file)), load_photo(Path(photo)))


def _read(stated: StatedEvidence, photo: Photo) -> Evidence:
    """Read the files of stated evidence, assets and photographs included; see `evidence_of`."""
    evidence = evidence_of(stated, photo.path.name, photo.rgb, photo.original_size)
    assets = {
        name: read_asset(Path(file), any_unit=name in stated.sizes)
        for name, file in stated.objects.items()
    }
    objects = evidence.objects.model_copy(update={"assets": assets})
    further = read_further(stated, photo, evidence.lens)
    return replace(evidence, objects=objects, further=further)


def read_asset(file: Path, *, any_unit: bool = False) -> ObjectSpec:
    """Read an object from a URDF, MJCF, glTF or mesh file.

    Args:
        file: the file.
        any_unit: False if the file must be in meters.

    Raises:
        EvidenceError: the file cannot be read, contains no single object, or is in another unit.
    """
    from ..export.importing import import_object
    from .mesh_tree import doubt_unit

    try:
        imported = import_object(file)
        if not any_unit:
            doubt_unit(replace(imported, fixed_base=False).scene, EXPECTED_UNIT)
    except SpecError as error:
        raise EvidenceError(f"objects: {error}") from None
    return imported.spec


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
    kept = () if folder is None else (folder / FOLDER, folder / KNOWN, folder / VIEWS)
    if given is None and folder is not None and any(map(os.path.lexists, kept)):
        refuse_links(folder)
        return RunEvidence(_kept(folder))
    if isinstance(given, Path | str):
        given = read_stated(Path(given))
    if isinstance(given, StatedEvidence):
        given = _read(given, photo)
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


def known_photo(
    file: Path, config: Config, given: Given | None = None, folder: Path | None = None
) -> tuple[Photo, RunEvidence]:
    """Read a photograph, without the distortion of its lens, and the evidence about it.

    Args:
        file: the image file.
        config: all options.
        given: as for `evidence_of_run`.
        folder: as for `evidence_of_run`.

    Raises:
        PhotoError: the photograph cannot be read.
        EvidenceError, RunError: as for `evidence_of_run`.
    """
    photo = load_photo(file, config.parse.max_side_px, MODEL_MIN_SIDE_PX)
    known = evidence_of_run(photo, given, folder)
    lens, camera = known.evidence.lens, known.evidence.camera
    if lens is None or camera is None:
        return photo, known
    rgb = undistorted(Evidence(photo=photo.rgb, lens=lens)).photo
    assert rgb is not None
    rgb.flags.writeable = False
    return replace(photo, rgb=rgb, original_size=camera.size), known


def keep_evidence(run: RunFolder, given: RunEvidence) -> None:
    """Write the evidence into the run folder, and record what is used and what is refused."""
    lines = evidence_lines(given.evidence)
    run.record("evidence", used=lines, refused=list(given.refused))
    files = _files(given.evidence)
    if not files and not given.refused:
        return
    with run.step(PART, {"refused": list(given.refused), **files}) as out:
        if out is None:
            return
        write_files(out, files)
        for kind, line in lines.items():
            run.note(PART, f"known: {kind}", line)
        for reason in given.refused:
            run.note(PART, "evidence is not used", reason)


def _files(evidence: Evidence) -> dict[str, bytes]:
    """Return the contents of the files that keep evidence, by path in the run folder."""
    files: dict[str, bytes] = {}
    if not (evidence.camera is None and evidence.depth is None and evidence.masks is None):
        files |= {f"{FOLDER}/{name}": data for name, data in evidence_files(evidence).items()}
    if evidence.objects.names:
        files[KNOWN] = (evidence.objects.model_dump_json(indent=1) + "\n").encode()
    return files | further_files(evidence.further)


def kept_inputs(run: RunFolder) -> dict[str, object]:
    """Return the inputs of the steps that use the evidence in a run folder; empty without any."""
    paths = {FOLDER: run.path / FOLDER, "known": run.path / KNOWN, VIEWS: run.path / VIEWS}
    return {name: path for name, path in paths.items() if path.exists()}


def parse_inputs(inputs: dict[str, object]) -> dict[str, object]:
    """Return the inputs of Step 1 among those of `kept_inputs`.

    What is known of single objects, and further photographs, are not among them: a name that the
    user reads in the parse must not ask for another one.
    """
    return {name: value for name, value in inputs.items() if name == FOLDER}


def kept_evidence(run: RunFolder) -> Evidence:
    """Return the evidence in a run folder, undistorted like the run's photograph."""
    return replace(undistorted(_kept(run.path)), further=kept_further(run.path, marked=True))


def evidence_of_tree(run: RunFolder, tree: SceneTree) -> tuple[Evidence, tuple[str, ...]]:
    """Return the evidence of a run with its photograph, and masks assigned to a tree's objects.

    Returns:
        The evidence, and a note for each mask that belongs to no object.
    """
    from ..evidence.mask_files import matched_to

    kept, photo = kept_evidence(run), run.path / PHOTO
    masks, notes = kept.masks, ()
    if masks is not None:
        masks, notes = matched_to(masks, tree)
    rgb = load_photo(photo).rgb if photo.is_file() else None
    boxes = not (run.path / GIVEN).is_file()  # Boxes of a rescue are no evidence.
    return replace(kept, photo=rgb, masks=masks, boxes=boxes), notes


def _kept(folder: Path) -> Evidence:
    """Return the evidence in a run folder, in the pixels of the photograph as it was taken."""
    evidence = replace(read_stored(folder / FOLDER), further=kept_further(folder))
    file = folder / KNOWN
    if not file.is_file():
        return evidence
    objects = read_model(file, KnownObjects, EvidenceError, "known objects")
    return replace(evidence, objects=objects)

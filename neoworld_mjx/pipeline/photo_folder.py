"""Reconstruction of a folder of photographs, with a common ledger and a common cost cap."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from ..config import Config
from ..errors import BudgetError, NeoWorldError, PhotoError, RunError
from ..io import read_object
from ..io.files import write_output
from ..io.names import repeated
from ..mllm.ledger import Ledger, load_prices
from ..places import HERE, Place, check_place, run_tasks
from ..progress import report
from ..run_folder import lock_folder, read_run, refuse_links
from .reconstruction import reconstruct

ABOUT, FORMAT = "photos.json", "neoworld-photos/1"


@dataclass(frozen=True)
class PhotoTask:
    """A photograph to reconstruct, and the options of its run."""

    photo: Path
    out: Path
    config: Config
    until: str | None
    overwrite: bool
    tapes: tuple[Path, ...]


@dataclass(frozen=True)
class PhotoOutcome:
    """Result of one photograph."""

    photo: Path
    summary: dict[str, Any] | None
    """`Result.summary` of the run; None after an error."""
    error: str = ""
    stopped: bool = False
    """True if the cost cap stopped the run."""


def reconstruct_photo(task: PhotoTask) -> Iterator[PhotoOutcome]:
    """Reconstruct a photograph; if a lost worker has started it, continue its run."""
    try:
        result = reconstruct(
            task.photo,
            task.out,
            task.config,
            until=task.until,
            resume=not task.overwrite,
            overwrite=task.overwrite,
            tapes=task.tapes,
        )
        yield PhotoOutcome(task.photo, result.summary())
    except NeoWorldError as error:  # An error of one photograph must not stop the others.
        yield PhotoOutcome(task.photo, None, str(error), isinstance(error, BudgetError))


def reconstruct_folder(
    photos: Path,
    out: Path,
    config: Config,
    *,
    until: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    tapes: tuple[Path, ...] = (),
    place: Place = HERE,
) -> dict[str, Any]:
    """Reconstruct every photograph of a folder, each into a run folder of its own.

    `mllm.max_cost_usd` limits the cost of all runs together. The remaining amount is divided evenly
    among the unfinished photographs. Photographs that reach their share are repeated with the
    amount that the others have not used.

    Args:
        photos: folder of the photographs.
        out: folder of photos.json and of the run folders, which are named after the photographs.
        config: all options.
        until: last step; see `reconstruct`.
        resume: if True, keep the steps that earlier runs in `out` have finished.
        overwrite: if True, replace earlier runs in `out`.
        tapes: see `reconstruct`.
        place: where the photographs are reconstructed.

    Returns:
        The content of photos.json: "photos", "passed", "mllm".

    Raises:
        PhotoError: the folder has no photographs, or two photographs have the same name.
        RunError: `out` is in use, or contains other files or runs that must not be replaced.
        NeoWorldError: no photograph can be reconstructed, all for the same reason.
    """
    files = photographs(photos)
    check_place(place)
    out = Path(out).resolve()  # A worker may have another working directory.
    try:
        out.mkdir(parents=True, exist_ok=True)
        refuse_links(out)
        _refuse_earlier(out, resume=resume, overwrite=overwrite)
        lock = lock_folder(out)
    except OSError as error:
        raise RunError(f"cannot write {out}: {error.strerror}") from None
    with lock:
        outcomes: dict[Path, PhotoOutcome] = {}
        pending = list(files)
        about = _save(out, files, outcomes, config, until)
        while pending:
            tasks = [
                PhotoTask(
                    *(photo, out / photo.stem, options, until),
                    *(overwrite and photo not in outcomes, tuple(t.resolve() for t in tapes)),
                )
                for photo, options in _cost_shares(
                    out, files, pending, config, ignore_earlier=overwrite
                ).items()
            ]
            for outcome in run_tasks(reconstruct_photo, tasks, place):
                outcomes[outcome.photo] = outcome
                about = _save(out, files, outcomes, config, until)
                report(
                    f"{outcome.photo.name}: {outcome.error or 'reconstructed'}; {len(outcomes)} of "
                    f"{len(files)} photographs done",
                    step=f"{len(files)} photographs, {len(outcomes)} done",
                )
            overwrite = False
            stopped = [photo for photo in pending if outcomes[photo].stopped]
            # Only photographs that did not reach their share leave an amount to the others.
            pending = stopped if len(stopped) < len(pending) else []
    errors = {outcome.error for outcome in outcomes.values()}
    if len(errors) == 1 and "" not in errors and len(files) > 1:
        raise RunError(f"no photograph of {photos} can be reconstructed: {errors.pop()}")
    return about


def photographs(folder: Path) -> list[Path]:
    """Return the photographs of a folder, sorted by name; other files are ignored.

    Raises:
        PhotoError: the folder has no photographs, or two photographs have the same name.
    """
    extensions = Image.registered_extensions()
    photos = sorted(
        path.resolve()
        for path in folder.iterdir()
        if path.suffix.lower() in extensions and path.is_file() and not path.name.startswith(".")
    )
    if not photos:
        raise PhotoError(f"{folder} has no photographs")
    if duplicates := repeated(path.stem for path in photos):
        raise PhotoError(
            f"{folder} has several photographs named {', '.join(duplicates)}: rename them"
        )
    return photos


def _refuse_earlier(out: Path, *, resume: bool, overwrite: bool) -> None:
    if resume and overwrite:
        raise RunError("--overwrite starts over and --resume continues runs: give one of them")
    if (out / ABOUT).exists():
        if read_object(out / ABOUT, RunError).get("format") != FORMAT:
            raise RunError(f"{out / ABOUT} belongs to another program; name a new folder")
        if not resume and not overwrite:
            raise RunError(
                f"{out} contains runs of photographs: continue them with --resume, replace them "
                "with --overwrite, or name a new folder"
            )
    elif any(not entry.name.startswith(".") for entry in out.iterdir()):
        raise RunError(f"{out} is not empty and contains no runs of photographs; name a new folder")


def _earlier(out: Path, photo: Path) -> dict[str, Any]:
    """Return the contents of a photograph's run.json; an empty dict if there is no run yet."""
    folder = out / photo.stem
    return read_run(folder) if (folder / "run.json").is_file() else {}


def _ledger(out: Path, files: Sequence[Path], config: Config) -> Ledger:
    """Return the ledger of all runs in the folder."""
    ledger = Ledger(config.mllm.max_cost_usd, load_prices(config.mllm.prices))
    for photo in files:
        if costs := _earlier(out, photo).get("mllm"):
            ledger.add_earlier(costs)
    return ledger


def _cost_shares(
    out: Path,
    files: Sequence[Path],
    pending: Sequence[Path],
    config: Config,
    *,
    ignore_earlier: bool,
) -> dict[Path, Config]:
    """Return the options of each pending photograph, with its share of the cost cap."""
    cap = config.mllm.max_cost_usd
    if cap is None:
        return dict.fromkeys(pending, config)
    spent = 0.0 if ignore_earlier else _ledger(out, files, config).spent_usd
    runs = {} if ignore_earlier else {photo: _earlier(out, photo) for photo in pending}
    unfinished = [photo for photo in pending if runs.get(photo, {}).get("status") != "finished"]
    share = max(cap - spent, 0.0) / max(len(unfinished), 1)
    shares = {}
    for photo in pending:
        spent = float((runs.get(photo, {}).get("mllm") or {}).get("known_cost_usd", 0.0))
        mllm = config.mllm.model_copy(
            update={"max_cost_usd": spent + (share if photo in unfinished else 0)}
        )
        shares[photo] = config.model_copy(update={"mllm": mllm})
    return shares


def _save(
    out: Path,
    files: Sequence[Path],
    outcomes: Mapping[Path, PhotoOutcome],
    config: Config,
    until: str | None,
) -> dict[str, Any]:
    """Write photos.json, and return its content."""
    photos = []
    for photo in files:
        entry: dict[str, Any] = {"photo": photo.name, "folder": str(out / photo.stem)}
        if outcome := outcomes.get(photo):
            summary = outcome.summary or {}
            seconds = sum(summary.get("seconds", {}).values())
            entry |= {"passed": summary.get("passed"), "seconds": round(seconds, 1)}
            entry |= {"error": outcome.error}
        photos.append(entry)
    complete = len(outcomes) == len(files)
    all_passed = all(not o.error and (o.summary or {}).get("passed") is not False
               for o in outcomes.values())  # fmt: skip
    costs = _ledger(out, files, config).to_json()
    about = {
        "format": FORMAT,
        "folder": str(out),
        "until": until,
        "finished": complete,
        "passed": complete and all_passed,
        "photos": photos,
        "mllm": {"provider": config.provider, **costs},
    }
    write_output(out / ABOUT, json.dumps(about, indent=1) + "\n", RunError)
    return about

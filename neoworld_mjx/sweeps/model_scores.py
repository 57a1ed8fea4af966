"""S_sem by a model in a sweep, from one panel with one cost cap, or from recorded scores."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..config import Config, RefineOptions
from ..errors import BudgetError, ConfigError, RunError
from ..mllm import Panel, Picture, open_panel
from ..parse.photo import load_photo
from ..refinement.outcome import Refined
from .cases import Case

SCORES, RESPONSES = "scores", "answers.tape.json"
"""Names in the folder of a sweep: the folder of the scores of all runs, and the file of the models'
recorded responses (tape)."""


def scored_by_model(options: RefineOptions) -> bool:
    """Return whether a model scores S_sem and the weight of S_sem is positive."""
    return options.semantic.scorer == "mllm" and options.reward.w_sem > 0


class ModelScores:
    """Source of the semantic scores of a sweep's runs.

    Args:
        config: options of the models, the provider and the cost cap of the whole sweep.
        recorded: folder of scores that an earlier sweep recorded. If given, no model is asked.
        tapes: tapes of recorded responses, or folders of tapes, for the provider `replay`.
        out: folder of the sweep, into which scores and responses are recorded. If None, nothing is
            recorded.
        earlier: ledger of the sweep that is resumed, from its sweep.json.

    Raises:
        ConfigError: `recorded` is not a folder, or the provider is invalid.
        ModelError: no model is available.
        RunError: the earlier ledger is damaged.
    """

    def __init__(
        self,
        config: Config,
        *,
        recorded: Path | None,
        tapes: Sequence[Path],
        out: Path | None,
        earlier: dict[str, Any],
    ) -> None:
        if recorded is not None and not recorded.is_dir():
            raise ConfigError(f"scores: {recorded} is not a folder of recorded scores")
        self._recorded, self._out = recorded, out
        self._photos: dict[Path, Picture] = {}
        self._panel: Panel | None = None
        if recorded is None:
            self._panel = open_panel(
                config.mllm,
                config.provider,
                tapes=tuple(tapes),
                mailbox=None if out is None else out / "mailbox",
                record=None if out is None else out / RESPONSES,
                made=f"recorded by a sweep from provider {config.provider}",
            )
        if self._panel is not None and earlier:
            try:
                self._panel.ledger.add_earlier(earlier)
            except (AttributeError, LookupError, TypeError, ValueError):
                raise RunError(
                    f"{out}: the costs in sweep.json are damaged; use --overwrite"
                ) from None
        self._config = config

    @property
    def ledger(self) -> dict[str, Any]:
        """Calls, tokens and cost of the whole sweep, as in run.json; empty if no model is asked."""
        if self._panel is None:
            return {}
        return {"provider": self._panel.name, **self._panel.ledger.to_json()}

    def check(self, case: Case) -> None:
        """Reject a scene that a model cannot score.

        Raises:
            ConfigError: the photograph or the camera of the scene is missing.
        """
        if self._recorded is None and (case.photo is None or case.scene.camera is None):
            raise ConfigError(
                f"scene {case.name}: scores by a model need a photograph and a camera; name a run "
                "folder, or choose refine.semantic.scorer: geometric"
            )

    def refine_arguments(self, case: Case, point: str, seed: int) -> dict[str, Any]:
        """Return the arguments of `refine` that concern the scores of one run."""
        name = file_name(case.name, point, seed)
        arguments: dict[str, Any] = {}
        if self._out is not None:
            arguments["scores"] = self._out / SCORES / name
        if self._recorded is not None:
            return arguments | {"recorded": self._recorded / name}
        assert case.photo is not None
        if case.photo not in self._photos:
            self._photos[case.photo] = Picture.of("photo", load_photo(case.photo).rgb)
        return arguments | {"photo": self._photos[case.photo], "panel": self._panel}

    def refuse_partial(self, refined: Refined, case: Case, point: str, seed: int) -> None:
        """Reject the result of a run whose requests were stopped, for example by the cost cap.

        Raises:
            BudgetError: the requests were stopped.
        """
        stopped = (refined.scoring or {}).get("stopped")
        if stopped:
            raise BudgetError(
                f"scene {case.name}, point {point}, seed {seed}: {stopped}; earlier runs are "
                "saved: raise the cap and continue with --resume"
            )

    def close(self) -> None:
        """Close the panel's connections."""
        if self._panel is not None:
            self._panel.close()


def file_name(scene: str, point: str, seed: int) -> str:
    """Return the file name of a run's scores. It contains no "/", even if the scene's name does."""
    short = hashlib.sha256(f"{scene}\n{point}".encode()).hexdigest()[:8]
    slug = re.sub(r"[^a-z0-9]+", "_", f"{Path(scene).name} {point}".lower()).strip("_")
    return f"{slug[:60]}_{short}_{seed}.jsonl"

"""Semantic scores by a model in a sweep: one panel, ledger and cap, or scores recorded before."""

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

SCORES, ANSWERS = "scores", "answers.tape.json"
"""In the folder of a sweep: each run's scores, and the models' answers."""


def asks_a_model(options: RefineOptions) -> bool:
    """Tell whether a run's S_sem is a model's, and counts."""
    return options.semantic.scorer == "mllm" and options.reward.w_sem > 0


class ModelScores:
    """Gives the runs of a sweep what they need for semantic scores by a model.

    Args:
        config: models, provider and cost cap, of the sweep as a whole.
        recorded: folder of scores that an earlier sweep recorded; followed, and nobody is asked.
        tapes: tapes, or folders of tapes, for the provider `replay`.
        out: folder of the sweep, into which scores and answers are recorded; None records none.
        earlier: ledger of the part of the sweep that is continued, as sweep.json has it.

    Raises:
        ConfigError: `recorded` is no folder, or the provider is wrong.
        ModelError: nobody can be asked.
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
            raise ConfigError(f"scores: {recorded} is no folder of recorded scores")
        self._recorded, self._out = recorded, out
        self._photos: dict[Path, Picture] = {}
        self._panel: Panel | None = None
        if recorded is None:
            self._panel = open_panel(
                config.mllm,
                config.provider,
                tapes=tuple(tapes),
                mailbox=None if out is None else out / "mailbox",
                record=None if out is None else out / ANSWERS,
                made=f"recorded by a sweep from provider {config.provider}",
            )
        if self._panel is not None and earlier:
            try:
                self._panel.ledger.carry(earlier)
            except (AttributeError, LookupError, TypeError, ValueError):
                raise RunError(
                    f"{out}: the costs in sweep.json are damaged; use --overwrite"
                ) from None
        self._config = config

    @property
    def ledger(self) -> dict[str, Any]:
        """Calls, tokens and cost of the whole sweep, as in run.json; empty for recorded scores."""
        if self._panel is None:
            return {}
        return {"provider": self._panel.name, **self._panel.ledger.to_json()}

    def check(self, case: Case) -> None:
        """Refuse a scene that no model can score.

        Raises:
            ConfigError: its photograph or its camera is missing.
        """
        if self._recorded is None and (case.photo is None or case.scene.camera is None):
            raise ConfigError(
                f"scene {case.name}: scores by a model need a photograph and a camera; name a run "
                "folder, or choose refine.semantic.scorer: geometric"
            )

    def of(self, case: Case, point: str, seed: int) -> dict[str, Any]:
        """Return what `refine` takes for the scores of one run."""
        name = file_name(case.name, point, seed)
        given: dict[str, Any] = {}
        if self._out is not None:
            given["scores"] = self._out / SCORES / name
        if self._recorded is not None:
            return given | {"recorded": self._recorded / name}
        assert case.photo is not None
        if case.photo not in self._photos:
            self._photos[case.photo] = Picture.of("photo", load_photo(case.photo).rgb)
        return given | {"photo": self._photos[case.photo], "panel": self._panel}

    def refuse_partial(self, refined: Refined, case: Case, point: str, seed: int) -> None:
        """Refuse the result of a run whose requests ended early: it would not be the plan's.

        Raises:
            BudgetError: they did, as at the cost cap.
        """
        stopped = (refined.scoring or {}).get("stopped")
        if stopped:
            raise BudgetError(
                f"scene {case.name}, point {point}, seed {seed}: {stopped}; the runs before it are "
                "kept: raise the cap and go on with --resume"
            )

    def close(self) -> None:
        """End the panel's connections."""
        if self._panel is not None:
            self._panel.close()


def file_name(scene: str, point: str, seed: int) -> str:
    """Return the name of the file of a run's scores; names of scenes never become paths."""
    short = hashlib.sha256(f"{scene}\n{point}".encode()).hexdigest()[:8]
    words = re.sub(r"[^a-z0-9]+", "_", f"{Path(scene).name} {point}".lower()).strip("_")
    return f"{words[:60]}_{short}_{seed}.jsonl"

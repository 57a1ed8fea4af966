"""Result of a run: metrics of the scene, time of each step, fallbacks and notes."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Result:
    """Result of a run."""

    folder: Path
    until: str | None
    """Last requested step; None for a complete run."""
    metrics: dict[str, Any]
    seconds: dict[str, float]
    """Duration of each step [s]."""
    waiting: dict[str, float]
    """Time that each step waited for models [s]."""
    fallbacks: list[dict[str, str]]
    notes: list[dict[str, str]]
    """Noteworthy outcomes, such as large moves by the fit or the search."""
    objects: list[str]
    passed: bool | None
    """True if the refined scene is stable and free of penetration; None before refinement."""
    cost: dict[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return the JSON object that `neoworld reconstruct --json` prints."""
        exported = self.passed is not None and self.until is None
        return {
            "scene": str(self.folder / "scene.xml") if exported else None,
            "folder": str(self.folder),
            "report": str(self.folder / "report.html"),
            "objects": self.objects,
            **{key: value for key, value in self.metrics.items() if key != "objects"},
            "passed": self.passed,
            "seconds": self.seconds,
            "waiting": self.waiting,
            "fallbacks": self.fallbacks,
            "notes": self.notes,
            "mllm": self.cost,
        }

    def __repr__(self) -> str:
        """Return folder and outcome, objects, and metrics, on one line each."""
        outcome = {None: "not refined", True: "passed", False: "failed its checks"}[self.passed]
        computing = sum(self.seconds.values()) - sum(self.waiting.values())
        numbers = [
            f"{name} {self.metrics[name]:.2g}"
            for name in ("max_depth_m", "max_drift_m", "max_tilt_deg")
            if self.metrics.get(name) is not None
        ]
        return (
            f"Result({str(self.folder)!r}: {outcome} in {computing:.1f} s of computing\n"
            f"  objects: {', '.join(self.objects)}\n"
            f"  {', '.join(numbers) or 'no metrics'}, {len(self.fallbacks)} fallbacks)"
        )

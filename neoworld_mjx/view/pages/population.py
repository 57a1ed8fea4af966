"""The search on the page: candidates as transparent ghosts, and reward terms by iteration."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import NeoWorldError, RunError
from ...render.part_meshes import visible_meshes
from ...spec import SceneSpec
from ..report.convergence import History, best_candidates, over_finite, term_histories

GHOSTS = 24
"""Maximum number of candidates that are shown."""
GOOD, POOR = np.array([40, 170, 90]), np.array([215, 120, 60])


def ranked_candidates(history: History, iteration: int) -> NDArray:
    """Return the candidates of an iteration with a finite reward, best first."""
    rewards = np.asarray(history["absolute"][iteration], float)
    order = np.argsort(-np.where(np.isfinite(rewards), rewards, -np.inf), kind="stable")
    return order[np.isfinite(rewards[order])]


def show_ghosts(server: Any, scene: SceneSpec, history: History, iteration: int) -> int:
    """Show the best candidates of an iteration as transparent objects, from green (best) to orange.

    Objects that none of these candidates moves are omitted.

    Args:
        server: the viser server.
        scene: the initial scene of the search.
        history: history of the search.
        iteration: index of the iteration, from 0.

    Returns:
        The number of candidates that are shown.

    Raises:
        RunError: the history belongs to another scene.
    """
    import jax

    from ...compose.on_supports import snap
    from ...physics.layout import Layout, arrange, compose_poses
    from ...physics.scene_arrays import snapped_heights

    names = [obj.name for obj in scene.objects]
    if [str(name) for name in history.get("object_names", names)] != names:
        raise RunError("refine/history.npz does not belong to compose/scene.json")
    chosen = ranked_candidates(history, iteration)[:GHOSTS]
    xy, yaw, log_scale = (history[key][iteration][chosen] for key in ("xy", "yaw", "log_scale"))
    changed = np.abs(np.concatenate([xy, yaw[..., None], log_scale[..., None]], axis=2)) > 1e-5
    rank = np.linspace(0.0, 1.0, len(chosen))[:, None]
    colors = np.round(GOOD + rank * (POOR - GOOD)).astype(np.uint8)
    arrangement = arrange(snap(scene))
    layouts = Layout(
        xy=np.asarray(xy, float), yaw=np.asarray(yaw, float), log_scale=np.asarray(log_scale, float)
    )
    heights = np.concatenate(
        [
            snapped_heights(arrangement, jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], layouts))
            for k in range(len(chosen))
        ]
    )
    poses = compose_poses(arrangement, layouts, heights, np)
    hide_ghosts(server)
    with server.atomic():
        for k, obj in enumerate(scene.objects):
            if obj.static or not changed[:, k].any():
                continue
            meshes = [m for part in obj.spec.parts for m in visible_meshes(obj.spec, part)]
            for n, mesh in enumerate(meshes):
                server.scene.add_batched_meshes_simple(
                    f"/ghosts/{obj.name}/{n}",
                    mesh.vertices,
                    mesh.faces,
                    np.asarray(poses.quat[:, k], np.float32),
                    np.asarray(poses.pos[:, k], np.float32),
                    batched_scales=np.exp(np.asarray(log_scale[:, k], np.float32)),
                    batched_colors=colors,
                    opacity=0.18,
                    cast_shadow=False,
                    receive_shadow=False,
                )
    return len(chosen)


def hide_ghosts(server: Any) -> None:
    """Remove the ghosts."""
    server.scene.remove_by_name("/ghosts")


class Ghosts:
    """Ghosts on a page.

    If requests arrive faster than ghosts are shown, only the latest request counts.
    """

    def __init__(self, server: Any, show_line: Callable[[str], None]):
        """Start without ghosts.

        Args:
            server: the viser server.
            show_line: function that shows a line of text.
        """
        self._server, self._show_line = server, show_line
        self._lock = threading.Lock()
        self._requested = self._shown = 0

    def show(self, scene: SceneSpec, history: History | None, iteration: int) -> None:
        """Show the best candidates of an iteration, counted from 1; if it is 0, show none."""
        self._requested = iteration
        with self._lock:
            requested = self._requested
            if requested == self._shown:
                return
            self._shown = requested
            hide_ghosts(self._server)
            if not requested or history is None:
                return
            requested = min(requested, len(history["absolute"]))
            try:
                count = show_ghosts(self._server, scene, history, requested - 1)
            except NeoWorldError as error:
                self._show_line(str(error))
                return
            self._show_line(
                f"iteration {requested}: the best {count} candidates that were rolled out"
            )

    def reset(self) -> None:
        """Remove the ghosts, and forget which iteration was shown."""
        with self._lock:
            self._requested = self._shown = 0
            hide_ghosts(self._server)


def term_chart(server: Any, history: History) -> Any:
    """Add a chart of the best candidate's reward terms, and of the mean reward, by iteration."""
    from viser import uplot

    best = best_candidates(history)
    iterations = np.arange(1, len(best) + 1, dtype=float)
    rows = np.arange(len(best))
    lines = [
        ("reward, best", np.asarray(history["absolute"], float)[rows, best]),
        ("reward, mean", over_finite(history["absolute"], np.mean)),
    ]
    for term in term_histories(history):
        weight = abs(term.weight) if np.isfinite(term.weight) else 1.0
        lines.append((f"{term.name} x {weight:g}", term.raw[rows, best] * weight))
    colors = ("#2a9d5c", "#9bc9ae", "#4287f5", "#d68c45", "#b854a8", "#7a6cdc", "#c4625a")
    series = [uplot.Series(label="iteration")]
    series += [
        uplot.Series(label=label, stroke=colors[k % len(colors)], width=2)
        for k, (label, _) in enumerate(lines)
    ]
    return server.gui.add_uplot(
        (iterations, *(np.nan_to_num(values, posinf=0.0, neginf=0.0) for _, values in lines)),
        tuple(series),
        title="Best candidate, by term",
        scales={"x": uplot.Scale(time=False)},
        aspect=1.4,
    )

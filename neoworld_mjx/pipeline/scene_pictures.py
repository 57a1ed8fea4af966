"""Pictures of the scene, rendered in a thread while the next steps of the run proceed."""

import contextlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from ..config import RenderOptions
from ..run_folder import RunFolder
from ..spec import SceneSpec, read_scene


class _Pending(NamedTuple):
    part: str
    inputs: dict[str, object]
    file: str
    png: Future[bytes]


@dataclass
class Pictures:
    """Pictures of a run. Use it in a `with` statement, which waits for unfinished pictures.

    Each picture is a part of a step, such as "compose/picture". Only the caller's thread writes to
    the run folder: `store` saves the pictures that have been rendered in the meantime.
    """

    run: RunFolder
    options: RenderOptions
    _pending: list[_Pending] = field(default_factory=list)
    _pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "pictures"))

    def begin(self, part: str, scene: Path, file: str) -> None:
        """Start to render a scene from its camera, unless the run already has this picture.

        Args:
            part: name of the picture as a part of a step.
            scene: file of the scene.
            file: path of the picture within the run folder.
        """
        inputs = {"scene": scene, "render": self.options}
        if not self.run.finished(part, inputs):
            future = self._pool.submit(_draw, read_scene(scene), self.options)
            self._pending.append(_Pending(part, inputs, file, future))

    def store(self, *, wait: bool = False) -> None:
        """Save the finished pictures in the run folder; if `wait` is True, save all pictures.

        The recorded duration of a part is the time that the run waited for it.
        """
        for pending in [p for p in self._pending if wait or p.png.done()]:
            self._pending.remove(pending)
            with self.run.step(pending.part, pending.inputs) as out:
                if out is not None:
                    (out / pending.file).parent.mkdir(parents=True, exist_ok=True)
                    (out / pending.file).write_bytes(pending.png.result())

    def __enter__(self) -> "Pictures":
        """Return this object."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Store pending pictures, even after an error, because they may show its cause."""
        try:
            if error is None:
                self.store(wait=True)
            elif isinstance(error, Exception):
                with contextlib.suppress(Exception):  # Report the first error.
                    self.store(wait=True)
        finally:
            self._pool.shutdown(wait=False, cancel_futures=True)


def _draw(scene: SceneSpec, options: RenderOptions) -> bytes:
    from ..render import render_scene, to_png

    return to_png(render_scene(scene, width=options.width, supersample=options.supersample))

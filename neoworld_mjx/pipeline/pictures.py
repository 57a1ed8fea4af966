"""Pictures of the scene, drawn in a thread while the run goes on with its next steps."""

import contextlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from ..config import RenderOptions
from ..run_folder import RunFolder
from ..spec import SceneSpec, read_scene


class _Begun(NamedTuple):
    part: str
    inputs: dict[str, object]
    file: str
    png: Future[bytes]


@dataclass
class Pictures:
    """The pictures of a run; use it in a `with` statement, which waits for those not yet done.

    Each picture is a part of a step, such as "compose/picture". The run folder is touched by the
    caller's thread alone: `store` moves in what has been drawn meanwhile.
    """

    run: RunFolder
    options: RenderOptions
    _begun: list[_Begun] = field(default_factory=list)
    _pool: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "pictures"))

    def begin(self, part: str, scene: Path, file: str) -> None:
        """Begin to draw a scene from its own camera, unless the run has this picture already.

        Args:
            part: of which step the picture is.
            scene: file of the scene.
            file: path of the picture within the run folder.
        """
        inputs = {"scene": scene, "render": self.options}
        if not self.run.finished(part, inputs):
            drawn = self._pool.submit(_drawn, read_scene(scene), self.options)
            self._begun.append(_Begun(part, inputs, file, drawn))

    def store(self, *, wait: bool = False) -> None:
        """Move the pictures that are done, or with `wait` all, into the run folder.

        A part's seconds are those for which the run waited for it.
        """
        for begun in [each for each in self._begun if wait or each.png.done()]:
            self._begun.remove(begun)
            with self.run.step(begun.part, begun.inputs) as out:
                if out is not None:
                    (out / begun.file).parent.mkdir(parents=True, exist_ok=True)
                    (out / begun.file).write_bytes(begun.png.result())

    def __enter__(self) -> "Pictures":
        """Return the pictures themselves."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Store what was begun, after an error too, as it may show why; drop it on Ctrl-C."""
        try:
            if error is None:
                self.store(wait=True)
            elif isinstance(error, Exception):
                with contextlib.suppress(Exception):  # The first error is the one to report.
                    self.store(wait=True)
        finally:
            self._pool.shutdown(wait=False, cancel_futures=True)


def _drawn(scene: SceneSpec, options: RenderOptions) -> bytes:
    from ..render import render_scene, to_png

    picture = render_scene(
        scene,
        width=options.width,
        supersample=options.supersample,
    )
    return to_png(picture)

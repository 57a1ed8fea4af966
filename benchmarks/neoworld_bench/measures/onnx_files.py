"""ONNX models from the user's files, run by onnxruntime (extra `metrics`) on the CPU."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.io.files import content_hash

_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


class TensorPort(NamedTuple):
    """Input of a model."""

    name: str
    shape: tuple[int | None, ...]
    """Shape; a dimension of any size is None."""
    dtype: type


class OnnxModel:
    """ONNX model that processes one sample at a time.

    Args:
        path: the file. External weights must be in the same folder.
        role: name of the model in messages, such as "clip".

    Raises:
        ConfigError: onnxruntime is not installed, or the file cannot be read or is not a model.
    """

    def __init__(self, path: Path, role: str) -> None:
        self.path, self.role = path, role
        try:
            import onnxruntime
        except ImportError:
            raise ConfigError(
                f"{role}: onnxruntime is not installed: uv sync --inexact --extra metrics"
            ) from None
        try:
            self.sha256 = content_hash(path)
        except OSError as error:
            raise ConfigError(f"{role}: cannot read {path}: {error.strerror}") from None
        options = onnxruntime.SessionOptions()
        options.log_severity_level = (
            4  # Suppress warnings and errors in the log; errors are raised as exceptions.
        )
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's exceptions have no common base class.
            raise ConfigError(f"{role}: {path} is no ONNX model: {_first_line(error)}") from None
        self.inputs = tuple(self._port(port) for port in self._session.get_inputs())
        self.outputs = tuple(port.name for port in self._session.get_outputs())

    def check_inputs(self, expected: Mapping[str, Sequence[int | None]], advice: str) -> None:
        """Check the names and shapes of the inputs.

        Args:
            expected: shape of each input by name; a dimension of any size is None.
            advice: description of the expected file, for the error message.

        Raises:
            ConfigError: the inputs have other names or shapes.
        """
        names = [port.name for port in self.inputs]
        if set(names) != {*expected}:
            raise ConfigError(
                f"{self.role}: {self.path} has the inputs {', '.join(names) or 'none'}; {advice}"
            )
        for port in self.inputs:
            shape = tuple(expected[port.name])
            if not _fits(port.shape, shape):
                raise ConfigError(
                    f"{self.role}: {self.path} takes {port.name} of shape {_shown(port.shape)}, "
                    f"not {_shown(shape)}; {advice}"
                )

    def run(self, values: Mapping[str, NDArray], output: str) -> NDArray:
        """Run the model and return one output as float64.

        Raises:
            ConfigError: the model fails on these values, or its output is not finite.
        """
        feed = {port.name: values[port.name].astype(port.dtype) for port in self.inputs}
        try:
            (result,) = self._session.run([output], feed)
        except Exception as error:
            shapes = ", ".join(f"{k} {_shown(v.shape)}" for k, v in feed.items())
            raise ConfigError(
                f"{self.role}: {self.path} fails on {shapes}: {_first_line(error)}"
            ) from None
        numbers = np.asarray(result, float)
        if not np.isfinite(numbers).all():
            raise ConfigError(
                f"{self.role}: {self.path} gives numbers that are not finite: its weights are "
                "damaged, or were exported wrongly"
            )
        return numbers

    def described(self) -> dict[str, str]:
        """Return the path and the digest of the file, which identify the model in results."""
        return {"file": str(self.path), "sha256": self.sha256[:16]}

    def _port(self, port: Any) -> TensorPort:
        if port.type not in _TYPES:
            raise ConfigError(
                f"{self.role}: {self.path} takes {port.name} as {port.type}; expected float32 or "
                "float16"
            )
        shape = tuple(side if isinstance(side, int) else None for side in port.shape)
        return TensorPort(port.name, shape, _TYPES[port.type])


def unit(vector: NDArray, model: OnnxModel) -> NDArray:
    """Return a vector [d] divided by its length.

    Raises:
        ConfigError: the vector is zero.
    """
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ConfigError(
            f"{model.role}: {model.path} gives a vector of zeros: its weights are damaged"
        )
    return vector / length


def _fits(shape: Sequence[int | None], expected: Sequence[int | None]) -> bool:
    return len(shape) == len(expected) and all(
        a is None or b is None or a == b for a, b in zip(shape, expected, strict=True)
    )


def _shown(shape: Sequence[int | None]) -> str:
    return "[" + ", ".join("any" if side is None else str(side) for side in shape) + "]"


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:300]

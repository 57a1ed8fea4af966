"""CLIP, DINOv2 and LPIPS from the files in which they are published or exported.

CLIP and DINOv2 are folders with two files: an image tower in ONNX (`onnx/vision_model.onnx`,
`onnx/model.onnx`, or these files without `onnx/`), and `preprocessor_config.json`, which specifies
resizing, center crop and normalization. LPIPS is one ONNX file with two image inputs.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from neoworld_mjx.errors import ConfigError
from neoworld_mjx.io import read_model

from .onnx_files import OnnxModel, unit

CONFIG = "preprocessor_config.json"
TOWERS = {
    "clip": (("vision_model.onnx",), ("image_embeds",)),
    "dino": (("model.onnx",), ("pooler_output", "last_hidden_state")),
    "uni3d": (("image.onnx",), ("image_embeds",)),
}
"""File names and output names of each kind of model; the first name that exists is used."""


def _shorter_side(value: Any) -> Any:
    if isinstance(value, dict) and set(value) == {"shortest_edge"}:
        return value["shortest_edge"]
    return value


def _square(value: Any) -> Any:
    if (
        isinstance(value, dict)
        and set(value) == {"height", "width"}
        and len({*value.values()}) == 1
    ):
        return value["height"]
    return value


_Side = Annotated[int, Field(ge=1, le=4096)]
_Triple = tuple[float, float, float]


class Preprocessing(BaseModel):
    """The file `preprocessor_config.json`, as `transformers` writes it for CLIP and DINOv2."""

    model_config = ConfigDict(extra="ignore")

    size: Annotated[_Side, BeforeValidator(_shorter_side)]
    """Length of the shorter side after resizing [px]."""
    crop_size: Annotated[_Side, BeforeValidator(_square)]
    """Side length of the center crop [px]."""
    resample: Annotated[int, Field(ge=0, le=5)] = 3
    """Pillow's number of the resampling filter; 3 is bicubic."""
    rescale_factor: float = 1 / 255
    image_mean: _Triple
    image_std: Annotated[_Triple, Field(description="Standard deviation of each channel.")]
    do_resize: Annotated[bool, Field(description="Only true is supported.")] = True
    do_center_crop: bool = True
    do_rescale: bool = True
    do_normalize: bool = True

    def tensor(self, rgb: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "1 3 side side"]:
        """Preprocess an image into the model's input."""
        height, width = rgb.shape[:2]
        short = min(width, height)
        # Round the longer side down, as the published preprocessors do.
        resized = (int(self.size * width / short), int(self.size * height / short))
        image = Image.fromarray(rgb).resize(resized, Image.Resampling(self.resample))
        side = self.crop_size
        left, top = (image.width - side) // 2, (image.height - side) // 2
        cut = np.asarray(image.crop((left, top, left + side, top + side)), np.float32)
        values = (cut * self.rescale_factor - np.array(self.image_mean)) / np.array(self.image_std)
        return values.transpose(2, 0, 1)[None].astype(np.float32)


class ImageEncoder:
    """Image tower with its preprocessing.

    Args:
        path: the published folder, or the ONNX file in it.
        kind: a key of `TOWERS`.

    Raises:
        ConfigError: a file is missing or is not of this kind.
    """

    def __init__(self, path: Path, kind: str) -> None:
        files, outputs = TOWERS[kind]
        file = _model_file(
            path, [Path(sub) / name for name in files for sub in ("onnx", ".")], kind
        )
        places = [file.parent, file.parent.parent]
        config = next((p / CONFIG for p in places if (p / CONFIG).is_file()), None)
        if config is None:
            raise ConfigError(
                f"{kind}: no {CONFIG} beside {file} or in the folder above; it is published with "
                "the model"
            )
        self.preprocessing = read_model(config, Preprocessing, ConfigError, "a preprocessor's")
        self._check(config, kind)
        self.model = OnnxModel(file, kind)
        side = self.preprocessing.crop_size
        advice = f"expected is an image tower, {' or '.join(files)}, with pixel_values alone"
        self.model.check_inputs({"pixel_values": (1, 3, side, side)}, advice)
        self._output = next((name for name in outputs if name in self.model.outputs), None)
        if self._output is None:
            raise ConfigError(
                f"{kind}: {file} has the outputs {', '.join(self.model.outputs)}; expected is "
                f"{' or '.join(outputs)}"
            )

    def embed(self, rgb: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, " d"]:
        """Return the normalized features of an image.

        If the model returns tokens, the features of the first token (CLS) are used.

        Raises:
            ConfigError: the model's output is not finite or not a vector.
        """
        assert self._output is not None
        values = self.model.run({"pixel_values": self.preprocessing.tensor(rgb)}, self._output)
        if values.ndim == 3:
            values = values[:, 0]
        if values.ndim != 2 or len(values) != 1:
            raise ConfigError(
                f"{self.model.role}: {self.model.path} gives {self._output} of shape "
                f"{list(values.shape)}; expected is [1, d] or, for tokens, [1, tokens, d]"
            )
        return unit(values[0], self.model)

    def _check(self, config: Path, kind: str) -> None:
        p = self.preprocessing
        unsupported = [
            name
            for name in ("do_resize", "do_center_crop", "do_rescale", "do_normalize")
            if not getattr(p, name)
        ]
        if unsupported or p.size < p.crop_size or min(p.image_std) <= 0:
            wrong = f"{unsupported[0]} is false" if unsupported else "size, crop_size or image_std"
            raise ConfigError(
                f"{kind}: {config}: {wrong}; expected is a picture that is resized, cut to its "
                "middle, rescaled and normalized, as CLIP and DINOv2 publish it"
            )


class LpipsModel:
    """LPIPS as an ONNX model with two inputs [1, 3, h, w] in [-1, 1] and one number as output.

    Args:
        path: the file, or a folder with lpips.onnx.

    Raises:
        ConfigError: the file is missing, or has other inputs.
    """

    def __init__(self, path: Path) -> None:
        self.model = OnnxModel(_model_file(path, [Path("lpips.onnx")], "lpips"), "lpips")
        advice = "expected is LPIPS with two pictures [1, 3, any, any] as inputs"
        names = [port.name for port in self.model.inputs]
        if len(names) != 2:
            # No file has these inputs, so `check_inputs` raises an error that lists the inputs.
            names = ["a picture", "another"]
        self.model.check_inputs(dict.fromkeys(names, (1, 3, None, None)), advice)

    def distance(self, a: UInt8[np.ndarray, "h w 3"], b: UInt8[np.ndarray, "h w 3"]) -> float:
        """Return the distance between two images of equal size, which is 0 for equal images.

        Raises:
            ConfigError: the output is not a number, or the model was exported for another size.
        """
        height, width = a.shape[:2]
        size = {port.name: (1, 3, height, width) for port in self.model.inputs}
        self.model.check_inputs(size, "export it with any height and width (dynamic axes)")
        pictures = {
            port.name: (rgb.astype(np.float32) / 127.5 - 1).transpose(2, 0, 1)[None]
            for port, rgb in zip(self.model.inputs, (a, b), strict=True)
        }
        values = self.model.run(pictures, self.model.outputs[0])
        if values.size != 1:
            raise ConfigError(
                f"lpips: {self.model.path} gives {self.model.outputs[0]} of shape "
                f"{list(values.shape)}; expected is one number (lpips.LPIPS(spatial=False))"
            )
        return float(values.reshape(()))


def _model_file(path: Path, names: list[Path], role: str) -> Path:
    """Return a model's file: the path itself, or the first of the names that the folder contains.

    Raises:
        ConfigError: no such file exists.
    """
    if path.is_file():
        return path
    if not path.is_dir():
        raise ConfigError(f"{role}: there is no {path}; name the model's folder or ONNX file")
    file = next((path / name for name in names if (path / name).is_file()), None)
    if file is None:
        raise ConfigError(
            f"{role}: {path} holds no {' or '.join(name.as_posix() for name in names)}"
        )
    return file

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Models for transformers in a folder on this machine.

Nothing is downloaded, and weights are read from safetensors files only, which hold no code. Photographs are
prepared here, as the models' processors do it, because those need torchvision.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.documents import Entries, Fields, Items, Number, read_json
from ..run.errors import FiptError
from ..run.extras import optional

_CONFIG = Fields(
    {"model_type": str},
    {
        "id2label": Entries(str),
        "image_size": Number(16, 8192, whole=True),
        "task_seq_len": Number(1, 1024, whole=True),
    },
)
_PROCESSOR = Fields({}, {"image_mean": Items(Number()), "image_std": Items(Number(low=1e-3)), "size": dict})
_INDEX = Fields({"weight_map": Entries(str)})
_PLAIN_WEIGHTS = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*\.safetensors")  # a file's name, no path
# Of ImageNet, with which they were trained.
MEAN, STD = np.array((0.485, 0.456, 0.406), np.float32), np.array((0.229, 0.224, 0.225), np.float32)
_REMEDY = (
    "Choose the folder of a model with config.json, preprocessor_config.json and model.safetensors: SAM or"
    " SAM 2 for parts; Mask2Former, OneFormer (with its tokenizer) or EoMT for semantic classes."
)


# Of a configuration: of what repeats layers, by words in its name, and of all other whole numbers (words of a
# vocabulary, sides of images, widths).
_REPEATING, _WIDTHS = ("layer", "depth", "block", "stage"), ("dim", "size", "width")


class ModelFolder:
    """The folder of a model, as `save_pretrained` of transformers writes it.

    Args:
        path: of the folder.

    Attributes:
        path: of the folder.
        kind: the model's type by transformers' name.
        config: content of config.json.
        size: what preprocessor_config.json says of the size of images in training; may be empty.

    Raises:
        FiptError: ``model-unusable`` for an incomplete folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = _read(path / "config.json", _CONFIG)
        self.kind: str = self.config["model_type"]
        fault = _config_fault(self.config)
        if fault:
            raise self.unusable(f"config.json: {fault}")
        if not list(path.glob("*.safetensors")):
            raise self.unusable("it has no safetensors file")
        self._check_weights()
        processor: dict[str, Any] = {}
        if (path / "preprocessor_config.json").is_file():
            processor = _read(path / "preprocessor_config.json", _PROCESSOR)
        self.size: dict[str, Any] = processor.get("size", {})
        self._mean = np.array(processor.get("image_mean", MEAN), np.float32)
        self._std = np.array(processor.get("image_std", STD), np.float32)
        if self._mean.size != 3 or self._std.size != 3:
            raise self.unusable("its images have not three channels")

    def _check_weights(self) -> None:
        """Refuse an index that names weights other than safetensors files in the model's own folder.

        Raises:
            FiptError: ``model-unusable``.
        """
        for index in self.path.glob("*.index.json"):
            for name in set(_read(index, _INDEX)["weight_map"].values()):
                if not _PLAIN_WEIGHTS.fullmatch(name):
                    raise self.unusable(
                        f"{index.name} names '{name[:100]}', no safetensors file in its folder"
                    )

    def load(self, name: str, **changes: Any) -> Any:
        """The model with all of its weights, for inference.

        Args:
            name: of its class in transformers.
            changes: of its configuration.

        Raises:
            FiptError: ``model-unusable`` or, without transformers, ``package-optional``.
        """
        kind = getattr(_transformers(), name)
        try:
            self._check_memory(kind, changes)
            model, info = kind.from_pretrained(
                str(self.path),
                local_files_only=True,
                use_safetensors=True,
                output_loading_info=True,
                **changes,
            )
        except Exception as error:  # transformers raises all kinds for files that do not fit together
            raise self.unusable(_first_line(error)) from None
        missing = sorted(info["missing_keys"])
        if missing:  # transformers fills them with random numbers
            raise self.unusable(f"{len(missing)} of its weights are missing, the first is {missing[0]}")
        return model.eval()

    def _check_memory(self, kind: Any, changes: dict[str, Any]) -> None:
        """Refuse a configuration of more numbers than the weights have, before these are filled at random.

        Raises:
            ValueError: what is wrong, besides whatever transformers raises.
        """
        config = kind.config_class.from_pretrained(str(self.path), local_files_only=True, **changes)
        with torch.device("meta"):  # sizes without content
            count = sum(parameter.numel() for parameter in kind(config).parameters())
        stored = sum(file.stat().st_size for file in self.path.glob("*.safetensors"))
        if count > stored:  # each number takes at least one byte
            raise ValueError(f"config.json describes {count:,} weights, and the files have {stored:,} bytes")

    def tokens(self, text: str, length: int) -> torch.Tensor:
        """(1, length) numbers of a text's words by CLIP's tokenizer in the folder, 0 after the last one.

        Raises:
            FiptError: ``model-unusable`` or, without transformers, ``package-optional``.
        """
        package = _transformers()
        try:
            tokenizer = package.CLIPTokenizer.from_pretrained(str(self.path), local_files_only=True)
            tokens = tokenizer([text], padding="max_length", max_length=length, truncation=True)
        except Exception as error:
            raise self.unusable(f"its tokenizer: {_first_line(error)}") from None
        return torch.tensor(tokens["attention_mask"]) * torch.tensor(tokens["input_ids"])

    def pixels(self, picture: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """A photograph as the model takes it.

        Args:
            picture: (height, width, 3) uint8, sRGB.
            size: height and width of the result.

        Returns:
            (1, 3, *size) float32, with the mean and the deviation of the training subtracted and divided out.
        """
        return normalized(picture, size, self._mean, self._std)

    def unusable(self, reason: str) -> FiptError:
        """The error for a model that can't be used."""
        return FiptError("model-unusable", f"The model in {self.path} can't be used: {reason}.", _REMEDY)


def normalized(
    picture: np.ndarray, size: tuple[int, int], mean: np.ndarray = MEAN, deviation: np.ndarray = STD
) -> torch.Tensor:
    """(1, 3, *size) of a picture (height, width, 3) uint8, sRGB; see `ModelFolder.pixels`."""
    values = (picture.astype(np.float32) / 255.0 - mean) / deviation
    pixels = torch.from_numpy(values).permute(2, 0, 1)[None]
    return torch.nn.functional.interpolate(
        pixels, size=size, mode="bilinear", align_corners=False, antialias=True
    )


def enlarged(scores: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Scores (N, h, w) at another resolution, (N, *size)."""
    return torch.nn.functional.interpolate(scores[None], size=size, mode="bilinear", align_corners=False)[0]


def _transformers() -> Any:
    """The package, which is told to stay off the network.

    Raises:
        FiptError: ``package-optional``.
    """
    os.environ["HF_HUB_OFFLINE"] = "1"  # read when transformers is imported
    return optional("transformers", "A masks model")


def _read(path: Path, shape: Fields) -> dict[str, Any]:
    try:
        data: dict[str, Any] = read_json(path, shape, _REMEDY)
    except FiptError as error:
        raise FiptError("model-unusable", error.text, _REMEDY) from None
    return data


def _config_fault(value: Any, name: str = "", nested: int = 0) -> str:
    """What no model has in a configuration, whose numbers decide on time and memory; "" where nothing is."""
    if isinstance(value, (dict, list)):
        if nested > 8 or len(value) > 4096:
            return f"{name or 'it'} has too many parts"
        items = value.items() if isinstance(value, dict) else [(name, item) for item in value]
        return next(filter(None, (_config_fault(item, key, nested + 1) for key, item in items)), "")
    is_width = any(word in name for word in _WIDTHS)
    most = 256 if any(word in name for word in _REPEATING) and not is_width else 1_000_000
    if isinstance(value, int) and abs(value) > most:
        return f"{name} is {value}; at most {most} is possible"
    return ""


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Semantic classes of photographs, by a Mask2Former, OneFormer or EoMT model in a folder on this machine.

Nothing is downloaded, and weights are read from safetensors files only, which hold no code. Images are
prepared and results combined here, as the models' processors do it, because those need torchvision.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.documents import Entries, Fields, Items, Number, read_json
from ..run.errors import FiptError
from .extras import optional

CLASSES = {
    "mask2former": "Mask2FormerForUniversalSegmentation",
    "oneformer": "OneFormerForUniversalSegmentation",
    "eomt": "EomtForUniversalSegmentation",
}
_CONFIG = Fields(
    {"model_type": str, "id2label": Entries(str)},
    {
        "image_size": Number(16, 8192, whole=True),
        "task_seq_len": Number(1, 1024, whole=True),
    },
)
_PROCESSOR = Fields({}, {"image_mean": Items(Number()), "image_std": Items(Number(low=1e-3)), "size": dict})
_TASK = "the task is semantic"  # what OneFormer is asked for
_TASK_WORDS = 77  # to which its tokens are filled up, where its configuration does not say
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, with which they were trained
_SHORT_SIDE = 800  # pixels, where the folder does not say how large images were in training
_MULTIPLE = 32  # of the sides that the backbones of all but EoMT need
_CLASSES_AT_ONCE = 16  # whose scores are enlarged together; all would take gigabytes
_REMEDY = (
    "Choose the folder of a Mask2Former, OneFormer or EoMT model for semantic segmentation with config.json, "
    "preprocessor_config.json and model.safetensors (and OneFormer's tokenizer)."
)


# What transformers raises for files that do not fit together.
_LOADING = (OSError, ValueError, RuntimeError, KeyError, TypeError, AttributeError, ImportError)


class Segmenter:
    """A segmentation model.

    Args:
        folder: of the model, as `save_pretrained` of transformers writes it.

    Attributes:
        classes: their names by id.

    Raises:
        FiptError: ``model-unusable`` for another or an incomplete model, ``package-optional`` without
            transformers.
    """

    def __init__(self, folder: Path) -> None:
        config = self._read(folder / "config.json", _CONFIG)
        kind = config["model_type"]
        if kind not in CLASSES:
            raise _unusable(folder, f"it is of the type '{kind}'")
        if not list(folder.glob("*.safetensors")):
            raise _unusable(folder, "it has no safetensors file")
        processor: dict[str, Any] = {}
        if (folder / "preprocessor_config.json").is_file():
            processor = self._read(folder / "preprocessor_config.json", _PROCESSOR)
        self._mean = np.array(processor.get("image_mean", _MEAN), np.float32)
        self._std = np.array(processor.get("image_std", _STD), np.float32)
        if self._mean.size != 3 or self._std.size != 3:
            raise _unusable(folder, "its images have not three channels")
        self._windows = kind == "eomt"  # its input is a square of one size
        self._side = int(config.get("image_size", _SHORT_SIDE)) if self._windows else _short_side(processor)
        # Only its training needs OneFormer's encoder of texts.
        changes = {"is_training": False} if kind == "oneformer" else {}
        self._model = _load(folder, CLASSES[kind], changes).eval()
        self._more = {}
        if kind == "oneformer":
            task = _task_tokens(folder, int(config.get("task_seq_len", _TASK_WORDS)))
            self._more = {"task_inputs": task}
        self.classes = {int(key): name for key, name in config["id2label"].items() if key.isdecimal()}

    @staticmethod
    def _read(path: Path, shape: Fields) -> dict[str, Any]:
        try:
            data: dict[str, Any] = read_json(path, shape, _REMEDY)
        except FiptError as error:
            raise FiptError("model-unusable", error.text, _REMEDY) from None
        return data

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """The class of each pixel.

        Args:
            picture: (height, width, 3) uint8, sRGB.

        Returns:
            (height, width) int32 keys of `classes`.
        """
        height, width = picture.shape[:2]
        scale = self._side / min(height, width)
        multiple = 1 if self._windows else _MULTIPLE
        size = (_rounded(height * scale, multiple), _rounded(width * scale, multiple))
        values = (picture.astype(np.float32) / 255.0 - self._mean) / self._std
        pixels = torch.from_numpy(values).permute(2, 0, 1)[None]
        pixels = torch.nn.functional.interpolate(
            pixels, size=size, mode="bilinear", align_corners=False, antialias=True
        )
        with torch.no_grad():
            scores = self._scores_of_windows(pixels) if self._windows else self._scores(pixels)
            return _best_class(scores, (height, width)).cpu().numpy()

    def _scores(self, pixels: torch.Tensor) -> torch.Tensor:
        """(C, h, w) score of each class, at the resolution of the model's masks."""
        output = self._model(pixel_values=pixels, **self._more)
        weights = output.class_queries_logits[0].softmax(dim=-1)[:, :-1]  # the last one is "nothing"
        masks = output.masks_queries_logits[0].sigmoid()
        return torch.einsum("qc,qhw->chw", weights, masks)

    def _scores_of_windows(self, pixels: torch.Tensor) -> torch.Tensor:
        """(C, h, w) mean score of square windows along the longer side."""
        height, width = pixels.shape[-2:]
        side, longer = min(height, width), max(height, width)
        total, count = None, torch.zeros(height, width, device=pixels.device)
        for start in window_starts(longer, side):
            rows = slice(start, start + side) if height > width else slice(0, side)
            columns = slice(0, side) if height > width else slice(start, start + side)
            scores = self._scores(pixels[..., rows, columns])
            scores = _enlarged(scores, (side, side))
            total = torch.zeros(len(scores), height, width, device=pixels.device) if total is None else total
            total[:, rows, columns] += scores
            count[rows, columns] += 1.0
        assert total is not None
        return total / count


def window_starts(longer: int, side: int) -> list[int]:
    """Where windows of a length begin that cover a longer one with equal overlaps."""
    count = math.ceil(longer / side)
    return [round(index * (longer - side) / max(count - 1, 1)) for index in range(count)]


def _short_side(processor: dict[str, Any]) -> int:
    size = processor.get("size", {})
    value = size.get("shortest_edge", size.get("height", _SHORT_SIDE))
    is_side = isinstance(value, int) and not isinstance(value, bool) and 2 * _MULTIPLE <= value <= 4096
    return value if is_side else _SHORT_SIDE


def _rounded(length: float, multiple: int) -> int:
    return max(multiple, round(length / multiple) * multiple)


def _load(folder: Path, name: str, changes: dict[str, Any]) -> Any:
    """The model with all of its weights, and some changes of its configuration."""
    try:
        model, info = getattr(_transformers(), name).from_pretrained(
            str(folder), local_files_only=True, use_safetensors=True, output_loading_info=True, **changes
        )
    except _LOADING as error:
        raise _unusable(folder, _first_line(error)) from None
    missing = sorted(info["missing_keys"])
    if missing:  # transformers fills them with random numbers
        raise _unusable(folder, f"{len(missing)} of its weights are missing, the first is {missing[0]}")
    return model


def _task_tokens(folder: Path, length: int) -> torch.Tensor:
    """(1, length) numbers of the words that tell OneFormer its task, as its processor makes them."""
    try:
        tokenizer = _transformers().CLIPTokenizer.from_pretrained(str(folder), local_files_only=True)
        tokens = tokenizer([_TASK], padding="max_length", max_length=length, truncation=True)
    except _LOADING as error:
        raise _unusable(folder, f"its tokenizer: {_first_line(error)}") from None
    return torch.tensor(tokens["attention_mask"]) * torch.tensor(tokens["input_ids"])


def _transformers() -> Any:
    os.environ["HF_HUB_OFFLINE"] = "1"  # read when transformers is imported
    return optional("transformers", "A segmentation model")


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def _enlarged(scores: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    return torch.nn.functional.interpolate(scores[None], size=size, mode="bilinear", align_corners=False)[0]


def _best_class(scores: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """(height, width) int32 class with the highest of the scores (C, h, w)."""
    highest = torch.full(size, -torch.inf, device=scores.device)
    best = torch.zeros(size, dtype=torch.int32, device=scores.device)
    for start in range(0, len(scores), _CLASSES_AT_ONCE):
        value, index = _enlarged(scores[start : start + _CLASSES_AT_ONCE], size).max(dim=0)
        better = value > highest
        best[better] = (index[better] + start).to(torch.int32)
        highest = torch.maximum(highest, value)
    return best


def _unusable(folder: Path, reason: str) -> FiptError:
    return FiptError("model-unusable", f"The model in {folder} can't be used: {reason}.", _REMEDY)

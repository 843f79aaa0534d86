# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of MobileSAM as its authors publish it, one file of weights.

Sizes are read from the shapes of the weights. Files are data: code in them is refused, and nothing is made
that is larger than the file says.
"""

from __future__ import annotations

import math
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.errors import FiptError
from ..run.extras import optional
from .local_models import normalized
from .sam_decoder import DecoderSizes, SamDecoder, fast_type
from .tiny_vit import TinyVit, TinyVitSizes

SUFFIXES = (".pt", ".pth", ".safetensors")
ENCODER, MOBILE = "image_encoder.", "image_encoder.patch_embed.seq.0.c.weight"
# A weight by which the checkpoints of other networks are known.
_OTHERS = {
    "image_encoder.patch_embed.proj.weight": "SAM",
    "image_encoder.trunk.patch_embed.proj.weight": "SAM 2",
}
# What training leaves behind: counters, TinyViT's classifier, and the encoding of masks as prompts.
_UNUSED = ("image_encoder.norm_head.", "image_encoder.head.", "prompt_encoder.mask_downscaling.")
_MOST_WIDTH = 4096
_REMEDY = (
    "Choose a checkpoint of MobileSAM (.pt, .pth or .safetensors) as its authors publish it; SAM and SAM 2 as"
    " the folder of a model for transformers."
)
# What torch and safetensors raise for files that are damaged or that are something else.
_DAMAGE = (OSError, ValueError, RuntimeError, KeyError, TypeError, AttributeError, EOFError, MemoryError)
STRIDE = 16  # pixels of a place of the encoding
Weights = dict[str, torch.Tensor]


def unusable(path: Path, reason: str) -> FiptError:
    """The error for a checkpoint that can't be used."""
    return FiptError("model-unusable", f"The model {path} can't be used: {reason}.", _REMEDY)


def read_weights(path: Path) -> Weights:
    """The weights of a checkpoint by name.

    Raises:
        FiptError: ``model-unusable`` for a file that is damaged, holds more than weights, or has values that
            are not finite; ``package-optional`` for a safetensors file without the package.
    """
    try:
        size = path.stat().st_size
        if not 0 < size <= 8 << 30:  # SAM's largest model has 2.6 GB
            raise unusable(path, f"it has {size} bytes")
        data = _read_safetensors(path) if path.suffix.lower() == ".safetensors" else _read_torch(path)
    except (pickle.UnpicklingError, zipfile.BadZipFile, *_DAMAGE) as error:
        lines = str(error).strip().splitlines()
        reason = lines[0].rstrip(".") if lines else type(error).__name__
        if isinstance(error, pickle.UnpicklingError):
            reason = "it holds more than weights, or is damaged"
        raise unusable(path, reason) from None
    for inner in ("model", "state_dict"):  # beside them, trainings save their own state
        if isinstance(data, dict) and isinstance(data.get(inner), dict):
            data = data[inner]
    if not isinstance(data, dict):
        raise unusable(path, "it holds no weights")
    weights = {name: value for name, value in data.items() if isinstance(name, str)}
    weights = {name: value for name, value in weights.items() if isinstance(value, torch.Tensor)}
    for name, value in weights.items():
        if value.layout != torch.strided or value.is_quantized:
            raise unusable(path, f"the weights {name} are packed")
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise unusable(path, f"the weights {name} are not finite")
    return {name: value.float() if value.is_floating_point() else value for name, value in weights.items()}


def _read_torch(path: Path) -> Any:
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > path.stat().st_size:
                raise ValueError("it is compressed")  # torch never does that
    return torch.load(path, map_location="cpu", weights_only=True)


def _read_safetensors(path: Path) -> Any:
    optional("safetensors", "A masks model in a safetensors file")
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except SafetensorError as error:
        raise ValueError(str(error)) from None


class MobileSam:
    """MobileSAM: TinyViT as encoder, SAM's decoder; both without other packages.

    Args:
        path: of the checkpoint, for messages.
        weights: its content.

    Attributes:
        side: pixels of the square in which photographs lie.
        keeps_shape: photographs keep their proportions.

    Raises:
        FiptError: ``model-unusable`` where weights are missing or do not fit.
    """

    side = longest = 1024
    resolution = 256
    keeps_shape = True
    at_once = 4  # whose features fit the cache

    def __init__(self, path: Path, weights: Weights) -> None:
        used = {name: value for name, value in weights.items() if not name.startswith(_UNUSED)}
        try:
            encoder, decoder = _mobile_sizes(used)
        except (KeyError, IndexError, ValueError) as error:
            raise unusable(path, f"its weights do not fit together ({error})") from None
        self._encoder, self._decoder = TinyVit(encoder), SamDecoder(decoder)
        inner = {
            name.removeprefix(ENCODER): value for name, value in used.items() if name.startswith(ENCODER)
        }
        rest = {name: value for name, value in used.items() if not name.startswith(ENCODER)}
        for module, values in ((self._encoder, inner), (self._decoder, rest)):
            try:
                module.load_state_dict(values)
            except RuntimeError as error:
                lines = [line.strip() for line in str(error).splitlines()]
                raise unusable(
                    path, f"its weights do not fit together ({lines[min(1, len(lines) - 1)]})"
                ) from None
            module.eval().requires_grad_(False)
        self._decoder.compute_in(fast_type())

    def normalized(self, picture: np.ndarray, size: tuple[int, int]) -> torch.Tensor:
        """(1, 3, *size) of a picture (height, width, 3) uint8, sRGB."""
        return normalized(picture, size)

    def encode(self, pixels: torch.Tensor) -> Any:
        """A normalized photograph (1, 3, h, w), neither side longer than `side`, ready for points.

        The rest of the square is not computed: the photograph is filled up to whole places only.
        """
        height, width = pixels.shape[-2:]
        padded = torch.nn.functional.pad(pixels, (0, -width % STRIDE, 0, -height % STRIDE))
        return self._decoder.places(self._encoder(padded), self.side // STRIDE)

    def answer(self, image: Any, points: torch.Tensor, least: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (N, h, w) and confidence (N,) of the masks at points (P, 2) of confidence above `least`.

        Args:
            points: x and y in pixels of the square.
        """
        # The first pixel's middle is at 0.5.
        logits, confidence = self._decoder(image, (points + 0.5) / self.side, lambda sure: sure > least)
        return logits, confidence[confidence > least]


def _mobile_sizes(weights: Weights) -> tuple[TinyVitSizes, DecoderSizes]:
    """Sizes of MobileSAM's networks from the shapes of its weights.

    Raises:
        KeyError, IndexError, ValueError: weights are missing or have other shapes.
    """

    def shape(name: str, axis: int, most: int = _MOST_WIDTH) -> int:
        length = weights[name].shape[axis]
        if not 0 < length <= most:
            raise ValueError(f"{name} has {length} rows or columns")
        return length

    stages = [f"{ENCODER}layers.{index}.blocks." for index in range(4)]
    names = [f"{stages[0]}0.conv1.c.weight", *(f"{stage}0.attn.proj.weight" for stage in stages[1:])]
    one, two, three, four = (shape(name, 1 if index == 0 else 0) for index, name in enumerate(names))
    blocks = [
        len({name[len(stage) :].partition(".")[0] for name in weights if name.startswith(stage)})
        for stage in stages
    ]
    if max(blocks) > 64:
        raise ValueError(f"{max(blocks)} blocks")
    biases = [f"{stage}0.attn.attention_biases" for stage in stages[1:]]
    heads = [shape(name, 0) for name in biases]
    windows = [math.isqrt(shape(name, 1, 32**2)) for name in biases]
    output = shape(f"{ENCODER}neck.0.weight", 0)
    inner = shape("mask_decoder.transformer.layers.0.mlp.lin1.weight", 0, 4 * _MOST_WIDTH)
    decoder = DecoderSizes(width=output, inner=inner)
    for width, parts in ((two, heads[0]), (three, heads[1]), (four, heads[2]), (output, 2 * decoder.heads)):
        if width % parts:
            raise ValueError(f"{width} channels for {parts} heads")
    encoder = TinyVitSizes(
        (one, two, three, four),
        (blocks[0], blocks[1], blocks[2], blocks[3]),
        (heads[0], heads[1], heads[2]),
        (windows[0], windows[1], windows[2]),
        output,
    )
    return encoder, decoder


def open_checkpoint(path: Path) -> MobileSam:
    """The network of a checkpoint.

    Raises:
        FiptError: ``model-unusable``, ``package-optional``.
    """
    weights = read_weights(path)
    if MOBILE in weights:
        return MobileSam(path, weights)
    other = next((name for weight, name in _OTHERS.items() if weight in weights), "another network")
    raise unusable(path, f"it is a checkpoint of {other}, not of MobileSAM")

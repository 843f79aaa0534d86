# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The image encoder of MobileSAM (Zhang et al. 2023), a TinyViT (Wu et al., ECCV 2022, Sec. 3.2 and Table 8).

Four stages at 1/4, 1/8, 1/16 and 1/16 of the picture's resolution: inverted bottlenecks with depthwise
convolutions, then attention within windows. MobileSAM leaves the last halving out and adds the neck of SAM's
encoder. The names of modules are those of the published weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import nn
from torch.nn import functional

_EXPANSION = 4  # of channels, within blocks and their perceptrons


@dataclass(frozen=True)
class TinyVitSizes:
    """Sizes of a TinyViT; the defaults are MobileSAM's, TinyViT-5M.

    Attributes:
        widths: channels of the four stages.
        depths: blocks of the stages.
        heads: of the attention of the last three stages.
        windows: side of their windows.
        output: channels of the result.
    """

    widths: tuple[int, int, int, int] = (64, 128, 160, 320)
    depths: tuple[int, int, int, int] = (2, 2, 6, 2)
    heads: tuple[int, int, int] = (4, 5, 10)
    windows: tuple[int, int, int] = (7, 14, 7)
    output: int = 256


class TinyVit(nn.Module):
    """(N, 3, H, W) pictures to (N, output, H / 16, W / 16); H and W are multiples of 16."""

    def __init__(self, sizes: TinyVitSizes) -> None:
        super().__init__()
        widths = sizes.widths
        self.patch_embed = _Stem(widths[0])
        self.layers = nn.ModuleList()
        for index, (width, depth) in enumerate(zip(widths, sizes.depths, strict=True)):
            following = widths[index + 1] if index < 3 else 0
            blocks: list[nn.Module] = [
                _AttentionBlock(width, sizes.heads[index - 1], sizes.windows[index - 1])
                if index
                else _Bottleneck(width)
                for _ in range(depth)
            ]
            self.layers.append(_Stage(blocks, width, following, stride=1 if index == 2 else 2))
        self.neck = nn.Sequential(
            nn.Conv2d(widths[3], sizes.output, 1, bias=False),
            LayerNorm2d(sizes.output),
            nn.Conv2d(sizes.output, sizes.output, 3, padding=1, bias=False),
            LayerNorm2d(sizes.output),
        )

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """The embedding of normalized pictures."""
        features: torch.Tensor = self.patch_embed(pixels)
        for stage in self.layers:
            features = stage(features)
        embedding: torch.Tensor = self.neck(features)
        return embedding


class LayerNorm2d(nn.Module):
    """Normalization over the channels of (N, C, H, W)."""

    def __init__(self, width: int, epsilon: float = 1e-6) -> None:
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))
        self._epsilon = epsilon

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Normalized features of the same shape."""
        last = features.permute(0, 2, 3, 1)
        normal = functional.layer_norm(last, last.shape[-1:], self.weight, self.bias, self._epsilon)
        return normal.permute(0, 3, 1, 2)


class _Convolution(nn.Module):
    """A convolution with batch normalization."""

    def __init__(self, inner: int, outer: int, side: int = 1, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.c = nn.Conv2d(inner, outer, side, stride, side // 2, groups=groups, bias=False)
        self.bn = nn.BatchNorm2d(outer)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        normalized: torch.Tensor = self.bn(self.c(features))
        return normalized


class _Stem(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        half = width // 2
        self.seq = nn.Sequential(
            _Convolution(3, half, 3, stride=2), nn.GELU(), _Convolution(half, width, 3, stride=2)
        )

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        features: torch.Tensor = self.seq(pixels)
        return features


class _Stage(nn.Module):
    def __init__(self, blocks: list[nn.Module], width: int, following: int, stride: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks)
        self.downsample = _Merging(width, following, stride) if following else None

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        for block in self.blocks:
            features = block(features)
        return features if self.downsample is None else self.downsample(features)


class _Bottleneck(nn.Module):
    """An inverted bottleneck with a depthwise convolution and a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        inner = _EXPANSION * width
        self.conv1 = _Convolution(width, inner)
        self.conv2 = _Convolution(inner, inner, 3, groups=inner)
        self.conv3 = _Convolution(inner, width)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        inner = functional.gelu(self.conv2(functional.gelu(self.conv1(features))))
        return functional.gelu(features + self.conv3(inner))


class _Merging(nn.Module):
    """To the channels, and half of the resolution, of the next stage."""

    def __init__(self, width: int, following: int, stride: int) -> None:
        super().__init__()
        self.conv1 = _Convolution(width, following)
        self.conv2 = _Convolution(following, following, 3, stride, groups=following)
        self.conv3 = _Convolution(following, following)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        merged: torch.Tensor = self.conv3(functional.gelu(self.conv2(functional.gelu(self.conv1(features)))))
        return merged


class _AttentionBlock(nn.Module):
    """Attention within windows, a depthwise convolution, and a perceptron for each place."""

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__()
        self.attn = _WindowAttention(width, heads, window)
        self.local_conv = _Convolution(width, width, 3, groups=width)
        self.mlp = _Perceptron(width)
        self._window = window

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        features = features + self.attended(features)
        features = self.local_conv(features)
        places = features.permute(0, 2, 3, 1)
        return (places + self.mlp(places)).permute(0, 3, 1, 2)

    def attended(self, features: torch.Tensor) -> torch.Tensor:
        count, width, height, length = features.shape
        side = self._window
        # Windows past the edge are filled up with zeros, which take part, as in training.
        padded = functional.pad(features, (0, -length % side, 0, -height % side))
        rows, columns = padded.shape[2] // side, padded.shape[3] // side
        windows = padded.reshape(count, width, rows, side, columns, side).permute(0, 2, 4, 3, 5, 1)
        attended = self.attn(windows.reshape(-1, side * side, width))
        attended = attended.reshape(count, rows, columns, side, side, width).permute(0, 5, 1, 3, 2, 4)
        return attended.reshape(count, width, rows * side, columns * side)[..., :height, :length]


class _WindowAttention(nn.Module):
    """Attention among the places of a window, with a bias for each distance along its two axes."""

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__()
        self.norm, self.qkv = nn.LayerNorm(width), nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)
        self._heads = heads
        places = list(product(range(window), range(window)))
        numbers: dict[tuple[int, int], int] = {}
        # In the order in which pairs of places show them first, as the weights have them.
        pairs = [
            numbers.setdefault((abs(one[0] - other[0]), abs(one[1] - other[1])), len(numbers))
            for one, other in product(places, places)
        ]
        self.attention_biases = nn.Parameter(torch.zeros(heads, len(numbers)))
        self._distance: torch.Tensor
        number = torch.tensor(pairs).reshape(len(places), len(places))
        self.register_buffer("_distance", number, persistent=False)

    def forward(self, windows: torch.Tensor) -> torch.Tensor:
        """(B, places, width) of windows of the same shape."""
        count, places, width = windows.shape
        mixed = self.qkv(self.norm(windows)).reshape(count, places, self._heads, -1).transpose(1, 2)
        query, key, value = mixed.chunk(3, dim=-1)
        bias = self.attention_biases[:, self._distance]
        attended = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        projected: torch.Tensor = self.proj(attended.transpose(1, 2).reshape(count, places, width))
        return projected


class _Perceptron(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.fc1, self.fc2 = nn.Linear(width, _EXPANSION * width), nn.Linear(_EXPANSION * width, width)

    def forward(self, places: torch.Tensor) -> torch.Tensor:
        result: torch.Tensor = self.fc2(functional.gelu(self.fc1(self.norm(places))))
        return result

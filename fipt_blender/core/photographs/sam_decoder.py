# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The prompt encoder and mask decoder of SAM (Kirillov et al. 2023, Appendix A), for single points.

The names of modules are those of the published weights. An image has thousands of places and a prompt seven
tokens; keys, queries and values of places are therefore never projected, the tokens' are, by the transposed
matrices (a third of the arithmetic, the same result). What all points share is computed once. On processors
that multiply bfloat16, all but the encoding of positions is done in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

from .tiny_vit import LayerNorm2d

MASKS = 3  # for each point: a part of a thing, the thing, and what it belongs to


def fast_type() -> torch.dtype:
    """The type of numbers in which this processor multiplies fastest: three times as fast as in float32."""
    return torch.bfloat16 if torch.cpu.get_capabilities().get("avx512_bf16") else torch.float32


@dataclass(frozen=True)
class DecoderSizes:
    """Sizes of the decoder; the defaults are those of all published models.

    Attributes:
        width: channels of image and tokens.
        heads: of all attention.
        inner: channels of the perceptrons of tokens.
    """

    width: int = 256
    heads: int = 8
    inner: int = 2048


@dataclass(frozen=True, eq=False)
class ImagePlaces:
    """An encoded image as the decoder takes it.

    Attributes:
        features: (h * w, width) embedding of each place, row by row, in the decoder's type.
        positions: (h * w, width) encoded position of each, likewise.
        shape: h and w.
    """

    features: torch.Tensor
    positions: torch.Tensor
    shape: tuple[int, int]


class SamDecoder(nn.Module):
    """What answers points with masks.

    Args:
        sizes: of the decoder.
    """

    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__()
        self.prompt_encoder = _Prompts(sizes.width)
        self.mask_decoder = _Decoder(sizes)

    def compute_in(self, dtype: torch.dtype) -> None:
        """Answer in another type of numbers."""
        self.mask_decoder.to(dtype)

    def places(self, embedding: torch.Tensor, side: int) -> ImagePlaces:
        """The encoder's result (1, width, h, w) with positions in a square of `side` places."""
        height, width = embedding.shape[-2:]
        y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        at = torch.stack([x.flatten(), y.flatten()], dim=1).to(embedding) / side
        features = embedding[0].flatten(1).T + self.prompt_encoder.no_mask_embed.weight
        positions, dtype = self.prompt_encoder.pe_layer(at), self.mask_decoder.dtype
        return ImagePlaces(features.contiguous().to(dtype), positions.to(dtype), (height, width))

    def forward(
        self, image: ImagePlaces, points: torch.Tensor, wanted: Callable[[torch.Tensor], torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The masks that points (P, 2) stand for.

        Args:
            image: the encoded image.
            points: x and y in the image's square of side 1.
            wanted: takes the confidence (P, MASKS) and returns which masks are wanted, (P, MASKS) bool;
                others are not computed.

        Returns:
            Logits (N, 4 h, 4 w) of the wanted masks, and the confidence (P, MASKS) of all, float32.
        """
        tokens = self.mask_decoder.tokens(self.prompt_encoder(points).to(image.features.dtype))
        answers, features = self.mask_decoder.transformer(image, tokens)
        confidence = self.mask_decoder.iou_prediction_head(answers[:, 0])[:, 1:].float()
        keep = wanted(confidence)
        return self.mask_decoder.masks(answers, features, image.shape, keep).float(), confidence


class _Positions(nn.Module):
    """Random Fourier features of places in a square of side 1."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.positional_encoding_gaussian_matrix: torch.Tensor
        self.register_buffer("positional_encoding_gaussian_matrix", torch.zeros(2, width // 2))

    def forward(self, places: torch.Tensor) -> torch.Tensor:
        waves = 2.0 * math.pi * ((2.0 * places - 1.0) @ self.positional_encoding_gaussian_matrix)
        return torch.cat([waves.sin(), waves.cos()], dim=-1)


class _Prompts(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.pe_layer = _Positions(width)
        # Points outside and inside a mask, corners of boxes.
        self.point_embeddings = nn.ModuleList([nn.Embedding(1, width) for _ in range(4)])
        self.not_a_point_embed, self.no_mask_embed = nn.Embedding(1, width), nn.Embedding(1, width)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """(P, 2, width) tokens of points inside, each followed by a token that stands for no point."""
        inside = self.pe_layer(points) + self.point_embeddings[1].weight
        return torch.stack([inside, self.not_a_point_embed.weight.expand_as(inside)], dim=1)


class _Decoder(nn.Module):
    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__()
        width = sizes.width
        self.iou_token, self.mask_tokens = nn.Embedding(1, width), nn.Embedding(MASKS + 1, width)
        self.transformer = _Transformer(sizes)
        self.output_upscaling = nn.Sequential(
            nn.ConvTranspose2d(width, width // 4, 2, 2),
            LayerNorm2d(width // 4),
            nn.GELU(),
            nn.ConvTranspose2d(width // 4, width // 8, 2, 2),
            nn.GELU(),
        )
        self.output_hypernetworks_mlps = nn.ModuleList(
            [_Perceptron([width, width, width, width // 8]) for _ in range(MASKS + 1)]
        )
        self.iou_prediction_head = _Perceptron([width, width, width, MASKS + 1])

    @property
    def dtype(self) -> torch.dtype:
        """The type of its numbers."""
        return self.iou_token.weight.dtype

    def tokens(self, prompts: torch.Tensor) -> torch.Tensor:
        own = torch.cat([self.iou_token.weight, self.mask_tokens.weight])
        return torch.cat([own.expand(len(prompts), -1, -1), prompts], dim=1)

    def masks(
        self, answers: torch.Tensor, features: torch.Tensor, shape: tuple[int, int], keep: torch.Tensor
    ) -> torch.Tensor:
        """Logits (N, 4 h, 4 w) of the masks to keep (P, MASKS), of features (P, h * w, width)."""
        used = keep.any(dim=1)
        fine = self._upscaled(features[used])
        weights = [
            net(answers[used, 2 + index]) for index, net in enumerate(self.output_hypernetworks_mlps[1:])
        ]
        logits = fine @ torch.stack(weights, dim=2)
        # Places in blocks of blocks of 2 x 2, as `_upscaled` leaves them.
        blocks = logits.reshape(len(logits), *shape, 2, 2, 2, 2, MASKS).permute(0, 7, 1, 3, 5, 2, 4, 6)
        return blocks[keep[used]].reshape(-1, 4 * shape[0], 4 * shape[1])

    def _upscaled(self, features: torch.Tensor) -> torch.Tensor:
        """(P, 16 N, width / 8) of (P, N, width): transposed convolutions whose pieces do not overlap."""
        first, norm, _, second, _ = self.output_upscaling
        for layer in (first, second):
            matrix = layer.weight.permute(0, 2, 3, 1).flatten(1)
            split = (features @ matrix).unflatten(2, (4, layer.out_channels)) + layer.bias
            features = split.flatten(1, 2)
            if layer is first:
                width = features.shape[-1:]
                features = functional.layer_norm(features, width, norm.weight, norm.bias, 1e-6)
            features = functional.gelu(features)
        return features


class _Perceptron(nn.Module):
    def __init__(self, widths: list[int]) -> None:
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(one, other) for one, other in pairwise(widths)])

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        for layer in self.layers[:-1]:
            values = functional.relu(layer(values))
        result: torch.Tensor = self.layers[-1](values)
        return result


class _Transformer(nn.Module):
    """Tokens attend to each other and to the image, the image to the tokens, twice."""

    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__()
        self.layers = nn.ModuleList([_Layer(sizes) for _ in range(2)])
        self.final_attn_token_to_image = _CrossAttention(sizes)
        self.norm_final_attn = nn.LayerNorm(sizes.width)

    def forward(self, image: ImagePlaces, tokens: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Answers (P, 7, width) to tokens of the same shape, and features (P, h * w, width)."""
        values, features = tokens, image.features[None]
        for index, layer in enumerate(self.layers):
            values, features = layer(values, features, tokens, image.positions, first=index == 0)
        attended = self.final_attn_token_to_image.to_image(
            values + tokens, features + image.positions, features
        )
        return self.norm_final_attn(values + attended), features


class _Layer(nn.Module):
    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__()
        width = sizes.width
        self.self_attn = _SelfAttention(sizes)
        self.cross_attn_token_to_image = _CrossAttention(sizes)
        self.cross_attn_image_to_token = _CrossAttention(sizes)
        self.mlp = nn.ModuleDict(
            {"lin1": nn.Linear(width, sizes.inner), "lin2": nn.Linear(sizes.inner, width)}
        )
        self.norm1, self.norm2, self.norm3, self.norm4 = (nn.LayerNorm(width) for _ in range(4))

    def forward(
        self,
        values: torch.Tensor,
        features: torch.Tensor,
        tokens: torch.Tensor,
        positions: torch.Tensor,
        first: bool,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Values of tokens (P, 7, width), and features (P, N, width), or of all points (1, N, width)."""
        if first:  # the tokens are their own encoding
            values = self.norm1(self.self_attn(values, values))
        else:
            values = self.norm1(values + self.self_attn(values + tokens, values))
        located = features + positions
        values = self.norm2(
            values + self.cross_attn_token_to_image.to_image(values + tokens, located, features)
        )
        values = self.norm3(values + self.mlp["lin2"](functional.relu(self.mlp["lin1"](values))))
        change = self.cross_attn_image_to_token.from_image(located, values + tokens, values)
        return values, self.norm4(features + change)


class _Attention(nn.Module):
    def __init__(self, sizes: DecoderSizes, width: int) -> None:
        super().__init__()
        self.q_proj, self.k_proj, self.v_proj = (nn.Linear(sizes.width, width) for _ in range(3))
        self.out_proj = nn.Linear(width, sizes.width)
        self._heads, self._scale = sizes.heads, 1.0 / math.sqrt(width / sizes.heads)

    def _split(self, values: torch.Tensor) -> torch.Tensor:
        """(P, T, width) to (P, heads, T, width of a head)."""
        return values.unflatten(-1, (self._heads, -1)).transpose(1, 2)

    def _matrix(self, layer: nn.Linear) -> torch.Tensor:
        """(heads, width of a head, width) of a projection to heads."""
        return layer.weight.unflatten(0, (self._heads, -1))


class _SelfAttention(_Attention):
    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__(sizes, sizes.width)

    def forward(self, tokens: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        query, key, value = self.q_proj(tokens), self.k_proj(tokens), self.v_proj(values)
        attended = functional.scaled_dot_product_attention(
            self._split(query), self._split(key), self._split(value)
        )
        result: torch.Tensor = self.out_proj(attended.transpose(1, 2).flatten(2))
        return result


class _CrossAttention(_Attention):
    def __init__(self, sizes: DecoderSizes) -> None:
        super().__init__(sizes, sizes.width // 2)

    def to_image(self, tokens: torch.Tensor, located: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        """What tokens (P, T, width) find in an image (P or 1, N, width)."""
        count, number = tokens.shape[:2]
        query = self._split(self.q_proj(tokens)) * self._scale @ self._matrix(self.k_proj)
        # The bias of keys adds the same to all places, which the softmax takes out again.
        share = _product(query.flatten(1, 2), located.transpose(1, 2)).softmax(dim=-1)
        found = _product(share, features).reshape(count, self._heads, number, -1)
        value = found @ self._matrix(self.v_proj).transpose(1, 2)
        result: torch.Tensor = self.out_proj(value.transpose(1, 2).flatten(2) + self.v_proj.bias)
        return result

    def from_image(self, located: torch.Tensor, tokens: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """(P, N, width), what places (P or 1, N, width) find in tokens (P, T, width)."""
        number = tokens.shape[1]
        key = self._split(self.k_proj(tokens)) * self._scale
        query = key @ self._matrix(self.q_proj)
        bias = key @ self.q_proj.bias.unflatten(0, (self._heads, -1))[..., None]
        # Places last, so that the softmax over the tokens runs along them.
        sums = _product(query.flatten(1, 2), located.transpose(1, 2)) + bias.flatten(1, 2)
        share = sums.unflatten(1, (self._heads, number)).softmax(dim=2).flatten(1, 2)
        out = self.out_proj.weight.unflatten(1, (self._heads, -1)).permute(1, 2, 0)
        value = (self._split(self.v_proj(values)) @ out).flatten(1, 2)
        return torch.baddbmm(self.out_proj.bias, share.transpose(1, 2), value)


def _product(rows: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    """(P, R, C) products of (P, R, K) and (P or 1, K, C); one table is multiplied once for all."""
    if len(table) == 1 and len(rows) > 1:
        return (rows.flatten(0, 1) @ table[0]).unflatten(0, rows.shape[:2])
    return rows @ table

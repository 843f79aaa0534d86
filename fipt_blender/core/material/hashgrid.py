"""Multi-resolution hash grid (Mueller et al. 2022) as one Dr.Jit kernel, differentiable in torch.

On a CPU, forward and backward with 16 levels and 8,192 points take 35 to 45 ms, compared with 135 ms for
torch's embedding_bag. Gradients are summed in fixed point: sums of integers do not depend on the order of
threads, so the same seed gives the same network bit for bit.

A point also has a unit, a surface of its own. In the levels that share entries by a hash, the unit is part of
it, so that surfaces which touch each other share no fine detail.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch

_PRIMES = (1, 2654435761, 805459861)
_UNIT_PRIME = 3674653429  # by which a unit's number enters the hash
# Of each level: cells along an axis, entries, and the first of these in the table.
Levels = tuple[tuple[int, int, int], ...]
# Positions stay below 1.0, which lies outside the last cell.
_INSIDE = 1.0 - 1e-6


class HashGrid(torch.nn.Module):
    """Features of positions in the unit cube, on surfaces that are numbered.

    Args:
        levels: number of levels.
        features: number of values per grid point and level.
        log2_size: log2 of the largest number of entries of a level; finer levels share entries by a hash.
        base_resolution: cells along an axis at the coarsest level; each level has `growth` times as many.
        generator: of the initial values, uniform in +-1e-4.
    """

    def __init__(
        self,
        levels: int,
        features: int,
        log2_size: int,
        base_resolution: int,
        growth: float,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        super().__init__()
        self.features = features
        self.resolutions = [int(np.floor(base_resolution * growth**level)) for level in range(levels)]
        sizes = [min((r + 1) ** 3, 2**log2_size) for r in self.resolutions]
        offsets = np.concatenate([[0], np.cumsum(sizes)]).tolist()
        self.levels = tuple(zip(self.resolutions, sizes, offsets[:-1], strict=True))
        table = torch.rand((offsets[-1], features), generator=generator) * 2e-4 - 1e-4
        self.table = torch.nn.Parameter(table.to(device))

    @property
    def width(self) -> int:
        """Number of features of one position."""
        return len(self.resolutions) * self.features

    def forward(self, positions: torch.Tensor, units: torch.Tensor) -> torch.Tensor:
        """(N, width) float32 features of (N, 3) positions in [0, 1] on units (N,) int."""
        return _Encode.apply(self.table, positions, units, self)


def _corners(
    levels: Levels, positions: mi.Point3f, units: mi.UInt32
) -> Iterator[list[tuple[mi.UInt32, mi.Float]]]:
    """Yield for each level the eight (entry, weight) pairs that surround each position on a unit."""
    p = dr.clip(positions, 0.0, _INSIDE)
    unit = units * _UNIT_PRIME
    unit ^= unit >> 15  # the table's size masks the high bits
    for resolution, size, offset in levels:
        scaled = p * resolution
        cell = mi.Point3u(dr.floor(scaled))
        fraction = scaled - mi.Point3f(cell)
        dense = (resolution + 1) ** 3 <= size
        strides = (1, resolution + 1, (resolution + 1) ** 2) if dense else _PRIMES
        ends = [(cell[i] * strides[i], (cell[i] + 1) * strides[i]) for i in range(3)]
        shares = [(1.0 - fraction[i], fraction[i]) for i in range(3)]
        pairs = []
        for corner in range(8):
            x, y, z = corner & 1, (corner >> 1) & 1, corner >> 2
            a, b, c = ends[0][x], ends[1][y], ends[2][z]
            entry = a + b + c if dense else (a ^ b ^ c ^ unit) & (size - 1)
            pairs.append((entry + offset, shares[0][x] * shares[1][y] * shares[2][z]))
        yield pairs


# Frozen: recording these kernels anew in each step would take longer than they do.
@dr.freeze
def _features(
    levels: Levels, count: int, table: mi.Float, positions: mi.Point3f, units: mi.UInt32
) -> list[mi.Float]:
    """The features of each level, `count` each, interpolated at positions on units."""
    columns = []
    for pairs in _corners(levels, positions, units):
        sums = [mi.Float(0.0) for _ in range(count)]
        for entry, weight in pairs:
            for f in range(count):
                sums[f] = dr.fma(weight, dr.gather(mi.Float, table, entry * count + f), sums[f])
        columns += sums
    return columns


@dr.freeze
def _table_gradient(
    levels: Levels, gradients: list[mi.Float], positions: mi.Point3f, units: mi.UInt32, unit: mi.Float
) -> mi.Float:
    """Gradient of the table by gradients of the features, which are in multiples of `unit`."""
    _, size, offset = levels[-1]
    count = len(gradients) // len(levels)
    target = dr.zeros(mi.Int32, (offset + size) * count)
    for level, pairs in enumerate(_corners(levels, positions, units)):
        for entry, weight in pairs:
            for f in range(count):
                amount = mi.Int32(dr.round(gradients[level * count + f] * weight))
                dr.scatter_reduce(
                    dr.ReduceOp.Add, target, amount, entry * count + f, mode=dr.ReduceMode.Direct
                )
    return mi.Float(target) * unit


def _points(positions: torch.Tensor) -> mi.Point3f:
    columns = positions.detach().T.contiguous()
    return mi.Point3f(*[mi.Float(columns[i]) for i in range(3)])


def _numbers(units: torch.Tensor) -> mi.UInt32:
    return mi.UInt32(mi.Int32(units.to(torch.int32)))


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, table: torch.Tensor, positions: torch.Tensor, units: torch.Tensor, grid: HashGrid
    ) -> torch.Tensor:
        ctx.grid = grid
        ctx.save_for_backward(positions, units)
        values = mi.Float(table.detach().reshape(-1))
        columns = _features(grid.levels, grid.features, values, _points(positions), _numbers(units))
        # A transposed view: written column by column, the features of one position would be far apart.
        return torch.stack([column.torch() for column in columns]).T.to(table.device)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None, None]:
        grid: HashGrid = ctx.grid
        positions, units = ctx.saved_tensors
        gradient = gradients[0].detach()
        # Scaled so that the sum can't overflow 31 bits, even with all points in one cell.
        largest = float(max(gradient.max(), -gradient.min()))
        if not largest > 0.0 or not np.isfinite(largest):
            return torch.zeros_like(grid.table), None, None, None
        scale = 2.0 ** np.floor(np.log2(2.0**30 / (largest * len(positions))))
        columns = [mi.Float(column) for column in (gradient * scale).T.contiguous()]
        unit = dr.opaque(mi.Float, 1.0 / scale)
        summed = _table_gradient(grid.levels, columns, _points(positions), _numbers(units), unit)
        return summed.torch().reshape(-1, grid.features).to(gradient.device), None, None, None

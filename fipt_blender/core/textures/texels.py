"""Texels as points of the surface, and the estimate there."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

import numpy as np

QUERY_POINTS = 1 << 18  # points per query


class FieldSource(Protocol):
    """What baking needs of an estimate; `core.material.fields.RoomFields` implements it."""

    def query(
        self, positions: np.ndarray, triangles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
    def confidence(self, positions: np.ndarray, triangles: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Texels:
    """Surface points of texels and the estimate there, N of them; float32 unless said otherwise.

    Attributes:
        position: (N, 3) world metres.
        triangle: (N,) int32.
        base_color: (N, 3) of the estimate.
        roughness, metallic: (N,).
        confidence: (N, 3) of the three above, 0 where no photograph saw the point.
        size: (N,) width of a texel, metres.
    """

    position: np.ndarray
    triangle: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    confidence: np.ndarray
    size: np.ndarray

    def __len__(self) -> int:
        return len(self.triangle)

    @classmethod
    def create(cls, count: int, folder: Path | None = None) -> Texels:
        """Room for `count` texels, in files of a folder that are mapped to memory, or in memory."""
        from ..pixels.store import open_array  # needs Mitsuba's variant

        arrays = {}
        for item in fields(cls):
            shape = (count, 3) if item.name in ("position", "base_color", "confidence") else (count,)
            kind = np.int32 if item.name == "triangle" else np.float32
            arrays[item.name] = (
                np.zeros(shape, kind)
                if folder is None
                else open_array(folder / f"{item.name}.npy", shape, kind, create=True)
            )
        return cls(**arrays)

    def rows(self, rows: slice) -> Texels:
        """Some of the texels, on the same memory."""
        return Texels(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


def sample_fields(source: FieldSource, texels: Texels) -> None:
    """Query the estimate at the positions of texels, in chunks; values are clipped to [0, 1]."""
    for first in range(0, len(texels), QUERY_POINTS):
        some = texels.rows(slice(first, first + QUERY_POINTS))
        base_color, roughness, metallic = source.query(some.position, some.triangle)
        some.base_color[:] = np.clip(base_color, 0.0, 1.0)
        some.roughness[:] = np.clip(np.reshape(roughness, -1), 0.0, 1.0)
        some.metallic[:] = np.clip(np.reshape(metallic, -1), 0.0, 1.0)
        some.confidence[:] = source.confidence(some.position, some.triangle)

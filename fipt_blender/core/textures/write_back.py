# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How Cycles' Principled BSDF differs from the paper's BRDF, and a correction for every viewing angle.

Under uniform white light, seen at cosine n.v, with base colour a, roughness sigma and metallic m, the albedo
is

    paper:      a (1-m) + (0.04 (1-m) + a m) s0 + s1
    Principled: a (1-m) t + (1-m) e + m (a f0 + f1)

with functions s0, s1, t, e, f0, f1 of n.v and sigma. Principled has another G, with more gloss at grazing
angles, and its gloss dims its diffuse lobe (t < 1). If Principled is scaled by the factor r that makes the
gloss agree, and a diffuse lobe of colour a (1-m) (1 - r t) is added, both albedos are equal. All factors are
between 0 and 1, so that textures can hold the fitted values and shader nodes the correction
(blend/results/write_back_nodes.py). The functions are tabulated by benchmarks/fit_write_back.py.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ..optics.factorised import DIELECTRIC_REFLECTANCE

TABLE = Path(__file__).with_name("write_back.json")
FUNCTIONS = ("s0", "s1", "t", "f0", "f1", "e")
MASKINGS = ("schlick", "smith")  # G of the fitted model, on which s0 and s1 depend


@dataclass(frozen=True)
class Table:
    """The functions on a regular grid: n.v along columns and sigma along rows, both from 0 to 1 inclusive.

    Attributes:
        values: (rows, columns, 6), in the order of FUNCTIONS.
    """

    values: np.ndarray

    def at(self, cosine: np.ndarray, roughness: np.ndarray) -> dict[str, np.ndarray]:
        """The functions, each (N,), at points (N,); bilinear interpolation."""
        rows, columns, _ = self.values.shape
        x, across = _cell(cosine, columns)
        y, up = _cell(roughness, rows)
        near = self.values[y, x] * (1.0 - across) + self.values[y, x + 1] * across
        far = self.values[y + 1, x] * (1.0 - across) + self.values[y + 1, x + 1] * across
        return dict(zip(FUNCTIONS, (near * (1.0 - up) + far * up).T, strict=True))


def _cell(value: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    position = np.clip(np.asarray(value, np.float64), 0.0, 1.0) * (count - 1)
    first = np.minimum(position.astype(np.int64), count - 2)
    return first, (position - first)[..., None]


@cache
def table(masking: str = MASKINGS[0]) -> Table:
    """The tabulated functions for a model with this G; one of `MASKINGS`."""
    data = json.loads(TABLE.read_text(encoding="utf-8"))
    functions = {**data["principled"], **data[masking]}
    return Table(np.stack([np.array(functions[name], np.float64) for name in FUNCTIONS], axis=-1))


def correction(
    base_color: np.ndarray,
    roughness: np.ndarray,
    metallic: np.ndarray,
    cosine: np.ndarray,
    masking: str = MASKINGS[0],
) -> tuple[np.ndarray, np.ndarray]:
    """The correction of Principled towards the paper's BRDF; `write_back_nodes` builds it of nodes.

    Args:
        base_color: (N,3). roughness, metallic, cosine: (N,).

    Returns:
        (N,) factor by which Principled is scaled, and (N,3) colour of the diffuse lobe to add.
    """
    f, m = table(masking).at(cosine, roughness), np.asarray(metallic, np.float64)
    mean = np.asarray(base_color, np.float64).mean(axis=1)
    wanted = (DIELECTRIC_REFLECTANCE + m * (mean - DIELECTRIC_REFLECTANCE)) * f["s0"] + f["s1"]
    there = f["e"] + m * (mean * f["f0"] + f["f1"] - f["e"])
    # A black metal seen head-on reflects nothing in either model.
    share = np.minimum(np.divide(wanted, there, out=np.zeros_like(there), where=there > 0.0), 1.0)
    return share, base_color * ((1.0 - m) * (1.0 - share * f["t"]))[:, None]

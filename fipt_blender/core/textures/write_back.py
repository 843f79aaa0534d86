"""How Cycles' Principled BSDF differs from the paper's BRDF, and a correction for every viewing angle.

Under uniform white light, seen at cosine n.v, with base colour a, roughness sigma and metallic m, the albedo
is

    paper:      a (1-m) + (0.04 (1-m) + a m) s0 + s1
    Principled: a (1-m) t + (1-m) e + m (a f0 + f1)

with functions s0, s1, t, e, f0, f1 of n.v and sigma. Principled has another G, with more gloss at grazing
angles, and its gloss dims its diffuse lobe (t < 1). If Principled is scaled by the factor r that makes the
gloss agree, and a diffuse lobe of colour a (1-m) (1 - r t) is added, both albedos are equal. r is the gloss
of the paper over that of Principled, for the mean of the channels of a, and at most 1; it is 0 for a black
metal seen head-on, which has none. All factors are between 0 and 1, so that textures can hold the fitted
values and shader nodes the correction (blend/results/write_back_nodes.py). The functions are tabulated by
benchmarks/fit_write_back.py.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

TABLE = Path(__file__).with_name("write_back.json")
FUNCTIONS = ("s0", "s1", "t", "f0", "f1", "e")
MASKINGS = ("schlick", "smith")  # G of the fitted model, on which s0 and s1 depend


@cache
def table(masking: str = MASKINGS[0]) -> np.ndarray:
    """(rows, columns, 6) float64 the functions, in the order of FUNCTIONS, for a model with this G.

    On a regular grid: n.v along columns and sigma along rows, both from 0 to 1 inclusive.

    Args:
        masking: one of `MASKINGS`.
    """
    data = json.loads(TABLE.read_text(encoding="utf-8"))
    functions = {**data["principled"], **data[masking]}
    return np.stack([np.array(functions[name], np.float64) for name in FUNCTIONS], axis=-1)

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Base colours with which Cycles' Principled BSDF reflects as much as the paper's BRDF does.

Both models' albedo, averaged over all directions of view (cosine-weighted), is linear in the base colour a:

    paper:  a (1-m) + (0.04 (1-m) + a m) s0(sigma) + s1(sigma)
    Cycles: (1-m) (d(sigma) + a t(sigma)) + m (a f0(sigma) + f1(sigma))

so that the Cycles base colour follows in closed form; roughness and metallic stay. The six functions are
tabulated by benchmarks/fit_write_back.py from white-furnace renders (Cycles) and quadrature (paper).
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

TABLE = Path(__file__).with_name("write_back.json")


@cache
def table() -> dict[str, np.ndarray]:
    """roughness (K,) and the functions at it: paper_s0, paper_s1, cycles_d, _t, _f0, _f1."""
    data = json.loads(TABLE.read_text(encoding="utf-8"))
    return {name: np.array(values, np.float64) for name, values in data.items()}


def _at(name: str, roughness: np.ndarray) -> np.ndarray:
    return np.interp(roughness, table()["roughness"], table()[name])[:, None]


def paper_albedo(base_color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """Directionally averaged albedo (N,3) of the paper's BRDF (Eq. 1)."""
    m = np.asarray(metallic, np.float64)[:, None]
    specular = 0.04 * (1.0 - m) + base_color * m
    return base_color * (1.0 - m) + specular * _at("paper_s0", roughness) + _at("paper_s1", roughness)


def cycles_albedo(base_color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """Directionally averaged albedo (N,3) of Cycles' Principled BSDF (GGX, IOR 1.5)."""
    m = np.asarray(metallic, np.float64)[:, None]
    dielectric = _at("cycles_d", roughness) + base_color * _at("cycles_t", roughness)
    metal = base_color * _at("cycles_f0", roughness) + _at("cycles_f1", roughness)
    return (1.0 - m) * dielectric + m * metal


def cycles_base_color(base_color: np.ndarray, roughness: np.ndarray, metallic: np.ndarray) -> np.ndarray:
    """Base colour for Principled that gives the albedo of the paper's BRDF, clipped to [0, 1].

    Args:
        base_color: (N,3) a of the paper.
        roughness: (N,) sigma.
        metallic: (N,) m.

    Returns:
        (N,3) f64.
    """
    m = np.asarray(metallic, np.float64)[:, None]
    constant = cycles_albedo(np.zeros_like(base_color), roughness, metallic)
    slope = (1.0 - m) * _at("cycles_t", roughness) + m * _at("cycles_f0", roughness)
    return np.clip((paper_albedo(base_color, roughness, metallic) - constant) / slope, 0.0, 1.0)

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A room with random materials and lamps: its tables are consistent."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks import other_materials

ROOT = Path(__file__).resolve().parent.parent
NAMES = ("materials.json", "emitters.json", "scene.npz")


def drawn(folder: Path, seed: int) -> tuple[list[dict], list[dict], dict[str, np.ndarray]]:
    """Materials, emitters and triangles of the example room after the random change."""
    folder.mkdir()
    for name in NAMES:
        shutil.copy(ROOT / "examples" / "room" / name, folder)
    other_materials.change(folder, seed)
    with np.load(folder / "scene.npz") as data:
        scene = {name: data[name] for name in data.files}
    materials = json.loads((folder / "materials.json").read_text())["materials"]
    return materials, json.loads((folder / "emitters.json").read_text()), scene


def test_tables_agree_and_follow_the_seed(tmp_path: Path) -> None:
    materials, emitters, scene = drawn(tmp_path / "a", 1)
    before = json.loads((ROOT / "examples/room/materials.json").read_text())["materials"]
    emitting = set(scene["material"][scene["is_emitter"]].tolist())
    for old, new in zip(before, materials, strict=True):
        if new["id"] in emitting:
            assert new == old
            continue
        assert {name for name in new if new[name] != old[name]} <= {"base_color", "roughness", "metallic"}
        assert 0.05 < new["roughness"] <= 1.0 and new["metallic"] in (0.0, 1.0)
        assert 0.0 < min(new["base_color"]) and max(new["base_color"]) <= 0.9
        assert not (new["texture"] and (new["metallic"] or new["base_color"] != old["base_color"]))
    kinds = [(new["roughness"] == 1.0, new["metallic"]) for new in materials if new["id"] not in emitting]
    assert {(True, 0.0), (False, 0.0), (False, 1.0)} <= set(kinds)
    for emitter in emitters:
        first, end = emitter["triangles"]
        assert np.ptp(scene["radiance"][first:end], axis=0) == pytest.approx(0.0)
        assert scene["radiance"][first] == pytest.approx(emitter["radiance"])
    assert drawn(tmp_path / "b", 1)[0] == materials
    assert drawn(tmp_path / "c", 2)[0] != materials

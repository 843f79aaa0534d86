# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets: what is stored comes back, whole, through Blender's own preset files."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from fipt_blender.panels import presets
from fipt_blender.properties import classes_of

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The user's folder of presets."""

    def user_resource(kind: str, *, path: str = "", create: bool = False) -> str:
        place = tmp_path / path
        if create:
            place.mkdir(parents=True, exist_ok=True)
        return str(place)

    monkeypatch.setattr(bpy.utils, "user_resource", user_resource)
    return tmp_path / "presets"


def store(section: str, folder: Path) -> Path:
    operator = getattr(bpy.ops.fipt, f"add_{section}_preset")
    assert operator(name="Mine") == {"FINISHED"}
    return folder / "fipt" / section / "Mine.py"


def recall(path: Path, section: str) -> None:
    menu = f"FIPT_PT_{section}_presets"
    assert bpy.ops.script.execute_preset(filepath=str(path), menu_idname=menu) == {"FINISHED"}


def test_estimate_settings_come_back(folder):
    settings = bpy.context.scene.fipt.estimate
    settings.preset, settings.device = "high", "llvm"
    settings.diffuse_samples, settings.denoise = 77, False
    path = store("estimate", folder)
    settings.preset, settings.device = "draft", "auto"
    settings.reset()
    settings.rounds = 5
    recall(path, "estimate")
    assert (settings.preset, settings.device, settings.diffuse_samples) == ("high", "llvm", 77)
    assert not settings.denoise and not settings.is_changed("rounds")


def test_import_and_check_settings_come_back(folder):
    capture, check = bpy.context.scene.fipt.capture, bpy.context.scene.fipt.check
    capture.up_axis, capture.hold_back, capture.align_mesh = "y", 5, True
    check.samples, check.which = 333, "TICKED"
    paths = {section: store(section, folder) for section in ("import", "check")}
    capture.up_axis, capture.hold_back, capture.align_mesh = "z", 8, False
    check.samples, check.which = 1, "CURRENT"
    for section, path in paths.items():
        recall(path, section)
    assert (capture.up_axis, capture.hold_back, capture.align_mesh) == ("y", 5, True)
    assert (check.samples, check.which) == (333, "TICKED")


def test_each_menu_knows_its_operator():
    for menu in classes_of([presets]):
        section, operator = menu.preset_add_operator.split(".")
        assert getattr(getattr(bpy.ops, section), operator).get_rna_type().identifier

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the section Capture draws."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from fipt_blender.blend.capture.survey import DISAGREEMENT, coverage_colors, level_colors, part_colors
from fipt_blender.core.run.errors import FiptError
from fipt_blender.jobs import running
from fipt_blender.panels import capture, parts, swatches
from fipt_blender.panels import capture as panel
from samples.layouts import Layout, drawn_by

pytestmark = pytest.mark.usefixtures("registered")


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (["images/IMG_1", "images/IMG_2"], "IMG_1"),
        (["train/000", "val/000"], "train/000"),
        (["a/left/1", "a/left/2"], "1"),
        (["000", "001"], "000"),
    ],
)
def test_names_of_views_without_their_common_folder(names, shown):
    settings = bpy.context.scene.fipt.capture
    for name in names:
        settings.views.add().name = name
    settings.count_views()
    assert capture.shown_name(names[0], settings.name_prefix) == shown


@pytest.mark.parametrize("has_run", [False, True])
def test_a_failed_import_is_told_once(monkeypatch, tmp_path, has_run):
    """Before a first import the scene has no run folder; later it has that of the last one that succeeded."""
    scene = bpy.context.scene
    scene.fipt.run_folder = str(tmp_path / "earlier") if has_run else ""
    info = running.RunningJob("Import Capture", "capture", scene.name, tmp_path / "failed")
    running.refuse(info, FiptError("odd", "The file is odd.", "Export it again."))
    drawn: list[str] = []
    told = lambda layout, context, error, run: drawn.append(error["text"])  # noqa: E731
    monkeypatch.setattr(capture, "draw_error", told)
    monkeypatch.setattr("fipt_blender.panels.job.draw_error", told)
    capture.draw_import(None, bpy.context)
    assert drawn == ["The file is odd."]


def test_a_warning_goes_once_its_remedy_was_followed(tmp_path):
    info = running.RunningJob("Import Capture", "capture", bpy.context.scene.name, tmp_path)
    info.warnings += [{"code": "mesh-missing"}, {"code": "images-not-hdr"}]
    running.refuse(info, FiptError("odd", "The file is odd.", "Export it again."))
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert info.warnings == [{"code": "images-not-hdr"}]


@pytest.mark.parametrize(("source", "has_model"), [("auto", True), ("masks", True), ("objects", False)])
def test_a_masks_model_is_asked_for_where_masks_are_used(source, has_model):
    bpy.context.scene.fipt.parts.source = source
    operators, properties = drawn_by(parts.FIPT_PT_parts)
    assert ("fipt.find_masks" in operators) is ("masks_model" in properties) is has_model


def room_texts() -> str:
    """What the panel Room tells."""
    return " ".join(drawn_by(capture.FIPT_PT_capture_room)[0])


def test_a_room_without_mesh_is_told_as_long_as_it_has_none():
    assert "no mesh" not in room_texts(), "before an import nothing is missing"
    bpy.context.scene.fipt.capture.views.add().name = "a"
    assert "The room has no mesh" in room_texts()
    bpy.ops.mesh.primitive_cube_add()
    assert bpy.ops.fipt.set_room() == {"FINISHED"}
    assert "no mesh" not in room_texts()


def test_few_import_settings_are_shown_at_first():
    """The others are in a part that is closed."""
    settings = bpy.context.scene.fipt.capture
    first = drawn_by(capture.FIPT_PT_capture_import)[1]
    every = drawn_by(capture.FIPT_PT_capture_import, is_open=True)[1]
    assert 1 <= len(first) <= 5 and len(every) > len(first)
    assert all(hasattr(settings, name) for name in every)


# Linear RGB as people without one kind of cones see it (Machado, Oliveira, Fernandes 2009, severity 1).
COLOR_BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [[0.1523, 1.0526, -0.2049], [0.1145, 0.7863, 0.0992], [-0.0039, -0.0481, 1.0520]],
    "deuteranopia": [[0.3673, 0.8606, -0.2280], [0.2801, 0.6725, 0.0474], [-0.0118, 0.0429, 0.9689]],
    "tritanopia": [[1.2555, -0.0767, -0.1788], [-0.0784, 0.9308, 0.1476], [0.0047, 0.6914, 0.3039]],
}


def lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB, (N, 3)."""
    xyz_from_rgb = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ xyz_from_rgb.T / xyz_from_rgb.sum(axis=1)
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0).T
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=1)


@pytest.mark.parametrize("blindness", COLOR_BLINDNESS)
def test_everyone_can_tell_the_colors_of_the_coverage_apart(blindness):
    colors = coverage_colors(np.array([0, 1, 2, 3, 5]))
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    seen = lab((linear @ np.array(COLOR_BLINDNESS[blindness]).T).clip(0.0, 1.0))
    distance = np.linalg.norm(seen[:, None] - seen[None], axis=2) + 100.0 * np.eye(5)
    assert distance.min() > 20.0
    assert (np.diff(seen[1:, 0]) > 15.0).all()  # more views are lighter


def test_the_legend_has_a_swatch_of_each_color(monkeypatch):
    monkeypatch.setattr(swatches, "icon", lambda color: color)
    layout = Layout()
    panel.draw_legend(layout, "coverage")
    levels = [(options["text"], options["icon_value"]) for options in layout.labels[1:]]
    assert [text for text, _ in levels] == ["0", "1", "2", "3+", "5+"]
    np.testing.assert_array_equal([color for _, color in levels], coverage_colors(np.array([0, 1, 2, 3, 5])))
    pixels = np.reshape(swatches.square_pixels(levels[0][1]), (-1, 4))
    assert (pixels[:, 3] == 1.0).all() and (pixels[:, :3] == levels[0][1]).all(axis=1).mean() > 0.7
    other = Layout()
    panel.draw_legend(other, "disagreement")
    assert [options["text"] for options in other.labels[1:]] == ["?", "0", ".1", ".25", ".5"]
    values = np.array([-1.0, 0.0, 0.2, 0.25, 1.0])
    colors = [options["icon_value"] for options in other.labels[1:]]
    np.testing.assert_array_equal(colors, level_colors(DISAGREEMENT, values))


def test_colours_of_coverage_and_parts():
    colors = coverage_colors(np.array([0, 1, 2, 3, 4, 5, 200]))
    assert len(np.unique(colors, axis=0)) == 5 and (colors[3] == colors[4]).all()
    parts = part_colors(np.arange(-1, 40))
    assert parts.min() >= 0.0 and parts.max() <= 1.0 and (parts[0] == 0.25).all()
    distance = np.linalg.norm(parts[1:, None] - parts[None, 1:], axis=2) + np.eye(40)
    assert distance.min() > 0.02 and np.diagonal(distance, 1).min() > 0.2  # neighbours differ most

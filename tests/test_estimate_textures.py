# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimation, textures and maps of views of captures without lamps and of meshes with openings."""

import argparse
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures import bake
from samples.small_captures import (
    COLORS,
    PANEL,
    PANEL_RADIANCE,
    UNTRAINED,
    few_sources,
    fixtures_of,
    panel_capture,
    photograph,
    run_here,
    warnings_of,
    window_capture,
    write_run,
)
from samples.small_rooms import BOX, table

pytestmark = [pytest.mark.usefixtures("one_thread"), pytest.mark.filterwarnings("error:.*invalid value:RuntimeWarning")]


def bake_here(run: RunFolder) -> list[dict]:
    """The engine command `textures` on a square for each quadrilateral of the room; returns its messages."""
    with np.load(run.room_npz) as room:
        quads = len(room["triangles"]) // 2
    side, corners = 16, np.array([(1, 1), (15, 1), (15, 15), (1, 15)])[[0, 1, 2, 0, 2, 3]].reshape(2, 3, 2)
    uv = np.concatenate([corners + (side * index, 0) for index in range(quads)]) / (side * quads, side)
    np.savez(run.atlas_npz, corner_uv=uv.astype(np.float32), triangle_image=np.zeros(2 * quads, np.int32))
    image = {"name": "Room", "width": side * quads, "height": side}
    write_json(run.atlas_json, {"mode": "uv", "images": [image]})
    stream = io.StringIO()
    bake.run(argparse.Namespace(run=run.root), Reporter(stream))
    return [message for line in stream.getvalue().splitlines() if (message := parse_message(line))]


def assert_textures_and_maps_follow(run: RunFolder, open_mesh: bool) -> None:
    """What the textures and the maps of views show of the estimate."""
    assert bake_here(run)[-1]["type"] == "done"
    views = read_document(run.results / "maps" / "maps.json", dict)["views"]
    (image,) = read_document(run.textures_json, dict)["images"]
    for entry in (image, *views):
        for path in list(entry.values())[1:]:
            assert np.isfinite(read_radiance(run.resolve(path))).all(), path
    maps = [
        {name: read_radiance(run.resolve(path)) for name, path in entry.items() if name != "view"} for entry in views
    ]
    assert len(maps) == 3
    seen = np.stack([of_view["roughness"][..., 0] > 0.0 for of_view in maps])
    emission = np.stack([of_view["emission"].max(axis=2) for of_view in maps])
    assert seen.any() and emission.any() == bool(fixtures_of(run))
    # A pixel that shows both a lamp and a wall has at most three of its four places on the lamp.
    assert (emission[seen] < 0.8 * emission.max() + 1e-6).all()
    assert (seen | (emission > 0.0)).all() != open_mesh
    for of_view, reflecting in zip(maps, seen, strict=True):
        assert not of_view["base_color"][~reflecting].any() and not of_view["confidence"][~reflecting].any()


def test_a_window_becomes_an_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Light from outside through a missing wall; no lamp."""
    few_sources(monkeypatch)
    radiance = [5.0, 4.0, 3.0]
    changes = {**UNTRAINED, "rounds": 0, "unseen_light": True, "environment_width": 32}
    run = write_run(tmp_path / "run", window_capture(radiance), **changes)
    messages = run_here(run, train=False)
    data = read_document(run.emitters_json, dict)
    assert data["fixtures"] == [] and data["environment"]["image"] == "environment.exr"
    assert 0.02 < data["environment"]["observed_share"] < 0.5
    found = read_radiance(run.environment_exr)
    assert found.shape == (16, 32, 3)
    ratio = np.log(found / np.array(radiance))
    seen = np.abs(ratio).max(axis=-1) < 1e-4
    assert seen.mean() > 0.06, "what photographs show is taken as it is"
    # The rest is like it, or follows from the light on the surfaces.
    assert np.abs(ratio).max() < 0.25 and np.sqrt((ratio**2).mean()) < 0.08
    assert warnings_of(messages) == [] and str(run.environment_exr) in messages[-1]["files"]
    assert_textures_and_maps_follow(run, open_mesh=True)


def test_a_room_without_lamp_is_a_warning(tmp_path: Path) -> None:
    """A closed mesh, all surfaces of one radiance: white walls explain it without a lamp."""
    capture = panel_capture()
    grey = replace(capture, images=[np.full_like(image, 0.4) for image in capture.images])
    changes = {**UNTRAINED, "rounds": 0, "force": True}  # photographs without content are refused
    run = write_run(tmp_path / "run", grey, **changes)
    messages = run_here(run, train=False)
    assert warnings_of(messages) == ["no-emitter"] and messages[-1]["type"] == "done"
    assert read_document(run.emitters_json, dict) == {"fixtures": [], "environment": None}
    assert_textures_and_maps_follow(run, open_mesh=False)


def test_a_lamp_in_a_room_whose_mesh_is_open(tmp_path: Path) -> None:
    """No mesh of two walls, behind which it is dark: a scan that has not been completed."""
    quads = [*BOX[:4], PANEL]
    capture = photograph(quads, [*COLORS[:4], [0.0] * 3], table([8, 9], PANEL_RADIANCE), None)
    run = write_run(tmp_path / "run", capture, rounds=0, **UNTRAINED)
    assert run_here(run, train=False)[-1]["type"] == "done"
    assert [fixture["triangles"] for fixture in fixtures_of(run)] == [[8, 9]]
    assert_textures_and_maps_follow(run, open_mesh=True)

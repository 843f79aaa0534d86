"""Maps of views: materials on walls, radiance on emitters, zero outside the room."""

import numpy as np
import pytest

from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.capture.views import View
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures.view_maps import write_view_maps
from samples.small_rooms import mesh_room, write_room

VIEWS = [
    View(f"{split}/{i}", split, None, 24, 12, 12.0, 12.0, 12.0, 6.0, np.eye(4))
    for i, split in enumerate(("train", "train", "train", "held_back"))
]


class Fields:
    """Base colour depends on the height, all else is constant."""

    def query(self, positions, triangles):
        count = len(positions)
        assert count == 12 * 12 * 4 and np.isfinite(positions).all()  # of the wall: rays past it end at infinity
        color = np.repeat(positions[:, 1:2] / 4.0 + 0.5, 3, axis=1).astype(np.float32)
        return color, np.full(count, 0.25, np.float32), np.full(count, 0.75, np.float32)

    def confidence(self, positions, triangles):
        return np.full((len(positions), 3), 0.5, np.float32)


@pytest.fixture
def run(tmp_path) -> RunFolder:
    """A wall on the left half of the image, whose lower right triangle is a lamp facing the camera."""
    run = RunFolder(tmp_path)
    vertices = np.array([[-4, -2, 2], [0, -2, 2], [0, 2, 2], [-4, 2, 2]], np.float32)
    triangles = np.array([[0, 2, 1], [0, 3, 2]], np.int32)  # fronts towards the camera at the origin
    write_room(tmp_path, mesh_room(vertices, triangles, np.zeros(2)))
    fixture = {"name": "a", "triangles": [0], "radiance": [8.0, 4.0, 2.0], "back_radiance": [1.0, 1.0, 1.0]}
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": None})
    return run


def test_held_back_views_come_first_and_their_maps_are_right(run):
    files = write_view_maps(run, Fields(), VIEWS)
    listed = read_document(files[-1], dict)["views"]
    assert [entry.pop("view") for entry in listed] == ["held_back/3", "train/0", "train/1"]
    maps = {name: read_radiance(run.resolve(path)) for name, path in listed[0].items()}
    lit, painted = maps["emission"][..., 0] / 8.0, maps["roughness"][..., 0] / 0.25
    # Pixels across the lamp's edge show both, each by its share.
    assert ((lit > 0.0) & (lit < 1.0)).any()
    np.testing.assert_allclose((lit + painted)[:, :12], 1.0, atol=1e-3)
    assert not lit[:, 12:].any() and not painted[:, 12:].any()
    emitter, wall = lit == 1.0, painted == 1.0
    assert emitter.any() and wall.any()
    assert (maps["emission"][emitter] == [8.0, 4.0, 2.0]).all()
    assert (maps["roughness"][wall] == 0.25).all() and (maps["metallic"][wall] == 0.75).all()
    assert (maps["confidence"][wall] == 0.5).all() and not maps["confidence"][painted == 0.0].any()
    # Rows run downwards, and so does the camera's y axis; z = 2 gives 1/6 of height a pixel.
    rows = np.nonzero(wall)[0]
    np.testing.assert_allclose(maps["base_color"][wall][:, 0], (rows + 0.5 - 6.0) / 24.0 + 0.5, atol=1e-3)
    assert (maps["base_color"][painted == 0.0] == 0.0).all()

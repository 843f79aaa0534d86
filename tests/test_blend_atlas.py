"""The atlas: UVs kept or made, and packed without overlap or waste; the artist's layers stay."""

import bpy
import numpy as np
import pytest

from fipt_blender.blend.room import islands, packing, unwrapping
from fipt_blender.blend.room.mesh_arrays import corner_uvs, vertex_positions
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.result_contents import AtlasImages
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.textures.raster import cover_count
from samples.at_once import export_room, make_atlas
from samples.refusals import error_of


def cube(size=1.0, location=(0, 0, 0), keep_uvs=True):
    bpy.ops.mesh.primitive_cube_add(size=size, location=location)
    item = bpy.context.object
    if not keep_uvs:
        item.data.uv_layers.remove(item.data.uv_layers[0])
    return item


def atlas_of(objects, run_folder, max_images=16, **changes):
    room = export_room(objects, run_folder)
    make_atlas(objects, run_folder, make_settings(changes=changes), max_images)
    images = read_document(run_folder.atlas_json, AtlasImages).images
    with np.load(run_folder.atlas_npz, allow_pickle=False) as data:
        corner_uv, image = data["corner_uv"].astype(np.float64), data["triangle_image"]
    return room, [(each.width, each.height) for each in images], corner_uv, image


def density_of(room, sizes, corner_uv, image):
    """Texels a metre of the whole room."""
    texels = islands.triangle_areas(corner_uv * np.array(sizes)[image][:, None]).sum()
    return np.sqrt(texels / islands.triangle_areas(room.vertices[room.triangles]).sum())


def check_layout(sizes, corner_uv, triangle_image):
    """Within the image, no texel shared by two triangles, the padding kept."""
    assert corner_uv.min() >= 0.0 and corner_uv.max() <= 1.0
    for image, size in enumerate(sizes):
        count = cover_count(corner_uv[triangle_image == image] * size, *size)
        assert (count > 1).sum() <= 1e-3 * (count > 0).sum()
        assert (count > 0).any()
        assert not count[: packing.PAD - 1].any() and not count[:, : packing.PAD - 1].any()


def test_good_uvs_are_kept_and_missing_ones_made(run_folder):
    objects = [cube(), cube(location=(2, 0, 0), keep_uvs=False)]
    room, sizes, corner_uv, image = atlas_of(objects, run_folder, texel_density=100.0)
    count = [len(np.unique(islands.uv_islands(room.triangles, corner_uv)[room.triangle_object == k])) for k in (0, 1)]
    assert count == [1, 6]  # the cross of Blender's cube, and its sides
    check_layout(sizes, corner_uv, image)
    assert density_of(room, sizes, corner_uv, image) == pytest.approx(100.0, rel=0.01)


def test_objects_are_not_changed(run_folder):
    item = cube()
    item.modifiers.new("Subdivision", "SUBSURF").levels = 2
    mesh = item.data
    atlas_of([item], run_folder)
    assert item.data == mesh and len(mesh.uv_layers) == 1 and item.modifiers[0].show_viewport
    assert len(bpy.data.meshes) == 1 and len(bpy.data.scenes) == 1
    assert [key for key in item.keys() if key.startswith("fipt_")] == ["fipt_object_id"]  # of the export


@pytest.mark.parametrize("fault", ["overlap", "collapsed", "not finite"])
def test_bad_uvs_are_replaced(run_folder, fault):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8)
    item = bpy.context.object
    uv = corner_uvs(item.data, item.data.uv_layers[0])
    if fault == "overlap":
        uv[:, 0] = np.abs(uv[:, 0] - 0.5)  # folded in the middle: one island overlaps itself
    elif fault == "collapsed":
        uv[:, 1] = 0.5
    else:
        uv[3] = np.nan
    item.data.uv_layers[0].uv.foreach_set("vector", uv.ravel())
    _, sizes, corner_uv, image = atlas_of([item], run_folder)
    check_layout(sizes, corner_uv, image)


def test_islands_that_overlap_each_other_are_packed_apart(run_folder):
    items = [cube() for _ in range(3)]
    for item in items:  # every face covers the whole image: six islands in one place
        layer = item.data.uv_layers[0].uv
        corners = np.tile([(0, 0), (1, 0), (1, 1), (0, 1)], (6, 1)).astype(np.float32)
        layer.foreach_set("vector", corners.ravel())
    _, sizes, corner_uv, image = atlas_of(items, run_folder)
    check_layout(sizes, corner_uv, image)


def test_too_much_surface_shrinks_instead_of_making_more_images(run_folder):
    objects = [cube(size=4.0, location=(10 * index, 0, 0)) for index in range(6)]
    room, sizes, *layout = atlas_of(objects, run_folder, max_images=4, texture_size=256)
    assert len(sizes) <= 4 and max(max(size) for size in sizes) <= 256
    assert density_of(room, sizes, *layout) < 128.0


def test_noise_does_not_tear_a_scan_apart(run_folder, monkeypatch, rng):
    monkeypatch.setattr(unwrapping, "LEAST_TRIANGLES", 1000)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5)
    item = bpy.context.object
    item.data.uv_layers.remove(item.data.uv_layers[0])
    position = vertex_positions(item.data)
    item.data.vertices.foreach_set("co", (position + rng.normal(0.0, 0.01, position.shape)).ravel())
    room, sizes, corner_uv, image = atlas_of([item], run_folder)
    check_layout(sizes, corner_uv, image)
    found = islands.uv_islands(room.triangles, corner_uv)
    assert found.max() < 60
    assert np.array_equal(corner_uv, np.round(corner_uv * 2.0**16) / 2.0**16)
    texels = np.bincount(found, islands.triangle_areas(corner_uv * np.array(sizes)[image][:, None]))
    areas = np.bincount(found, islands.triangle_areas(room.vertices[room.triangles]))
    assert np.allclose(texels / areas, 128.0**2, rtol=0.05)  # the same density for all


def test_colour_attribute_mode_and_changed_rooms(run_folder):
    item = cube()
    _, sizes, _, image = atlas_of([item], run_folder, atlas_mode="color_attribute")
    assert sizes == [] and (image == -1).all()
    assert read_document(run_folder.atlas_json, dict) == {"mode": "color_attribute", "images": []}
    # The atlas holds the room as it was exported, whatever the artist has made of it.
    item.modifiers.new("Bevel", "BEVEL")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    make_atlas([item], run_folder, make_settings())
    assert len(read_document(run_folder.atlas_json, AtlasImages).images) == 1
    item["fipt_object_id"] = item.name = "another"
    assert error_of(make_atlas, [item], run_folder, make_settings()).code == "room-changed"


def test_scans_are_told_from_modelled_meshes(rng):
    areas = rng.uniform(0.5, 1.5, 30_000)
    assert unwrapping.is_scan(areas)
    assert not unwrapping.is_scan(areas[:5000])
    assert not unwrapping.is_scan(np.append(areas, 100.0 * areas.sum()))  # with a wall of one triangle
    assert not unwrapping.is_scan(np.zeros(30_000))


def test_islands_longer_than_an_image_are_cut(run_folder):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=40, y_subdivisions=4, size=1.0)
    item = bpy.context.object
    item.scale.x = 8.0
    bpy.context.view_layer.update()
    room, sizes, corner_uv, image = atlas_of([item], run_folder, texel_density=128.0, texture_size=512)
    assert density_of(room, sizes, corner_uv, image) == pytest.approx(128.0, rel=0.01)
    check_layout(sizes, corner_uv, image)

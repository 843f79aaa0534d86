"""Views at the resolution of light: budgets, means, majorities, and the files of a run."""

from __future__ import annotations

import shutil
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture import views as views_module
from fipt_blender.core.capture.averaging import majority, means
from fipt_blender.core.capture.encoded import CLIPPED_CODE, srgb_decoded, srgb_encoded
from fipt_blender.core.capture.images import Picture, write_exr, write_ids
from fipt_blender.core.capture.views import View, chosen_views, light_views
from fipt_blender.core.run import light_size as light_size_module
from fipt_blender.core.run.light_size import LEAST_PIXELS, SPARE_BYTES, light_size, light_views_count, refuse_full_disk
from samples.refusals import error_of

SIZES = [(5, 3), (7, 4), (10, 6), (31, 17)]


def make_view(folder: Path, name: str = "a", size: tuple[int, int] = (60, 40), **changes: object) -> View:
    width, height = size
    image = folder / f"{name}.exr"
    rng = np.random.default_rng(len(name))
    write_exr(image, rng.uniform(0.1, 2.0, (height, width, 3)).astype(np.float32))
    view = View(name, "train", image, width, height, 50.0, 52.0, 28.0, 21.0, np.eye(4))
    return replace(view, **changes)


def test_a_budget_is_shared_evenly_and_small_views_keep_their_size() -> None:
    sizes = [(4000, 3000), (3000, 4000), (100, 80), (1600, 1200)]
    found = light_size(sizes, 0.5)
    areas = [width * height for width, height in found]
    assert found[2] == (100, 80)
    assert 0.98 * 0.5e6 < sum(areas) <= 0.5e6
    assert max(areas) - areas[3] < 0.01 * areas[0]
    for (width, height), (light_width, light_height) in zip(sizes, found, strict=True):
        assert light_width / light_height == pytest.approx(width / height, rel=0.01)


def test_more_views_than_the_budget_serves_are_thinned_out_by_what_they_see() -> None:
    assert light_views_count([(4000, 3000)] * 200, 100 * LEAST_PIXELS / 1e6) == 100
    assert light_views_count([(10, 10)] * 200, 0.02) == 200
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = [0.0, 0.01, 0.02, 5.0, 5.01, 9.0]
    base = View("a", "train", Path("a.exr"), 400, 300, 1.0, 1.0, 1.0, 1.0, np.eye(4))
    views = [replace(base, name=str(i), camera_to_world=pose) for i, pose in enumerate(poses)]
    found = [view.name for view in chosen_views(views, 3 * LEAST_PIXELS / 1e6)]
    assert len(found) == 3 and found[0] == "0" and "5" in found and {"3", "4"} & set(found)


@pytest.mark.parametrize("size", SIZES)
def test_means_of_constants_and_ramps_are_exact(size: tuple[int, int]) -> None:
    width, height = size
    y, x = np.mgrid[:34, :62].astype(np.float32)
    image = np.stack([np.full_like(x, 3.0), x + 0.5, y + 0.5], axis=-1)
    found = means(image, width, height)
    assert found.shape == (height, width, 3) and found.dtype == np.float32
    assert found[..., 0] == pytest.approx(3.0, rel=1e-6)
    # The light of a ramp is that of the pixel's centre; steps at its borders add up to less than a quarter.
    assert found[0, :, 1] == pytest.approx((np.arange(width) + 0.5) * 62 / width, abs=0.25)
    assert found[:, 0, 2] == pytest.approx((np.arange(height) + 0.5) * 34 / height, abs=0.25)


def test_means_weigh_a_pixel_across_a_border_by_its_area() -> None:
    row = np.array([1.0, 10.0, 100.0], np.float32)[None, :, None]
    assert means(row, 2, 1)[0, :, 0] == pytest.approx([(1.0 + 5.0) / 1.5, (5.0 + 100.0) / 1.5])


def test_majority_takes_the_most_frequent_id() -> None:
    ids = np.array([[7, 7, 70000, 0], [7, 9, 0, 0], [3, 3, 5, 5], [4, 4, 5, 2]], np.int32)
    assert majority(ids, 2, 2).tolist() == [[7, 0], [3, 5]]
    large = np.kron(np.arange(12).reshape(3, 4), np.ones((11, 7), int))
    assert majority(large, 4, 3).tolist() == np.arange(12).reshape(3, 4).tolist()
    assert majority(np.full((5, 5), -1), 2, 3).tolist() == [[-1, -1]] * 3


def test_rays_of_light_pixels_agree_with_those_of_the_photograph(tmp_path: Path) -> None:
    view = make_view(tmp_path, size=(62, 34))
    light = view.resized(31, 17)
    full = view.rays(z_depth=True)[1].reshape(34, 62, 3)  # linear in the pixels
    corner = full[0::2, 0::2] + full[1::2, 0::2] + full[0::2, 1::2] + full[1::2, 1::2]
    assert np.abs(corner / 4.0 - light.rays(z_depth=True)[1].reshape(17, 31, 3)).max() < 1e-6


def test_images_are_averaged_when_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_size_module, "LEAST_PIXELS", 1)
    mask = np.ones((40, 60), np.int32)
    mask[0, 0] = 0
    changes = {kind: tmp_path / f"{kind}.png" for kind in ("parts", "mask", "semantics")}
    write_ids(changes["parts"], np.repeat(np.arange(40)[:, None] // 20 + 1, 60, axis=1))
    write_ids(changes["mask"], mask)
    write_ids(changes["semantics"], np.ones((40, 60), np.int32))
    views = [make_view(tmp_path, "room/a", **changes), make_view(tmp_path, "small", size=(9, 6))]
    assert all(one is other for one, other in zip(light_views(views, 1.0), views, strict=True))
    light, small = light_views(views, (60 + 9 * 6) / 1e6)
    assert (light.width, light.height) == (9, 6) and small is views[1]
    pixels, read, shown = views[0].radiance(), [], Picture.shown
    monkeypatch.setattr(Picture, "shown", lambda picture: read.append(picture.path) or shown(picture))
    found = light.radiance()
    assert light.radiance() is found and views[0].resized(9, 6).radiance() is found and read == [light.image]
    other = replace(light, kept=views_module.KeptImages())  # another capture has its own
    other.keep(pixels)
    assert np.array_equal(other.radiance(), found) and other.radiance() is not found and read == [light.image]
    assert not deepcopy(light).kept  # and so has another process
    assert np.array_equal(found, means(pixels, 9, 6))
    monkeypatch.setattr(views_module, "MOST_KEPT", 0)
    assert light.part_ids() is not light.part_ids()  # memory has a bound
    ids, masked = light.part_ids(), light.masked()
    assert ids is not None and set(np.unique(ids)) == {1, 2}
    assert masked is not None and masked[0, 0] and masked.sum() == 1  # any share spoils the mean
    assert np.array_equal(light.semantic_ids(), np.ones((6, 9)))  # type: ignore[arg-type]
    write_exr(light.image, 2.0 * views[0].radiance())
    assert light.radiance() == pytest.approx(2.0 * found)
    write_exr(light.image, np.ones((6, 9, 3)))  # of its own size, as masks are that were linked
    assert (light.radiance() == 1.0).all()
    write_exr(light.image, np.ones((5, 9, 3)))
    assert error_of(light.radiance).code == "image-size" and not (tmp_path / "run").exists()


def test_light_pixels_with_clipped_ones_are_clipped(tmp_path: Path) -> None:
    codes = np.full((40, 40, 3), 128, np.uint8)
    codes[:10, :10] = 255  # a lamp that fills one light pixel
    codes[10:13, 10:12, 0] = 255  # 6 of 100 pixels, red only
    codes[20, 20] = 255  # one hot pixel of 100
    Image.fromarray(codes).save(tmp_path / "a.png")
    view = View("a", "train", tmp_path / "a.png", 40, 40, 50.0, 50.0, 20.0, 20.0, np.eye(4), encoded=True)
    found = srgb_encoded(view.resized(4, 4).radiance()) * 255.0
    clipped = found >= CLIPPED_CODE
    assert clipped[0, 0].all() and clipped[1, 1].tolist() == [True, False, False]
    assert clipped.sum() == 4
    grey = srgb_decoded(np.array([128 / 255.0]))[0]
    assert srgb_decoded(found[2, 2] / 255.0) == pytest.approx(0.99 * grey + 0.01, rel=1e-4)


def test_a_disk_that_is_too_small_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run" / "stage"
    free = SPARE_BYTES + 1000
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    refuse_full_disk(folder, 1000, "lower the setting")
    error = error_of(refuse_full_disk, folder, 2_000_000_000, "lower the setting")
    assert error.code == "disk-space" and "2.0 GB" in error.text
    assert "lower the setting" in error.remedy
    folder.mkdir(parents=True)
    (folder / "before.npy").write_bytes(bytes(2000))  # a resumed run writes it over
    refuse_full_disk(folder, 3000, "lower the setting")

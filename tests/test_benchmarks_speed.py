# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The speed benchmark: the reference's shadings, records, curves, and a complete run."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks import curves, resampled, scaling, shading_error, speed, speed_table
from benchmarks.reference import AUTHORS, bake_apart, batch_means, masked_triangles, reference_settings
from benchmarks.speed_engine import kept_path
from benchmarks.turns import merged, take_turns
from fipt_blender.core.capture.images import read_ids, read_radiance, write_exr
from fipt_blender.core.light.cache import SurfaceLookup, pool
from fipt_blender.core.light.radiance import CachedRadiance
from fipt_blender.core.light.shadings import SampleCounts, ShadingPoints, bake
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.room import Room, load_room, triangle_normals
from samples.camera_poses import look_at
from samples.refusals import error_of
from samples.shading_points import make_grid
from samples.small_captures import QUICK, panel_capture, write_run
from samples.small_rooms import BOX, agree, make_room, room_with_bulb, surface_points

LEVELS = np.array([0.1, 0.4, 1.0], np.float32)


def lit_box() -> tuple[Room, CachedRadiance]:
    """A box with a different radiance on each wall."""
    room = make_room(BOX)
    nothing = np.zeros((0, 3))
    grid = make_grid(room, nothing, nothing, 48, np.random.default_rng(0))
    points, normals, ids = surface_points(room, 4000, np.random.default_rng(1))
    light = np.array([0.2, 3.0, 0.5, 1.0, 0.1, 0.7])[ids // 2]
    cache = pool(grid, grid.entries(points, normals), np.repeat(light[:, None], 3, axis=1))[0]
    return room, CachedRadiance(room, SurfaceLookup(grid, cache), None)


def test_levels_traced_apart_agree_with_one_pool_of_rays() -> None:
    """Both are unbiased estimates of the same integrals (z-test); the pool has ten times the rays.

    Both terms of a level together: L_s1 alone hangs on so few samples that no z-test holds.
    """
    room, source = lit_box()
    position = np.array([[0.3, -0.5, 0.0], [-1.0, 0.8, 0.0]], np.float32)
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (2, 1))
    view = np.array([[0.6, 0.0, 0.8], [0.0, -0.28, 0.96]], np.float32)
    times = 4000
    points = ShadingPoints(*(np.repeat(each, times, axis=0) for each in (position, up, up, view)))
    lights = AreaLights(
        room.vertices,
        room.triangles,
        EmitterTable(np.array([2, 3], np.int32), *np.ones((2, 2, 3), np.float32)),
    )
    pooled = bake(points, source, lights, LEVELS, SampleCounts(16, 16, 16), 1)
    apart = bake_apart(points, source, LEVELS, 4, [2, 3, 4], 2)
    lobes = [found.specular.sum(axis=2) for found in (pooled, apart)]
    for one, other in ((pooled.diffuse, apart.diffuse), lobes):
        first, second = (each.reshape(2, times, -1).astype(np.float64) for each in (one, other))
        error = np.sqrt((first.var(axis=1) + second.var(axis=1)) / times)
        assert (second.mean(axis=1) > 0.0).all()
        agree(first.mean(axis=1) - second.mean(axis=1), error)


def test_only_its_own_samples_count_for_a_level() -> None:
    """The counts of other levels have no effect."""
    _, source = lit_box()
    up = np.array([[0.0, 0.0, 1.0]], np.float32)
    points = ShadingPoints(np.array([[0.3, -0.5, 0.0]], np.float32), up, up, up)
    few = bake_apart(points, source, LEVELS, 8, [4, 4, 4], 3).specular
    more = bake_apart(points, source, LEVELS, 8, [4, 9, 4], 3).specular
    assert np.array_equal(few[:, [0, 2]], more[:, [0, 2]]) and not np.array_equal(few[:, 1], more[:, 1])


def test_means_of_a_batch_follow_the_highlights() -> None:
    values = torch.tensor([[0.2, 0.0], [0.8, 1.0], [0.5, 0.5]], requires_grad=True)
    weight = torch.tensor([3.0, 1.0, 7.0])
    means = batch_means(values, weight, torch.tensor([4, 4, -1]))
    assert torch.allclose(means[0], torch.tensor([0.35, 0.25])) and torch.allclose(means[0], means[1])
    assert torch.allclose(means[2], values[2])
    means[0, 0].backward()
    assert torch.allclose(values.grad, torch.tensor([[0.75, 0.0], [0.25, 0.0], [0.0, 0.0]]))


def test_the_reference_has_the_authors_counts() -> None:
    settings = reference_settings(10_000, 1.0, {"view_share": 0.5})
    assert (settings.diffuse_spp, settings.specular_spp, settings.roughness_levels) == (256, 128, 6)
    assert (settings.refine_diffuse_spp, settings.refine_specular_spp, settings.rounds) == (128, 64, 2)
    assert settings.view_share == 0.5 and not settings.denoise
    quick = reference_settings(7, 0.01, {})
    assert (quick.diffuse_spp, quick.specular_spp, quick.refine_specular_spp) == (3, 1, 1)
    assert quick.training_steps == 7
    assert "no-such" in str(error_of(reference_settings, 1, 1.0, {"no-such": 1}))


def test_the_references_mask_finds_a_bulb_of_five_centimetres_and_nothing_else() -> None:
    room = room_with_bulb(0.05)

    def mask(positions: np.ndarray) -> np.ndarray:
        inside = np.linalg.norm(positions - [0.5, 0.3, 1.0], axis=1) < 0.06
        return np.where(inside, 0.6, 0.0) + 1e-4  # a trained mask is never quite zero

    found = masked_triangles(room, mask, 0.01, 100, np.random.default_rng(0))
    assert np.flatnonzero(found).tolist() == list(range(12, 20))
    # The threshold is on the mean: three quarters of a wall's upper triangle at 0.012 are not enough.
    for alpha, expected in ((0.012, False), (0.02, True)):
        found = masked_triangles(
            room, lambda p, a=alpha: a * (p[:, 2] > 1.5), 0.01, 100, np.random.default_rng(0)
        )
        assert found[5] == expected and not found[4] and found[[2, 3]].all()


def record(scale: float) -> dict:
    """Two trainings and a baking, as reported by speed_engine."""
    stages = [
        {
            "name": "shadings",
            "seconds": 4.0 * scale,
            "cpu_seconds": 8.0,
            "rays": 8_000_000,
            "peak_memory_gb": 2.0,
            "peak_own_gb": 0.7,
        },
        {"name": "estimate-0", "seconds": 1.0 * scale, "cpu_seconds": 2.0, "peak_memory_gb": 1.0},
        {"name": "training", "seconds": 3.0 * scale, "cpu_seconds": 2.0, "peak_memory_gb": 1.5},
    ]
    return {"seconds": 10.0 * scale, "cpu_seconds": 13.0, "stages": stages}


def test_the_fastest_of_several_runs_counts() -> None:
    found = merged([record(1.0), record(2.0), record(3.0)])
    shadings, *_, other = found["stages"]
    assert shadings["seconds"] == 4.0 and shadings["median_seconds"] == 8.0
    assert shadings["mrays_per_second"] == 2.0
    assert other["name"] == "other" and other["seconds"] == 2.0 and other["cpu_seconds"] == 1.0
    assert found["seconds"] == 10.0 and found["median_seconds"] == 20.0 and found["peak_memory_gb"] == 2.0


def test_ratios_join_the_rounds_of_a_stage() -> None:
    slow, fast = merged([record(3.0)]), merged([record(1.0)])
    del fast["stages"][2]  # one round less
    fast["seconds"] -= 3.0
    found = speed.ratios(slow, fast)
    assert found["ratio"] == pytest.approx(30.0 / 7.0, abs=1e-3)
    assert found["stage_ratios"] == {"shadings": 3.0, "training": 12.0, "other": 3.0}
    assert found["cpu_stage_ratios"]["training"] == 2.0
    result = json.loads(json.dumps({**found, "reference": slow, "shipped": fast}))
    text = speed_table.format_result(result)
    assert "training" in text and "ratio 4.29" in text


def test_the_truths_own_noise_is_no_error() -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(0.2, 0.6, (20_000, 3))
    first, second, found = (true + rng.normal(0.0, spread, true.shape) for spread in (0.03, 0.03, 0.02))
    shown = true ** (1.0 / 2.2)
    wanted = np.sqrt(np.mean((found ** (1.0 / 2.2) - shown) ** 2) / np.mean(shown**2))
    assert shading_error.relative_rmse(found, first, second) == pytest.approx(wanted, rel=0.05)
    assert shading_error.relative_rmse(found, first) > 1.5 * wanted
    levels = np.array([0.0, 0.5, 1.0])
    values = np.repeat(levels[None, :, None, None], 3, axis=3).repeat(2, axis=2)
    between = shading_error.interpolated(values, levels, np.array([0.0, 0.3, 0.9, 1.0]))
    assert np.allclose(between[0, :, 0, 0], [0.0, 0.3, 0.9, 1.0])


def test_exponents_are_those_of_power_laws(tmp_path: Path) -> None:
    sizes = [10, 20, 50, 200]
    assert curves.fit_exponent(sizes, [3.0 * n**1.7 for n in sizes]) == pytest.approx(1.7)
    assert curves.fit_exponent(sizes, [2.0] * 4) == pytest.approx(0.0)
    assert curves.fit_exponent([10], [1.0]) is None
    assert curves.fit_exponent(sizes, [0.0, None, 1.0, 4.0]) == pytest.approx(1.0)
    records = [merged([record(scale)]) for scale in (1.0, 2.0)]
    stages = scaling.fitted([10, 20], records)
    assert stages["estimate"]["seconds"] == [1.0, 2.0] and stages["training"]["seconds"] == [3.0, 6.0]
    assert stages["training"]["exponent"] == pytest.approx(1.0)
    assert stages["all"]["cpu_exponent"] == pytest.approx(0.0)
    shown = {"views": {"unit": "views", "sizes": [10, 20], "stages": stages}}
    assert "1.00" in scaling.format_table(shown)
    assert stages["shadings"]["own_gb"] == [0.7, 0.7] and stages["memory"]["gb"] == [0.7, 0.7]
    assert stages["memory"]["exponent"] == pytest.approx(0.0) and stages["resident"]["gb"] == [2.0, 2.0]
    scaling.draw(shown, tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").stat().st_size > 1000
    assert scaling.read_sizes("1e4, 20") == [20, 10_000] and scaling.read_sizes("") == []
    assert "sizes" in str(error_of(scaling.read_sizes, "ten"))


def test_each_curve_varies_one_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_run(tmp_path / "source", panel_capture())
    measured: list[tuple[int, int, int]] = []
    lasts: list[str | None] = []

    def fake(runs: dict[str, RunFolder], last: str | None) -> dict:
        lasts.append(last)
        views = read_json(runs["shipped"].capture_json)["views"]
        triangles = load_room(runs["shipped"]).triangles
        measured.append((len(views), views[0]["height"], len(triangles)))
        return {"shipped": record(float(len(measured)))}

    monkeypatch.setattr(scaling, "take_turns", fake)
    sizes = {"views": [2, 8], "resolution": [16, 32], "triangles": [14, 56]}
    steps = scaling.measure(source, tmp_path / "out", make_settings("draft", QUICK), sizes, (2, 16), 1)
    *_, last = steps
    # The first is measured twice: kernels are compiled once.
    assert measured == [
        (2, 16, 14), (2, 16, 14), (8, 16, 14), (2, 16, 14), (2, 32, 14), (2, 16, 14), (2, 16, 56)
    ]  # fmt: skip
    assert lasts == [None] * 5 + ["shadings"] * 2
    assert last["views"]["sizes"] == [2, 8] and last["triangles"]["sizes"] == [14, 56]
    assert last["resolution"]["sizes"] == [16 * 24, 32 * 48]
    assert last["views"]["stages"]["all"]["seconds"] == [20.0, 30.0]


@pytest.fixture
def compass(tmp_path: Path) -> RunFolder:
    """A run with two views of 40 x 20 pixels whose photographs show each pixel's direction, plus two."""
    run = RunFolder(tmp_path / "compass")
    run.create(make_settings("draft"))
    views = []
    for index, target in enumerate(([1.0, 1.0, 0.3], [-1.0, 0.5, -0.2])):
        pose = look_at([0.0, 0.0, 1.0], list(np.array(target) + [0.0, 0.0, 1.0]))
        view = {
            "name": f"train/{index:03d}",
            "split": "train",
            "width": 40,
            "height": 20,
            "fx": 30.0,
            "fy": 30.0,
        }
        view |= {"cx": 20.0, "cy": 10.0, "camera_to_world": pose.tolist(), "semantics": None, "mask": None}
        view |= {"image": f"images/{index}.exr", "parts": f"images/parts_{index}.exr"}
        write_exr(run.root / view["image"], directions(view) + 2.0)
        write_exr(run.root / view["parts"], (directions(view)[..., 2] > 0.0).astype(np.float32))
        views.append(view)
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    run.capture_json.write_text(json.dumps({**head, "world_from_source": np.eye(4).tolist(), "views": views}))
    return run


def directions(view: dict) -> np.ndarray:
    """(H, W, 3) z = 1 directions of the pixels' centres in the world."""
    y, x = np.mgrid[: view["height"], : view["width"]] + 0.5
    local = [(x - view["cx"]) / view["fx"], (y - view["cy"]) / view["fy"], np.ones_like(x)]
    direction = np.stack(local, axis=-1) @ np.array(view["camera_to_world"])[:3, :3].T
    return (direction / np.linalg.norm(direction, axis=-1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("height", [10, 20, 60])
def test_resampled_photographs_show_what_their_cameras_see(
    compass: RunFolder, tmp_path: Path, height: int
) -> None:
    target = RunFolder(tmp_path / "more")
    target.create(make_settings("draft"))
    assert resampled.write_views(compass, target, 6, height) == 2 * height**2
    views = read_json(target.capture_json)["views"]
    assert len({view["name"] for view in views}) == 6
    for number, view in enumerate(views):
        image = read_radiance(target.root / view["image"])
        assert image.shape == (height, 2 * height, 3)
        inner = (slice(1, -1), slice(1, -1))  # up-sampled borders have no neighbours to look between
        off = np.abs(image - 2.0 - directions(view))[inner]
        assert off.max() < 0.02, number
        ids = read_ids(target.root / view["parts"])
        clear = np.abs(directions(view)[..., 2]) > 0.04
        assert (ids == (directions(view)[..., 2] > 0.0))[clear].all()
    turns = [np.array(view["camera_to_world"])[:3, :3] for view in views]
    assert np.allclose(turns[0] @ turns[0].T, np.eye(3)) and not np.allclose(turns[0], turns[2])
    assert len(resampled.planned_views(views, 2)) == 2


def test_meshes_get_more_and_fewer_triangles() -> None:
    room = make_room(BOX)
    arrays = {
        "vertices": room.vertices,
        "triangles": room.triangles,
        "corner_normals": room.corner_normals,
        "triangle_object": room.triangle_object,
    }
    more = resampled.with_triangles(arrays, 1000)
    assert 1000 <= len(more["triangles"]) <= 1002 == len(more["corner_normals"])
    corners = more["vertices"][more["triangles"]].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    assert np.bincount(more["triangle_object"], area) == pytest.approx([16.0, 16.0, 12.0, 12.0, 12.0, 12.0])
    normals = triangle_normals(more["vertices"], more["triangles"])
    assert np.allclose(more["corner_normals"], normals[:, None], atol=1e-5)
    fewer = resampled.with_triangles(more, 200)
    count = len(fewer["triangles"])
    assert 50 <= count <= 200 and len(fewer["triangle_object"]) == count
    assert fewer["triangles"].max() < len(fewer["vertices"])
    assert np.abs(fewer["vertices"]).max() <= 3.0


def test_both_configurations_run_in_turns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_run(tmp_path / "source", panel_capture())
    small = {name: QUICK[name] for name in ("device", "voxel_resolution", "hash_levels", "hash_log2_size")}
    small |= {"batch_size": 1024}
    settings = {
        "reference": reference_settings(30, 0.05, small | {"rounds": 1}),
        "shipped": make_settings("draft", QUICK),
    }
    result = speed.compare(source, tmp_path / "out", settings)
    told = capsys.readouterr().err.splitlines()
    assert told[1:5] == ["reference: pixels", "shipped: pixels", "reference: outside", "shipped: checks"]
    assert result["ratio"] > 0.0 and set(result["stage_ratios"]) >= {
        "pixels",
        "shadings",
        "refinement",
    }
    json.dumps(result)
    for name in speed.CONFIGURATIONS:
        run = RunFolder(tmp_path / "out" / name)
        names = [stage["name"] for stage in result[name]["stages"]]
        assert names[0] == "pixels" and names[-1] == "other"
        assert result[name]["seconds"] == pytest.approx(
            sum(s["seconds"] for s in result[name]["stages"]), abs=0.1
        )
        assert all(stage["peak_memory_gb"] > 0.0 for stage in result[name]["stages"][:-1])
        if sys.platform == "linux":
            peaks = [(stage["peak_own_gb"], stage["peak_memory_gb"]) for stage in result[name]["stages"][:-1]]
            assert all(0.0 < own <= resident for own, resident in peaks)
        assert len(read_json(run.emitters_json)["fixtures"]) >= 0 and run.fields_npz.exists()
    with np.load(kept_path(RunFolder(tmp_path / "out" / "reference"), "shadings")) as kept:
        assert kept["specular"].shape[1] == AUTHORS["roughness_levels"] and kept["diffuse"].mean() > 0.0
        seen = (kept["diffuse"] > 0.0).any(axis=1).sum()
    counts = settings["reference"]
    a_pixel = counts.diffuse_spp + counts.specular_spp // 2 + 5 * counts.specular_spp
    assert result["reference"]["stages"][2]["rays"] == pytest.approx(seen * a_pixel, rel=0.02)
    assert load_room(RunFolder(tmp_path / "out" / "shipped")).triangles.shape == (14, 3)


def test_nothing_follows_the_last_stage(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", panel_capture(), **QUICK)
    record = take_turns({"shipped": run}, "shadings")["shipped"]
    assert [stage["name"] for stage in record["stages"]] == [
        "pixels",
        "checks",
        "unmixing",
        "outside",
        "shadings",
    ]


def test_a_run_that_dies_names_its_log(tmp_path: Path) -> None:
    source = write_run(tmp_path / "source", panel_capture())
    data = json.loads(source.capture_json.read_text())
    source.capture_json.write_text(json.dumps({**data, "views": []}))
    settings = {"shipped": make_settings("draft", QUICK)}
    with pytest.raises(FiptError, match=r"shipped run failed.*log\.txt"):
        speed.compare(source, tmp_path / "out", settings)
    assert "views-none" in RunFolder(tmp_path / "out" / "shipped").log.read_text()


def test_wrong_options_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert speed.main([str(tmp_path), "--repeats", "0", "--output", str(tmp_path / "out")]) == 1
    assert "above zero" in capsys.readouterr().err
    assert speed.main([str(tmp_path), "--reuse", "--output", str(tmp_path / "out")]) == 1
    assert "times.json" in capsys.readouterr().err
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary").write_text("dear")
    assert "not a run folder" in str(error_of(speed.prepare, tmp_path, tmp_path / "mine"))
    assert (tmp_path / "mine" / "diary").exists()


def test_shadings_are_judged_only_where_the_truth_has_all_textures(tmp_path):
    assert not shading_error.has_true_materials(tmp_path)
    (tmp_path / "scene.npz").touch()
    materials = [{"texture": None}, {"texture": "textures/wood.png"}]
    (tmp_path / "materials.json").write_text(json.dumps({"materials": materials}))
    assert not shading_error.has_true_materials(tmp_path)
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "wood.png").touch()
    assert shading_error.has_true_materials(tmp_path)

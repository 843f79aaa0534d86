"""Vignetting found from overlapping views, and images that are corrected once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.radiometry.adjustment import falloff_terms
from fipt_blender.prepare.lens import light_share
from fipt_blender.prepare.preparation import Preparation, PreparationFolder
from fipt_blender.prepare.solve_step import write_model
from fipt_blender.prepare.vignetting import TERMS, Observations, fit_falloff, profile_of
from samples.camera_poses import look_at
from samples.prepared_captures import facts, placed_model, run_with, single
from samples.textured_room import FOCAL, HEIGHT, SIZE, WIDTH, project

TRUE = np.array([-0.3, -0.15, 0.0])
# The folder, what is prepared, and the images without vignetting by their names.
Capture = tuple[PreparationFolder, Preparation, dict[str, np.ndarray]]


def observations(falloff: np.ndarray, count: int, noise: float, seed: int = 0) -> Observations:
    """Points seen by six views of different exposure; a tenth of the observations is of something else."""
    generator = np.random.default_rng(seed)
    point = np.repeat(np.arange(count), 3)
    view = generator.integers(0, 6, len(point))
    radius = np.sqrt(generator.uniform(0.0, 1.0, len(point)))
    value = generator.normal(0.0, 1.5, count)[point] + generator.normal(0.0, 0.3, 6)[view]
    value = value + falloff_terms(radius, TERMS) @ falloff + generator.normal(0.0, noise, len(point))
    wrong = generator.uniform(size=len(point)) < 0.1
    return Observations(point, view, radius, np.where(wrong, value + 1.0, value))


def test_falloff_is_found_in_spite_of_exposures_and_outliers() -> None:
    found = fit_falloff(observations(TRUE, 2000, 0.05))
    assert found is not None and found.certain
    share = profile_of(found.coefficients) / profile_of(TRUE)
    assert np.abs(share - 1.0).max() < 0.02
    assert abs(found.corner - np.exp(TRUE.sum())) < 4.0 * found.corner_error < 0.05
    assert found.noise == pytest.approx(0.05, rel=0.25)


def test_the_error_of_the_corner_is_that_of_repeated_fits() -> None:
    fits = [fit_falloff(observations(TRUE, 300, 0.1, seed)) for seed in range(16)]
    corners = np.array([fit.corner for fit in fits if fit])
    expected = np.mean([fit.corner_error for fit in fits if fit])
    assert 0.5 < corners.std(ddof=1) / expected < 1.8


def test_without_vignetting_or_with_few_points_nothing_is_corrected() -> None:
    for seed in range(4):
        found = fit_falloff(observations(np.zeros(3), 500, 0.1, seed))
        assert found is not None and not found.certain
    assert fit_falloff(observations(TRUE, 60, 0.05)) is None
    alone = observations(TRUE, 900, 0.05)
    assert fit_falloff(replace(alone, point=np.arange(len(alone.point)))) is None, "no point is shared"


def test_the_share_of_light_never_rises_outwards() -> None:
    share = light_share(profile_of(np.array([-1.0, 0.9, 0.0])), 200, 100)
    row = share[50, 100:]
    assert (np.diff(row) <= 1e-6).all() and share.max() <= 1.0 and share.dtype == np.float32


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    """Five views of points on the walls of a room, through a lens with vignetting, and their solve."""
    folder = PreparationFolder(tmp_path / "capture")
    generator = np.random.default_rng(1)
    points = generator.uniform(0.0, 1.0, (900, 3)) * [SIZE[0], 0.0, SIZE[2]] + [0.0, SIZE[1], 0.0]
    center = [0.5 * WIDTH, 0.5 * HEIGHT]
    share = light_share(profile_of(TRUE), WIDTH, HEIGHT)[..., None]
    tracks: dict[int, pycolmap.Track] = {index: pycolmap.Track() for index in range(len(points))}
    originals = {}
    poses = [look_at(np.array([0.6 * i, 0.4, 1.2]), np.array([2.0 + 0.3 * i, 3.0, 1.1])) for i in range(1, 6)]
    places: list[list[np.ndarray]] = []
    for number, pose in enumerate(poses, start=1):
        seen = [(index, project(point, pose)) for index, point in enumerate(points)]
        seen = [(i, xy) for i, xy in seen if 0.0 <= xy[0] < WIDTH and 0.0 <= xy[1] < HEIGHT]
        for place, (index, _) in enumerate(seen):
            tracks[index].add_element(number, place)
        places.append([xy for _, xy in seen])
        # A wall whose brightness is a smooth function of the position on it.
        x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        rays = np.stack([(x - center[0]) / FOCAL, (y - center[1]) / FOCAL, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
        depth = (SIZE[1] - pose[1, 3]) / rays[..., 1]
        wall = pose[:3, 3] + rays * depth[..., None]
        value = 1.5 + np.sin(2.0 * wall[..., 0]) * np.cos(3.0 * wall[..., 2])
        originals[f"v{number}"] = np.repeat(value[..., None], 3, axis=-1).astype(np.float32)
        write_exr(folder.images / f"v{number}.exr", originals[f"v{number}"] * share)
    model = placed_model(poses, places)
    for index, track in tracks.items():
        if track.length() > 1:
            model.add_point3D(points[index], track)
    write_model(folder.model, model)
    return folder, single(tmp_path, originals, (WIDTH, HEIGHT), focal_length=20.0), originals


def run(folder: PreparationFolder, preparation: Preparation, **settings: str) -> dict:
    run_with(folder, preparation, ["vignetting"], **settings)
    return facts(folder, "vignetting")


def errors(folder: PreparationFolder, originals: dict[str, np.ndarray]) -> float:
    """The largest relative error of the images, up to one factor."""
    ratios = [read_radiance(folder.images / f"{name}.exr") / image for name, image in originals.items()]
    return float(np.abs(np.array(ratios) / np.median(ratios) - 1.0).max())


def test_images_are_corrected_once_and_the_correction_can_be_undone(capture: Capture) -> None:
    folder, preparation, originals = capture
    before = {path.name: path.read_bytes() for path in folder.images.iterdir()}
    found = run(folder, preparation)["lenses"]
    assert [(item["lens"], item["views"], item["applied"]) for item in found] == [("20 mm", 5, True)]
    assert found[0]["corner"] == pytest.approx(float(np.exp(TRUE.sum())), abs=0.03)
    assert errors(folder, originals) < 0.03
    first = {path.name: path.read_bytes() for path in folder.images.iterdir()}
    folder.facts("vignetting").unlink()
    again = run(folder, preparation)["lenses"]
    assert again[0]["corner"] == pytest.approx(found[0]["corner"], abs=1e-3), "it fits the originals"
    assert errors(folder, originals) < 0.03
    run(folder, preparation, vignetting="none")
    for name in originals:
        restored = read_radiance(folder.images / f"{name}.exr")
        assert np.allclose(
            restored, originals[name] * light_share(profile_of(TRUE), WIDTH, HEIGHT)[..., None], rtol=1e-5
        )
    (folder.images / "v1.exr").write_bytes(before["v1.exr"])  # as if it was merged again
    run(folder, preparation)
    assert errors(folder, originals) < 0.03
    assert {path.name for path in folder.images.iterdir()} == set(first)


def test_a_stop_between_two_images_corrects_nothing_twice(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, preparation, originals = capture
    written = []

    def stopped(path: Path, *rest: object, **more: object) -> None:
        written.append(path)
        if len(written) == 3:
            raise KeyboardInterrupt
        write_exr(path, *rest, **more)

    monkeypatch.setattr("fipt_blender.prepare.vignetting.write_exr", stopped)
    with pytest.raises(KeyboardInterrupt):
        run(folder, preparation)
    monkeypatch.undo()
    assert run(folder, preparation)["lenses"][0]["applied"]
    assert errors(folder, originals) < 0.03


def test_radiance_files_and_known_lenses_are_left_alone(capture: Capture) -> None:
    folder, preparation, _ = capture
    before = {path.name: path.read_bytes() for path in folder.images.iterdir()}
    linear = tuple(replace(photograph, kind="linear") for photograph in preparation.photographs)
    camera = {"make": "Canon", "model": "Canon EOS 5D Mark III", "lens": "EF24-105mm f/4L IS USM"}
    known = tuple(replace(item, focal_length=24.0, aperture=8.0, **camera) for item in preparation.photographs)
    assert run(folder, replace(preparation, photographs=linear)).get("lenses", []) == []
    # The merge has corrected RAW photographs by the database, and JPEGs that the camera has not.
    for changes in ({"kind": "raw"}, {"corrected": False}):
        photographs = tuple(replace(item, **changes) for item in known)
        (found,) = run(folder, replace(preparation, photographs=photographs))["lenses"]
        assert found["source"] == "database" and 0.1 < found["corner"] < 0.9
    assert {path.name: path.read_bytes() for path in folder.images.iterdir()} == before
    for corrected in (True, None):
        photographs = tuple(replace(item, corrected=corrected) for item in known)
        (found,) = run(folder, replace(preparation, photographs=photographs))["lenses"]
        assert found["source"] == "overlap"


def test_vignetting_that_nothing_tells_is_said(capture: Capture) -> None:
    folder, preparation, _ = capture
    reporter = run_with(folder, replace(preparation, groups=preparation.groups[:1]), ["vignetting"])
    assert [warning["code"] for warning in reporter.warnings] == ["vignetting-unknown"]
    assert "20 mm" in reporter.warnings[0]["text"]

"""Panoramas and photographs through lenses become views that show at their rays what was there."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.distortion import (
    Undistortion,
    is_distorted,
    lens_camera,
    lens_pinhole,
    undistorted_pinhole,
)
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.rig import Lens
from fipt_blender.core.capture.views import View, load_capture, photographs_of
from fipt_blender.core.run.runfolder import RunFolder
from samples import rig_writers as write
from samples.camera_poses import random_rotation
from samples.capture_files import Sample, write_colmap
from samples.ingesting import edited_json, run_ingest, warnings
from samples.metashape_writers import Chunk, metashape_chunk, write_metashape
from samples.refusals import error_of

WIDTH, HEIGHT = 256, 128
FACES = {"front", "right", "back", "left", "up", "down"}


def radiance(directions: np.ndarray) -> np.ndarray:
    """(..., 3) of unit directions (..., 3) in the source's world: smooth, and nowhere alike."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([2.0 + np.sin(3.0 * x + y), np.exp(1.5 * y - z), 1.5 + x * z - 0.3 * y], axis=-1)


def panorama_rays(width: int = WIDTH) -> np.ndarray:
    """(H, W, 3) right, up and forward of an equirectangular image's pixels: left of its centre is to the left."""
    columns, rows = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(width // 2) + 0.5) / (width // 2))
    longitude, latitude = 2.0 * np.pi * (columns - 0.5), np.pi * (0.5 - rows)
    flat = np.cos(latitude)
    return np.stack([flat * np.sin(longitude), np.sin(latitude), flat * np.cos(longitude)], axis=-1)


def make_shots(panoramas: tuple[int, ...], count: int = 4) -> list[write.Shot]:
    """Photographs turned in any way, of which some are panoramas."""
    rng, shots = np.random.default_rng(5), []
    for index in range(count):
        size = (WIDTH, HEIGHT, 1.0, 1.0) if index in panoramas else (96, 64, 70.0, 70.0)
        width, height, fx, fy = size
        rotation, centre = random_rotation(rng), rng.uniform(-2.0, 2.0, 3)
        shots.append(write.Shot(f"{index}.exr", width, height, fx, fy, 0.5 * width, 0.5 * height, rotation, centre))
    return shots


def write_images(folder: Path, shots: list[write.Shot]) -> None:
    """What each shot sees."""
    for shot in shots:
        if shot.width == 2 * shot.height:
            local = panorama_rays() * [1.0, -1.0, 1.0]  # Y down
        else:
            x, y = np.meshgrid(np.arange(shot.width) + 0.5 - shot.cx, np.arange(shot.height) + 0.5 - shot.cy)
            local = np.stack([x / shot.fx, y / shot.fy, np.ones_like(x)], axis=-1)
            local /= np.linalg.norm(local, axis=-1, keepdims=True)
        write_exr(folder / shot.name, radiance(local @ shot.rotation).astype(np.float32))


def in_transforms(folder: Path, shots: list[write.Shot]) -> None:
    """nerfstudio: cameras look along -Z, Y is up; some programs write a focal length of panoramas, too."""
    frames = []
    for shot in shots:
        pose = shot.pose @ np.diag([1.0, -1.0, -1.0, 1.0])
        frame = {"file_path": f"images/{shot.name}", "transform_matrix": pose.tolist()}
        if shot.width == 2 * shot.height:
            frame |= {"camera_model": "EQUIRECTANGULAR", "fl_x": shot.height, "fl_y": shot.height}
        frames.append(frame)
    flat = next((shot for shot in shots if shot.width != 2 * shot.height), shots[0])
    common = {"fl_x": flat.fx, "fl_y": flat.fy, "w": flat.width, "h": flat.height, "k1": 0.0}
    folder.mkdir()
    (folder / "transforms.json").write_text(json.dumps({**common, "frames": frames}))


def in_colmap(folder: Path, shots: list[write.Shot]) -> None:
    """COLMAP: Z forward, Y down."""
    samples = []
    for shot in shots:
        lens = Lens("PINHOLE", (shot.fx, shot.fy, shot.cx, shot.cy))
        if shot.width == 2 * shot.height:
            lens = Lens("EQUIRECTANGULAR", (float(shot.width), float(shot.height)))
        samples.append(Sample(Path(shot.name).stem, shot.width, shot.height, lens, shot.pose))
    write_colmap(folder, samples, text=False)


def in_metashape(folder: Path, shots: list[write.Shot]) -> None:
    """Metashape: Z forward, Y down; spherical sensors have no calibration."""
    document = metashape_chunk(Chunk(shots, 2.0, random_rotation(np.random.default_rng(1)), np.array([1.0, 2.0, 3.0])))
    for index, shot in enumerate(shots):
        if shot.width == 2 * shot.height:
            start = document.index(f'<sensor id="{index}"')
            end = document.index("</sensor>", start)
            sensor = f'<sensor id="{index}" label="x" type="spherical"><resolution width="{WIDTH}" height="{HEIGHT}"/>'
            document = document[:start] + sensor + document[end:]
    write_metashape(folder, [document])


def in_opensfm(folder: Path, shots: list[write.Shot]) -> None:
    """OpenSfM: Z forward, Y down; it solves tone-mapped copies."""
    shots = [replace(shot, name=f"{Path(shot.name).stem}.png") for shot in shots]
    write.write_opensfm(folder, [shots], "perspective")
    with edited_json(folder / "reconstruction.json") as models:
        for index, shot in enumerate(shots):
            if shot.width == 2 * shot.height:
                kind = ("spherical", "equirectangular")[index % 2]
                camera = {"projection_type": kind, "width": WIDTH, "height": HEIGHT}
                models[0]["cameras"][f"camera of {shot.name}"] = camera


def assert_shows(views: list[View], source_from_world: np.ndarray | None = None) -> None:
    """Each pixel has the radiance of its ray, to the error of bilinear interpolation."""
    turn = np.eye(3) if source_from_world is None else source_from_world
    for view in views:
        expected = radiance(view.rays()[1] @ turn.T)
        found = view.radiance().reshape(expected.shape)
        np.testing.assert_allclose(found, expected, atol=3e-3, err_msg=view.name)


@pytest.mark.parametrize("writer", [in_transforms, in_colmap, in_metashape, in_opensfm])
@pytest.mark.parametrize("panoramas", [(2,), (0, 1, 2, 3)])
def test_views_show_what_the_panorama_shows(tmp_path: Path, writer, panoramas: tuple[int, ...]) -> None:
    shots = make_shots(panoramas)
    writer(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    run = RunFolder(tmp_path / "run")
    messages = run_ingest(tmp_path / "in", run, up_axis="z", hold_back=0)
    assert warnings(messages) == []
    views = load_capture(run).views
    assert_shows(list(views))
    faces = [view for view in views if view.panorama]
    assert len(views) == 4 + 5 * len(panoramas) and len(faces) == 6 * len(panoramas)
    assert {Path(view.name).name for view in faces} == {f"{index}@{face}" for index in panoramas for face in FACES}
    for view in faces:
        centre = shots[int(Path(view.panorama or "").name)].centre
        np.testing.assert_allclose(view.camera_to_world[:3, 3], centre, atol=1e-5)
        # All directions, and in the middle the solid angle of the panorama's pixels at the horizon.
        assert view.width == view.height == pytest.approx(2.0 * view.fx)
        assert 1.0 / view.fx == pytest.approx(2.0 * np.pi / WIDTH, rel=0.01)


def test_faces_are_one_photograph(tmp_path: Path) -> None:
    """For what is held back, for the number of photographs and for exposures."""
    shots = make_shots((1, 3, 5), 8)
    in_transforms(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    run = RunFolder(tmp_path / "run")
    run_ingest(tmp_path / "in", run, hold_back=2)
    views = load_capture(run).views
    assert {Path(view.name).name[0] for view in views if view.split == "held_back"} == {"1", "3", "5", "7"}
    assert {Path(view.name).name[0] for view in views if view.split == "train"} == {"0", "2", "4", "6"}
    found = photographs_of(views)
    assert found[0] == 0 and len(np.unique(found)) == 8
    assert {Path(view.name).name[0] for view, number in zip(views, found, strict=True) if number == 1} == {"1"}
    run_ingest(tmp_path / "in", run, views=4, hold_back=0)
    assert len(load_capture(run).views) == 1 + 1 + 1 + 1


def test_masks_are_cut_alike(tmp_path: Path) -> None:
    """The tripod below a panorama, and ids."""
    shots = make_shots((0,), 2)
    in_transforms(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[HEIGHT * 3 // 4 :] = 0  # more than 45 degrees below the horizon
    (tmp_path / "in" / "masks").mkdir()
    (tmp_path / "in" / "parts").mkdir()
    Image.fromarray(mask).save(tmp_path / "in" / "masks" / "0.png")
    Image.fromarray((panorama_rays()[..., 0] > 0.0).astype(np.uint8)).save(tmp_path / "in" / "parts" / "0.png")
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][0]["mask_path"] = "masks/0.png"
    run = RunFolder(tmp_path / "run")
    run_ingest(tmp_path / "in", run, hold_back=0)
    views = {Path(view.name).name: view for view in load_capture(run).views}
    down, front, right = (views[f"0@{face}"] for face in ("down", "front", "right"))
    x, y = np.meshgrid((np.arange(down.width) + 0.5) / down.fx - 1.0, (np.arange(down.width) + 0.5) / down.fx - 1.0)
    assert (down.masked() == (np.hypot(x, y) < 1.0)).mean() > 0.97
    assert not front.masked()[:-2].any()
    assert (front.part_ids() == (x > 0.0)).mean() > 0.97 and (right.part_ids() == 1).all()


def test_a_panorama_is_placed_by_hand(tmp_path: Path) -> None:
    """In the imported scene, whatever is up in the capture and its unit; its centre looks where it is headed."""
    shots = make_shots((), 3)
    in_transforms(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    (tmp_path / "masks").mkdir()
    heading = math.radians(30.0)
    right, forward = (
        np.array([math.cos(heading), math.sin(heading), 0]),
        np.array([-math.sin(heading), math.cos(heading), 0]),
    )
    rays = panorama_rays() @ np.stack([right, [0.0, 0.0, 1.0], forward])
    write_exr(tmp_path / "middle.exr", radiance(rays).astype(np.float32))
    Image.fromarray(np.full((HEIGHT, WIDTH), 255, np.uint8)).save(tmp_path / "masks" / "middle.png")
    run = RunFolder(tmp_path / "run")
    placed = {"panorama": tmp_path / "middle.exr", "panorama_place": (1.0, 2.0, 1.5), "panorama_heading": 30.0}
    run_ingest(tmp_path / "in", run, up_axis="y", scale=2.0, hold_back=2, **placed)
    faces = [view for view in load_capture(run).views if view.panorama == "middle"]
    assert len(faces) == 6 and all(view.split == "train" and view.mask for view in faces)
    assert_shows(faces)
    for view in faces:
        np.testing.assert_allclose(view.camera_to_world[:3, 3], (1.0, 2.0, 1.5), atol=1e-9)
    front = next(view for view in faces if view.name.endswith("@front"))
    np.testing.assert_allclose(front.camera_to_world[:3, 2], forward, atol=1e-9)
    for bad in ((1.0, 2.0), (1.0, 2.0, math.nan)):
        assert error_of(run_ingest, tmp_path / "in", run, **{**placed, "panorama_place": bad}).code == "setting-invalid"


def test_what_is_no_whole_panorama_is_refused(tmp_path: Path) -> None:
    shots = make_shots((0,), 2)
    in_transforms(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    path, run = tmp_path / "in" / "images" / "0.exr", RunFolder(tmp_path / "run")
    write_exr(path, read_radiance(path)[: HEIGHT // 2])
    error = error_of(run_ingest, tmp_path / "in", run)
    assert error.code == "panorama-shape" and "256 x 64" in error.text and error.remedy
    assert not run.root.exists()


def test_a_panorama_with_the_camera_of_a_photograph_is_refused(tmp_path: Path) -> None:
    """A solver that does not know panoramas takes them for photographs of a small field of view."""
    shots = make_shots((), 2)
    in_transforms(tmp_path / "in", shots)
    write_images(tmp_path / "in" / "images", shots)
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][0] |= {"file_path": "images/a.jpg", "w": 64, "h": 32}
    packet = b'<rdf:Description GPano:ProjectionType="equirectangular"/>'
    file = tmp_path / "in" / "images" / "a.jpg"
    Image.fromarray(np.full((32, 64, 3), 90, np.uint8)).save(file, xmp=packet)
    error = error_of(run_ingest, tmp_path / "in", RunFolder(tmp_path / "run"))
    assert error.code == "camera-model" and "panorama" in error.text


LENS_WIDTH, LENS_HEIGHT = 160, 120
LENSES = [
    Lens("SIMPLE_RADIAL", (150.0, 80.0, 60.0, 0.15)),
    Lens("RADIAL", (150.0, 84.0, 57.0, -0.1, 0.03)),
    Lens("OPENCV", (150.0, 135.0, 77.0, 63.0, -0.2, 0.05, 0.004, -0.003)),
    Lens("FULL_OPENCV", (150.0, 150.0, 80.0, 60.0, -0.1, 0.02, 0.001, 0.0, 0.01, 0.0, 0.0, 0.0)),
    Lens("OPENCV_FISHEYE", (110.0, 105.0, 80.0, 60.0, 0.02, 0.0, 0.0, 0.0)),
    Lens("SIMPLE_FISHEYE", (110.0, 80.0, 60.0)),
    Lens("FOV", (150.0, 150.0, 80.0, 60.0, 0.4)),
    Lens("EUCM", (130.0, 130.0, 80.0, 60.0, 0.5, 1.1)),
]


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) in direction (x, y, 1): smooth, with values far above 1 and close to 0."""
    return np.stack([50.0 + 45.0 * np.sin(9.0 * x), np.exp(4.0 * y), 1e-3 * (2.0 + np.cos(8.0 * (x + y)))], -1)


def parts(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where(x + 0.3 * y > 0.05, 1000, 7).astype(np.int32)


def seen_through(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Directions x, y (LENS_HEIGHT, LENS_WIDTH) of the distorted image's pixel centres."""
    columns, rows = np.meshgrid(np.arange(LENS_WIDTH) + 0.5, np.arange(LENS_HEIGHT) + 0.5)
    positions = np.stack([columns.ravel(), rows.ravel()], axis=1)
    directions = np.asarray(lens_camera(lens, LENS_WIDTH, LENS_HEIGHT).cam_from_img(positions))
    return directions[:, 0].reshape(LENS_HEIGHT, LENS_WIDTH), directions[:, 1].reshape(LENS_HEIGHT, LENS_WIDTH)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_undistorted_pattern_is_the_pinholes(lens):
    assert is_distorted(lens, LENS_WIDTH, LENS_HEIGHT)
    x, y = seen_through(lens)
    resampling = Undistortion(lens, LENS_WIDTH, LENS_HEIGHT)
    pinhole = resampling.pinhole
    assert pinhole == undistorted_pinhole(lens, LENS_WIDTH, LENS_HEIGHT)
    image, ids = resampling.image(pattern(x, y).astype(np.float32)), resampling.ids(parts(x, y))
    assert image.shape == (pinhole.height, pinhole.width, 3) and image.dtype == np.float32
    u, v = np.meshgrid(
        (np.arange(pinhole.width) + 0.5 - pinhole.cx) / pinhole.fx,
        (np.arange(pinhole.height) + 0.5 - pinhole.cy) / pinhole.fy,
    )
    # bilinear error of these sines is below 0.2 % of their range; half a pixel's shift would be 3 %
    np.testing.assert_allclose(image / [95.0, 1.0, 3e-3], pattern(u, v) / [95.0, 1.0, 3e-3], atol=4e-3, rtol=4e-3)
    assert set(np.unique(ids)) == {7, 1000}  # nearest neighbour does not interpolate ids
    assert (ids != parts(u, v)).mean() < 0.01


def test_without_distortion_the_lens_is_a_pinhole():
    for lens in (
        Lens("PINHOLE", (150.0, 135.0, 70.0, 66.0)),
        Lens("OPENCV", (150.0, 135.0, 70.0, 66.0, 0.0, 0.0, 0.0, 0.0)),
    ):
        assert not is_distorted(lens, LENS_WIDTH, LENS_HEIGHT)
        pinhole = lens_pinhole(lens, LENS_WIDTH, LENS_HEIGHT)
        assert (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy) == (150.0, 135.0, 70.0, 66.0)


@pytest.mark.parametrize(
    "lens",
    [
        Lens("EQUIRECTANGULAR", ()),
        Lens("PINHOLE", (1.0, 2.0)),
        Lens("NO_SUCH_MODEL", (1.0,)),
        Lens("OPENCV", (150.0, 150.0, 80.0, 60.0, 40.0, -900.0, 0.0, 0.0)),
    ],
)
def test_lenses_that_cannot_be_undone(lens):
    assert error_of(undistorted_pinhole, lens, LENS_WIDTH, LENS_HEIGHT).code == "camera-model"

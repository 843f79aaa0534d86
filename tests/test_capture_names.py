# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs and masks are found by the name that a person sees, whichever program has written it how."""

from __future__ import annotations

import itertools
import json
import os
import random
import unicodedata
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pycolmap
import pytest
from PIL import Image

from fipt_blender.core.capture.files import Folders
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.prepare.models import WantedView, model_from_rig
from samples import rig_writers as write
from samples.child_processes import posix
from samples.combinations import pairs
from samples.ingesting import run_ingest, warnings
from samples.metashape_writers import (
    Chunk,
    metashape_chunk,
    write_metashape,
    write_realityscan_colmap,
    write_realityscan_csv,
    write_realityscan_xmp,
)
from samples.refusals import error_of
from samples.rig_checks import CENTRED, read

STEMS = ("Küche été 0001", "Küche été 0002", "Café nº 7")
Writer = Callable[[Path, list[write.Shot]], None]


def write_transforms(folder: Path, shots: list[write.Shot]) -> None:
    frames = []
    for shot in shots:
        pose = shot.pose
        pose[:3, 1:3] *= -1.0
        lens = {"fl_x": shot.fx, "fl_y": shot.fy, "cx": shot.cx, "cy": shot.cy}
        size = {"w": shot.width, "h": shot.height}
        frames.append({"file_path": shot.name, "transform_matrix": pose.tolist(), **lens, **size})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))


def write_colmap_binary(folder: Path, shots: list[write.Shot]) -> None:
    write_realityscan_colmap(folder, shots)
    model = pycolmap.Reconstruction(str(folder))
    model.write_binary(str(folder))
    for file in folder.glob("*.txt"):
        file.unlink()


# Formats whose cameras name photographs freely.
WRITERS: dict[str, Writer] = {
    "transforms": write_transforms,
    "colmap": write_realityscan_colmap,
    "colmap-binary": write_colmap_binary,
    "metashape": lambda folder, shots: write_metashape(folder, [metashape_chunk(Chunk(shots))]),
    "blocksexchange": write.write_blocksexchange,
    "realityscan": write_realityscan_csv,
    "meshroom": lambda folder, shots: write.write_meshroom(folder, shots, (1, 2, 8)),
    "opensfm": lambda folder, shots: write.write_opensfm(folder, [shots], "perspective"),
    "openmvg": lambda folder, shots: write.write_openmvg(folder, shots, "pinhole", ""),
    "bundler": write.write_bundler,
    "nvm": lambda folder, shots: write.write_nvm(folder, [shots]),
    "scannetpp": lambda folder, shots: write.write_scannetpp(folder, shots, len(shots)),
}
LABELS = ("metashape",)  # have names without folders
ANYWHERE = [kind for kind in WRITERS if kind != "scannetpp"]  # have photographs in any folder


def write_capture(kind: str, folder: Path, names: list[str], files: list[str]) -> list[write.Shot]:
    """A capture whose camera file has these names, and photographs at these paths below its folder."""
    folder.mkdir(parents=True)
    shots = write.make_shots(write.Style(off_centre=CENTRED), len(names))
    if kind == "scannetpp":  # all frames have one camera
        shots = [write.Shot(**{**vars(shots[0]), "rotation": shot.rotation, "centre": shot.centre,
                               "name": shot.name}) for shot in shots]  # fmt: skip
    WRITERS[kind](folder, shots)
    cameras = [file for file in folder.rglob("*") if file.is_file() and file.suffix not in (".jpg", ".png")]
    for file in folder.rglob("*.jpg"):
        file.unlink()
    for shot, name in zip(shots, names, strict=True):
        for file in cameras:
            if file.suffix == ".bin":
                continue
            text = file.read_text(encoding="utf-8")
            escaped = json.dumps(name)[1:-1] if file.suffix in (".json", ".sfm") else name
            old = f'"{Path(shot.name).stem}"' if kind == "metashape" else shot.name
            text = text.replace(f"B:\\\\photos\\\\{old}", old).replace(f"images/{old}", old)
            text = text.replace(f"./{old}", old)
            file.write_text(text.replace(old, quoteattr(name) if kind == "metashape" else escaped), encoding="utf-8")
    if kind == "colmap-binary":
        model = pycolmap.Reconstruction(str(folder))
        for index, name in enumerate(names, start=1):
            model.images[index].name = name
        model.write_binary(str(folder))
    root = folder / "dslr" if kind == "scannetpp" else folder
    for index, (shot, file) in enumerate(zip(shots, files, strict=True)):
        path = root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (shot.width, shot.height), (40 * index, 90, 90)).save(path, "JPEG")
    return shots


def assert_found(folder: Path, shots: list[write.Shot], files: list[str]) -> None:
    views = {view.image: view for view in read(folder).views}
    for shot, file in zip(shots, files, strict=True):
        root = folder / "dslr" if (folder / "dslr").is_dir() else folder
        np.testing.assert_allclose(views[root / file].camera_to_world, shot.pose, atol=1e-5)
    assert len(views) == len(shots)


# --------------------------------------------------------------------------------------- the generated family

PREFIXES = ("", "./", "images/", "images\\", "C:\\Users\\me\\shoot 3\\images\\", "/home/me/shoot 3/", ".\\images/")
CASES: tuple[Callable[[str], str], ...] = (str, str.upper, str.lower)
FORMS = ("NFC", "NFD")
SUFFIXES = (".jpg", ".JPG", "", ".jpeg", ".CR2")
FOLDERS = ("images", "images", "Images", "", "shoot 3/images", "photos/day 1")
STYLES = [*itertools.product(PREFIXES, CASES, FORMS, SUFFIXES, FOLDERS, CASES, FORMS, (".jpg", ".JPG", ".Jpg"))]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", WRITERS)
def test_names_of_any_style(tmp_path: Path, kind: str, seed: int) -> None:
    """Slashes, drives, dots, blanks, case, accents, suffix given or not or another one, and subfolders."""
    chosen = random.Random(f"{kind} {seed}")
    prefix, case, form, suffix, folder, other_case, other_form, other_suffix = chosen.choice(STYLES)
    if kind in LABELS:
        prefix = ""
    if kind not in ANYWHERE:
        prefix, folder = prefix.replace("images", "resized_images"), "resized_images"
    names = [prefix + unicodedata.normalize(form, case(stem)) + suffix for stem in STEMS]
    files = [unicodedata.normalize(other_form, other_case(stem)) + other_suffix for stem in STEMS]
    files = [f"{folder}/{file}" if folder else file for file in files]
    shots = write_capture(kind, tmp_path / "capture", names, files)
    assert_found(tmp_path / "capture", shots, files)


@pytest.mark.parametrize("kind", ANYWHERE)
def test_equal_names_in_several_folders(tmp_path: Path, kind: str) -> None:
    """Folders in the names tell them apart; names without are refused with a list, for all of the cameras."""
    files = ["photos/day/0001.jpg", "photos/night/0001.jpg"]
    if kind not in LABELS:
        for index, start in enumerate(("", "./", "D:\\old\\", "/old/", "photos\\")):
            names = [start + file.removeprefix("photos/").replace("/", "/\\"[index % 2]) for file in files]
            shots = write_capture(kind, tmp_path / str(index), names, files)
            assert_found(tmp_path / str(index), shots, files)
    write_capture(kind, tmp_path / "plain", ["0001.jpg", "other.jpg"], [*files])
    first, second = (tmp_path / "plain" / file for file in files)
    second.write_bytes(first.read_bytes())  # otherwise the one of the camera's size would be taken
    error = error_of(read, tmp_path / "plain")
    assert error.code == "file-ambiguous" and all(str(Path(file)) in error.text for file in files)


@pytest.mark.parametrize("kind", ANYWHERE)
def test_one_file_is_never_that_of_two_cameras(tmp_path: Path, kind: str) -> None:
    """The folders of the names are gone, so that both lead to the one file that is left."""
    names = ["0001.jpg"] * 2 if kind in LABELS else ["day/0001.jpg", "night/0001.jpg"]
    write_capture(kind, tmp_path / "capture", names, ["images/0001.jpg", "images/0002.jpg"])
    error = error_of(read, tmp_path / "capture")
    assert error.code == "file-ambiguous" and "0001.jpg" in error.text


@pytest.mark.parametrize("kind", [kind for kind in ANYWHERE if kind not in LABELS])
@pytest.mark.parametrize("start", ["", "D:\\old\\"])
def test_a_photograph_in_the_folder_of_other_cameras_is_not_taken(tmp_path: Path, kind: str, start: str) -> None:
    """The photograph of day/1 is gone; that of night/1 has no camera."""
    names = [f"{start}day/1.jpg", f"{start}night/2.jpg"]
    write_capture(kind, tmp_path / "in", names, ["photos/night/1.jpg", "photos/night/2.jpg"])
    error = error_of(run_ingest, tmp_path / "in", RunFolder(tmp_path / "run"), hold_back=0)
    assert error.code == "image-missing" and "1.jpg" in error.text


@pytest.mark.parametrize("kind", ANYWHERE)
def test_what_is_not_found_is_told_alike(tmp_path: Path, kind: str) -> None:
    write_capture(kind, tmp_path / "in", ["kitchen_1.jpg", "hall.jpg"], ["images/kitchen-1.jpg", "hall.jpg"])
    run = RunFolder(tmp_path / "run")
    error = error_of(run_ingest, tmp_path / "in", run, hold_back=0)
    assert error.code == "image-missing" and "--images" in error.remedy and not run.root.exists()
    assert "kitchen_1.jpg'" in error.text and "kitchen-1.jpg" in error.text.partition("Similar")[2]
    if kind not in ("bundler", "nvm", "realityscan"):  # they need all photographs for their sizes
        assert "1 of 2" in error.text


# ------------------------------------------------------------------------------------- formats of fixed names


def upper(folder: Path, ends: tuple[str, ...]) -> None:
    for file in [*folder.rglob("*")]:
        if file.name.endswith(ends):
            file.rename(file.with_suffix(file.suffix.upper()))


def test_suffixes_of_fixed_layouts_in_upper_case(tmp_path: Path) -> None:
    from samples.capture_files import make_samples, write_fipt_real, write_fipt_synthetic
    from samples.rgbd_frames import write_exported_scan, write_frames

    shots = write.make_shots(write.Style(off_centre=CENTRED), 3)
    write.write_polycam(tmp_path / "polycam", shots, np.eye(4), True)
    (tmp_path / "polycam" / "keyframes" / "depth").mkdir()
    Image.fromarray(np.full((6, 8), 1000, np.uint16)).save(
        tmp_path / "polycam" / "keyframes" / "depth" / "IMG_0000.png"
    )
    write.write_record3d(tmp_path / "record3d", [shots[0], shots[2]], True)
    for index, name in enumerate(("IMG_0000.jpg", "IMG_0002.jpg")):
        (tmp_path / "record3d" / "rgb" / name).rename(tmp_path / "record3d" / "rgb" / f"{index}.jpg")
    write_realityscan_xmp(tmp_path / "xmp", shots)
    write_frames(tmp_path / "rgbd", 2, (60, 40), 50.0)
    write_exported_scan(tmp_path / "scannet", (60, 40), 50.0)
    write_fipt_real(tmp_path / "real", make_samples(2))
    write_fipt_synthetic(tmp_path / "synthetic", {"train": [np.eye(4)], "val": [np.eye(4)]}, True)
    for folder in sorted(tmp_path.iterdir()):
        before = read(folder)
        upper(folder, (".jpg", ".png", ".exr", ".pose.txt"))
        after = read(folder)
        assert [view.name for view in after.views] == [view.name for view in before.views]
        assert len(after.depths) == len(before.depths) and not after.notes
        for one, other in zip(before.views, after.views, strict=True):
            for kind in ("image", "parts", "semantics"):
                path = getattr(one, kind)
                expected = path and path.with_suffix(path.suffix.upper())
                assert getattr(other, kind) == expected, (folder.name, kind)


@pytest.mark.parametrize("folder", ["dense/sparse", "sparse/0", "sparse"])
def test_images_of_the_size_of_their_cameras(tmp_path: Path, folder: str) -> None:
    """COLMAP's undistorted photographs have other sizes than the originals beside them."""
    shots = write.make_shots(write.Style(off_centre=CENTRED), 2)
    write_realityscan_colmap(tmp_path / "solve", shots)
    (tmp_path / "capture" / "dense").mkdir(parents=True)
    (tmp_path / "solve" / "images").rename(tmp_path / "capture" / "dense" / "images")
    (tmp_path / "capture" / folder).parent.mkdir(exist_ok=True)
    (tmp_path / "solve").rename(tmp_path / "capture" / folder)
    larger = [write.Shot(**{**vars(shot), "width": shot.width + 8}) for shot in shots]
    write.write_photographs(tmp_path / "capture" / "images", larger)
    images = [view.image for view in read(tmp_path / "capture").views]
    assert images == [tmp_path / "capture" / "dense" / "images" / shot.name for shot in shots]


# ------------------------------------------------------------------------------------------- byte-order marks


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("kind", [kind for kind in ANYWHERE if kind != "colmap-binary"])
def test_byte_order_marks(tmp_path: Path, kind: str, encoding: str) -> None:
    names = [f"{stem}.jpg" for stem in STEMS]
    files = [f"images/{name}" for name in names]
    shots = write_capture(kind, tmp_path / "in", names, files)
    for file in (tmp_path / "in").rglob("*"):
        if file.suffix in (".json", ".xml", ".csv", ".txt", ".out", ".nvm", ".sfm"):
            file.write_text(file.read_text(encoding="utf-8").replace("\n", "\r\n"), encoding=encoding, newline="")
    assert_found(tmp_path / "in", shots, files)


# ----------------------------------------------------------------------------------------------------- splits


@pytest.mark.parametrize(
    ("frame", "listed", "missing"),
    pairs(
        ("images/{}.jpg", "./images/{}.jpg", "images\\{}.JPG", "images/{}"),
        ("images/{}.jpg", "./images/{}.jpg", ".\\images\\{}.jpg", "images/{}"),
        (False, True),
    ),
)
def test_splits_name_photographs_in_any_style(tmp_path: Path, frame: str, listed: str, missing: bool) -> None:
    names = [frame.format(index) for index in range(4)]
    write_capture("transforms", tmp_path / "in", names, [f"images/{index}.jpg" for index in range(4)])
    path = tmp_path / "in" / "transforms.json"
    data = json.loads(path.read_text())
    data.update(train_filenames=[listed.format(0), listed.format(1)], val_filenames=[listed.format(3)])
    path.write_text(json.dumps({**data, "test_filenames": [listed.format(2), "images/gone.jpg"]}))
    if missing:
        for file in (tmp_path / "in" / "images").iterdir():
            file.unlink()
    rig = read(tmp_path / "in")
    assert [view.split for view in rig.views] == ["train", "train", "held_back", "held_back"]
    (note,) = rig.notes
    assert note.code == "splits-unknown" and "1 of 5" in note.text and "images/gone.jpg" in note.text


# ------------------------------------------------------------------------------------------------------ masks


@pytest.mark.parametrize("name", ["masks\\0.png", ".\\masks/0.PNG", "C:\\me\\masks\\0.png", "/me/masks/0.png", "0"])
def test_masks_of_any_style(tmp_path: Path, name: str) -> None:
    write_capture("transforms", tmp_path / "in", ["images/0.jpg", "images/1.jpg"], ["images/0.jpg", "images/1.jpg"])
    path = tmp_path / "in" / "transforms.json"
    data = json.loads(path.read_text())
    data["frames"][0]["mask_path"] = name
    path.write_text(json.dumps(data))
    mask = tmp_path / "in" / "masks" / "0.png"
    if name.startswith("/"):
        assert error_of(read, tmp_path / "in").code == "path-outside"
    else:
        assert read(tmp_path / "in").views[0].missing  # the mask is never the photograph itself
    mask.parent.mkdir()
    Image.new("L", (480, 320), 255).save(mask)
    first, second = read(tmp_path / "in").views
    assert first.mask == mask and second.mask is None and not first.missing


def test_id_images_of_other_folders_are_not_taken(tmp_path: Path) -> None:
    files = ["train/r_0.png", "val/r_0.png", "r_1.png"]
    write_capture("transforms", tmp_path / "in", ["./train/r_0", "./val/r_0", "./r_1"], files)
    for name in ("train/r_0.png", "day/r_1.png", "night/r_0.png"):
        (tmp_path / "in" / "parts" / name).parent.mkdir(parents=True)
        (tmp_path / "in" / "parts" / name).write_bytes(b"")
    parts = {view.name: view.parts for view in read(tmp_path / "in").views}
    folder = tmp_path / "in" / "parts"
    assert parts == {"train/r_0": folder / "train/r_0.png", "val/r_0": None, "r_1": folder / "day/r_1.png"}


def test_one_id_image_is_never_that_of_two_photographs(tmp_path: Path) -> None:
    files = ["images/a/0.jpg", "images/b/0.jpg"]
    write_capture("colmap", tmp_path / "in", ["a/0.jpg", "b/0.jpg"], files)
    for place in ("a", "b"):
        (tmp_path / "in" / "parts" / place).mkdir(parents=True)
        (tmp_path / "in" / "parts" / place / "0.png").write_bytes(b"")
    views = read(tmp_path / "in").views
    assert [view.parts for view in views] == [tmp_path / "in" / "parts" / place / "0.png" for place in "ab"]
    (tmp_path / "in" / "parts" / "a" / "0.png").rename(tmp_path / "in" / "parts" / "0.png")
    (tmp_path / "in" / "parts" / "b" / "0.png").unlink()
    error = error_of(read, tmp_path / "in")
    assert error.code == "file-ambiguous" and str(tmp_path / "in" / "parts" / "0.png") in error.text


# ---------------------------------------------------------------------------------------- what lies unused


@pytest.mark.parametrize("kind", ANYWHERE)
def test_files_that_lie_unused_are_told(tmp_path: Path, kind: str) -> None:
    files = [f"images/{index}.jpg" for index in range(3)]
    names = [file.rpartition("/")[2] for file in files]
    write_capture(kind, tmp_path / "in", names, files)
    root = tmp_path / "in"
    assert not read(tmp_path / "in").notes
    for index in range(12):
        (root / "images" / f"more{index:02d}.jpg").write_bytes((root / files[0]).read_bytes())
    (root / "parts").mkdir()
    for name in ("0.png", "7.png", "more00.png"):
        Image.new("L", (480, 320)).save(root / "parts" / name)
    messages = run_ingest(tmp_path / "in", RunFolder(tmp_path / "run"), hold_back=0)
    told = {message["code"]: message["text"] for message in messages if message["type"] == "warning"}
    assert told["images-unused"].startswith("12 ") and "more00.jpg" in told["images-unused"]
    assert told["masks-unused"].startswith("2 ") and "7.png" in told["masks-unused"]
    assert set(warnings(messages)) == {"images-unused", "masks-unused", "images-not-hdr"}


@pytest.mark.parametrize("value", ["false", "False", "0"])
def test_cameras_that_are_switched_off_in_metashape(tmp_path: Path, value: str) -> None:
    names = [f"{index}.jpg" for index in range(3)]
    write_capture("metashape", tmp_path / "in", names, names)
    path = tmp_path / "in" / "cameras.xml"
    path.write_text(path.read_text().replace('label="1.jpg" enabled="true"', f'label="1.jpg" enabled="{value}"'))
    rig = read(tmp_path / "in")
    assert [view.name for view in rig.views] == ["0", "2"]
    assert "cameras-off" in [note.code for note in rig.notes] and "1.jpg" in rig.notes[0].text


def test_cameras_that_are_switched_off_in_realityscan(tmp_path: Path) -> None:
    write_realityscan_xmp(tmp_path, write.make_shots(write.Style(off_centre=CENTRED), 3))
    for index, value in enumerate("101"):
        path = tmp_path / f"IMG_{index:04d}.xmp"
        path.write_text(path.read_text().replace('xcr:Skew="0"', f'xcr:Skew="0" xcr:InTexturing="{value}"'))
    rig = read(tmp_path)
    assert [view.name for view in rig.views] == ["IMG_0000", "IMG_0002"]
    assert [note.code for note in rig.notes] == ["cameras-off"] and "IMG_0001" in rig.notes[0].text


# ------------------------------------------------------------------------------------------------- the search


def test_a_name_that_is_spelled_exactly_wins(tmp_path: Path) -> None:
    for name in ("img.jpg", "IMG.JPG", "other.jpg", "OTHER.jpg"):
        (tmp_path / name).write_bytes(b"")
    if len(list(tmp_path.iterdir())) < 4:
        pytest.skip("the file system ignores case")
    folders = Folders()
    assert folders.find("img.jpg", [tmp_path]).path == tmp_path / "img.jpg"
    assert folders.find("x\\IMG.JPG", [tmp_path]).path == tmp_path / "IMG.JPG"
    error = error_of(folders.find, "Other.jpg", [tmp_path])
    assert error.code == "file-ambiguous" and "OTHER.jpg" in error.text and "other.jpg" in error.text


def test_a_name_without_suffix_has_one_photograph(tmp_path: Path) -> None:
    """Of RAW and JPEG the one that can be read; two that can be read are no longer one photograph."""
    for name in ("a.CR2", "a.JPG", "a.xmp", "a.txt", "b.png", "b.jpg", "frame.0001.jpg", "frame.0002.jpg"):
        (tmp_path / name).write_bytes(b"")
    folders = Folders()
    assert folders.find("a", [tmp_path]).path == tmp_path / "a.JPG"
    assert folders.find("a.dng", [tmp_path]).path == tmp_path / "a.JPG"
    assert folders.find("b.jpg", [tmp_path]).path == tmp_path / "b.jpg"
    assert folders.find("frame.0002", [tmp_path]).path == tmp_path / "frame.0002.jpg"
    assert folders.find("frame", [tmp_path]) is None
    assert error_of(folders.find, "b", [tmp_path]).code == "file-ambiguous"


def test_runs_and_loops_of_links_are_not_searched(tmp_path: Path) -> None:
    (tmp_path / "photos" / "day").mkdir(parents=True)
    (tmp_path / "photos" / "day" / "a.jpg").write_bytes(b"")
    for hidden in ("run/images", ".trash", "masks"):
        (tmp_path / hidden).mkdir(parents=True)
        (tmp_path / hidden / "a.jpg").write_bytes(b"")
    (tmp_path / "run" / "run.json").write_text("{}")
    (tmp_path / "photos" / "again").symlink_to(tmp_path, target_is_directory=True)
    found = Folders().find("C:\\x\\a.jpg", [tmp_path], tmp_path)
    assert found == (tmp_path / "photos" / "day" / "a.jpg", ("a.jpg",))


@posix
def test_pipes_and_broken_links_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.jpg")
    (tmp_path / "b.jpg").symlink_to(tmp_path / "gone.jpg")
    folders = Folders()
    assert folders.find("a.jpg", [tmp_path], tmp_path) is folders.find("b", [tmp_path], tmp_path) is None


def test_no_name_leads_out_of_the_folders(tmp_path: Path) -> None:
    (tmp_path / "secret.jpg").write_bytes(b"")
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "own.jpg").write_bytes(b"")
    folders = Folders()
    for start in ("", "../", "..\\", f"{tmp_path}/", "x/../../", "C:\\", "//server/share/", "\\\\server\\share\\"):
        assert folders.find(f"{start}secret.jpg", [tmp_path / "capture"], tmp_path / "capture") is None
        found = folders.find(f"{start}own.jpg", [tmp_path / "capture"], tmp_path / "capture")
        assert found.path == tmp_path / "capture" / "own.jpg"


# -------------------------------------------------------------------------------------------- existing solves


def test_existing_solves_find_groups_by_paths(tmp_path: Path) -> None:
    write_capture("colmap", tmp_path / "in", ["day/1.jpg", "night/1.jpg"], ["day/1.jpg", "night/1.jpg"])
    rig = read_rig(tmp_path / "in", "auto", CaptureOptions())
    wanted = [WantedView("1", 480, 320, ("1", "Day/1.CR2")), WantedView("1_2", 320, 480, ("1_2", "night\\1.CR2"))]
    wanted[1] = WantedView("1_2", 320, 480, ("1_2", "night/1.CR2"))
    model = model_from_rig(rig, wanted)
    for number, view in enumerate(rig.views, start=1):
        found = np.linalg.inv(np.vstack([model.images[number].cam_from_world().matrix(), [0, 0, 0, 1]]))
        np.testing.assert_allclose(found, view.camera_to_world, atol=1e-6)
    for wanted in ([WantedView("1", 480, 320, ("1",))],
                   [WantedView(name, 480, 320, ("day/1.CR2",)) for name in ("1", "2")]):  # fmt: skip
        assert error_of(model_from_rig, rig, wanted).code == "file-ambiguous"

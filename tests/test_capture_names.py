"""Photographs and masks are found by the name that a person sees, whichever program has written it how."""

from __future__ import annotations

import itertools
import json
import os
import random
import re
import shutil
import unicodedata
from collections.abc import Callable
from dataclasses import replace
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
from fipt_blender.prepare.solve_step import model_from_rig
from fipt_blender.prepare.solving import SolveView
from samples import rig_writers as write
from samples.capture_files import make_samples, write_fipt_real, write_fipt_synthetic
from samples.capture_files import write_mesh as write_triangle
from samples.capture_files import write_transforms as write_sample_transforms
from samples.child_processes import posix
from samples.combinations import pairs
from samples.ingesting import edited_json, run_ingest
from samples.metashape_writers import (
    Chunk,
    metashape_chunk,
    write_metashape,
    write_realityscan_colmap,
    write_realityscan_csv,
    write_realityscan_xmp,
)
from samples.refusals import error_of
from samples.rgbd_frames import write_exported_scan, write_frames
from samples.rig_checks import CENTRED, read

STEMS = ("Küche été 0001", "Küche été 0002", "Café nº 7")
Writer = Callable[[Path, list[write.Shot]], None]


def write_transforms(folder: Path, shots: list[write.Shot]) -> None:
    frames = []
    for shot in shots:
        pose = (shot.pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
        lens = {"fl_x": shot.fx, "fl_y": shot.fy, "cx": shot.cx, "cy": shot.cy, "w": shot.width, "h": shot.height}
        frames.append({"file_path": shot.name, "transform_matrix": pose, **lens})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))


# Formats whose cameras name photographs freely.
WRITERS: dict[str, Writer] = {
    "transforms": write_transforms,
    "colmap": write_realityscan_colmap,
    "colmap-binary": write_realityscan_colmap,
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
CAMERA_FILES = (".json", ".sfm", ".xml", ".csv", ".txt", ".out", ".nvm")
ANYWHERE = [kind for kind in WRITERS if kind != "scannetpp"]  # have photographs in any folder
WITH_FOLDERS = [kind for kind in ANYWHERE if kind != "metashape"]  # name them


def write_capture(kind: str, folder: Path, names: list[str], files: list[str]) -> list[write.Shot]:
    """A capture whose camera file has these names, and photographs at these paths below its folder."""
    folder.mkdir(parents=True)
    shots = write.make_shots(write.Style(off_centre=CENTRED), len(names))
    if kind == "scannetpp":  # all frames have one camera
        shots = [replace(shots[0], rotation=shot.rotation, centre=shot.centre, name=shot.name) for shot in shots]
    WRITERS[kind](folder, shots)
    if kind == "colmap-binary":
        model = pycolmap.Reconstruction(str(folder))
        for index, name in enumerate(names, start=1):
            model.images[index].name = name
        model.write_binary(str(folder))
    for file in [file for file in folder.rglob("*") if file.suffix in (".jpg", *CAMERA_FILES)]:
        if file.suffix == ".jpg" or kind == "colmap-binary":
            file.unlink()
            continue
        text = file.read_text(encoding="utf-8")
        for shot, name in zip(shots, names, strict=True):
            if kind == "metashape":
                text = text.replace(f'"{Path(shot.name).stem}"', quoteattr(name))
            else:
                name = json.dumps(name)[1:-1] if file.suffix in (".json", ".sfm") else name
                text = re.sub(rf"(B:\\\\photos\\\\|images/|\./)?{shot.name}", lambda _, name=name: name, text)
        file.write_text(text, encoding="utf-8")
    for index, (shot, file) in enumerate(zip(shots, files, strict=True)):
        path = root_of(folder) / file
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (shot.width, shot.height), (40 * index, 90, 90)).save(path, "JPEG")
    add_companions(folder)
    return shots


def add_companions(folder: Path) -> None:
    """What Macs write as ``._NAME`` beside each file on disks of other systems; all readers ignore it."""
    for file in [path for path in folder.rglob("[!.]*") if path.is_file()]:
        (file.parent / f"._{file.name}").write_bytes(bytes.fromhex("0005160700020000") + bytes(200))


def root_of(folder: Path) -> Path:
    return folder / "dslr" if (folder / "dslr").is_dir() else folder


def assert_found(folder: Path, shots: list[write.Shot], files: list[str]) -> None:
    views = {view.image: view.camera_to_world for view in read(folder).views}
    assert len(views) == len(shots)
    for shot, file in zip(shots, files, strict=True):
        np.testing.assert_allclose(views[root_of(folder) / file], shot.pose, atol=1e-5)


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
    if kind == "metashape":
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
    for index, start in enumerate(("", "./", "D:\\old\\", "/old/", "photos\\") if kind in WITH_FOLDERS else ()):
        names = [start + file.removeprefix("photos/").replace("/", "/\\"[index % 2]) for file in files]
        shots = write_capture(kind, tmp_path / str(index), names, files)
        assert_found(tmp_path / str(index), shots, files)
    write_capture(kind, tmp_path / "plain", ["0001.jpg", "other.jpg"], files)
    first, second = (tmp_path / "plain" / file for file in files)
    second.write_bytes(first.read_bytes())  # otherwise the one of the camera's size would be taken
    error = error_of(read, tmp_path / "plain")
    assert error.code == "file-ambiguous" and all(str(Path(file)) in error.text for file in files)


@pytest.mark.parametrize("kind", ANYWHERE)
def test_a_photograph_is_never_that_of_two_or_of_another_camera(tmp_path: Path, kind: str) -> None:
    """Folders of the names are gone, so that both lead to one file; or only the photograph of one camera is."""
    names = ["day/0001.jpg", "night/0001.jpg"] if kind in WITH_FOLDERS else ["0001.jpg"] * 2
    write_capture(kind, tmp_path / "one", names, ["images/0001.jpg", "images/0002.jpg"])
    error = error_of(read, tmp_path / "one")
    assert error.code == "file-ambiguous" and "0001.jpg" in error.text
    for index, start in enumerate(("", "D:\\old\\") if kind in WITH_FOLDERS else ()):
        folder = tmp_path / str(index)
        write_capture(kind, folder, [f"{start}day/1.jpg", f"{start}night/2.jpg"], ["night/1.jpg", "night/2.jpg"])
        error = error_of(run_ingest, folder, RunFolder(tmp_path / "run"), hold_back=0)
        assert error.code == "image-missing" and "1.jpg" in error.text


@pytest.mark.parametrize("kind", WITH_FOLDERS)
def test_names_as_in_web_addresses(tmp_path: Path, kind: str) -> None:
    names = [f"images/my%20room%20{index}.jpg" for index in range(3)]
    files = [f"images/my room {index}.jpg" for index in range(3)]
    shots = write_capture(kind, tmp_path / "capture", names, files)
    assert_found(tmp_path / "capture", shots, files)


@pytest.mark.parametrize("kind", ANYWHERE)
def test_what_is_not_found_is_told_alike(tmp_path: Path, kind: str) -> None:
    write_capture(kind, tmp_path / "in", ["kitchen_1.jpg", "hall.jpg"], ["images/kitchen-1.jpg", "hall.jpg"])
    run = RunFolder(tmp_path / "run")
    error = error_of(run_ingest, tmp_path / "in", run, hold_back=0)
    assert error.code == "image-missing" and "--images" in error.remedy and not run.root.exists()
    assert "kitchen_1.jpg'" in error.text and "kitchen-1.jpg" in error.text.partition("Similar")[2]
    if kind not in ("bundler", "nvm", "realityscan"):  # they need all photographs for their sizes
        assert "1 of 2" in error.text


def test_companions_and_suffixes_of_fixed_layouts_in_upper_case(tmp_path: Path) -> None:
    shots = write.make_shots(write.Style(off_centre=CENTRED), 3)
    write.write_polycam(tmp_path / "polycam", shots, np.eye(4), True)
    depth = tmp_path / "polycam" / "keyframes" / "depth"
    depth.mkdir()
    Image.fromarray(np.full((6, 8), 1000, np.uint16)).save(depth / "IMG_0000.png")
    write.write_record3d(tmp_path / "record3d", [replace(shots[i], name=f"{i // 2}.jpg") for i in (0, 2)], True)
    scanner_shots = [replace(shot, name=f"frame_{index:05d}.jpg") for index, shot in enumerate(shots)]
    write.write_scanner_app(tmp_path / "scanner", scanner_shots)
    write_realityscan_xmp(tmp_path / "xmp", shots)
    write_frames(tmp_path / "rgbd", 2, (60, 40), 50.0)
    write_exported_scan(tmp_path / "scannet", (60, 40), 50.0)
    write_fipt_real(tmp_path / "real", make_samples(2))
    write_fipt_synthetic(tmp_path / "synthetic", {"train": [np.eye(4)], "val": [np.eye(4)]}, True)
    for folder in sorted(tmp_path.iterdir()):
        before = read(folder)
        add_companions(folder)
        for file in [*folder.rglob("[!.]*")]:
            if file.name.endswith((".jpg", ".png", ".exr", ".pose.txt")):
                file.rename(file.with_suffix(file.suffix.upper()))
        after = read(folder)
        assert len(after.depths) == len(before.depths) and not after.notes
        for one, other in zip(before.views, after.views, strict=True):
            assert one.name == other.name
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
    larger = [replace(shot, width=shot.width + 8) for shot in shots]
    write.write_photographs(tmp_path / "capture" / "images", larger)
    images = [view.image for view in read(tmp_path / "capture").views]
    assert images == [tmp_path / "capture" / "dense" / "images" / shot.name for shot in shots]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("kind", [kind for kind in ANYWHERE if kind != "colmap-binary"])
def test_byte_order_marks(tmp_path: Path, kind: str, encoding: str) -> None:
    names = [f"{stem}.jpg" for stem in STEMS]
    files = [f"images/{name}" for name in names]
    shots = write_capture(kind, tmp_path / "in", names, files)
    for file in (tmp_path / "in").rglob("*"):
        if file.suffix in CAMERA_FILES:
            file.write_text(file.read_text(encoding="utf-8").replace("\n", "\r\n"), encoding=encoding, newline="")
    assert_found(tmp_path / "in", shots, files)


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
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data.update(train_filenames=[listed.format(0), listed.format(1)], val_filenames=[listed.format(3)])
        data["test_filenames"] = [listed.format(2), "images/gone.jpg"]
    if missing:
        shutil.rmtree(tmp_path / "in" / "images")
    rig = read(tmp_path / "in")
    assert [view.split for view in rig.views] == ["train", "train", "held_back", "held_back"]
    (note,) = rig.notes
    assert note.code == "splits-unknown" and "1 of 5" in note.text and "images/gone.jpg" in note.text


# ------------------------------------------------------------------------------------------------------ masks


@pytest.mark.parametrize("name", ["masks\\0.png", ".\\masks/0.PNG", "C:\\me\\masks\\0.png", "/me/masks/0.png", "0"])
def test_masks_of_any_style(tmp_path: Path, name: str) -> None:
    write_capture("transforms", tmp_path / "in", ["images/0.jpg", "images/1.jpg"], ["images/0.jpg", "images/1.jpg"])
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][0]["mask_path"] = name
    mask = tmp_path / "in" / "masks" / "0.png"
    if name.startswith("/"):
        assert error_of(read, tmp_path / "in").code == "path-outside"
    else:
        assert read(tmp_path / "in").views[0].missing  # the mask is never the photograph itself
    mask.parent.mkdir()
    Image.new("L", (480, 320), 255).save(mask)
    first, second = read(tmp_path / "in").views
    assert first.mask == mask and second.mask is None and not first.missing


def write_ids(capture: Path, *names: str) -> Path:
    for name in names:
        (capture / "parts" / name).parent.mkdir(parents=True, exist_ok=True)
        (capture / "parts" / name).write_bytes(b"")
    return capture / "parts"


def test_id_images_of_other_folders_are_not_taken(tmp_path: Path) -> None:
    names = ["train/r_0", "val/r_0", "r_1"]
    write_capture("transforms", tmp_path / "in", names, [f"{name}.png" for name in names])
    folder = write_ids(tmp_path / "in", "train/r_0.png", "day/r_1.png", "night/r_0.png")
    parts = {view.name: view.parts for view in read(tmp_path / "in").views}
    assert parts == {"train/r_0": folder / "train/r_0.png", "val/r_0": None, "r_1": folder / "day/r_1.png"}


def test_one_id_image_is_never_that_of_two_photographs(tmp_path: Path) -> None:
    write_capture("colmap", tmp_path / "in", ["a/0.jpg", "b/0.jpg"], ["images/a/0.jpg", "images/b/0.jpg"])
    folder = write_ids(tmp_path / "in", "a/0.png", "b/0.png")
    assert [view.parts for view in read(tmp_path / "in").views] == [folder / "a" / "0.png", folder / "b" / "0.png"]
    shutil.rmtree(folder)
    write_ids(tmp_path / "in", "0.png")
    error = error_of(read, tmp_path / "in")
    assert error.code == "file-ambiguous" and str(folder / "0.png") in error.text


# ---------------------------------------------------------------------------------------- what lies unused


@pytest.mark.parametrize("kind", ANYWHERE)
def test_files_that_lie_unused_are_told(tmp_path: Path, kind: str) -> None:
    names = [f"{index}.jpg" for index in range(3)]
    root = tmp_path / "in"
    write_capture(kind, root, names, [f"images/{name}" for name in names])
    assert not read(root).notes
    for index in range(12):
        shutil.copy(root / "images" / "0.jpg", root / "images" / f"more{index:02d}.jpg")
    (root / "images" / "more00.CR2").write_bytes(b"")  # of another kind than those used
    (root / "parts").mkdir()
    for name in ("0.png", "7.png", "more00.png"):
        Image.new("L", (480, 320)).save(root / "parts" / name)
    messages = run_ingest(root, RunFolder(tmp_path / "run"), hold_back=0)
    told = {message["code"]: message["text"] for message in messages if message["type"] == "warning"}
    assert told.keys() == {"images-unused", "masks-unused", "images-not-hdr"}
    assert told["images-unused"].startswith("12 ") and "more00.jpg" in told["images-unused"]
    assert told["masks-unused"].startswith("2 ") and "7.png" in told["masks-unused"]
    (root / "images" / "dynamic_mask_0.png").touch()  # instant-ngp's, where white is left out
    assert ("dynamic_mask" in str(read(root).notes)) == (kind == "transforms")


@pytest.mark.parametrize(
    "name",
    ["masks/{0}.jpg.png", "masks/{0}.png", "mask/{0}_mask.png", "images/{0}.jpg.mask.png", "images/{0}_mask.png"],
)
@pytest.mark.parametrize("kind", ["colmap", "transforms"])
def test_masks_are_found_where_programs_write_them(tmp_path: Path, kind: str, name: str) -> None:
    root = tmp_path / "in"
    write_capture(kind, root, [f"{index}.jpg" for index in range(3)], [f"images/{index}.jpg" for index in range(3)])
    for index in range(2):
        path = root / name.format(index)
        path.parent.mkdir(exist_ok=True)
        with Image.open(root / "images" / f"{index}.jpg") as image:
            mask = np.full(image.size[::-1], 255, np.uint8)
        mask[:100] = 0
        Image.fromarray(mask).save(path)
    rig = read(root)
    assert [view.mask and view.mask.relative_to(root).as_posix() for view in rig.views] == [
        *(name.format(index) for index in range(2)), None]  # fmt: skip
    assert [note.code for note in rig.notes] == ["masks-found"] and "2 of 3" in rig.notes[0].text
    path = root / name.format(0)
    with Image.open(path) as image:
        smooth = np.array(image)
    smooth[100:103] = [[64], [128], [192]]
    Image.fromarray(smooth).save(path)
    assert [note.code for note in read(root).notes] == ["masks-found"]
    for other in (np.arange(480 * 320).astype(np.uint8).reshape(320, 480), np.zeros((9, 9), np.uint8)):
        Image.fromarray(other).save(path)  # ids of parts; another size
        rig = read(root)
        assert not any(view.mask for view in rig.views) and [note.code for note in rig.notes] == ["masks-unused"]


@pytest.mark.parametrize("value", ["false", "False", "0"])
def test_cameras_that_are_switched_off(tmp_path: Path, value: str) -> None:
    shots = write.make_shots(write.Style(off_centre=CENTRED), 3)
    write.write_photographs(tmp_path / "metashape", shots)
    write_metashape(tmp_path / "metashape", [metashape_chunk(Chunk(shots))])
    path = tmp_path / "metashape" / "cameras.xml"
    path.write_text(path.read_text().replace('"IMG_0001" enabled="true"', f'"IMG_0001" enabled="{value}"'))
    write_realityscan_xmp(tmp_path / "realityscan", shots)
    for index, used in enumerate("101"):
        path = tmp_path / "realityscan" / f"IMG_{index:04d}.xmp"
        path.write_text(path.read_text().replace('xcr:Skew="0"', f'xcr:Skew="0" xcr:InTexturing="{used}"'))
    for folder in tmp_path.iterdir():
        rig = read(folder)
        assert [view.name for view in rig.views] == ["IMG_0000", "IMG_0002"]
        assert rig.notes[0].code == "cameras-off" and "IMG_0001" in rig.notes[0].text


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
    """Of RAW, JPEG and EXR the one that is HDR or can be read; two of a kind are no longer one photograph."""
    hdr = tmp_path / "hdr"
    hdr.mkdir()
    for name in ("a.CR2", "a.JPG", "a.xmp", "a.txt", "b.png", "b.jpg", "frame.0001.jpg", "frame.0002.jpg", "hdr/c.exr"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "c.jpg").write_bytes(b"")
    folders = Folders()
    for name, file in {"a": "a.JPG", "a.dng": "a.JPG", "b.jpg": "b.jpg", "frame.0002": "frame.0002.jpg"}.items():
        assert folders.find(name, [tmp_path]) == (tmp_path / file, (name,))
    assert folders.find("c.jpg", [tmp_path, hdr]).path == hdr / "c.exr"
    assert folders.find("x/c.jpg", [tmp_path]).path == tmp_path / "c.jpg"
    assert folders.find("frame", [tmp_path], tmp_path) is folders.find("d.jpg", [hdr, tmp_path], tmp_path) is None
    assert error_of(folders.find, "b", [tmp_path]).code == "file-ambiguous"


@posix
def test_runs_loops_of_links_pipes_and_broken_links_are_not_searched(tmp_path: Path) -> None:
    for folder in ("photos/day", "run/images", ".trash", "masks"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "a.jpg").write_bytes(b"")
    (tmp_path / "run" / "run.json").write_text("{}")
    (tmp_path / "photos" / "again").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(tmp_path / "b.jpg")
    (tmp_path / "c.jpg").symlink_to(tmp_path / "gone.jpg")
    folders = Folders()
    assert folders.find("C:\\x\\a.jpg", [tmp_path], tmp_path) == (tmp_path / "photos" / "day" / "a.jpg", ("a.jpg",))
    assert folders.find("b.jpg", [tmp_path], tmp_path) is folders.find("c", [tmp_path], tmp_path) is None


def test_no_name_leads_out_of_the_folders(tmp_path: Path) -> None:
    (tmp_path / "secret.jpg").write_bytes(b"")
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "own.jpg").write_bytes(b"")
    folders = Folders()
    for start in ("", "../", "..\\", f"{tmp_path}/", "x/../../", "C:\\", "//server/share/", "\\\\server\\share\\"):
        assert folders.find(f"{start}secret.jpg", [tmp_path / "capture"], tmp_path / "capture") is None
        found = folders.find(f"{start}own.jpg", [tmp_path / "capture"], tmp_path / "capture")
        assert found.path == tmp_path / "capture" / "own.jpg"


def test_plain_names_come_before_copies_and_bins_are_not_searched(tmp_path: Path) -> None:
    root = tmp_path / "in"
    write_capture("transforms", root, ["0.jpg", "1.jpg"], ["images/0.jpg", "images/1.jpg"])
    for folder in ("@eaDir", "#recycle"):
        (root / folder).mkdir()
        shutil.copy(root / "images" / "0.jpg", root / folder / "0.jpg")
    for name in ("room.obj", "room (1).obj", "room (A's conflicted copy 2024-01-01).obj", "room - Copy.obj"):
        write_triangle(root / name)
    (root / "transforms.json").rename(root / "transforms (1).json")
    rig = read(root)
    assert rig.mesh == root / "room.obj" and len(rig.views) == 2 and not any(view.missing for view in rig.views)
    write_triangle(root / "other.obj")  # two meshes
    assert read(root).mesh is None


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("poses_bounds.npy", b"x", "LLFF"),
        ("groundtruth.txt", b"# timestamp tx", "trajectory"),
        ("cameras.json", b'[{"id": 0, "img_name": "0"}]', "Gaussians"),
    ],
)
def test_poses_that_are_not_read_are_named(tmp_path: Path, name: str, content: bytes, word: str) -> None:
    Image.new("L", (9, 9)).save(tmp_path / "0.jpg")
    (tmp_path / name).write_bytes(content)
    error = error_of(read, tmp_path)
    assert error.code == "cameras-other" and name in error.text and word in error.text and "Convert" in error.remedy


@pytest.mark.parametrize("suffix", [".dvc", ".nextcloud", ".icloud"])
def test_stubs_of_photographs_are_named(tmp_path: Path, suffix: str) -> None:
    write_capture("transforms", tmp_path / "in", ["images/0.jpg"], ["images/0.jpg"])
    path = tmp_path / "in" / "images" / "0.jpg"
    path.rename(path.with_name(("." if suffix == ".icloud" else "") + path.name + suffix))
    error = error_of(read, tmp_path / "in")
    assert error.code == "file-stand-in" and suffix in error.text and error.remedy


def test_existing_solves_find_groups_by_paths(tmp_path: Path) -> None:
    write_capture("colmap", tmp_path / "in", ["day/1.jpg", "night/1.jpg"], ["day/1.jpg", "night/1.jpg"])
    rig = read_rig(tmp_path / "in", "auto", CaptureOptions())
    wanted = [
        SolveView("1", 480, 320, files=("1", "Day/1.CR2")),
        SolveView("1_2", 320, 480, files=("1_2", "night/1.CR2")),
    ]
    model = model_from_rig(rig, wanted)
    for number, view in enumerate(rig.views, start=1):
        found = np.linalg.inv(np.vstack([model.images[number].cam_from_world().matrix(), [0, 0, 0, 1]]))
        np.testing.assert_allclose(found, view.camera_to_world, atol=1e-6)
    for wanted in ([SolveView("1", 480, 320, files=("1",))],
                   [SolveView(name, 480, 320, files=("day/1.CR2",)) for name in ("1", "2")]):  # fmt: skip
        assert error_of(model_from_rig, rig, wanted).code == "file-ambiguous"


@pytest.mark.parametrize("name", ["images/000_0001.exr", "mesh.ply", "transforms.json"])
@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:aa\nsize 4\n", "lfs"),
        (b"<!DOCTYPE html><html>", "web"),
        (b"../../raw/IMG_0000.JPG", "link"),
    ],
)
def test_files_that_stand_for_others_are_named(tmp_path: Path, name: str, content: bytes, word: str) -> None:
    write_sample_transforms(tmp_path / "in", make_samples(2))
    (tmp_path / "in" / name).write_bytes(content)
    error = error_of(run_ingest, tmp_path / "in", RunFolder(tmp_path / "run"))
    assert error.code == "file-stand-in" and name.split("/")[-1] in error.text
    assert word in (error.text + error.remedy).lower()

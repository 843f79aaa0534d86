"""`prepare`, step `read`: headers, brackets, bad files, and prepare.json between the steps."""

from __future__ import annotations

import io
import json
import struct
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender import cli
from fipt_blender.core.capture import encoded
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.extras import EXTRAS, install_list, optional
from fipt_blender.core.run.messages import Reporter
from fipt_blender.prepare.brackets import find_groups, remarks
from fipt_blender.prepare.exif import describe
from fipt_blender.prepare.preparation import Group, Photograph, PreparationFolder, read_preparation, write_preparation
from fipt_blender.prepare.reading import list_photographs, without_doubles
from samples.photographs import exif, write_brackets, write_jpeg
from samples.prepared_captures import facts, prepare
from samples.refusals import error_of

ROOT = Path(__file__).resolve().parent.parent
GREY = np.full((6, 8, 3), 128, np.uint8)


def read(photographs: Path, capture: Path, *changes: str) -> Reporter:
    return prepare(photographs, capture, "read", *changes)


def shot(path: str, exposure: float | None, time: float | None = None, **others: object) -> Photograph:
    values = {"kind": "ldr", "width": 8, "height": 6, "exposure": exposure, "time": time, **others}
    return Photograph(path=path, **values)


def names(groups: list[Group]) -> list[tuple[str, ...]]:
    return [group.photographs for group in groups]


def test_the_header_of_a_jpeg(tmp_path: Path) -> None:
    path = write_jpeg(tmp_path / "a.jpg", GREY, exif(1 / 60, 0.25, aperture=5.6, iso=400, orientation=6))
    found = describe(path, "a.jpg")
    assert (found.width, found.height, found.upright_size) == (8, 6, (6, 8))
    assert found.shutter == pytest.approx(1 / 60, rel=1e-3) and found.aperture == 5.6 and found.iso == 400
    assert found.exposure == pytest.approx(4.0 / 60 / 5.6**2, rel=1e-3)
    assert (found.make, found.model, found.focal_length, found.kind) == ("Make", "Model X", 24.0, "ldr")
    later = describe(write_jpeg(tmp_path / "b.jpg", GREY, exif(1 / 60, 3.75)), "b.jpg")
    assert later.time - found.time == pytest.approx(3.5)


@pytest.mark.parametrize(("value", "corrected"), [(0, False), (3, True), (None, None)])
def test_a_maker_note_tells_whether_the_camera_corrected_vignetting(
    tmp_path: Path, value: int | None, corrected: bool | None
) -> None:
    """Nikon's: a TIFF of its own, whose tag 0x002A is the vignette control (0 off, 3 normal)."""
    tags = exif(0.01)
    tags[0x010F] = "NIKON CORPORATION"
    if value is not None:
        entries = struct.pack(">H", 1) + struct.pack(">HHIHH", 0x002A, 3, 1, value, 0) + bytes(4)
        tags.get_ifd(0x8769)[0x927C] = b"Nikon\0\x02\x10\0\0" + struct.pack(">2sHI", b"MM", 42, 8) + entries
    found = describe(write_jpeg(tmp_path / "a.jpg", GREY, tags), "a.jpg")
    assert found.corrected is corrected and found.shutter == pytest.approx(0.01)
    assert found.has_vignetting is (corrected is False)


def test_photographs_that_can_not_be_read_are_refused_in_plain_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.cr2").write_bytes(b"II*\0" + bytes(200))
    with pytest.raises(FiptError, match=r"a\.cr2 can't be read \([A-Z]"):
        describe(tmp_path / "a.cr2", "a.cr2")
    path = write_jpeg(tmp_path / "a.jpg", GREY, exif(0.01))
    monkeypatch.setattr(encoded, "MOST_PIXELS", 20)
    with pytest.raises(FiptError, match=r"a\.jpg has 8 x 6 pixels"):
        describe(path, "a.jpg")


def test_brackets_by_time_and_exposure(tmp_path: Path) -> None:
    write_brackets(tmp_path, 3, (1 / 60, 1 / 240, 1 / 15))
    photographs = [describe(tmp_path / name, name) for name in list_photographs(tmp_path)]
    groups = find_groups(photographs, "auto")
    assert names(groups)[2] == ("IMG_7.jpg", "IMG_8.jpg", "IMG_9.jpg") and len(groups) == 3
    assert [group.name for group in groups] == ["IMG_1", "IMG_4", "IMG_7"]
    assert not list(remarks(photographs, groups))
    assert len(find_groups(photographs, "single")) == 9
    assert len(find_groups(photographs, "folders")) == 1


@pytest.mark.parametrize(
    ("photographs", "by", "expected"),
    [  # a bracket ends where an exposure repeats
        (
            [(f"{index}.jpg", 4.0 ** (index % 3)) for index in range(6)],
            "auto",
            {"0": ("0.jpg", "1.jpg", "2.jpg"), "3": ("3.jpg", "4.jpg", "5.jpg")},
        ),
        (  # folders tell the groups where headers say nothing
            [(path, None) for path in ("b/1.jpg", "b/2.jpg", "a/1.jpg", "a/2.jpg")],
            "auto",
            {"a": ("a/1.jpg", "a/2.jpg"), "b": ("b/1.jpg", "b/2.jpg")},
        ),
        (  # names of groups are unique file names
            [(path, 1.0) for path in ("a/x?.jpg", "b/X?.jpg", "c/x?.png")],
            "single",
            {"x_": ("a/x?.jpg",), "X__2": ("b/X?.jpg",), "x__3": ("c/x?.png",)},
        ),
    ],
)
def test_groups_and_their_names(photographs: list, by: str, expected: dict[str, tuple[str, ...]]) -> None:
    groups = find_groups([shot(*photograph) for photograph in photographs], by)
    assert {group.name: group.photographs for group in groups} == expected


@pytest.mark.parametrize("other", [{"model": "Y"}, {"focal_length": 50.0}, {"width": 9}, {"time": 20.0}])
def test_a_bracket_is_of_one_camera_and_without_pause(other: dict[str, object]) -> None:
    first, second = shot("1.jpg", 1.0, 0.0), shot("2.jpg", 4.0, 1.0)
    assert len(find_groups([first, second], "auto")) == 1
    assert len(find_groups([first, replace(second, **other)], "auto")) == 2


def test_what_looks_wrong_is_told() -> None:
    good = [shot(f"{i}.jpg", 4.0 ** (i % 3), 100.0 * (i // 3) + i % 3) for i in range(9)]
    odd = [
        shot("90.jpg", 1.0, 1000.0),  # one exposure alone
        shot("91.jpg", None, 2000.0),
        shot("92.jpg", 1.0, 3000.0, model="Other", width=99),
        shot("93.jpg", 1.0, 4000.0, aperture=4.0),
        shot("94.jpg", 4.0, 4001.0, aperture=8.0),
    ]
    photographs = good + odd
    found = {remark.code: remark for remark in remarks(photographs, find_groups(photographs, "auto"))}
    assert set(found) == {"bracket-incomplete", "exposure-unknown", "cameras-mixed", "sizes-mixed", "aperture-varies"}
    assert "'91'" in found["exposure-unknown"].text or "91.jpg" in found["exposure-unknown"].text
    assert all(remark.remedy for remark in found.values())
    single = good[:1]
    assert [remark.code for remark in remarks(single, find_groups(single, "auto"))] == ["no-brackets"]


def test_copies_beside_raw_photographs_in_other_folders_and_of_other_edits_are_left_out() -> None:
    photographs = [
        shot("RAW/1.DNG", 1.0, 10.0, kind="raw"),
        shot("RAW/1.jpg", 1.0),  # beside it
        shot("JPG/1.JPG", 1.0, 10.0),
        shot("other/1.JPG", 1.0, 99.0),  # another camera's, whose counter was there, too
        shot("IMG_100.JPG", 1.0, 20.0),
        shot("IMG_E100.JPG", 1.0, 20.0),
        shot("IMG_E101.JPG", 1.0, 30.0),  # without its original
        shot("day/a.jpg", 1.0, 40.0),
        shot("day/a-edited.jpg", 1.0, 40.0),
    ]
    kept, copies = without_doubles(photographs)
    assert [item.path for item in copies] == ["RAW/1.jpg", "JPG/1.JPG", "IMG_E100.JPG", "day/a-edited.jpg"]
    assert len(kept) == 5


def test_maps_and_companions_are_no_photographs(tmp_path: Path) -> None:
    source, capture = tmp_path / "in", tmp_path / "out"
    write_brackets(source, 2, (1 / 60, 1 / 240))
    (source / "._IMG_1.jpg").write_bytes(bytes.fromhex("00051607") + bytes(200))
    for name in ("depth/1.png", "depth/2.png", "confidence/1.png", "IMG_1_normal.png"):
        (source / name).parent.mkdir(exist_ok=True)
        Image.fromarray(GREY[..., 0]).save(source / name)
    write_jpeg(source / "depth of the room.jpg", GREY, exif(1 / 15))  # of a camera
    reporter = read(source, capture)
    found = facts(PreparationFolder(capture), "read")
    assert found["photographs"] == 5 and len(found["skipped"]) == 4
    assert "._IMG_1.jpg" not in {item["name"] for item in found["skipped"]}
    said = [warning for warning in reporter.warnings if warning["code"] == "images-left-out"]
    assert len(said) == 1 and "2 depth maps" in said[0]["text"] and "1 confidence maps" in said[0]["text"]


def test_real_disks_have_second_copies_bins_and_names_of_other_systems(tmp_path: Path) -> None:
    source, capture = tmp_path / "in", tmp_path / "out"
    write_brackets(source, 2, (1 / 60, 1 / 240))
    for name in (
        "@eaDir/IMG_1.jpg/SYNOPHOTO_THUMB_M.jpg",
        "#recycle/IMG_9.jpg",
        "$RECYCLE.BIN/x.jpg",
        "__MACOSX/y.jpg",
    ):
        write_jpeg(source / name, GREY, exif(1 / 15))
    for name in ("a (1).jpg", "a.jfif", "a copy.jpg", "b.jpg"):  # the last one is another photograph
        write_jpeg(source / name, GREY + np.uint8(name == "b.jpg"), exif(1 / 9, 900.0))
    write_jpeg(source / "c.jpg", GREY + np.uint8(2), exif(1 / 8, 990.0)).rename(source / "c.DNG")  # is a JPEG
    write_jpeg(source / "d.jpg", GREY + np.uint8(3), exif(1 / 7, 995.0)).rename(source / "d.insp")
    reporter = read(source, capture)
    paths = {item.path for item in read_preparation(PreparationFolder(capture)).photographs}
    assert paths == {"IMG_1.jpg", "IMG_2.jpg", "IMG_3.jpg", "IMG_4.jpg", "a.jfif", "b.jpg", "c.DNG"}
    said = {warning["code"]: warning["text"] for warning in reporter.warnings}
    assert "2 second copies" in said["images-left-out"] and "d.insp" in said["panoramas-left-out"]
    skipped = {item["name"]: item["reason"] for item in facts(PreparationFolder(capture), "read")["skipped"]}
    assert "a.jfif" in skipped["a (1).jpg"] and "a.jfif" in skipped["a copy.jpg"]


def test_digital_zoom_is_another_focal_length(tmp_path: Path) -> None:
    tags = exif(1 / 60)
    tags.get_ifd(0x8769).update({0x920A: 6.5, 0xA405: 24, 0xA404: 2.0})
    zoomed = describe(write_jpeg(tmp_path / "a.jpg", GREY, tags), "a.jpg")
    assert zoomed.focal_length == pytest.approx(13.0) and zoomed.focal_35mm is None
    tags.get_ifd(0x8769)[0xA404] = 1.0
    plain = describe(write_jpeg(tmp_path / "b.jpg", GREY, tags), "b.jpg")
    assert plain.focal_length == pytest.approx(6.5) and plain.focal_35mm == 24.0


def test_brackets_by_aperture_may_repeat_an_exposure() -> None:
    apertures = (6.3, 5.0, 3.2, 2.8, 2.8, 4.0, 8.0)
    photographs = [
        shot(f"{7 * burst + index:02d}.jpg", 1.0 / aperture**2, 180.0 * burst + index + 1.0)
        for burst in range(3)
        for index, aperture in enumerate(apertures)
    ]
    assert [len(group.photographs) for group in find_groups(photographs, "auto")] == [7, 7, 7]
    alike = [shot(f"{index}.jpg", 1.0, 2.0 * index + 1.0) for index in range(6)]  # and no bracket
    assert len(find_groups(alike, "auto")) == 6


def test_reading_a_folder(tmp_path: Path) -> None:
    source, capture = tmp_path / "in", tmp_path / "out"
    write_brackets(source, 2, (1 / 60, 1 / 240))
    (source / "empty.dng").write_bytes(b"")
    (source / "cut.jpg").write_bytes((source / "IMG_1.jpg").read_bytes()[:20])
    (source / "text.txt").write_text("no photograph")
    reporter = read(source, capture)
    preparation = read_preparation(PreparationFolder(capture))
    assert len(preparation.photographs) == 4 and len(preparation.groups) == 2
    assert [item.path for item in preparation.of(preparation.groups[0])] == ["IMG_2.jpg", "IMG_1.jpg"]
    assert [message["code"] for message in reporter.warnings] == ["photographs-skipped"]
    facts = json.loads((capture / "stage" / "read.json").read_text())
    assert {item["name"] for item in facts["skipped"]} == {"empty.dng", "cut.jpg"}
    assert any("empty" in item["reason"] for item in facts["skipped"])


def test_panoramas_are_left_out_with_a_word(tmp_path: Path) -> None:
    source, capture = tmp_path / "in", tmp_path / "out"
    write_brackets(source, 2, (1 / 60, 1 / 240))
    packet = b"<GPano:ProjectionType>equirectangular</GPano:ProjectionType>"
    Image.fromarray(np.full((6, 12, 3), 128, np.uint8)).save(source / "all_round.jpg", xmp=packet)
    (message,) = read(source, capture).warnings
    assert message["code"] == "panoramas-left-out" and "all_round.jpg" in message["text"] and message["remedy"]
    assert len(read_preparation(PreparationFolder(capture)).photographs) == 4
    facts = json.loads((capture / "stage" / "read.json").read_text())
    assert [item["name"] for item in facts["skipped"]] == ["all_round.jpg"]


def test_corrections_by_the_user_stay_until_the_files_change(tmp_path: Path) -> None:
    source, folder = tmp_path / "in", PreparationFolder(tmp_path / "out")
    write_brackets(source, 2, (1 / 60, 1 / 240))
    write_jpeg(source / "x.jpg", GREY, exif(None))
    read(source, folder.root)
    before = read_preparation(folder)
    entered = tuple(replace(item, exposure=0.5) if item.exposure is None else item for item in before.photographs)
    write_preparation(folder, replace(before, photographs=entered, groups=before.groups[:1]))
    reporter = read(source, folder.root, "working_width=640")
    after = read_preparation(folder)
    assert after.groups == before.groups[:1] and after.settings.working_width == 640
    assert [message["code"] for message in reporter.warnings]  # those of the reading are told again
    unticked = (replace(before.groups[0], used=False), *before.groups[1:])
    write_preparation(folder, replace(after, groups=unticked))
    read(source, folder.root, f"cameras={tmp_path}")  # with which panoramas would be read, too
    assert read_preparation(folder).groups == unticked
    read(source, folder.root, "grouping=single")
    assert len(read_preparation(folder).groups) == len(before.photographs)
    write_jpeg(source / "y.jpg", GREY, exif(1 / 30, 500.0))
    read(source, folder.root, "grouping=auto")
    again = read_preparation(folder)
    assert len(again.groups) == len(before.groups) + 1
    assert next(item for item in again.photographs if item.path == "x.jpg").exposure == 0.5


@pytest.mark.parametrize(
    ("files", "code"),
    [({}, "no-photographs"), ({"a.jpg": b"", "b.dng": b"x" * 99}, "no-photographs"), (None, "photographs-missing")],
)
def test_folders_without_photographs(tmp_path: Path, files: dict[str, bytes] | None, code: str) -> None:
    source = tmp_path / "in"
    if files is not None:
        source.mkdir()
        for name, content in files.items():
            (source / name).write_bytes(content)
    caught = error_of(read, source, tmp_path / "out")
    assert caught.code == code and caught.remedy


def test_foreign_folders_are_left_alone(tmp_path: Path) -> None:
    source = tmp_path / "in"
    write_brackets(source, 1, (1 / 60,))
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("mine")
    for capture in (full, source / "capture"):
        caught = error_of(read, source, capture)
        assert caught.code == "capture-foreign"
    assert [path.name for path in full.iterdir()] == ["mine.txt"] and not (source / "capture").exists()
    read(source, tmp_path / "out")
    other = tmp_path / "other"
    write_brackets(other, 1, (1 / 60,))
    caught = error_of(read, other, tmp_path / "out")
    assert caught.code == "capture-foreign" and str(source) in caught.text


@pytest.mark.parametrize(
    "damage",
    [
        {"version": 2},
        {"groups": [{"name": "a", "photographs": ["other.jpg"]}]},
        {"groups": [{"name": "../a", "photographs": ["IMG_1.jpg"]}]},
        {"groups": [{"name": name, "photographs": ["IMG_1.jpg"]} for name in "aA"]},
        {"groups": [{"name": name, "photographs": ["IMG_1.jpg"]} for name in "ab"]},
        {"photographs": [{"path": "../IMG_1.jpg", "kind": "ldr", "width": 8, "height": 6}], "groups": []},
        {"photographs": [{"path": "IMG_1.jpg", "kind": "ldr", "width": 0, "height": 6}], "groups": []},
        {"settings": {"unknown": 1}},
        {"settings": {"working_width": -5}},
        {"settings": {"response": "log"}},
    ],
)
def test_a_damaged_preparation_is_refused(tmp_path: Path, damage: dict[str, object]) -> None:
    source, folder = tmp_path / "in", PreparationFolder(tmp_path / "out")
    write_brackets(source, 1, (1 / 60,))
    read(source, folder.root)
    data = json.loads(folder.prepare_json.read_text())
    folder.prepare_json.write_text(json.dumps({**data, **damage}))
    caught = error_of(read_preparation, folder)
    assert caught.code in ("file-damaged", "setting-unknown", "setting-invalid")
    assert caught.remedy


def test_unknown_steps_and_options_are_refused(tmp_path: Path) -> None:
    for options in (("read,cook",), ("read", "working_width")):
        assert error_of(prepare, tmp_path, tmp_path / "out", *options).code == "option-invalid"
    assert not (tmp_path / "out").exists()


def test_an_optional_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    caught = error_of(optional, "heif", "A photograph in HEIC")
    assert caught.code == "package-optional" and "pillow-heif (extra 'heif')" in caught.text
    assert f'--require-hashes --no-deps -r "{install_list("heif")}"' in caught.remedy


def test_extras_have_the_pins_of_the_project_and_hashes() -> None:
    """After a change of a pin: python3 dev.py lock."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra, (_, package) in EXTRAS.items():
        (pin,) = project["optional-dependencies"][extra]
        lines = install_list(extra).read_text(encoding="utf-8").splitlines()
        assert pin.startswith(f"{package}==") and any(line.startswith(f"{pin} ") for line in lines)
        assert all("==" in line and "--hash=sha256:" in line for line in lines)
        assert not [line for line in lines if line.startswith(("numpy", "pillow=="))]  # the engine's stay


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_brackets(tmp_path / "in", 2, (1 / 60, 1 / 240))
    output = tmp_path / "out"
    arguments = ["prepare", str(tmp_path / "in"), "--output", str(output), "--steps", "read", "--json"]
    assert cli.main([*arguments, "--engine-python", sys.executable]) == 0
    messages = [json.loads(line) for line in io.StringIO(capsys.readouterr().out)]
    assert messages[-1]["type"] == "done" and len(read_preparation(PreparationFolder(output)).groups) == 2
    assert (
        cli.main(["prepare", str(tmp_path / "none"), "--output", str(output), "--engine-python", sys.executable]) == 1
    )
    assert "does not exist" in capsys.readouterr().err

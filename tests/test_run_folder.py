"""A run folder: its settings, links that lead outside, damaged files, files that do not fit each other, a full disk."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.networks import BrdfNetwork, Fields
from fipt_blender.core.material.reliability import PlaceColors, part_detail
from fipt_blender.core.material.seen import Box, seen_cells
from fipt_blender.core.material.training import load_tensors, save_tensors
from fipt_blender.core.pixels.store import open_array
from fipt_blender.core.run import parts
from fipt_blender.core.run.declared import declared
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.lock import hold, holder, open_lockable
from fipt_blender.core.run.replacing import atomic_folder
from fipt_blender.core.run.result_contents import AtlasImages
from fipt_blender.core.run.run_files import LeftAlone
from fipt_blender.core.run.runfolder import RunFolder, explained_write_errors, write_json
from fipt_blender.core.run.settings import PRESETS, Settings, make_settings
from fipt_blender.core.run.store import read_arrays, write_arrays
from fipt_blender.jobs import run_job
from samples.child_processes import posix
from samples.refusals import error_of


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "precious").write_text("precious")
    return folder


FOLDERS = (*("results", "report", "textures", "renders", "stage", "survey", "messages", "images", "align"),)
INNER = ("stage/pixels", "renders/rerender", "results/maps", "report/images")


@posix  # elsewhere links need rights
@pytest.mark.parametrize("name", [*FOLDERS, *INNER, "engine.lock", "log.txt", "messages/estimate.jsonl"])
def test_links_that_lead_outside_are_refused(run_folder: RunFolder, outside: Path, name: str) -> None:
    path = run_folder.root / name
    path.parent.mkdir(exist_ok=True)
    if path.is_dir():
        path.rmdir()
    path.symlink_to(outside / "precious" if path.suffix else outside)
    for use in (
        lambda: run_folder.create(make_settings()),
        lambda: run_job.open_job(run_folder, []),
        lambda: hold(run_folder, ["estimate"]).__enter__(),
    ):
        caught = error_of(use)
        assert caught.code == "run-linked" and str(path) in caught.text
    assert [entry.name for entry in outside.iterdir()] == ["precious"]
    assert (outside / "precious").read_text() == "precious"


@posix
def test_links_within_the_folder_and_to_it_are_followed(run_folder: RunFolder, tmp_path: Path) -> None:
    (run_folder.stage / "a").mkdir()
    (run_folder.stage / "b").symlink_to(run_folder.stage / "a")
    (tmp_path / "link").symlink_to(run_folder.root)
    RunFolder(tmp_path / "link").create(make_settings())
    with hold(RunFolder(tmp_path / "link"), ["estimate"]):
        pass


@posix
def test_a_pipe_in_place_of_a_file_stops_nothing(run_folder: RunFolder) -> None:
    for path in (run_folder.engine_lock, run_folder.statistics_json):
        os.mkfifo(path)
    assert holder(run_folder) is None
    assert "no regular file" in str(error_of(read_document, run_folder.statistics_json, dict))


@posix
def test_a_lock_is_no_link_and_no_other_special_file(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "lock").symlink_to(outside / "precious")
    for path in (tmp_path / "lock", Path("/dev/null"), outside):
        assert error_of(open_lockable, path).code == "run-unwritable"
    assert (outside / "precious").read_text() == "precious"


def test_a_damaged_run_json_is_refused(run_folder: RunFolder) -> None:
    settings = ([1], {"preset": ["draft"]}, {"seed": 1e30})
    damaged = [json.dumps({"format": "fipt-run", "version": 1, "settings": each}) for each in settings]
    for content in (*damaged, "", "[]", '{"format": ["fipt-run"], "version": 1}', "[" * 100_000):
        run_folder.run_json.write_text(content)
        assert error_of(run_folder.read).code in ("run-damaged", "setting-unknown", "setting-invalid"), content


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_is_replaced_when_the_new_one_is_complete_never_before(run_folder: RunFolder) -> None:
    results = run_folder.results
    (results / "old").touch()
    with pytest.raises(KeyboardInterrupt), atomic_folder(results) as new:
        (new / "half").touch()
        raise KeyboardInterrupt
    assert names(results) == ["old"] and not new.exists()
    with atomic_folder(results) as new:
        (new / "new").touch()
        assert names(results) == ["old"]
    assert names(results) == ["new"]
    assert not {"results.new", "results.old"} & set(names(run_folder.root))
    # A kill between the two renamings loses nothing.
    results.rename(run_folder.root / "results.old")
    (run_folder.root / "results.new").mkdir()
    run_folder.create(make_settings())
    assert names(results) == ["new"]


def test_a_damaged_archive_is_one_error_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_arrays(path, LeftAlone(np.ones(3, bool)))
    data = path.read_bytes()
    assert read_arrays(path, LeftAlone).left_alone.tolist() == [True] * 3
    encrypted = data.replace(b"PK\x01\x02-\x03-\x00\x00", b"PK\x01\x02-\x03-\x00\x01")
    damaged = (data[: len(data) // 2], data[:30] + bytes(100) + data[130:], encrypted)
    for content in (*damaged, b"", b"PK\x05\x06" + bytes(18), b"\x80\x04N."):
        path.write_bytes(content)
        caught = error_of(read_arrays, path, LeftAlone)
        assert content != data and caught.code == "file-damaged" and path.name in caught.text and caught.remedy


def test_names_of_images_are_file_names(tmp_path: Path) -> None:
    path = tmp_path / "atlas.json"
    for name in ("../../EVIL", "..", "", "a/b", "a\\b", "C:x", "a\0b", "x" * 300, ".hidden", "a\n", 5):
        write_json(path, {"mode": "uv", "images": [{"name": name, "width": 8, "height": 8}]})
        assert "images[0].name should be a file name" in error_of(read_document, path, AtlasImages).text, name


SMALL = Settings(rounds=2, hash_levels=2, hash_log2_size=6, brdf_width=8)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_damaged_weights_are_an_error_of_ours_and_run_no_code(tmp_path: Path) -> None:
    path = tmp_path / "bad.pt"

    class Touch:
        def __reduce__(self):
            return (open, (str(tmp_path / "touched"), "w"))

    path.write_bytes(pickle.dumps(Touch()))
    caught = error_of(load_tensors, path, torch.device("cpu"))
    assert caught.code == "file-damaged" and not (tmp_path / "touched").exists()


def to_full_disk(path: Path) -> None:
    """Put the temporary file beside `path` on a device that is always full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(f".{os.getpid()}.{path.name}").symlink_to("/dev/full")


BOX = Box(np.zeros(3), 1.0)


def room_fields(points: np.ndarray, *detail: object) -> RoomFields:
    """Of a room of one unit that was seen at these points (N, 3)."""
    network = BrdfNetwork(SMALL, 2, np.full((2, 5), 0.5), torch.Generator(), torch.device("cpu"))
    cells = seen_cells(BOX, [(points, np.zeros(len(points), np.int32))])
    errors = [np.full((len(cells.keys), 3), 0.02, np.float32), 0.0] if detail else []
    return RoomFields(Fields(network, BOX), Units(np.zeros(1, np.int32), np.ones(1, bool)), cells, *errors, *detail)


WRITERS = {
    "results/fields.npz": lambda run: room_fields(np.zeros((1, 3), np.float32)).save(run),
    "results/emitters.json": lambda run: write_json(run.emitters_json, {"fixtures": [1] * 99}),
    "stage/weights.pt": lambda run: save_tensors(run.stage / "weights.pt", {"x": torch.ones(9999)}),
}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a zip file closed twice
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_said_so_and_keeps_what_was_there(name: str, tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    run.stage.mkdir(exist_ok=True)
    path = run.root / name
    path.write_text("what was there")
    to_full_disk(path)
    caught = error_of(WRITERS[name], run)
    assert caught.code == "disk-full" and str(path) in caught.text
    assert path.read_text() == "what was there"
    assert [entry.name for entry in path.parent.iterdir() if entry.name.startswith(".")] == []


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="only POSIX reserves blocks by call")
def test_mapped_arrays_reserve_their_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a full disk would end the process by SIGBUS at the first page without space."""
    array = open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=True)
    assert (array == 0).all()
    assert (tmp_path / "a.npy").stat().st_blocks * 512 >= array.nbytes
    del array
    assert open_array(tmp_path / "a.npy", (1000, 700), np.float32, create=False).shape == (1000, 700)
    caught = error_of(open_array, tmp_path / "a.npy", (1000, 701), np.float32, create=False)
    assert caught.code == "file-damaged"

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(FiptError, match="full"), explained_write_errors(tmp_path):
        open_array(tmp_path / "b.npy", (10, 3), np.float32, create=True)


def test_the_detail_of_parts_is_kept_with_the_fields(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    part, rng = np.zeros(200, np.int32), np.random.default_rng(0)
    points = rng.random((200, 3)).astype(np.float32)
    color = rng.random((200, 3))
    places = PlaceColors(points, part, color, np.stack([color] * 2), np.ones((2, 200)), np.zeros(200))
    saved = room_fields(points, part_detail(places, np.array([[0.1, 0.2, 0.3]]), 0.02, BOX))
    saved.save(run)
    for one, other in zip(saved.query(points, part), RoomFields.load(run).query(points, part), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


OBJECTS = ["Side_table", "floor"]
OF_OBJECT = np.array([0, 0, 0, 1, 1], np.int32)


def entry(index, name, pixels=10):
    return {
        "id": index, "key": f"mask:{index + 1}", "name": name, "single": True, "class": None, "triangles": 1,
        "pixels": pixels, "area": 1.0, "base_color": [0.1, 0.2, 0.3], "roughness": 0.5, "metallic": 0.0,
        "confidence": [1.0, 0.5, 0.0],
    }  # fmt: skip


@pytest.fixture
def described(tmp_path):
    folder = RunFolder(tmp_path)
    folder.results.mkdir()
    describe(folder, [0, 0, -1, 1, -1], [entry(0, "Top"), entry(1, "Floor")])
    return folder


def describe(folder, units, entries):
    np.savez(folder.parts_npz, triangle_part=np.array(units, np.int32), single=np.ones(len(entries), bool))
    write_json(folder.parts_json, {"format": "fipt-parts", "version": 1, "source": "masks", "parts": entries})


def part_names(found: parts.RoomParts) -> list[str]:
    return [found.parts[index].name for index in found.triangle]


def test_units_and_the_rest_of_objects_are_parts(described):
    found = parts.read_parts(described, OF_OBJECT, OBJECTS)
    assert part_names(found) == ["Top", "Top", "Side table", "Floor", "Floor 2"]  # names are unique
    assert found.source == "masks"
    top, rest = found.parts[found.triangle[0]], found.parts[found.triangle[2]]
    assert (top.triangles, top.pixels, top.roughness, top.key) == (2, 10, 0.5, "mask:1")
    assert (rest.unit, rest.key, rest.roughness) == (parts.NO_UNIT, "rest:Side_table", None)


def test_units_of_few_pixels_join_the_rest_of_their_object(described, monkeypatch):
    monkeypatch.setattr(parts, "MOST_PARTS", 1)
    describe(described, [0, 0, -1, 1, -1], [entry(0, "Top", 5), entry(1, "Floor", 9)])
    assert part_names(parts.read_parts(described, OF_OBJECT, OBJECTS)) == [*["Side table"] * 3, "Floor", "Floor 2"]


def test_a_run_without_description_has_its_objects_as_parts(described):
    described.parts_json.unlink()
    assert part_names(parts.read_parts(described, OF_OBJECT, OBJECTS)) == ["Side table"] * 3 + ["Floor"] * 2


def test_presets_and_changes() -> None:
    assert make_settings() == Settings()
    for preset, values in PRESETS.items():
        settings = dataclasses.asdict(make_settings(preset))
        assert settings["preset"] == preset and values.items() <= settings.items()
    changed = make_settings("draft", {"seed": "7", "denoise": "false", "lambda_part": "0", "batch_size": 64.0})
    assert (changed.seed, changed.denoise, changed.lambda_part, changed.batch_size) == (7, False, 0.0, 64)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("batch_size", ["many", 1.5, 0, float("inf"), "1" * 30]),
        ("learning_rate", [float("nan"), float("inf"), "inf", 10**400, True]),
        ("denoise", ["perhaps", 2, "yes", ["false"], None]),
        ("device", ["abacus", ["llvm"]]),
        *[("lambda_part", [-1.0]), ("roughness_levels", [2]), ("voxel_resolution", [2]), ("rounds", [True])],
        ("seed", [1e30]),
    ],
)
def test_values_that_make_no_sense(name: str, values: list[Any]) -> None:
    for value in values:
        caught = error_of(make_settings, "medium", {name: value})
        assert caught.code == "setting-invalid" and name in caught.text, value
    assert error_of(make_settings, "medium", {"no_such": 1}).code == "setting-unknown"


def test_every_setting_explains_itself() -> None:
    options = declared(Settings)
    assert list(options) == [item.name for item in dataclasses.fields(Settings)]
    assert all(item.option.text for item in options.values())


def test_presets_that_do_not_exist() -> None:
    for preset in ("ultra", ["draft"], None):
        assert "no preset" in str(error_of(make_settings, preset))


@pytest.mark.parametrize(("values", "expected"), [((True, 1, "TRUE"), True), ((False, 0, "0"), False)])
def test_switches_take_true_false_one_and_zero(values: tuple, expected: bool) -> None:
    assert all(make_settings("draft", {"denoise": value}).denoise is expected for value in values)

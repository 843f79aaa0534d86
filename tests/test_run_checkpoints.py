# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints: kept for the same input, removed for another; no partial files on a full disk."""

import errno
import os
import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.groups import Units
from fipt_blender.core.material.inference import Fields
from fipt_blender.core.material.networks import BrdfNetwork
from fipt_blender.core.material.reliability import PlaceColors, part_detail
from fipt_blender.core.material.seen import Box, seen_cells
from fipt_blender.core.pixels.store import open_array
from fipt_blender.core.run import checkpoints, finished_views, method
from fipt_blender.core.run.checkpoints import Checkpoints, stage_keys, stage_names
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, explained_write_errors, write_json
from fipt_blender.core.run.settings import Settings
from samples.refusals import error_of

SMALL = Settings(rounds=2, hash_levels=2, hash_log2_size=6, brdf_width=8)


STAGES = stage_names(1)


def make_keys(changed: str = "") -> dict[str, str]:
    """Keys of the stages, which differ from a stage on."""
    first = STAGES.index(changed) if changed else len(STAGES)
    return {name: f"{name} {index >= first}" for index, name in enumerate(STAGES)}


def test_hints_change_the_keys_from_the_stage_that_honours_them() -> None:
    """Hints of a run from its first estimate on; those of a re-estimate only the two stages that they add."""
    plain = stage_keys(SMALL, [])
    hinted = stage_keys(SMALL, [], hints="a")
    kept = [name for name in plain if plain[name] == hinted[name]]
    assert kept == ["pixels", "shadings"]
    again, other = (stage_keys(SMALL, [], hints_again=digest) for digest in ("a", ""))
    assert {name: again[name] for name in plain} == plain
    assert list(again) == stage_names(SMALL.rounds, hinted=True)
    assert not {again[name] for name in list(again)[-2:]} & {other[name] for name in list(other)[-2:]}


def do(checkpoints: Checkpoints, names: list[str], folder: Path) -> None:
    """Do the stages and write the files that the engine would write."""
    for name in names:
        checkpoints.begin(name)
        if name.startswith(("estimate", "training")):
            checkpoints.save_tensors(name, {"x": torch.arange(3)})
        (folder / "previews").mkdir(exist_ok=True)
        (folder / "previews" / f"{name}-base_color.png").touch()
        checkpoints.mark(name, {"seconds": 2.0})


def test_an_updated_method_repeats_every_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = stage_keys(SMALL, [])
    assert before == stage_keys(SMALL, [])
    core = tmp_path / "core"
    for room in method.ROOMS:
        folder = core if room.endswith(".py") else core / room
        folder.mkdir(parents=True, exist_ok=True)
        (core / room if room.endswith(".py") else folder / "rules.py").write_text("THRESHOLD = 0.7\n")
    digest = method.method_digest(core)
    (core / "light" / "rules.py").write_text("THRESHOLD = 0.8\n")
    method.method_digest.cache_clear()
    assert method.method_digest(core) != digest
    monkeypatch.setattr(checkpoints, "method_digest", lambda: "another method")
    assert not set(before.values()) & set(stage_keys(SMALL, []).values())


def test_stages_are_remembered_for_the_same_input_only(tmp_path: Path) -> None:
    folder = tmp_path / "stage"
    first = Checkpoints(folder, make_keys())
    first.remember("scale", 0.25)
    do(first, STAGES[:3], folder)
    again = Checkpoints(folder, make_keys())
    assert again.done("estimate-0") and not again.done("refinement-1") and again.recall("scale") == 0.25
    assert again.facts() == [{"name": name, "seconds": 2.0} for name in STAGES[:3]]
    assert again.load_tensors("estimate-0", torch.device("cpu"))["x"].tolist() == [0, 1, 2]
    other = Checkpoints(folder, make_keys("pixels"))
    assert not other.done("pixels") and list(folder.iterdir()) == []
    for damaged in ("{ cut off", "{}", '{"stages": 1, "keys": {}, "values": {}}', '{"key": "a"}'):
        (folder / "stages.json").write_text(damaged)
        assert not Checkpoints(folder, make_keys()).done("pixels")


@pytest.mark.parametrize(
    ("done", "changed", "kept"),
    [
        (3, "shadings", 1),
        (3, "estimate-0", 2),
        (3, "refinement-1", 3),
        (6, "estimate-0", 1),  # the refinement wrote over stage 1's shadings
        (6, "refinement-1", 3),
        (6, "estimate-1", 4),
        (6, "training", 5),
        (5, "", 5),
        (6, "", 6),
    ],
)
def test_stages_before_a_change_are_kept(done: int, changed: str, kept: int, tmp_path: Path) -> None:
    folder = tmp_path / "stage"
    do(Checkpoints(folder, make_keys()), STAGES[:done], folder)
    (folder / "unfinished.pt").touch()  # under way
    checkpoints = Checkpoints(folder, make_keys(changed))
    assert [name for name in STAGES if checkpoints.done(name)] == STAGES[:kept]
    pictures = [path.name.removesuffix("-base_color.png") for path in (folder / "previews").iterdir()]
    assert sorted(pictures) == sorted(STAGES[:kept])
    saved = [name for name in STAGES[:kept] if name.startswith(("estimate", "training"))]
    left = {path.stem for path in folder.glob("*.pt")}
    assert left == {*saved, *(["unfinished"] if changed == "" else [])}
    assert [name for name in STAGES if Checkpoints(folder, make_keys(changed)).done(name)] == STAGES[:kept]


def test_a_refinement_that_began_has_spoilt_the_shadings_before(tmp_path: Path) -> None:
    folder = tmp_path / "stage"
    first = Checkpoints(folder, make_keys())
    do(first, STAGES[:3], folder)
    first.begin("refinement-1")
    assert Checkpoints(folder, make_keys()).done("estimate-0")
    checkpoints = Checkpoints(folder, make_keys("estimate-0"))
    assert checkpoints.done("pixels") and not checkpoints.done("shadings")


def test_a_kill_amid_dropping_stages_leaves_none_that_lack_their_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "stage"
    do(Checkpoints(folder, make_keys()), STAGES, folder)
    (folder / "unfinished.pt").touch()

    def killed(path: Path, missing_ok: bool = False) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "unlink", killed)
        Checkpoints(folder, make_keys("estimate-1"))
    assert (folder / "estimate-1.pt").exists()
    again = Checkpoints(folder, make_keys())
    assert not again.done("estimate-1") and again.done("refinement-1")
    assert not (folder / "estimate-1.pt").exists(), "it may be another key's"


def test_finished_views_are_those_of_the_same_stage_and_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finished_views, "NOTE_SECONDS", 0.0)
    folder = tmp_path / "stage"
    first = Checkpoints(folder, make_keys())
    do(first, STAGES[:1], folder)
    flushed = []
    views = first.finished_views("shadings")
    views.flush = lambda: flushed.append(set(views.views))
    views.add(2, 50)
    views.add(0, 30)
    assert flushed == [{2}, {0, 2}], "the results must be on the disk before the note is"
    again = Checkpoints(folder, make_keys()).finished_views("shadings")
    assert again.views == {0, 2} and again.rays == 80
    assert not Checkpoints(folder, make_keys()).finished_views("refinement-1").views
    # The refinement writes over the shadings.
    assert not Checkpoints(folder, make_keys()).finished_views("shadings").views
    first.finished_views("shadings").add(1, 10)
    assert not Checkpoints(folder, make_keys("shadings")).finished_views("shadings").views
    for damaged in ("{ cut off", "[]", '{"key": "shadings False", "views": [-1], "rays": 0}'):
        (folder / "baked.json").write_text(damaged)
        assert not Checkpoints(folder, make_keys()).finished_views("shadings").views
        assert not (folder / "baked.json").exists()


def test_results_need_the_shadings_of_their_own_last_round(tmp_path: Path) -> None:
    folder = tmp_path / "stage"
    do(Checkpoints(folder, make_keys()), STAGES, folder)
    fewer = {name: key for name, key in make_keys().items() if not name.endswith("-1")}
    checkpoints = Checkpoints(folder, fewer)
    assert checkpoints.done("pixels") and not checkpoints.done("shadings")


def test_fewer_rounds_keep_the_stages_that_they_share(tmp_path: Path) -> None:
    keys = stage_keys(SMALL, [])
    assert list(keys) == stage_names(2)
    fewer = stage_keys(replace(SMALL, rounds=1), [])
    changed = [name for name in fewer if fewer[name] != keys[name]]
    assert changed == ["estimate-1", "training"], "no refinement follows this estimate now"


def test_keys_follow_the_settings_that_a_stage_and_those_before_it_read(tmp_path: Path) -> None:
    file, photograph = tmp_path / "capture.json", tmp_path / "a.exr"
    file.write_text("one")
    photograph.write_text("one")
    names = stage_names(SMALL.rounds)
    keys = stage_keys(SMALL, [file], [photograph])

    def first_other(settings: Settings) -> str | None:
        others = stage_keys(settings, [file], [photograph])
        differs = [others.get(name) != keys[name] for name in names]
        assert differs == sorted(differs)  # and all after it
        return names[differs.index(True)] if any(differs) else None

    assert first_other(replace(SMALL)) is None
    for item in fields(Settings):
        if item.name != "rounds":
            changed = replace(SMALL, **{item.name: ("x", getattr(SMALL, item.name))})
            assert first_other(changed) == item.metadata["stage"], item.name
    photograph.write_text("another")
    assert first_other(SMALL) == "pixels"
    photograph.unlink()
    file.write_text("two")
    assert first_other(SMALL) == "pixels"


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_damaged_weights_are_an_error_of_ours_and_run_no_code(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path / "stage", make_keys())

    class Touch:
        def __reduce__(self):
            return (open, (str(tmp_path / "touched"), "w"))

    (tmp_path / "stage" / "bad.pt").write_bytes(pickle.dumps(Touch()))
    caught = error_of(checkpoints.load_tensors, "bad", torch.device("cpu"))
    assert caught.code == "file-damaged" and not (tmp_path / "touched").exists()


def to_full_disk(path: Path) -> None:
    """Put the temporary file beside `path` on a device that is always full."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(f".{os.getpid()}.{path.name}").symlink_to("/dev/full")


def save_fields(run: RunFolder) -> None:
    network = BrdfNetwork(SMALL, 2, np.full((2, 5), 0.5), torch.Generator(), torch.device("cpu"))
    box, part = Box(np.zeros(3), 1.0), np.zeros(1, np.int32)
    cells = seen_cells(box, [(np.zeros((1, 3), np.float32), part)])
    RoomFields(Fields(network, box), Units(part, np.ones(1, bool)), cells).save(run)


WRITERS = {
    "results/fields.npz": save_fields,
    "results/emitters.json": lambda run: write_json(run.emitters_json, {"fixtures": [1] * 99}),
    "stage/weights.pt": lambda run: Checkpoints(run.stage, make_keys()).save_tensors(
        "weights", {"x": torch.ones(9999)}
    ),
}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a zip file closed twice
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_said_so_and_keeps_what_was_there(name: str, tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    Checkpoints(run.stage, make_keys()).mark("pixels", {})
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
    with pytest.raises(FiptError) as caught, explained_write_errors(tmp_path):
        open_array(tmp_path / "b.npy", (10, 3), np.float32, create=True)
    assert caught.value.code == "disk-full"


def test_the_detail_of_parts_is_kept_with_the_fields(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    run.create(SMALL)
    network = BrdfNetwork(SMALL, 2, np.full((2, 5), 0.5), torch.Generator(), torch.device("cpu"))
    box, part, rng = Box(np.zeros(3), 1.0), np.zeros(200, np.int32), np.random.default_rng(0)
    points = rng.random((200, 3)).astype(np.float32)
    color = rng.random((200, 3))
    places = PlaceColors(points, part, color, np.stack([color] * 2), np.ones((2, 200)), np.zeros(200))
    detail = part_detail(places, np.array([[0.1, 0.2, 0.3]]), 0.02, box)
    units, cells = Units(np.zeros(1, np.int32), np.ones(1, bool)), seen_cells(box, [(points, part)])
    errors = np.full((len(cells.keys), 3), 0.02, np.float32)
    saved = RoomFields(Fields(network, box), units, cells, errors, 0.0, detail)
    saved.save(run)
    for one, other in zip(saved.query(points, part), RoomFields.load(run).query(points, part), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)
    with np.load(run.fields_npz) as data:
        arrays = dict(data)
    for name, wrong in (("detail_median", np.zeros((2, 3))), ("detail_sums", arrays["detail_sums"][1:])):
        np.savez(run.fields_npz, **arrays | {name: wrong})
        assert error_of(RoomFields.load, run).code == "results-damaged"

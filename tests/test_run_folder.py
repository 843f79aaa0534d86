# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A run folder writes nothing outside itself, and a damaged run.json is an error with a remedy."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.lock import hold, holder, open_lockable
from fipt_blender.core.run.replacing import atomic_folder
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from fipt_blender.jobs import run_job
from samples.child_processes import posix
from samples.refusals import error_of

pytestmark = posix  # elsewhere links need rights


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "precious").write_text("precious")
    return folder


FOLDERS = (*("results", "report", "textures", "renders", "stage", "survey", "messages", "images", "align"),)
INNER = ("stage/pixels", "renders/rerender", "results/maps", "report/images")


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


def test_links_within_the_folder_and_to_it_are_followed(run_folder: RunFolder, tmp_path: Path) -> None:
    (run_folder.stage / "a").mkdir()
    (run_folder.stage / "b").symlink_to(run_folder.stage / "a")
    (tmp_path / "link").symlink_to(run_folder.root)
    RunFolder(tmp_path / "link").create(make_settings())
    with hold(RunFolder(tmp_path / "link"), ["estimate"]):
        pass


def test_a_pipe_in_place_of_a_file_stops_nothing(run_folder: RunFolder) -> None:
    for path in (run_folder.engine_lock, run_folder.statistics_json):
        os.mkfifo(path)
    assert holder(run_folder) is None
    assert "no regular file" in str(error_of(read_document, run_folder.statistics_json, dict))


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


def test_a_run_with_settings_that_are_gone_is_read_without_them(run_folder: RunFolder) -> None:
    settings = make_settings("draft", {"seed": 3})
    run_folder.create(settings)
    data = json.loads(run_folder.run_json.read_text())
    data["settings"] |= {"doubt_pixels": False, "lamp_outlines": True, "emission": "joint", "lambda_joint": 0.5}
    run_folder.run_json.write_text(json.dumps(data))
    assert run_folder.read() == settings
    data["settings"]["of_a_newer_version"] = 1
    run_folder.run_json.write_text(json.dumps(data))
    assert error_of(run_folder.read).code == "setting-unknown"


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

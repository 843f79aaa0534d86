# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Earlier results are kept as versions: a switch brings all of them back, and a kill loses none."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from fipt_blender.core.run import versions
from fipt_blender.core.run.replacing import keep_inputs
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.run.version_figures import changed_parts, figures
from samples.refusals import error_of


def stages(run: RunFolder, **keys: str) -> None:
    done = {name: {} for name in keys}
    write_json(run.stages_json, {"keys": keys, "stages": done, "warnings": {}, "values": {}})


def estimate(run: RunFolder, text: str, hints: int = 0, key: str = "", **changes: int) -> str:
    """Results of an estimation as the engine writes them, with this content; returns their version."""
    run.create(make_settings("draft", changes))
    stages(run, training=key or text, **({"hinted-training": text} if hints else {}))
    with versions.new_results(run) as new:
        new.fields_npz.write_text(text)
        (new.results / "maps").mkdir()
        (new.results / "maps" / "0.exr").write_text(text)
        told = {"triangles": 1, "roughness": None, "metallic": None, "emits": None, "left_alone": False}
        write_json(new.statistics_json, {"hints": [{"name": "Sofa", **told}] * hints})
        keep_inputs(new, new.results)
        versions.note_version(new.results)
    versions.prune(run, run.read().kept_versions)
    return versions.list_versions(run)[0].id


def apply(run: RunFolder) -> None:
    """Textures of the present results, as Apply Results leaves them."""
    shutil.rmtree(run.textures, ignore_errors=True)
    run.textures.mkdir()
    for path in (run.textures_json, run.atlas_npz, run.apply_json):
        path.unlink(missing_ok=True)
        path.write_text(f"of {run.fields_npz.read_text()}")


def contents(run: RunFolder) -> dict[str, str]:
    """What each version holds, by its id."""
    found = versions.list_versions(run)
    return {each.id: versions.version_folder(run, each.id).fields_npz.read_text() for each in found}


def test_versions_are_listed_with_what_they_differ_in(run_folder: RunFolder) -> None:
    run_folder.room_npz.write_bytes(b"both are of this room")
    first = estimate(run_folder, "first")
    second = estimate(run_folder, "second", hints=2, rounds=2)
    newest, oldest = versions.list_versions(run_folder)
    assert (newest.id, oldest.id) == (second, first) and newest.current and not oldest.current
    assert (newest.what, newest.preset, oldest.what) == ("rounds=2, 2 hints", "draft", "")
    assert newest.time >= oldest.time and oldest.title.startswith("Draft 20")
    assert contents(run_folder) == {second: "second", first: "first"}
    sizes = newest.size + oldest.size
    assert versions.total_size(run_folder) == sizes - run_folder.room_npz.stat().st_size
    versions.rename_version(run_folder, first, "  with  the lamp ")
    assert versions.list_versions(run_folder)[1].title == "with the lamp"
    versions.rename_version(run_folder, second, "kept")
    assert estimate(run_folder, "second", hints=2, rounds=2) == second, "the same again is no other version"
    assert [each.name for each in versions.list_versions(run_folder)] == ["kept", "with the lamp"]


def test_a_switch_brings_results_inputs_and_textures_back(run_folder: RunFolder) -> None:
    first = estimate(run_folder, "first", rounds=0)
    apply(run_folder)
    second = estimate(run_folder, "second", rounds=2)
    assert not run_folder.apply_json.exists()  # the textures are those of other results
    apply(run_folder)
    versions.rename_version(run_folder, first, "one")
    for version, text, rounds in ((first, "first", 0), (second, "second", 2), (first, "first", 0)):
        versions.use_version(run_folder, version)
        assert run_folder.fields_npz.read_text() == text
        assert (run_folder.results / "maps" / "0.exr").read_text() == text
        assert run_folder.read_estimated().rounds == rounds
        for path in (run_folder.textures_json, run_folder.atlas_npz, run_folder.apply_json):
            assert path.read_text() == f"of {text}"
        assert contents(run_folder) == {first: "first", second: "second"}
        assert not (run_folder.results / "textures").exists()
    assert versions.list_versions(run_folder)[0].name == "one"
    left = {path.name for path in run_folder.root.iterdir()}
    assert not {name for name in left if name.endswith((".new", ".old")) or name.startswith(".")}
    third = estimate(run_folder, "third")  # is not applied: its textures are baked again
    versions.use_version(run_folder, second)
    assert run_folder.textures_json.read_text() == "of second"
    versions.use_version(run_folder, third)
    assert not run_folder.apply_json.exists()


def test_the_oldest_versions_without_a_name_go(run_folder: RunFolder) -> None:
    made = [estimate(run_folder, text, kept_versions=2) for text in "abc"]
    versions.rename_version(run_folder, made[0], "mine")
    made += [estimate(run_folder, text, kept_versions=2) for text in "de"]
    assert list(contents(run_folder)) == [made[4], made[3], made[2], made[0]]
    last = estimate(run_folder, "f", kept_versions=0)
    assert list(contents(run_folder)) == [last, made[0]]


def test_versions_are_deleted_but_never_the_present_one(run_folder: RunFolder) -> None:
    first, second = estimate(run_folder, "first"), estimate(run_folder, "second")
    assert "present results" in str(error_of(versions.delete_version, run_folder, second))
    for wrong in ("other", "", "..", "../results", str(run_folder.results)):
        for work in (versions.delete_version, versions.use_version):
            assert error_of(work, run_folder, wrong).code == "version-missing"
    versions.delete_version(run_folder, first)
    assert list(contents(run_folder)) == [second]


def test_results_of_earlier_releases_are_versions_too(run_folder: RunFolder) -> None:
    """They have no version.json, no stages and no inputs of their own."""
    run_folder.fields_npz.write_text("old")
    (old,) = versions.list_versions(run_folder)
    assert old.time == pytest.approx(run_folder.fields_npz.stat().st_mtime) and not old.preset
    assert versions.total_size(run_folder) == 3
    new = estimate(run_folder, "new")
    assert contents(run_folder) == {new: "new", old.id: "old"}
    versions.use_version(run_folder, old.id)
    assert run_folder.fields_npz.read_text() == "old" and run_folder.estimated() is run_folder


def killed_at(work: Callable[[], object], number: int) -> bool:
    """Do work in a process that is killed before its `number`-th change of the disk; whether it was."""
    child = os.fork()
    if child:
        ended_by = os.WTERMSIG(os.waitpid(child, 0)[1])
        assert ended_by in (signal.SIGKILL, signal.SIGTERM), "the work has failed"
        return ended_by == signal.SIGKILL
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGABRT, signal.SIG_DFL)
    numbers = itertools.count(1)

    def counted(function: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **options: object) -> object:
            if next(numbers) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return call

    try:
        changes = [(os, "rename"), (os, "replace"), (os, "link"), (shutil, "rmtree"), (Path, "unlink")]
        for owner, name in changes:
            setattr(owner, name, counted(getattr(owner, name)))
        work()
        os.kill(os.getpid(), signal.SIGTERM)  # rather than pytest's end
    finally:
        os.abort()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize("what", ["use", "estimate"])
def test_a_kill_at_any_moment_loses_no_version(tmp_path: Path, what: str) -> None:
    start = RunFolder(tmp_path / "start")
    first = estimate(start, "first")
    apply(start)
    second = estimate(start, "second")
    apply(start)
    for number in range(1, 100):
        run = RunFolder(shutil.copytree(start.root, tmp_path / str(number)))
        work = partial(versions.use_version, run, first) if what == "use" else partial(estimate, run, "third")
        if not killed_at(work, number):
            break
        versions.settle(run)
        found = contents(run)
        assert found.items() >= {first: "first", second: "second"}.items(), number
        if run.apply_json.exists():  # else they are baked again
            assert run.textures_json.read_text() == run.apply_json.read_text() == run.atlas_npz.read_text()
        if number % 5 == 0:
            versions.use_version(run, first)
            versions.use_version(run, second)
            assert run.fields_npz.read_text() == "second" and set(contents(run)) == set(found)
    assert number > 5


def test_only_the_stages_of_the_results_can_be_continued(run_folder: RunFolder) -> None:
    assert not versions.can_continue(run_folder)
    first = estimate(run_folder, "first", key="light")
    hinted = estimate(run_folder, "hinted", hints=1, key="light")
    versions.use_version(run_folder, first)  # its stages are those before the hints
    assert versions.can_continue(run_folder) and versions.stages_last(run_folder) == hinted
    estimate(run_folder, "other", key="other light")
    versions.use_version(run_folder, hinted)
    assert not versions.can_continue(run_folder)
    assert "another estimate has replaced them" in str(error_of(versions.refuse_other_stages, run_folder))


def test_the_inputs_of_the_results_come_back_and_the_settings_stay(run_folder: RunFolder) -> None:
    run_folder.room_npz.write_bytes(b"estimated")
    estimate(run_folder, "first", rounds=2)
    stages_before = run_folder.stages_json.read_bytes()
    run_folder.room_npz.unlink()
    run_folder.room_npz.write_bytes(b"of an estimate that was stopped at once")
    run_folder.create(make_settings("draft", {"rounds": 0}))
    for _ in range(2):
        versions.restore_inputs(run_folder)
        assert run_folder.room_npz.read_bytes() == b"estimated" and run_folder.read().rounds == 0
    assert run_folder.stages_json.read_bytes() == stages_before
    assert not [path for path in run_folder.root.iterdir() if path.name.startswith(".")]


def test_figures_and_the_parts_that_differ(run_folder: RunFolder) -> None:
    made = []
    for color in (0.2, 0.8):
        made.append(estimate(run_folder, str(color)))
        part = {"id": 0, "key": "k", "triangles": 1, "pixels": 1, "single": True, "class": None, "area": 1.0}
        values = {"base_color": [color] * 3, "roughness": 0.5, "metallic": 0.0, "confidence": [1.0] * 3}
        parts = [{**part, **values, "name": "Wall"}, {**part, **values, "base_color": [0.1] * 3, "name": "A"}]
        head = {"format": "fipt-parts", "version": 1, "source": "objects"}
        write_json(run_folder.parts_json, {**head, "parts": parts})
        lamp = {"name": "L", "triangles": [], "radiance": [1.0] * 3, "back_radiance": [0.0] * 3}
        fixtures = [{**lamp, "power": [3.0, 6.0, 9.0]}] * len(made)
        write_json(run_folder.emitters_json, {"fixtures": fixtures, "environment": None})
    first, second = (figures(run_folder, version) for version in made)
    assert (first.lamps, second.lamps, first.power, second.power) == (1, 2, 6.0, 12.0)
    assert first.environment is False and first.doubts is None
    assert changed_parts(first, second) == ["Wall"]

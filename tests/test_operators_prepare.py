"""The buttons of the section Photographs as scripts press them, with a stand-in for the engine."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import bpy
import pytest

from fipt_blender.jobs import run_job, running
from fipt_blender.prepare.preparation import Group, PreparationFolder, read_preparation, write_preparation
from samples.operator_calls import refused
from samples.prepared_captures import make_preparation, write_prepared

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def settings(tmp_path):
    """The section's state, with a folder of photographs."""
    (tmp_path / "card").mkdir()
    settings = bpy.context.scene.fipt.photographs
    settings.path = str(tmp_path / "card")
    return settings


@pytest.fixture
def commands(monkeypatch, tmp_path) -> list[list[str]]:
    """The arguments of each start of the engine, whose work a function in this process does."""
    started: list[list[str]] = []

    def work(arguments: list[str]) -> None:
        started.append(arguments)
        photographs, folder = Path(arguments[-2]), PreparationFolder(arguments[-1])
        if "--steps=read" in arguments:
            write_preparation(folder, make_preparation(photographs))
        else:
            write_prepared(folder, read_preparation(folder))

    real = run_job.open_job

    def open_job(run, steps, **options):
        faked = [replace(step, command=None, function=partial(work, list(step.command))) for step in steps]
        return real(run, faked, run_job.Launch(Path(sys.executable), {}))

    monkeypatch.setattr(run_job, "open_job", open_job)
    return started


def listed(settings) -> list[tuple[str, bool, int]]:
    return [(group.name, group.used, len(group.photographs)) for group in settings.groups]


def test_find_brackets_lists_the_groups_beside_the_photographs(settings, commands, tmp_path):
    assert ops.find_brackets() == {"FINISHED"}
    capture = tmp_path / "card-capture"
    assert settings.capture_folder() == capture and (capture / "prepare.json").is_file()
    assert commands[0][0] == "prepare" and commands[0][-2:] == [str(tmp_path / "card"), str(capture)]
    assert "--set=working_width=2048" in commands[0] and "--set=align=True" in commands[0]
    assert listed(settings) == [("IMG_1", True, 3), ("IMG_4", True, 3), ("IMG_7", False, 1)]
    assert settings.groups[0].photographs[0].exposure == "1/100 s  f/8  ISO 100"
    assert settings.used_count == 2 and settings.registered_count == -1
    job = running.last("photographs")
    assert job.state == "finished" and job.run_folder == capture
    assert not bpy.context.scene.fipt.run_folder  # no run is made of it yet


def test_corrections_reach_prepare_json_and_the_outcome_comes_back(settings, commands, tmp_path):
    ops.find_brackets()
    settings.active_group, settings.active_photograph = 1, 2
    assert ops.split_bracket() == {"FINISHED"}
    assert listed(settings)[1:3] == [("IMG_4", True, 2), ("IMG_6", True, 1)]
    assert settings.groups[2].photographs[0].exposure == "1/6 s  f/8  ISO 100"
    settings.active_group = 2
    assert ops.merge_brackets() == {"FINISHED"}
    assert listed(settings)[2] == ("IMG_6", True, 2)
    settings.groups[1].used = False
    assert ops.prepare() == {"FINISHED"}
    capture = PreparationFolder(settings.capture_folder())
    groups = read_preparation(capture).groups
    assert groups[1] == Group("IMG_4", ("IMG_4.jpg", "IMG_5.jpg"), False)
    assert groups[2] == Group("IMG_6", ("IMG_6.jpg", "IMG_7.jpg"), True)
    assert [group.state for group in settings.groups] == ["REGISTERED", "NONE", "LEFT_OUT"]
    assert "too few points" in settings.groups[2].problem
    assert settings.registered_count == 1 and settings.groups[0].clipped_share > 0.0
    assert bpy.context.scene.fipt.capture.path == str(capture.root)


def test_groups_changed_by_hand_are_shown_and_never_overwritten(settings, commands):
    ops.find_brackets()
    folder = PreparationFolder(settings.capture_folder())
    preparation = read_preparation(folder)
    changed = (replace(preparation.groups[0], name="door"), *preparation.groups[1:])
    write_preparation(folder, replace(preparation, groups=changed))
    assert "not those that were listed" in refused(ops.prepare)
    assert settings.groups[0].name == "door" and len(commands) == 1
    assert ops.prepare() == {"FINISHED"}
    assert read_preparation(folder).groups == changed


def test_refusals_name_a_remedy_and_write_nothing(settings, commands, tmp_path):
    assert not ops.prepare.poll() and not ops.split_bracket.poll() and not ops.merge_brackets.poll()
    foreign = tmp_path / "pictures"
    foreign.mkdir()
    (foreign / "cat.jpg").write_bytes(b"")
    settings.output = str(foreign)
    assert "not empty" in refused(ops.find_brackets)
    assert [path.name for path in foreign.iterdir()] == ["cat.jpg"]
    settings.output = str(tmp_path / "card" / "inside")
    assert "inside the photographs" in refused(ops.find_brackets)
    assert not list((tmp_path / "card").iterdir())
    settings.output = ""
    ops.find_brackets()
    shutil.rmtree(settings.capture_folder())
    assert "does not exist" in refused(ops.prepare)
    settings.path = str(tmp_path / "gone")
    assert "does not exist" in refused(ops.find_brackets)
    assert running.last("photographs").error["code"] == "photographs-missing"
    assert "no report" in refused(ops.open_photographs_report)
    settings.path = ""
    assert not ops.find_brackets.poll() and settings.capture_folder() is None


def test_two_points_are_picked_in_merged_images(settings, commands):
    from fipt_blender.prepare.scale import parse_picks

    ops.find_brackets()
    assert "not merged yet" in refused(ops.show_merged)
    ops.prepare()
    assert ops.show_merged() == {"FINISHED"}
    shown = bpy.path.abspath(bpy.data.images[-1].filepath)
    assert shown == str(PreparationFolder(settings.capture_folder()).images / "IMG_1.exr")
    assert ops.pick_scale_points(view="IMG_1", points=(10, 20, 30, 40.25)) == {"FINISHED"}
    assert settings.scale == "points" and settings.scale_picks == "IMG_1 10.0 20.0; IMG_1 30.0 40.2"
    ops.pick_scale_points(view="IMG_4", points=(1, 2, 3, 4), extend=True)
    ops.pick_scale_points(view="IMG_1", points=(5, 6, 7, 8), extend=True)
    first, second = parse_picks(settings.scale_picks)
    assert [(pick.view, pick.x, pick.y) for pick in first] == [("IMG_4", 1.0, 2.0), ("IMG_1", 5.0, 6.0)]
    assert [(pick.view, pick.x, pick.y) for pick in second] == [("IMG_4", 3.0, 4.0), ("IMG_1", 7.0, 8.0)]
    ops.pick_scale_points(view="IMG_4", points=(1, 2, 3, 4))
    assert settings.scale_picks == "IMG_4 1.0 2.0; IMG_4 3.0 4.0"
    before = settings.scale_picks
    for wrong in ({"view": "other", "points": (1, 2, 3, 4)}, {"view": "IMG_4", "points": (1, 2, 1, 2)}):
        with pytest.raises(RuntimeError):
            ops.pick_scale_points(**wrong)
    assert settings.scale_picks == before

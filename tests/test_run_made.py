"""Files that are made once: what makes them be made again."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fipt_blender.core.run.contents import Problem
from fipt_blender.core.run.made import Made, content_digest, file_state, folder_states
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder


def test_files_are_kept_while_what_they_are_made_from_is_the_same(run_folder: RunFolder) -> None:
    def made(*facts: object) -> Made:
        return Made(run_folder, "atlas", *facts, outputs=[run_folder.atlas_npz])

    warning = {"type": "warning", "code": "odd", "text": "It is odd.", "remedy": "Mend it."}
    assert made(1).kept() is None
    with made(1).making([warning]):
        run_folder.atlas_npz.touch()
    reporter = Reporter()
    assert made(1).kept() == (Problem("odd", "It is odd.", "Mend it."),) and made(2).kept() is None
    assert made(1).told_again(reporter) and [each["code"] for each in reporter.warnings] == ["odd"]
    run_folder.made("atlas").write_text("{")
    assert made(1).kept() is None and not made(1).told_again(reporter)
    with made(1).making():
        pass
    run_folder.atlas_npz.unlink()
    assert made(1).kept() is None


def test_files_of_a_cancelled_making_are_not_the_former_ones(run_folder: RunFolder) -> None:
    def made(size: int) -> Made:
        return Made(run_folder, "textures", size, outputs=[run_folder.textures])

    def write(size: int, most: int) -> None:
        with made(size).making():
            for number in range(3):
                if number == most:
                    raise KeyboardInterrupt
                run_folder.textures.mkdir(exist_ok=True)
                (run_folder.textures / str(number)).write_text(str(size))

    write(1024, 3)
    for most in range(3):
        with pytest.raises(KeyboardInterrupt):
            write(2048, most)
        assert made(1024).kept() is None and made(2048).kept() is None
        write(1024, 3)
        assert made(1024).kept() == ()


def test_the_files_of_a_folder_count_but_for_those_that_are_made_in_it(tmp_path: Path) -> None:
    file, inside, mask = (tmp_path / name for name in ("transforms.json", "run/x", "masks/0.png"))
    for path in (file, inside, mask):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    for capture in (tmp_path, file):
        before = folder_states(capture, tmp_path / "masks" / ".." / "run")
        inside.write_text("changed")
        (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
        assert folder_states(capture, tmp_path / "run") == before
        os.utime(mask, (1e9, 1e9))
        assert folder_states(capture, tmp_path / "run") != before
        (tmp_path / "dangling").unlink()
        os.utime(mask)
    assert folder_states(None, tmp_path) == [] == folder_states(tmp_path / "nowhere", tmp_path)
    assert file_state(None) == "" == file_state(Path("a\0b")) and file_state(mask) != file_state(file)
    assert content_digest(file) == content_digest(mask) != content_digest(tmp_path / "nowhere")

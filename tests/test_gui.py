# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The GUI test in the window of the Blender that $FIPT_TEST_BLENDER names (gui/README.md); its chapters."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).with_name("gui") / "run.py"
BLENDER = os.environ.get("FIPT_TEST_BLENDER", "")


@pytest.mark.skipif(not BLENDER, reason="FIPT_TEST_BLENDER is not set")
@pytest.mark.skipif(not shutil.which("xvfb-run"), reason="xvfb-run is not installed")
def test_from_an_empty_scene_to_a_relit_render(tmp_path):
    shots = Path(os.environ.get("FIPT_TEST_SHOTS") or tmp_path)
    command = [sys.executable, str(RUN), "--blender", BLENDER, "--shots", str(shots)]
    result = subprocess.run(
        [*command, "--engine", sys.executable], stderr=subprocess.PIPE, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


@pytest.fixture(scope="module")
def chapters():
    """The module of the chapters' order."""
    specification = importlib.util.spec_from_file_location("gui_chapters", RUN.with_name("chapters.py"))
    module = importlib.util.module_from_spec(specification)
    sys.modules["gui_chapters"] = module
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("only", "told", "start", "acted"),
    [
        ([], "abcd", "", "abcd"),
        (["d"], "", "", "abd"),
        (["c"], "", "", "ac"),
        (["d"], "ad", "a", "bd"),
        (["d"], "ab", "b", "d"),
        (["c", "d"], "ab", "b", "cd"),
    ],
)
def test_chapters_bring_what_they_continue(chapters, only, told, start, acted):
    def make(name, after):
        def act(window, options):
            raise AssertionError

        act.__name__ = name
        return chapters.Chapter(act, after)

    story = [make("a", ""), make("b", "a"), make("c", "a"), make("d", "b")]
    found, plan = chapters.plan(story, only, told.__contains__)
    assert (found, "".join(chapter.name for chapter in plan)) == (start, acted)

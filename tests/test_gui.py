"""The GUI test in the window of the Blender that $FIPT_TEST_BLENDER names (gui/README.md)."""

from __future__ import annotations

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
    result = subprocess.run([*command, "--engine", sys.executable], stderr=subprocess.PIPE, text=True, check=False)
    assert result.returncode == 0, result.stderr

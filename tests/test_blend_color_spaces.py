"""Other scene-linear spaces and names: OpenColorIO configurations and the working spaces of Blender 5."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from samples import color_child

TESTS = Path(__file__).parent
# Primaries and white, CIE xy.
D65, D60 = (0.3127, 0.3290), (0.32168, 0.33767)
SPACES = {
    "AP0": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077), D60),
    "AP1": ((0.713, 0.293), (0.165, 0.83), (0.128, 0.044), D60),
    "Rec.2020": ((0.708, 0.292), (0.17, 0.797), (0.131, 0.046), D65),
    "Rec.709": ((0.64, 0.33), (0.3, 0.6), (0.15, 0.06), D65),
    "P3": ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), D65),
}
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def xyz(xy: tuple[float, float]) -> np.ndarray:
    return np.array([xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]])


def to_d60(space: str) -> np.ndarray:
    """(3, 3) from a space to XYZ, adapted to D60 by Bradford's cones."""
    *primaries, white = SPACES[space]
    columns = np.stack([xyz(each) for each in primaries], axis=1)
    matrix = columns * np.linalg.solve(columns, xyz(white))
    gain = (BRADFORD @ xyz(D60)) / (BRADFORD @ xyz(white))
    return np.linalg.inv(BRADFORD) @ np.diag(gain) @ BRADFORD @ matrix


def matrix_transform(space: str) -> str:
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.solve(to_d60("AP0"), to_d60(space))
    return f"!<MatrixTransform> {{matrix: [{', '.join(f'{value:.10f}' for value in matrix.ravel())}]}}"


def write_config(path: Path, spaces: tuple[str, ...]) -> Path:
    """A configuration with these spaces, whose scene-linear space is AP1 and whose names say nothing."""
    curves = {"sRGB": "!<ExponentWithLinearTransform> {gamma: 2.4, offset: 0.055}",
              "gamma": "!<ExponentTransform> {value: [2.2, 2.2, 2.2, 1]}"}  # fmt: skip
    words = ["plate 7", "Utility - Raw", "x/y", "show A", "lin", "tex", "grade", "cam"]
    names = dict(zip((*curves, "data", *spaces), words, strict=False))
    made = [f"  - !<ColorSpace> {{name: {names['data']}, isdata: true}}"]
    for key in (*curves, *spaces):
        steps = [curves[key], matrix_transform("Rec.709")] if key in curves else [matrix_transform(key)]
        made.append(f"""  - !<ColorSpace>
    name: {names[key]}
    isdata: false
    to_scene_reference: !<GroupTransform>
      children:
        - {(chr(10) + "        - ").join(steps)}""")
    roles = {"scene_linear": "AP1", "default_float": "AP1", "reference": "AP0", "aces_interchange": "AP0",
             "data": "data", "default_byte": "sRGB", "default_sequencer": "sRGB", "texture_paint": "sRGB",
             "color_picking": "sRGB", "matte_paint": "sRGB"}  # fmt: skip
    listed = "\n".join(f"  {role}: {names[key]}" for role, key in roles.items())
    path.write_text(f"""ocio_profile_version: 2
strictparsing: true
roles:
{listed}
file_rules:
  - !<Rule> {{name: Default, colorspace: {names['data']}}}
displays:
  monitor:
    - !<View> {{name: plain, colorspace: {names['sRGB']}}}
active_displays: [monitor]
active_views: [plain]
colorspaces:
""" + "\n".join(made) + "\n")  # fmt: skip
    return path


def run(code: list[str], config: Path | None) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "OCIO"}
    environment["PYTHONPATH"] = os.pathsep.join([str(TESTS), str(TESTS.parent)])
    if config is not None:
        environment["OCIO"] = str(config)
    return subprocess.run([sys.executable, *code], env=environment, capture_output=True, text=True, timeout=300)


def seen(folder: Path, config: Path | None = None, working_space: str = "") -> dict:
    """What `samples.color_child` measures with a configuration or a working space."""
    result = run(["-m", "samples.color_child", str(folder), working_space], config)
    assert (folder / "seen.json").exists(), result.stdout[-2000:] + result.stderr[-3000:]
    return json.loads((folder / "seen.json").read_text())


@pytest.fixture(scope="module")
def usual(tmp_path_factory, registered) -> dict:
    """What is seen with Blender's own configuration and default working space."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        found = color_child.measure(tmp_path_factory.mktemp("usual"), monkeypatch)
    assert found["composite"]
    np.testing.assert_allclose(found["lamp"], [8.0, 4.0, 2.0], rtol=1e-4)
    return found


def check(found: dict, usual: dict) -> None:
    assert found.keys() == usual.keys()
    for name, value in usual.items():
        # Light that surfaces have reflected: products of channels differ between primaries.
        tolerance = 0.04 if name in ("cube", "ball") else 3e-3
        np.testing.assert_allclose(found[name], value, rtol=tolerance, atol=5e-3, err_msg=name)


def test_a_studios_configuration_changes_no_colour(tmp_path, usual):
    check(seen(tmp_path, write_config(tmp_path / "studio.ocio", tuple(SPACES))), usual)


@pytest.mark.skipif(not hasattr(bpy.data, "colorspace"), reason="working spaces came with Blender 5.0")
@pytest.mark.parametrize("space", ["ACEScg", "Linear Rec.2020"])
def test_a_working_space_changes_no_colour(tmp_path, usual, space):
    check(seen(tmp_path, working_space=space), usual)


def test_a_configuration_without_rec709_is_explained(tmp_path):
    config = write_config(tmp_path / "studio.ocio", ("AP0", "AP1"))
    code = """
import os, bpy
from fipt_blender.blend import color_spaces
from fipt_blender.core.run.errors import FiptError
print(len(color_spaces.encoded_space()))
try:
    color_spaces.linear_space()
except FiptError as error:
    print(error.code, error.remedy)
os._exit(bool(bpy.data.images.get("FIPT Probe")))
"""
    result = run(["-u", "-c", code], config)
    assert result.returncode == 0 and "color-space-missing" in result.stdout and "OCIO" in result.stdout

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip in a real Blender: validated, installed, updated, disabled, removed, installed again; its start-up.

Needs a Blender executable, named in FIPT_TEST_BLENDER; in a folder of its own, it leaves the user's alone.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import zipfile
from pathlib import Path

import pytest

from samples.development import load_dev
from samples.enabling import needless

BLENDER = os.environ.get("FIPT_TEST_BLENDER", "")
MODULE = "bl_ext.user_default.fipt_blender"

pytestmark = pytest.mark.skipif(not BLENDER, reason="FIPT_TEST_BLENDER names no Blender")

STATE = """
import bpy, gc, json, sys
def state():
    handlers = {}
    for name in dir(bpy.app.handlers):
        found = getattr(bpy.app.handlers, name)
        if isinstance(found, list):
            handlers[name] = [str(each) for each in found if "fipt" in str(getattr(each, "__module__", ""))]
    keymaps = bpy.context.window_manager.keyconfigs.addon
    items = [item.idname for keymap in keymaps.keymaps for item in keymap.keymap_items] if keymaps else []
    return {
        "classes": [name for name in dir(bpy.types) if name.upper().startswith("FIPT_")],
        "operators": dir(bpy.ops.fipt),
        "scene": hasattr(bpy.types.Scene, "fipt"),
        "handlers": {name: found for name, found in handlers.items() if found},
        "keys": [name for name in items if "fipt" in name],
    }
def say(**what):
    print("ANSWER " + json.dumps(what), flush=True)
"""

ENABLED = """
import sys, addon_utils
MODULE = sys.argv[-1]
addon_utils.disable(MODULE, default_set=True)
first = state()
lost = "fipt" in str(bpy.context.preferences.addons.keys())
for name in [name for name in sys.modules if name.startswith(MODULE)]:
    del sys.modules[name]
loaded = set(sys.modules)
addon_utils.enable(MODULE, default_set=True)
loaded = sorted(set(sys.modules) - loaded)
on = state()
addon_utils.disable(MODULE, default_set=True)
addon_utils.enable(MODULE, default_set=True)
for _ in range(3):
    addon_utils.disable(MODULE, default_set=True)
    off = state()
    addon_utils.enable(MODULE, default_set=True)
values = bpy.context.preferences.addons[MODULE].preferences
say(off=off, first=first, on=on, again=state(), lost=lost, loaded=loaded,
    data_folder=values.data_folder, on_close=values.on_close,
    version=sys.modules[MODULE + ".core.run.runfolder"].PRODUCT_VERSION)
"""

CHANGE = """
values = bpy.context.preferences.addons[sys.argv[-1]].preferences
values.data_folder, values.on_close = sys.argv[-2], "KEEP"
bpy.ops.wm.save_userpref()
package = sys.modules[sys.argv[-1] + ".preferences"]
say(run=str(package.new_run_folder("room")))
"""


class Home:
    """A separate user folder, and a Blender that uses only this folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "BLENDER_USER_RESOURCES": str(folder / "blender"),
            "FIPT_DATA": str(folder / "data"),
            "PYTHONDONTWRITEBYTECODE": "",
        }
        (folder / "blender").mkdir(parents=True)

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Blender without a window."""
        command = [BLENDER, *arguments]
        return subprocess.run(
            command, env=self.environment, capture_output=True, text=True, timeout=1800, cwd=self.folder
        )

    def extension(self, *arguments: str) -> str:
        """Run `blender --command extension`; returns its output."""
        result = self.run("--command", "extension", *arguments)
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    def script(self, text: str, *arguments: str) -> dict:
        """Run a script with the user's preferences; returns its output."""
        file = self.folder / "script.py"
        file.write_text(STATE + text)
        result = self.run("--background", "--python", str(file), "--", *arguments, MODULE)
        lines = [line for line in result.stdout.splitlines() if line.startswith("ANSWER ")]
        assert lines, result.stdout + result.stderr
        return json.loads(lines[-1].removeprefix("ANSWER "))

    def installed(self) -> Path:
        """The folder of the installed extension."""
        found = [path.parent for path in (self.folder / "blender").rglob("fipt_blender/__init__.py")]
        assert len(found) <= 1
        return found[0] if found else self.folder / "none"


@pytest.fixture
def home(tmp_path: Path) -> Home:
    return Home(tmp_path / "home")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return load_dev().build_extension(tmp_path_factory.mktemp("dist"))


def older(archive: Path, folder: Path) -> Path:
    """The same extension as version 0.0.1, with a module that the next version does not have."""
    target = folder / "fipt_blender-0.0.1.zip"
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(target, "w") as copy:
        for name in source.namelist():
            data = source.read(name)
            if name in ("blender_manifest.toml", "core/run/runfolder.py"):
                pattern = rb'^(version|PRODUCT_VERSION) = ".+"$'
                data, count = re.subn(pattern, rb'\1 = "0.0.1"', data, flags=re.MULTILINE)
                assert count == 1
            copy.writestr(name, data)
        copy.writestr("gone.py", "")
    return target


def test_install_update_remove_and_install_again_lose_nothing(home: Home, archive: Path) -> None:
    install = ("install-file", "-r", "user_default", "-e")
    assert "Success" in home.extension("validate", str(archive))
    home.extension(*install, str(older(archive, home.folder)))
    assert (home.installed() / "gone.py").exists()
    far = home.folder / "far away"
    run = Path(home.script(CHANGE, str(far))["run"])
    (run / "marker").write_text("mine")
    assert run.parent == far / "runs"

    home.extension(*install, str(archive))
    assert not (home.installed() / "gone.py").exists()
    answer = home.script(ENABLED)
    assert answer["version"] != "0.0.1"
    assert (answer["data_folder"], answer["on_close"]) == (str(far), "KEEP")

    home.extension("remove", "fipt_blender")
    assert not home.installed().exists()
    assert (run / "marker").read_text() == "mine"
    assert not list((home.folder / "blender").rglob("*fipt*")), "nothing of it stays in Blender's folders"

    home.extension(*install, str(archive))
    answer = home.script(ENABLED)
    assert (answer["data_folder"], answer["on_close"]) == (str(far), "KEEP")
    assert (run / "marker").read_text() == "mine"


def test_disabling_leaves_nothing_and_enabling_loads_little(home: Home, archive: Path) -> None:
    home.extension("install-file", "-r", "user_default", "-e", str(archive))
    answer = home.script(ENABLED)
    nothing = {"classes": [], "operators": [], "scene": False, "handlers": {}, "keys": []}
    assert answer["first"] == answer["off"] == nothing and answer["lost"] is False
    assert answer["on"] == answer["again"] and "FIPT_OT_set_up_engine" in answer["on"]["classes"]
    assert needless(answer["loaded"], MODULE) == []


def test_command_line_and_its_exit_status(home: Home, archive: Path) -> None:
    home.extension("install-file", "-r", "user_default", "-e", str(archive))
    helped = home.run("--command", "fipt", "--help")
    assert helped.returncode == 0 and "estimate" in helped.stdout
    home.environment["FIPT_ENGINE_PYTHON"] = str(home.folder / "no-python")
    checked = home.run("--command", "fipt", "check")
    assert checked.returncode == 1 and "no-python" in checked.stderr
    assert home.run("--command", "fipt", "nonsense").returncode == 2

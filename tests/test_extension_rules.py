"""The extension's zip: what reviewers of Blender's extension platform ask for (CONTRIBUTING.md), and the site.

In a real Blender it is installed, updated, disabled and removed. That needs a Blender executable, named in
FIPT_TEST_BLENDER; in a folder of its own, it leaves the user's alone.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import bpy
import pytest

from fipt_blender import operators
from samples.child_processes import PATIENCE_SECONDS
from samples.development import load_dev
from samples.enabling import needless
from samples.fuzz_samples import write_transforms
from samples.pages import Page

ROOT = Path(__file__).resolve().parent.parent
# Blender's fixed list of tags for add-ons
TAGS = """3D View,Add Curve,Add Mesh,Animation,Bake,Camera,Compositing,Development,Game Engine,Geometry Nodes,
Grease Pencil,Import-Export,Lighting,Material,Modeling,Mesh,Node,Object,Paint,Pipeline,Physics,Render,Rigging,
Scene,Sculpt,Sequencer,System,Text Editor,Tracking,User Interface,UV""".replace("\n", "").split(",")
# Data and source text; no code that a reviewer can't read.
SUFFIXES = {".py", ".json", ".toml", ".txt", ".html", ".jpg", ".exr", ".obj", ""}
# What the source must contain for a permission to be used.
SIGNS = {"files": "write_json", "network": "online_access", "clipboard": "clipboard"}
# The command line without Blender, and two modules that run as children in the engine's Python.
STARTED_ALONE = {"__main__.py", "bridge/start.py", "core/device/probe.py"}

ACTIONS = """
import os, sys
package, data, capture = sys.argv[1:]
written, connected = set(), set()
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        mode, flags = arguments[1] or "", arguments[2] or 0
        if set(mode) & set("wax+") or flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            written.add(os.fsdecode(arguments[0]))
    elif event in ("os.mkdir", "os.rename", "os.remove", "os.link", "os.symlink", "shutil.rmtree"):
        written.update(os.fsdecode(each) for each in arguments[:2] if isinstance(each, (str, bytes)))
    elif event in ("socket.connect", "socket.getaddrinfo", "urllib.Request"):
        connected.add(event)
import bpy, importlib, json
sys.path.insert(0, package)
sys.addaudithook(watch)
addon = importlib.import_module("installed.fipt_blender")
api = importlib.import_module("installed.fipt_blender.api")
addon.register()
bpy.ops.fipt.copy_wheel_command()
api.import_capture(capture)
may_set_up = bpy.ops.fipt.set_up_engine.poll()
answer = {"written": sorted(written), "connected": sorted(connected), "may_set_up": may_set_up}
answer["online"] = bpy.app.online_access
print(json.dumps(answer), flush=True)
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[zipfile.ZipFile]:
    with zipfile.ZipFile(load_dev().build_extension(tmp_path_factory.mktemp("dist"))) as opened:
        yield opened


def test_the_manifest_keeps_the_rules(archive: zipfile.ZipFile) -> None:
    manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert manifest["schema_version"] == "1.0.0" and manifest["type"] == "add-on"
    assert manifest["id"] == "fipt_blender" and "blender" not in manifest["name"].lower()
    for text in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(text) <= 64 and text[-1].isalnum()
    assert set(manifest["tags"]) <= set(TAGS)
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert manifest["blender_version_min"].count(".") == 2


def test_permissions_are_those_that_are_used(archive: zipfile.ZipFile) -> None:
    manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    source = b"".join(archive.read(name) for name in archive.namelist() if name.endswith(".py")).decode()
    assert set(manifest["permissions"]) == {name for name, sign in SIGNS.items() if sign in source}


def test_everything_in_the_zip_can_be_read_by_a_reviewer(archive: zipfile.ZipFile) -> None:
    for name in archive.namelist():
        assert PurePosixPath(name).suffix in SUFFIXES, name
        assert not archive.read(name).startswith((b"\x7fELF", b"MZ", b"PK", b"\xcf\xfa\xed\xfe")), name


def test_blenders_python_stays_as_it_is(archive: zipfile.ZipFile) -> None:
    """No changed search path, no own package by an absolute name, no code made of text, no bl_info."""
    modules = sorted(name for name in archive.namelist() if name.endswith(".py"))
    for name in modules:
        source = archive.read(name).decode()
        assert not re.search(r"(?<![\w.])(exec|eval)\(", source), name
        if name not in STARTED_ALONE:
            assert not re.search(r"\bsys\.path(\.\w+\(|\[.*\] = | \+?= )|^bl_info\b", source, re.MULTILINE), name
            assert not re.search(r"^\s*(from|import) fipt_blender\b", source, re.MULTILINE), name
    assert len(modules) > 100


def test_it_writes_into_the_users_folder_alone_and_is_offline(archive: zipfile.ZipFile, tmp_path: Path) -> None:
    """The extension, installed elsewhere, imports a capture; Blender is offline, as bpy is by default. A script
    that leaves the add-on registered ends by itself."""
    data, package = tmp_path / "data", tmp_path / "site" / "installed" / "fipt_blender"
    archive.extractall(package)
    (tmp_path / "capture").mkdir()
    write_transforms(tmp_path / "capture")
    environment = {**os.environ, "FIPT_DATA": str(data), "FIPT_ENGINE_PYTHON": sys.executable}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    command = [sys.executable, "-c", ACTIONS, *map(str, (tmp_path / "site", data, tmp_path / "capture"))]
    ended = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=PATIENCE_SECONDS, cwd=tmp_path
    )
    assert ended.returncode == 0, ended.stderr
    answer = json.loads(next(line for line in ended.stdout.splitlines() if line.startswith("{")))
    assert answer["connected"] == [] and answer["online"] is answer["may_set_up"] is False
    allowed = (str(data), os.devnull)
    assert any(path.startswith(str(data)) for path in answer["written"])
    assert [path for path in answer["written"] if not path.startswith(allowed)] == []


def test_the_site_is_complete(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_SECONDS)
    assert built.returncode == 0, built.stderr
    pages = {path.relative_to(tmp_path).with_suffix("") for path in tmp_path.rglob("*.html")}
    docs = ROOT / "docs"
    assert {path.relative_to(docs).with_suffix("") for path in docs.rglob("*.md")} <= pages
    page = Page(tmp_path / "operators.html")
    for each in operators.CLASSES:
        if issubclass(each, bpy.types.Operator):
            internal = "INTERNAL" in getattr(each, "bl_options", ())
            assert (f"bpy.ops.{each.bl_idname}\n" in page.text) != internal, each.bl_idname
    options = Page(tmp_path / "options.html").text
    assert all(text in options for text in ("--hold-back", "--render-spp", "diffuse_spp", "working_width"))
    assert not list(tmp_path.rglob("*.py")), "hooks are no pages"


def test_the_guide_in_the_zip_is_complete(archive: zipfile.ZipFile) -> None:
    names = {name.removeprefix("guide/") for name in archive.namelist() if name.startswith("guide/")}
    pages = {name: Page(archive.read(f"guide/{name}")) for name in names if name.endswith(".html")}
    for name, page in pages.items():
        assert page.in_order and not page.open
        for target in page.values("href", "src"):
            if not target.startswith("https://"):
                file, _, place = target.partition("#")
                assert (file or name) in names, (name, target)
                assert not place or place in pages[file or name].values("id"), (name, target)
    assert {f"{chapter}.html" for chapter in ("lights", "check")} <= names
    assert "install.html" in names
    for path in (ROOT / "docs" / "guide").glob("*.md"):
        shown = " ".join(pages[f"{path.stem}.html"].text.split())
        guide = path.read_text(encoding="utf-8").partition("```")[0]
        guide = re.sub(r"!\[[^]]*\]\([^)]*\)|^\|[-|]+\|$", "", guide, flags=re.MULTILINE)
        guide = re.sub(r"^#+ |^ *(-|\d\.) |[*`]", "", guide, flags=re.MULTILINE)
        guide = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", guide)
        for words in re.split(r"[|\n]", guide):
            assert " ".join(words.split()) in shown
        assert "**" not in shown and "](" not in shown and "|" not in shown


BLENDER = os.environ.get("FIPT_TEST_BLENDER", "")
MODULE = "bl_ext.user_default.fipt_blender"

in_blender = pytest.mark.skipif(not BLENDER, reason="FIPT_TEST_BLENDER names no Blender")

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
    data_folder=values.data_folder, device=values.device,
    version=sys.modules[MODULE + ".core.run.runfolder"].PRODUCT_VERSION)
"""

CHANGE = """
values = bpy.context.preferences.addons[sys.argv[-1]].preferences
values.data_folder, values.device = sys.argv[-2], "llvm"
bpy.ops.wm.save_userpref()
package = sys.modules[sys.argv[-1] + ".machine"]
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


def older(archive: zipfile.ZipFile, folder: Path) -> Path:
    """The same extension as version 0.0.1, with a module that the next version does not have."""
    target = folder / "fipt_blender-0.0.1.zip"
    with zipfile.ZipFile(target, "w") as copy:
        for name in archive.namelist():
            data = archive.read(name)
            if name in ("blender_manifest.toml", "core/run/runfolder.py"):
                pattern = rb'^(version|PRODUCT_VERSION) = ".+"$'
                data, count = re.subn(pattern, rb'\1 = "0.0.1"', data, flags=re.MULTILINE)
                assert count == 1
            copy.writestr(name, data)
        copy.writestr("gone.py", "")
    return target


@in_blender
def test_install_update_remove_and_install_again_lose_nothing(home: Home, archive: zipfile.ZipFile) -> None:
    install = ("install-file", "-r", "user_default", "-e")
    assert "Success" in home.extension("validate", str(archive.filename))
    home.extension(*install, str(older(archive, home.folder)))
    assert (home.installed() / "gone.py").exists()
    far = home.folder / "far away"
    run = Path(home.script(CHANGE, str(far))["run"])
    (run / "marker").write_text("mine")
    assert run.parent == far / "runs"

    home.extension(*install, str(archive.filename))
    assert not (home.installed() / "gone.py").exists()
    answer = home.script(ENABLED)
    assert answer["version"] != "0.0.1"
    assert (answer["data_folder"], answer["device"]) == (str(far), "llvm")

    home.extension("remove", "fipt_blender")
    assert not home.installed().exists()
    assert (run / "marker").read_text() == "mine"
    assert not list((home.folder / "blender").rglob("*fipt*")), "nothing of it stays in Blender's folders"

    home.extension(*install, str(archive.filename))
    answer = home.script(ENABLED)
    assert (answer["data_folder"], answer["device"]) == (str(far), "llvm")
    assert (run / "marker").read_text() == "mine"


@in_blender
def test_disabling_leaves_nothing_and_the_command_line_has_its_exit_status(
    home: Home, archive: zipfile.ZipFile
) -> None:
    home.extension("install-file", "-r", "user_default", "-e", str(archive.filename))
    answer = home.script(ENABLED)
    nothing = {"classes": [], "operators": [], "scene": False, "handlers": {}, "keys": []}
    assert answer["first"] == answer["off"] == nothing and answer["lost"] is False
    assert answer["on"] == answer["again"] and "FIPT_OT_set_up_engine" in answer["on"]["classes"]
    assert needless(answer["loaded"], MODULE) == [], "enabling loads little"
    helped = home.run("--command", "fipt", "--help")
    assert helped.returncode == 0 and "estimate" in helped.stdout
    home.environment["FIPT_ENGINE_PYTHON"] = str(home.folder / "no-python")
    checked = home.run("--command", "fipt", "check")
    assert checked.returncode == 1 and "no-python" in checked.stderr
    assert home.run("--command", "fipt", "nonsense").returncode == 2

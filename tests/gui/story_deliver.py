"""The story's last chapter: from the estimated room to what a client gets, in few clicks."""

from __future__ import annotations

import subprocess
from pathlib import Path

import agent
import bpy
import inside
from chapters import Options
from hand import PICTURE
from window import Window

_FILES = ("FILE_BROWSER", "EXECUTE")
_MOST_CLICKS = 15
_RENDER_SECONDS = 3600.0
_PREVIEW = 20  # percent of the pictures' size, with --fast

# What a Blender without the extension sees of a collected file: images without a file; and its render.
_OPENED = """
import bpy, os, sys
scene = bpy.context.scene
assert not hasattr(scene, "fipt")
files = [image for image in bpy.data.images if image.source == "FILE" and not image.packed_files]
places = [bpy.path.abspath(image.filepath) for image in files]
missing = [place for place in places if not os.path.isfile(place)]
scene.cycles.samples, scene.render.resolution_percentage = 16, 20
scene.render.filepath = sys.argv[-1]
scene.render.image_settings.file_format = "PNG"
bpy.ops.render.render(write_still=True)
print("MISSING", missing)
"""


def deliver(window: Window, options: Options) -> None:
    """One lamp on, a product placed, a picture of the room, one over the photograph, a copy for others."""
    folder = window.shots.resolve() / "delivered"
    window.ask(_save_in, str(folder), options.fast)
    window.open_section("Lights")  # what was open before does not count
    window.settle()
    start = window.presses
    window.click("fipt.switch_lights", on=False)
    window.tick("lights.lights[0].on", True)
    window.settle(10.0)
    window.shot("40_one_lamp")
    _section(window, "Render", "Picture")
    before = set(window.ask(inside.objects))
    window.point_in_view(0.41, 0.31)
    window.key("shift+RIGHTMOUSE")  # the 3D cursor
    window.presses += 1
    window.click("fipt.add_ball", kind="MIRROR_BALL")
    window.wait(inside.objects, until=lambda names: len(set(names) - before) > 0)
    window.settle(10.0)
    window.shot("41_placed")
    _picture(window, "43_final_picture")
    window.ask(_scale, 100)  # the example's photographs are small
    window.click("fipt.set_backdrop", mode="PHOTOGRAPH")
    window.settle()
    window.shot("44_over_the_photograph")
    _picture(window, "45_over_the_photograph")
    _section(window, "Materials", "Hand Off")
    window.click("fipt.collect_room")
    window.wait(agent.is_open, *_FILES)
    window.settle()
    window.shot("46_collect")
    window.click("file.execute", _FILES)
    copy = window.wait(_collected, str(folder), seconds=120)
    window.settle()
    window.shot("47_collected")
    clicks = window.presses - start
    opened = _open_elsewhere(copy, window.shots.resolve() / "48_opened_elsewhere.png", window)
    assert opened == "[]" and clicks <= _MOST_CLICKS, (opened, clicks)


def _section(window: Window, *labels: str) -> None:
    """Open a section and its parts as an artist does, by one click (Ctrl) on each header."""
    before = window.presses
    window.open_section(*labels)
    window.presses = before + len(labels)


def _save_in(folder: str, small: bool) -> None:
    """Give the file a name, as an artist's has one by now."""
    Path(folder).mkdir(exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / "room.blend"))
    _scale(_PREVIEW if small else 100)


def _scale(percent: int) -> None:
    bpy.context.scene.render.resolution_percentage = percent


def _picture(window: Window, name: str) -> None:
    """Press Final Picture, wait for the window with it and close that."""
    before = window.ask(inside.picture)
    window.click("fipt.final_picture")
    picture = Path(window.wait(inside.picture, until=lambda now: now != before, seconds=_RENDER_SECONDS))
    assert picture.is_file() and picture.with_suffix(".exr").is_file(), picture
    window.wait(agent.is_open, *PICTURE)
    window.settle(5.0)
    window.shot(name)
    window.ask(agent.close_window, PICTURE[0])
    window.settle()


def _collected(folder: str) -> str:
    """The collected file, "" until it is there."""
    found = sorted(Path(folder).glob("*_collected/*.blend"))
    return str(found[0]) if found else ""


def _open_elsewhere(copy: str, picture: Path, window: Window) -> str:
    """Open a file in a Blender without the extension and render it; the images that are missing."""
    program = window.ask(lambda: bpy.app.binary_path)
    command = [program, "--background", "--factory-startup", copy, "--python-exit-code", "1"]
    command += ["--python-expr", _OPENED, "--", str(picture)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return next(line for line in done.stdout.splitlines() if line.startswith("MISSING")).partition(" ")[2]

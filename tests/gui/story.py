"""The GUI test: from an empty scene to a relit render, by mouse and keyboard.

Each chapter acts through the window, then asserts on Blender's data and takes its pictures.
"""

from __future__ import annotations

import json
import shutil
import statistics
import subprocess
import time
from pathlib import Path

import agent
import bpy
import inside
import story_align
import story_deliver
import story_hints
import story_lights
import story_materials
from chapters import Chapter, Options, finish
from hand import PICTURE, PREFERENCES
from window import Window

_ENGINE_SECONDS = 3600.0
_FIRST_PICTURE_SECONDS = 60.0  # of Cycles, on a busy machine
_COLORED = 8.0  # of 255, as `Window.colors` tells it; gray has 0, the example's room 38
_DRAWS = 25
_PREFERENCES_PAGES = (("PREFERENCES", "NAVIGATION_BAR"), ("PREFERENCES", "UI"))  # up to 4.5, from 5.0
# Advanced settings with --fast.
_FAST = {
    "diffuse_samples": 8,
    "specular_samples": 4,
    "light_samples": 2,
    "training_steps": 100,
    "voxel_resolution": 48,
    "roughness_levels": 3,
}
_MAPS = ("ORIGINAL", "BASE_COLOR", "ROUGHNESS", "METALLIC", "EMISSION", "CONFIDENCE", "ESTIMATED")


def empty_scene(window: Window, options: Options) -> None:
    """Select all with the keyboard and delete it."""
    window.point_in_view()
    window.key("A", "DEL")
    window.wait(inside.counts, until=lambda counts: counts["objects"] == 0)
    window.open_tab()
    window.settle()
    window.shot("01_empty_scene")
    assert window.sections() == ["Start"], window.sections()


def preferences(window: Window, options: Options) -> None:
    """Find the extension in the preferences, name the interpreter, press Check."""
    module = window.ask(lambda: inside.ours("machine").ADDON)
    window.point_in_view()
    window.key("ctrl+COMMA")
    window.wait(agent.is_open, *PREFERENCES)
    window.settle()
    pages = next(where for where in _PREFERENCES_PAGES if window.ask(agent.is_open, *where))
    window.pick("preferences.active_section", "ADDONS", pages)
    window.set_text("addon_search", "fipt", PREFERENCES)
    window.click("preferences.addon_expand", PREFERENCES, module=module)
    window.shot("02_preferences_before")
    assert not window.ask(inside.engine_status)["ready"]
    window.set_text("engine_python", str(options.engine), PREFERENCES)
    window.click("fipt.check_engine", PREFERENCES)
    status = window.wait(inside.engine_status, until=lambda s: s["ready"] or s["error"], seconds=120)
    assert status["ready"], status["error"]
    window.wait(inside.busy, until=lambda busy: not busy)
    window.hover("engine_python", PREFERENCES)  # the Check button has moved away from the pointer
    window.settle()
    window.shot("03_preferences_after")
    window.ask(agent.close_window, "PREFERENCES")
    window.settle()


def example(window: Window, options: Options) -> None:
    """One click, and the lit room is seen from inside; without a capture, the tab offers nothing else."""
    window.open_tab()
    window.settle()
    window.shot("03_start")
    assert window.sections() == ["Start"], window.sections()
    presses = window.presses
    window.click("fipt.try_example")
    assert window.presses == presses + 1
    _progress(window, 0.3)
    window.shot("03_example_running")
    finish(window, "estimate", _ENGINE_SECONDS)
    _assert_inside(window, "held_back")
    window.shot("03_example_lit")


def _assert_inside(window: Window, split: str) -> None:
    """The room has textures, and the 3D view soon shows its light, through a view of a split."""
    textured = window.ask(inside.textured)
    assert textured["objects"] == textured["textured"] > 0, textured
    seen = window.ask(inside.seen)
    assert seen == {"split": split, "shading": "RENDERED"}, seen
    end = time.monotonic() + _FIRST_PICTURE_SECONDS
    while window.colors() < _COLORED:
        if time.monotonic() > end:
            raise agent.Lost("the 3D view stays gray")
        time.sleep(0.5)


def photographs(window: Window, options: Options) -> None:
    """Drop a camera's photographs, correct their brackets by hand, make a capture of them and import it."""
    folder = window.shots.resolve() / "photographs"
    shutil.rmtree(folder, ignore_errors=True)
    script = Path(__file__).with_name("brackets.py")
    subprocess.run([options.engine, script, options.capture, folder], check=True)
    window.open_section("Start")
    window.ask(inside.drop, [str(file) for file in sorted((folder / "card").iterdir())])
    finish(window, "photographs")
    window.open_section("Photographs")
    found = window.ask(inside.photographs)
    assert Path(found["path"]) == folder / "card" and set(found["sizes"]) == {3}, found
    window.shot("03_photographs_found")
    window.click_row("photographs.active_group", 1)
    window.click_row("photographs.active_photograph", 2)
    window.click("fipt.split_bracket")
    split = window.wait(inside.photographs, until=lambda now: now["sizes"][1:3] == [2, 1])
    assert len(split["sizes"]) == len(found["sizes"]) + 1
    window.shot("03_photographs_split")
    window.click("fipt.merge_brackets")
    window.wait(inside.photographs, until=lambda now: now["sizes"] == found["sizes"])
    window.tick("photographs.groups[4].used", False)
    window.open_section("Photographs", "Settings")
    window.set_text("photographs.cameras", str(folder / "solve"))
    window.shot("03_photographs_settings")
    window.open_section("Photographs")
    window.click("fipt.prepare")
    finish(window, "photographs")
    prepared = window.ask(inside.photographs)
    assert prepared["registered"] == sum(prepared["used"]) == len(found["sizes"]) - 1, prepared
    assert (Path(prepared["capture"]) / "report" / "index.html").is_file()
    window.shot("03_photographs_prepared")
    window.click("fipt.import_capture")
    finish(window, "capture")
    counts = window.ask(inside.counts)
    assert counts["views"] == counts["cameras"] == prepared["registered"], counts
    window.point_in_view()
    window.settle()
    window.shot("03_photographs_imported")


def capture(window: Window, options: Options) -> None:
    """Import the example, look through its views and check them."""
    window.open_section("Start")
    window.set_text("capture.path", str(options.capture))
    window.click("fipt.import_capture")
    finish(window, "capture")
    window.shot("04_capture_closed")
    window.open_section("Capture", "Views")
    counts = window.ask(inside.counts)
    pictures = len(list(options.capture.glob("*/Image/*.exr")))
    assert counts["views"] == counts["cameras"] == pictures, (counts, pictures)
    assert counts["held_back"] > 0 and counts["room"] > 0, counts
    window.shot("04_capture_imported")
    cameras = window.ask(inside.view_cameras)
    for index in (2, 0):
        window.click_row("capture.active_view", index)
        window.wait(inside.view_through, until=cameras[index].__eq__)
    window.click("fipt.look_through", step=1)
    window.wait(inside.view_through, until=cameras[1].__eq__)
    window.shot("05_capture_view")
    window.click("fipt.check_views")
    finish(window, "survey")
    assert window.ask(inside.counts)["checked"] == counts["views"]
    window.click("fipt.show_coverage")
    window.settle()
    window.shot("06_capture_coverage")
    window.click("fipt.show_coverage", show=False)


def parts(window: Window, options: Options) -> None:
    """Colour the room by its parts."""
    window.open_section("Estimate", "Parts")
    window.click("fipt.show_parts")
    window.settle()
    window.shot("07_parts")
    window.click("fipt.show_parts", show=False)


def estimate(window: Window, options: Options) -> None:
    """Start the engine, stop it with ESC midway, resume it."""
    window.open_section("Estimate")
    window.choose("estimate.preset", "draft")
    if options.fast:
        window.open_section("Estimate", "Advanced")
        for name, value in _FAST.items():
            window.set_text(f"estimate.{name}", str(value))
        window.open_section("Estimate")
    window.click("fipt.estimate")
    window.wait(
        inside.job, "estimate", until=lambda job: job["fraction"] >= 0.4 or job["error"], seconds=_ENGINE_SECONDS
    )
    window.shot("08_estimate_running")
    window.key("ESC")
    if not _stops(window):  # a run of more than a minute asks first
        window.shot("08_estimate_asked")
        window.key("RET")
    job = window.wait(inside.job, "estimate", until=lambda job: job["state"] != "running", seconds=300)
    assert job["state"] == "cancelled", job
    window.settle()
    window.shot("09_estimate_cancelled")
    stages = window.wait(_stages)
    window.click("fipt.resume")
    _progress(window, 0.1)
    window.shot("10_estimate_resumed")
    assert stages > 0
    finish(window, "estimate", _ENGINE_SECONDS)
    finish(window, "materials", _ENGINE_SECONDS)
    _assert_inside(window, "train")  # through the view that was chosen before
    window.shot("11_estimate_applied")


def _stages() -> int:
    """How many stages of the estimate are finished on disk."""
    return inside.ours("jobs.runstate").known(bpy.context.scene.fipt.run_folder).stages


def _stops(window: Window) -> bool:
    """Whether the estimate was told to stop within a second."""
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        job = window.ask(inside.job, "estimate")
        if job["stopping"] or job["state"] != "running":
            return True
    return False


def materials(window: Window, options: Options) -> None:
    """Show the room's maps one after the other."""
    window.open_section("Materials")
    window.shot("12_materials")
    for shown in _MAPS:
        window.choose("materials.shown", shown)
        window.settle(5.0)
        window.shot(f"13_show_{shown.lower()}")


def check(window: Window, options: Options) -> None:
    """A picture of the current view before anything is changed, and the report."""
    window.open_section("Render", "Picture")
    window.choose("check.size", "PHOTOGRAPH")  # as the picture that it is compared with
    window.click("fipt.final_picture")
    window.wait(inside.picture, seconds=600)
    window.wait(agent.is_open, *PICTURE)
    window.settle()
    window.shot("14_check_render")
    window.ask(agent.close_window, PICTURE[0])
    window.open_section("Render", "Report")
    window.click("fipt.write_report")
    finish(window, "report")
    assert Path(window.ask(lambda: bpy.context.scene.fipt.check.report)).is_file()


def lights(window: Window, options: Options) -> None:
    """Switch a fixture off, and add a light."""
    window.open_section("Capture", "Views")
    window.click_row("capture.active_view", 1)  # the photograph instead of the check's picture
    window.open_section("Lights")
    rows = window.ask(inside.light_rows)
    assert rows, "no fixtures"
    before = window.ask(inside.emission_strengths, rows[0]["name"])
    assert max(before) > 0.0, before
    window.shot("16_lights")
    window.tick("lights.lights[0].on", False)
    after = window.ask(inside.emission_strengths, rows[0]["name"])
    assert max(after) == 0.0, after
    window.settle()
    window.shot("17_fixture_off")
    window.click("fipt.add_light", place="PICK")
    window.point_in_view(0.45, 0.3)
    window.press()
    added = window.wait(inside.light_rows, until=lambda now: len(now) == len(rows) + 1)
    assert added[-1]["kind"] == "LIGHT" and added[-1]["on"], added
    window.settle()
    window.shot("18_light_added")


def insert(window: Window, options: Options) -> None:
    """Add a ball at the 3D cursor, and render the relit room with it."""
    window.open_section("Render", "Picture")
    before = set(window.ask(inside.objects))
    window.point_in_view(0.45, 0.35)
    window.key("shift+RIGHTMOUSE")  # the 3D cursor
    window.click("fipt.add_ball", kind="GRAY_BALL")
    new = window.wait(inside.objects, until=lambda names: len(set(names) - before) > 0)
    selected = window.ask(lambda: [item.name for item in bpy.context.view_layer.objects.selected])
    assert {*selected} & ({*new} - before), new
    window.shot("19_inserted")
    rendered = window.ask(inside.picture)
    window.click("fipt.final_picture")
    picture = window.wait(inside.picture, until=lambda now: now != rendered, seconds=600)
    change = window.ask(inside.change, rendered, picture)
    assert change > 0.05, change
    window.ask(agent.close_window, PICTURE[0])
    window.shot("20_relit_panel")
    window.click("fipt.open_picture")
    window.wait(agent.is_open, *PICTURE)
    window.settle()
    window.shot("21_relit_render")
    window.ask(agent.close_window, PICTURE[0])


def draw_requests(window: Window, options: Options) -> None:
    """Have each panel drawn many times on the finished scene: most draws ask the system for nothing."""
    window.ask(agent.draw_requests)
    for label in window.sections():
        window.open_section(label)
        for _ in range(_DRAWS):
            window.redraw()
    found = {
        name: {"median": statistics.median(counts), "max": max(counts), "draws": len(counts)}
        for name, counts in sorted(window.ask(agent.draw_requests).items())
    }
    (window.shots / "draw_requests.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    asking = {name: counts for name, counts in found.items() if counts["median"]}
    assert not asking, asking


def _progress(window: Window, fraction: float) -> None:
    """Wait until the estimate has reached a stage, with the pointer out of the way."""
    window.point_in_view()
    window.wait(
        inside.job,
        "estimate",
        until=lambda job: job["fraction"] >= fraction or job["state"] != "running",
        seconds=_ENGINE_SECONDS,
        every=0.2,
    )
    job = window.ask(inside.job, "estimate")
    assert job["state"] == "running", job


CHAPTERS = (
    Chapter(empty_scene),
    Chapter(preferences, "empty_scene"),
    Chapter(example, "preferences"),
    Chapter(photographs, "preferences", anew=True),
    Chapter(capture, "preferences", anew=True),
    Chapter(story_align.align, "capture"),
    Chapter(parts, "capture"),
    Chapter(estimate, "capture"),
    Chapter(story_hints.hints, "estimate"),
    Chapter(materials, "estimate"),
    Chapter(story_materials.part_materials, "materials"),
    Chapter(check, "materials"),
    Chapter(lights, "check"),
    Chapter(story_lights.named, "check"),
    Chapter(story_lights.menus, "check"),
    Chapter(story_lights.aim, "check"),
    Chapter(story_lights.eevee, "check"),
    Chapter(insert, "lights"),  # relit: a lamp is off
    Chapter(draw_requests, "insert"),
    Chapter(story_deliver.deliver, "estimate", anew=True),
)

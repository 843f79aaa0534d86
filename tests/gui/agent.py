"""What a driver in another thread may ask of Blender; only `simulate` acts, by events."""

from __future__ import annotations

import inspect
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

_TICK_SECONDS = 0.005
_ANSWER_SECONDS = 600.0  # longer than anything for which Blender stands still


class _Watch:
    """What the panels' draw functions asked of the system, and how often the sidebar was drawn."""

    def __init__(self) -> None:
        self.requests: dict[str, list[int]] = {}
        self.asked = 0
        sys.addaudithook(self._note)
        self.drawn: set[str] = set()
        self.redraws = self.forgotten = 0
        self.wrapped: set[type] = set()

    def wrap(self, prefix: str) -> None:
        """Watch the draw functions of the panels whose class name has this prefix."""
        for panel in _panels(prefix):
            if panel not in self.wrapped:
                self.wrapped.add(panel)
                panel.draw = self._watched(panel.__name__, panel.draw)

    def _watched(self, name: str, draw: Callable[..., None]) -> Callable[..., None]:
        def watched(panel: bpy.types.Panel, context: bpy.types.Context) -> None:
            before = self.asked
            try:
                draw(panel, context)
            finally:
                self.requests.setdefault(name, []).append(self.asked - before)
                self.drawn.add(name)

        return watched

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if threading.current_thread() is threading.main_thread():
            self.asked += event in ("open", "os.listdir", "os.scandir", "subprocess.Popen", "import")


_watch = _Watch()


def _panels(prefix: str) -> list[type[bpy.types.Panel]]:
    """The registered panels whose class name has this prefix."""
    found = []
    classes = list(bpy.types.Panel.__subclasses__())
    while classes:
        each = classes.pop()
        classes.extend(each.__subclasses__())
        if each.__name__.startswith(prefix) and each.is_registered:
            found.append(each)
    return found


def _spaces() -> Iterator[tuple[bpy.types.Window, bpy.types.Area, bpy.types.Region]]:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                yield window, area, region


def _find(area: str, region: str) -> dict[str, Any]:
    """Context of the largest area of a type and its region of a type, in the newest window that has one."""
    found = [s for s in _spaces() if s[1].type == area and s[2].type == region and s[2].width > 1]
    if not found:
        raise LookupError(f"no {region} of a {area} is open")
    windows = list(bpy.context.window_manager.windows)
    window, its_area, its_region = max(found, key=lambda s: (windows.index(s[0]), s[1].width * s[1].height))
    return {"window": window, "area": its_area, "region": its_region}


def place(area: str, region: str) -> dict[str, int]:
    """A region's rectangle in screen pixels (y up), and Blender's interface scale."""
    found = _find(area, region)
    window, its_region = found["window"], found["region"]
    return {
        "x": window.x + its_region.x,
        "y": window.y + its_region.y,
        "width": its_region.width,
        "height": its_region.height,
        "scale": bpy.context.preferences.system.ui_scale,
    }


def tab(area: str = "VIEW_3D") -> str:
    """The sidebar's active tab."""
    return _find(area, "UI")["region"].active_panel_category


def is_open(area: str, region: str) -> bool:
    """Whether a region of this type is on the screen."""
    return any(s[1].type == area and s[2].type == region and s[2].width > 1 for s in _spaces())


def button(area: str, region: str) -> dict[str, str]:
    """The button under the pointer: its operator as Python, and the full path of its property."""
    manager = bpy.context.window_manager
    answer = {"operator": "", "property": ""}
    with bpy.context.temp_override(**_find(area, region)):
        manager.clipboard = ""
        if (found := bpy.context.property) is not None:
            owner, path, index = found  # for nested groups this is the last name only
            if bpy.ops.ui.copy_data_path_button.poll():
                bpy.ops.ui.copy_data_path_button(full_path=True)
            place = f"[{index}]" if index >= 0 else ""
            answer["property"] = manager.clipboard or f"{_owner_path(owner)}.{path}{place}"
        elif bpy.ops.ui.copy_python_command_button.poll():
            bpy.ops.ui.copy_python_command_button()
            answer["operator"] = manager.clipboard
    return answer


def _owner_path(owner: Any) -> str:
    """Python path of a part of the preferences, for which Blender gives none."""
    if isinstance(owner, bpy.types.AddonPreferences):
        for name, addon in bpy.context.preferences.addons.items():
            if addon.preferences == owner:
                return f'bpy.context.preferences.addons["{name}"].preferences'
    return "bpy.context.preferences" if isinstance(owner, bpy.types.Preferences) else type(owner).__name__


def value(path: str) -> Any:
    """The value at a path that `button` gave; for an ID its name."""
    for prefix, start in (("bpy.data.", bpy.data), ("bpy.context.", bpy.context)):
        if path.startswith(prefix):
            found = _resolve(start, path.removeprefix(prefix))
            return found.name if isinstance(found, bpy.types.ID) else _plain(found)
    raise LookupError(path)


def items(path: str) -> list[str]:
    """Identifiers of an enumeration's items, in order."""
    owner, _, name = path.rpartition(".")
    start = bpy.data if owner.startswith("bpy.data.") else bpy.context
    found = _resolve(start, owner.split(".", 2)[2])
    return [item.identifier for item in found.bl_rna.properties[name].enum_items]


def _resolve(start: Any, path: str) -> Any:
    if start is bpy.context:  # no Blender data: plain Python attributes
        name, _, path = path.partition(".")
        start = getattr(start, name)
    return start.path_resolve(path) if path else start


def _plain(found: Any) -> Any:
    return found if isinstance(found, str | int | float | bool | None) else list(found)


def redraws() -> int:
    """How often the sidebar was drawn."""
    return _watch.redraws


def scroll(area: str, region: str) -> float:
    """Scroll position of a region in pixels from its upper end; it decreases downwards."""
    found = _find(area, region)["region"]
    return found.view2d.region_to_view(0.0, float(found.height))[1]


def project(point: list[float]) -> list[float] | None:
    """Pixel of the 3D viewport, from its lower left, that shows a world position; None behind the viewer."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    found = _find("VIEW_3D", "WINDOW")
    pixel = location_3d_to_region_2d(found["region"], found["area"].spaces.active.region_3d, point)
    return None if pixel is None else list(pixel)


def forget_drawn(prefix: str = "FIPT_PT_") -> None:
    """Clear the list of drawn panels and redraw the sidebar."""
    _watch.wrap(prefix)
    _watch.drawn.clear()
    _watch.forgotten = _watch.redraws
    for _, _, region in _spaces():
        if region.type == "UI":
            region.tag_redraw()


def drawn_anew() -> bool:
    """Whether the sidebar was drawn since `forget_drawn`."""
    return _watch.redraws > _watch.forgotten


def drawn() -> list[str]:
    """Names of the panels drawn open since `forget_drawn`."""
    return sorted(_watch.drawn)


def panels(prefix: str = "FIPT_PT_") -> list[dict[str, Any]]:
    """The add-on's panels that the viewport's sidebar shows, in the order in which they are drawn."""
    view = _find("VIEW_3D", "UI") if is_open("VIEW_3D", "UI") else _find("VIEW_3D", "WINDOW")
    shown = {}
    with bpy.context.temp_override(**view):
        for panel in _panels(prefix):
            poll = getattr(panel, "poll", None)
            shown[panel.__name__] = poll is None or poll(bpy.context)
    found = [
        {
            "name": panel.__name__,
            "label": panel.bl_label,
            "order": getattr(panel, "bl_order", 0),
            "parent": getattr(panel, "bl_parent_id", ""),
            "closed": "DEFAULT_CLOSED" in getattr(panel, "bl_options", ()),
        }
        for panel in _panels(prefix)
        # Others are menus of presets.
        if (panel.bl_space_type, panel.bl_region_type) == ("VIEW_3D", "UI") and shown[panel.__name__]
    ]
    return sorted(found, key=lambda panel: panel["order"])


def draw_requests() -> dict[str, list[int]]:
    """Files, folders, processes and imports that each draw call asked for, by panel; clears the record."""
    requests, _watch.requests = _watch.requests, {}
    return requests


def simulate(kind: str, value: str, x: int, y: int, more: dict[str, Any]) -> None:
    """An event of pointer or keyboard in the newest window at a pixel of the screen, from its top left."""
    windows = bpy.context.window_manager.windows
    y = windows[0].y + windows[0].height - 1 - y
    at = [w for w in windows if 0 <= x - w.x < w.width and 0 <= y - w.y < w.height]
    at[-1].event_simulate(kind, value, x=x - at[-1].x, y=y - at[-1].y, **more)


def viewport_samples(count: int) -> None:
    """Set Cycles' samples of viewports."""
    bpy.context.scene.cycles.preview_samples = count


def close_window(area: str) -> None:
    """Close an editor's window, as a window manager's button would: the screen has no window manager."""
    with bpy.context.temp_override(window=_find(area, "WINDOW")["window"]):
        bpy.ops.wm.window_close()


def save_copy(path: str) -> None:
    """Save a copy of the scene beside the screenshots; the open file stays the same."""
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True, compress=True)


def open_file(path: str) -> None:
    """Open a scene that `save_copy` has saved, with its own windows."""
    bpy.ops.wm.open_mainfile(filepath=path)


def count_redraw() -> None:
    """Called whenever the sidebar is drawn."""
    _watch.redraws += 1


class Lost(AssertionError):
    """An expected button, window or condition did not appear."""


class Blender:
    """Blender's main thread, which answers a driver in another thread; made in the main thread.

    Args:
        shots: folder of the pictures.
    """

    def __init__(self, shots: Path) -> None:
        self.shots = shots
        window = bpy.context.window_manager.windows[0]
        self.height = window.y + window.height  # of the screen
        self._questions: queue.SimpleQueue[list[Any]] = queue.SimpleQueue()
        self._waiting: list[list[Any]] = []
        bpy.app.timers.register(self._tick, first_interval=0.5, persistent=True)

    def ask(self, call: Callable[..., Any], *arguments: Any, ticks: int = 0) -> Any:
        """What a function returns in Blender's main thread: plain values alone.

        Args:
            ticks: rounds of Blender's main loop to let pass before.

        Raises:
            Lost: the function raised, or Blender does not answer.
        """
        answer: queue.SimpleQueue[tuple[Any, str]] = queue.SimpleQueue()
        self._questions.put([ticks, call, arguments, answer])
        try:
            result, error = answer.get(timeout=_ANSWER_SECONDS)
        except queue.Empty:
            raise Lost(f"Blender does not answer {call.__name__}") from None
        if error:
            raise Lost(error)
        return result

    def wait(
        self,
        call: Callable[..., Any],
        *arguments: Any,
        seconds: float = 20.0,
        until: Callable[[Any], bool] = bool,
        every: float = 0.05,
    ) -> Any:
        """Ask until the answer is true (or satisfies `until`); returns the answer.

        Raises:
            Lost: it did not come true in time.
        """
        end = time.monotonic() + seconds
        while not until(answer := self.ask(call, *arguments)):
            if time.monotonic() > end:
                line = inspect.getsource(call).strip() if call.__name__ == "<lambda>" else call.__name__
                raise Lost(f"{line} {arguments or ''} was {answer!r} after {seconds:g} seconds")
            time.sleep(every)
        return answer

    def _tick(self) -> float:
        ready = [question for question in self._waiting if question[0] <= 0]
        self._waiting = [question for question in self._waiting if question[0] > 0]
        for question in self._waiting:
            question[0] -= 1
        while not self._questions.empty():
            self._waiting.append(self._questions.get())
        for _, call, arguments, answer in ready:
            try:
                answer.put((call(*arguments), ""))
            except Exception:
                answer.put((None, traceback.format_exc()))
        return _TICK_SECONDS

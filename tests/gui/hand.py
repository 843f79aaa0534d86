"""Moves Blender's pointer, clicks and types, and finds the buttons to click.

Buttons are found by moving the pointer over them and asking Blender which operator or property lies under it.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import agent
from agent import Blender, Lost

VIEW, SIDEBAR = ("VIEW_3D", "WINDOW"), ("VIEW_3D", "UI")
MARGIN = 10  # pixels at the left of a region: beside its edge, which is to be dragged, and without buttons
PREFERENCES, PICTURE = ("PREFERENCES", "WINDOW"), ("IMAGE_EDITOR", "WINDOW")
UNIT = 20.0  # height of a button at scale 1
TABS = 20.0  # width of the strip of tabs
_DOUBLE_CLICK_SECONDS = 0.4  # Blender's own is 0.35
_CALM_SECONDS = 0.12  # this long without a redraw, and the sidebar's animations are over
_GAP = 16  # pixels between groups of one property's buttons

Where = tuple[str, str]  # types of an area and of its region


class Hand(Blender):
    """Pointer and keyboard of Blender."""

    def __init__(self, shots: Path) -> None:
        super().__init__(shots)
        self._places: dict[tuple[Where, str], list[tuple[int, int]]] = {}
        self.pointer = (0, 0)
        self._last_press = (0, 0, 0.0)
        self.presses = 0  # of mouse buttons, by `press`

    def settle(self, seconds: float = 2.0) -> None:
        """Wait until an action's effects are over: the sidebar is no longer redrawn."""
        end = time.monotonic() + seconds
        count, since = self.ask(agent.redraws, ticks=2), time.monotonic()
        while time.monotonic() < end and time.monotonic() - since < _CALM_SECONDS:
            if (now := self.ask(agent.redraws, ticks=2)) != count:
                count, since = now, time.monotonic()

    def shot(self, name: str) -> None:
        """Write a picture of the screen as NAME.png."""
        # Blender's own pictures are black where nothing composes windows.
        subprocess.run(["import", "-window", "root", str(self.shots / f"{name}.png")], check=True)

    def colors(self) -> float:
        """Mean difference of a pixel's largest and smallest channel, of 255, in the middle of the 3D viewport."""
        left, top, width, height = self.box(VIEW)
        middle = f"{width // 4}x{height // 4}+{left + width * 3 // 8}+{top + height * 3 // 8}"
        command = ["import", "-window", "root", "-crop", middle, "-depth", "8", "RGB:-"]
        data = subprocess.run(command, check=True, capture_output=True).stdout
        return statistics.mean(max(pixel) - min(pixel) for pixel in zip(*[iter(data)] * 3, strict=True))

    def event(self, kind: str, value: str, **more: Any) -> None:
        """A key, a button or a motion where the pointer is, by the names of `Window.event_simulate`."""
        self.ask(agent.simulate, kind, value, *self.pointer, more)

    def move(self, x: int, y: int) -> None:
        """Move the pointer to a pixel of the screen, from its top left."""
        self.pointer = (x, y)
        self.event("MOUSEMOVE", "NOTHING")

    def under(self, where: Where = SIDEBAR) -> dict[str, str]:
        """The button under the pointer: `operator` as Python, `property` as full path; or empty."""
        return self.ask(agent.button, *where, ticks=2)

    def point(self, where: Where, x: float, y: float) -> None:
        """Move to a pixel of a region, from its lower left as in Blender."""
        left, top, _, height = self.box(where)
        self.move(round(left + x), round(top + height - 1 - y))

    def point_at(self, location: Iterable[float]) -> None:
        """Move to where the 3D viewport shows a world position."""
        pixel = self.ask(agent.project, list(location))
        if pixel is None:
            raise Lost(f"the view does not show {list(location)}")
        self.point(VIEW, *pixel)

    def point_in_view(self, right: float = 0.35, up: float = 0.35) -> None:
        """Move into the 3D viewport, to fractions of its width and height from the lower left."""
        _, _, width, height = self.box(VIEW)
        self.point(VIEW, right * width, up * height)

    def press(self) -> None:
        """Press the left mouse button where the pointer is; never as the second click of a double click."""
        x, y, at = self._last_press
        if (x, y) == self.pointer:
            time.sleep(max(0.0, at + _DOUBLE_CLICK_SECONDS - time.monotonic()))
        for value in ("PRESS", "RELEASE"):
            self._let_pass()
            self.event("LEFTMOUSE", value)
        self._last_press = (*self.pointer, time.monotonic())
        self.presses += 1
        self._let_pass()
        self.settle()

    def key(self, *chords: str) -> None:
        """Press keys by Blender's names (`RET`, `ctrl+Z`); the region under the pointer receives them."""
        for chord in chords:
            *held, name = chord.split("+")
            for value in ("PRESS", "RELEASE"):
                self._let_pass()
                self.event(name, value, **dict.fromkeys(held, True))
        self._let_pass()

    def _let_pass(self) -> None:
        """Wait until Blender has handled all events: a click acts where Blender last saw the pointer."""
        self.ask(agent.redraws, ticks=2)

    def type(self, text: str) -> None:
        """Type a text."""
        for character in text:
            self.event("A", "PRESS", unicode=character)  # a field reads the character alone
            self.event("A", "RELEASE")
        self._let_pass()

    def hover(self, target: str, where: Where = SIDEBAR, **values: Any) -> str:
        """Move onto a button; the full path of its property, or its operator as Python.

        Raises:
            Lost: no such button can be reached by scrolling.
        """
        key = (where, f"{target} {values}" if values else target)
        for place in self._places.get(key, ()):
            self.move(*place)
            if found := _matches(self.under(where), target, values):
                return found
        if found := self._scan(where, target, values, True) or self._scan(where, target, values, False):
            return found
        for wide in (True, False):  # few buttons are narrow
            for page in self._pages(where):
                del page
                if found := self._scan(where, target, values, wide):
                    return found
        raise Lost(f"no button {target} {values or ''} in {where}")

    def extent(self, path: str, where: Where, axis: int) -> tuple[int, int]:
        """Extent of a property's buttons from the pointer along an axis; restores the pointer."""
        home = self.pointer
        low, size = self.box(where)[axis], self.box(where)[2 + axis]
        ends = []
        for step in (-4, 4):
            place, last, misses = list(home), home[axis], 0
            while misses < _GAP // 4:
                place[axis] += step
                if not low <= place[axis] < low + size:  # Blender still names the button that was left last
                    break
                self.move(place[0], place[1])
                if self.under(where)["property"] == path:
                    last, misses = place[axis], 0
                else:
                    misses += 1
            ends.append(last)
            self.move(*home)
            self.under(where)
        return ends[0], ends[1]

    def _scan(self, where: Where, target: str, values: dict[str, Any], wide: bool) -> str:
        """Move over a region column by column until the target, wide or narrow, lies under the pointer."""
        left, top, width, height = self.box(where)
        scale = self.scale()
        if where == SIDEBAR:
            width -= round(TABS * scale)
        unit = UNIT * scale
        edge = round(unit) if where == SIDEBAR else 4  # at which Blender resizes the region
        narrow = [width - unit * (0.9 + n) for n in range(4)] + [unit * (1.0 + n) for n in range(3)]
        for column in (width * 0.66, width * 0.3) if wide else (*narrow, width * 0.5, width * 0.8):
            for y in range(top + 4, top + height - edge, round(unit * 0.75)):  # the lowest buttons have 0.8
                place = (left + round(column), y)
                self.move(*place)
                report = self.under(where)
                if found := _matches(report, target, values):
                    inner = (place[0], y + round(unit * 0.3))
                    self.move(*inner)
                    if not _matches(self.under(where), target, values):
                        inner = place
                        self.move(*place)
                        self.under(where)
                    key = (where, f"{target} {values}" if values else target)
                    self._places.setdefault(key, []).insert(0, inner)
                    return found
        return ""

    def to_top(self, where: Where) -> None:
        last = None
        while (now := self.ask(agent.scroll, *where)) != last and now < 0:
            self._wheel(where, "UP", 10)
            last = now

    def _pages(self, where: Where) -> Iterable[int]:
        """Scroll to the top, then down by half the region until the end is reached."""
        self.to_top(where)
        page = 0
        while True:
            yield page
            if not self.scroll_down(where, round(self.box(where)[3] * 0.6)):
                return
            page += 1

    def scroll_down(self, where: Where, pixels: int) -> bool:
        """Scroll a region down by about so many pixels; False where it shows its end already."""
        before = self.ask(agent.scroll, *where)
        for _ in range(8):
            self._wheel(where, "DOWN", 1)
            if abs(self.ask(agent.scroll, *where) - before) >= pixels:
                break
        return bool(self.ask(agent.scroll, *where) != before)

    def _wheel(self, where: Where, way: str, times: int) -> None:
        left, top, _, height = self.box(where)
        self.move(left + MARGIN, top + height // 2)  # a list under the pointer would scroll instead
        self.turn_wheel(way, times)

    def turn_wheel(self, way: str, times: int) -> None:
        """Turn the wheel where the pointer is, UP or DOWN."""
        for _ in range(times):
            self.event(f"WHEEL{way}MOUSE", "PRESS")
        self.settle()

    def box(self, where: Where) -> tuple[int, int, int, int]:
        """Left, top, width and height of a region in screen pixels."""
        place = self.ask(agent.place, *where)
        top = self.height - place["y"] - place["height"]
        return place["x"], top, place["width"], place["height"]

    def scale(self) -> float:
        return self.ask(agent.place, *VIEW)["scale"]


def _matches(report: dict[str, str], target: str, values: dict[str, Any]) -> str:
    """The report's operator or property if it is the target, else an empty string."""
    operator, path = report["operator"], report["property"]
    if operator.startswith(f"bpy.ops.{target}("):
        words = [f"{name}={_python(value)}" for name, value in values.items()]
        plain = operator.replace("'", '"')  # as Blender quotes items of enumerations
        return operator if all(word in plain for word in words) else ""
    return path if path == target or path.endswith(f".{target}") else ""


def _python(value: Any) -> str:
    """A value as Blender writes it in Python."""
    return json.dumps(value) if isinstance(value, str) else repr(value)

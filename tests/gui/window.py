"""A Blender window driven by a script: buttons, fields, menus, lists and the sidebar's sections."""

from __future__ import annotations

from typing import Any

import agent
from agent import Lost
from hand import SIDEBAR, TABS, UNIT, Hand, Where

TAB = "FIPT"
_HEADER = 27.0  # from one closed panel's header to the next, at scale 1
_TRIES = 6


class Window(Hand):
    """A script's actions on a window."""

    def click(self, target: str, where: Where = SIDEBAR, **values: Any) -> None:
        """Click a button by its operator (`fipt.estimate`) or property (`estimate.preset`).

        Args:
            values: of the operator's properties, to tell between buttons of one operator.
        """
        self.hover(target, where, **values)
        self.press()

    def set_text(self, target: str, text: str, where: Where = SIDEBAR) -> None:
        """Type a text or a number into a field, and check the property."""
        path = self.hover(target, where)
        before = self.ask(agent.value, path)
        if isinstance(before, str):
            self.press()
        else:
            first, last = self.extent(path, where, 0)
            self.move((first + last) // 2, self.pointer[1])  # its ends are arrows
            self.key("RET")  # a click would start dragging the number
        self.key("ctrl+A")
        self.type(text)
        self.key("RET")
        wanted = type(before)(text)
        near = (lambda v: abs(v - wanted) < 1e-4) if isinstance(wanted, float) else wanted.__eq__
        self.wait(agent.value, path, until=near, seconds=60)
        self.settle()

    def tick(self, target: str, value: bool = True, where: Where = SIDEBAR) -> None:
        """Set a checkbox, and check the property."""
        path = self.hover(target, where)
        if self.ask(agent.value, path) != value:
            self.press()
        self.wait(agent.value, path, until=value.__eq__, seconds=60)

    def choose(self, target: str, item: str, where: Where = SIDEBAR) -> None:
        """Open a menu property and choose an item by its identifier, with the arrow keys."""
        path = self.hover(target, where)
        index = self.ask(agent.items, path).index(item)
        if self.ask(agent.value, path) != item:
            self.press()
            self.key("HOME", *["DOWN_ARROW"] * index, "RET")
        self.wait(agent.value, path, until=item.__eq__, seconds=60)
        self.settle()

    def pick(self, target: str, item: str, where: Where = SIDEBAR) -> None:
        """Click an item, by its identifier, of an enumeration that shows all items in a row or column."""
        path = self.hover(target, where)
        names = self.ask(agent.items, path)
        x, y = self.pointer
        (left, right), (upper, lower) = self.extent(path, where, 0), self.extent(path, where, 1)
        column = lower - upper > 2 * UNIT * self.scale()
        start, end = (upper, lower) if column else (left, right)
        step = (end - start) / len(names)
        place = start + step * (names.index(item) + 0.5)
        for _ in range(_TRIES):
            self.move(*((x, round(place)) if column else (round(place), y)))
            if self.under(where)["property"] != path:  # a gap
                place += step / 3.0
                continue
            self.press()
            got = self.ask(agent.value, path)
            if got == item:
                return
            place += step * (names.index(item) - names.index(got))
        raise Lost(f"{path} is not {item}")

    def click_row(self, target: str, index: int, where: Where = SIDEBAR) -> None:
        """Click one of the first rows of a list, named by the property of the active row's index."""
        path = self.hover(target, where)
        self.turn_wheel("UP", self.ask(agent.value, path))  # the list shows its first row
        if self.under(where)["property"] != path:  # the region has moved as well
            self.hover(target, where)
        x, _ = self.pointer
        row = UNIT * self.scale()
        first, last = self.extent(path, where, 1)
        y = first + row * (index + 0.5)
        got = None
        for _ in range(_TRIES):
            if not first <= y <= last:
                break
            self.move(x, round(y))
            self.press()
            got = self.ask(agent.value, path)
            if got == index:
                return
            y += row * (index - got)
        raise Lost(f"{path} is {got} and not {index}")

    def search(self, text: str) -> None:
        """Run an operator from the menu search (F3) over the 3D viewport."""
        self.point_in_view()
        self.key("F3")
        self.settle()
        self.type(text)
        self.settle()
        self.key("RET")
        self.settle()

    def open_tab(self, tab: str = TAB) -> None:
        """Open the sidebar with its shortcut and one of its tabs with the mouse."""
        if not self.ask(agent.is_open, *SIDEBAR):
            self.point_in_view()
            self.key("N")
            self.wait(agent.is_open, *SIDEBAR)
            self.settle()
        if self.ask(agent.tab) == tab:
            return
        left, top, width, height = self.box(SIDEBAR)
        scale = self.scale()
        for offset in range(10, height, round(UNIT * scale * 0.7)):
            self.move(left + width - round(TABS * scale / 2), top + offset)
            self.press()
            if self.ask(agent.tab) == tab:
                return
        raise Lost(f"the sidebar has no tab {tab}")

    def open_section(self, label: str, *parts: str) -> None:
        """Open a section of the sidebar, close the others, and open its subpanels by their labels."""
        self.open_tab()
        panels = self.ask(agent.panels)
        sections = [panel for panel in panels if not panel["parent"]]
        names = [panel["label"] for panel in sections]
        if label not in names:
            raise Lost(f"the sidebar has no section {label}, but {', '.join(names)}")
        index = names.index(label)
        parent = sections[index]["name"]
        self.to_top(SIDEBAR)
        if self._open_sections(sections) != {parent}:
            self._close_sections(sections)
            self._press_header(index)
            if self._open_sections(sections) != {parent}:
                raise Lost(f"the header of {label} is not where it should be; open: {self._drawn()}")
        y = self._header(index)[1]
        for part in parts:
            found = [p for p in panels if p["parent"] == parent and p["label"] == part]
            if not found:
                raise Lost(f"{label} has no part {part}")
            parent = found[0]["name"]
            if parent not in self._drawn():
                y = self._open_part(parent, y)
        self.settle()

    def sections(self) -> list[str]:
        """Labels of the sections, from top to bottom."""
        return [panel["label"] for panel in self.ask(agent.panels) if not panel["parent"]]

    def redraw(self) -> None:
        """Have the sidebar redrawn once."""
        self.ask(agent.forget_drawn)
        self.wait(agent.drawn_anew, every=0.01)

    def _drawn(self) -> set[str]:
        """The panels that are open."""
        self.redraw()
        return set(self.ask(agent.drawn))

    def _open_sections(self, sections: list[dict[str, Any]]) -> set[str]:
        return self._drawn() & {section["name"] for section in sections}

    def _close_sections(self, sections: list[dict[str, Any]]) -> None:
        """Close from the top down: a header's place is known when all above it are closed."""
        for index, section in enumerate(sections):
            left = self._open_sections(sections)
            if section["name"] in left:
                self._press_header(index)
            elif not left:
                return
        if left := self._open_sections(sections):
            raise Lost(f"these sections do not close: {left}")

    def _header(self, index: int) -> tuple[int, int]:
        """Pixel of a section's header when all above are closed."""
        left, top, _, _ = self.box(SIDEBAR)
        scale = self.scale()
        return left + round(110 * scale), top + round((14.0 + index * _HEADER) * scale)

    def _press_header(self, index: int) -> None:
        self.move(*self._header(index))
        self.press()

    def _open_part(self, name: str, below: int) -> int:
        """Click downwards from a section's header, where there is no button, until the subpanel opens.

        Returns:
            its y; the top of the sidebar where that had to be scrolled to reach it.
        """
        top, height = self.box(SIDEBAR)[1], self.box(SIDEBAR)[3]
        if (y := self._click_open(name, below)) is not None:
            return y
        for _ in range(_TRIES):
            if not self.scroll_down(SIDEBAR, height // 2):
                break
            # From the bottom: to close what is above would scroll the sidebar back.
            if self._click_open(name, top, upwards=True) is not None:
                return top
        raise Lost(f"the part {name} has no header below")

    def _click_open(self, name: str, below: int, upwards: bool = False) -> int | None:
        """The y of the click that has opened a subpanel, or None where none on the visible part did."""
        left, top, _, height = self.box(SIDEBAR)
        x, step = left + round(60 * self.scale()), round(UNIT * self.scale() * 0.6)
        before = self._drawn()
        places = range(below + 2 * step, top + height, step)
        for y in reversed(places) if upwards else places:
            self.move(x, y)
            if any(self.under().values()):
                continue
            self.press()
            now = self._drawn()
            if name in now:
                return y
            if now != before:  # the header of another subpanel
                self.press()
            else:  # a picture may have opened the others to choose from
                self.key("ESC")
        return None

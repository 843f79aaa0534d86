# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that wait for clicks, with a stand-in window: which events they take, and what they restore."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from fipt_blender.operators.pointer import PicksInViewport


class Window:
    """Half a 3D viewport (x below 100) beside its sidebar; notes what an operator shows."""

    def __init__(self) -> None:
        self.shown: dict[str, object] = {}
        view = SimpleNamespace(type="WINDOW", x=0, y=0, width=200, height=100)
        sidebar = SimpleNamespace(type="UI", x=100, y=0, width=100, height=100)
        area = SimpleNamespace(
            type="VIEW_3D",
            regions=[view, sidebar],
            spaces=SimpleNamespace(active="space"),
            header_text_set=lambda text: self.shown.update(header=text),
        )
        window = SimpleNamespace(
            screen=SimpleNamespace(areas=[area]),
            cursor_modal_set=lambda cursor: self.shown.update(cursor=cursor),
            cursor_modal_restore=lambda: self.shown.update(cursor=None),
        )
        self.context = SimpleNamespace(
            window=window,
            area=area,
            workspace=SimpleNamespace(status_text_set=lambda text: self.shown.update(status=text)),
            window_manager=SimpleNamespace(modal_handler_add=lambda operator: None),
        )


class Picker(PicksInViewport):
    """Finds something left of x = 50."""

    text_in_header = True

    def __init__(self) -> None:
        self.done: list[float] = []

    def take_click(self, context, event) -> bool:
        self.place = event.mouse_x
        return event.mouse_x < 50

    def execute(self, context) -> set[str]:
        self.done.append(self.place)
        return {"FINISHED"}


def event(kind: str, x: float = 20.0, value: str = "PRESS") -> SimpleNamespace:
    return SimpleNamespace(type=kind, value=value, mouse_x=x, mouse_y=50.0)


@pytest.fixture
def window():
    return Window()


@pytest.fixture
def picker(window):
    picker = Picker()
    assert picker.wait_for_clicks(window.context, "Click it") == {"RUNNING_MODAL"}
    assert window.shown == {"cursor": "EYEDROPPER", "status": "Click it", "header": "Click it"}
    return picker


NOTHING = {"cursor": None, "status": None, "header": None}


def test_a_click_that_hits_executes_and_restores_the_window(window, picker):
    assert picker.modal(window.context, event("LEFTMOUSE")) == {"FINISHED"}
    assert picker.done == [20.0] and window.shown == NOTHING


def test_after_a_miss_it_waits_for_another_click(window, picker):
    assert picker.modal(window.context, event("LEFTMOUSE", 70.0)) == {"RUNNING_MODAL"}
    assert not picker.done and window.shown["status"] == "Click it"
    assert picker.modal(window.context, event("LEFTMOUSE", 10.0)) == {"FINISHED"} and picker.done == [10.0]


@pytest.mark.parametrize("kind", ["ESC", "RIGHTMOUSE"])
def test_it_is_cancelled(window, picker, kind):
    assert picker.modal(window.context, event(kind, value="RELEASE")) == {"RUNNING_MODAL"}
    assert picker.modal(window.context, event(kind)) == {"CANCELLED"}
    assert not picker.done and window.shown == NOTHING


def test_the_view_and_the_sidebar_stay_usable_and_keys_do_nothing(window, picker):
    for kind in ("MIDDLEMOUSE", "WHEELUPMOUSE", "MOUSEMOVE", "NDOF_MOTION"):
        assert picker.modal(window.context, event(kind)) == {"PASS_THROUGH"}
    assert picker.modal(window.context, event("LEFTMOUSE", 150.0)) == {"PASS_THROUGH"}
    for kind, value in (("X", "PRESS"), ("LEFTMOUSE", "RELEASE")):
        assert picker.modal(window.context, event(kind, value=value)) == {"RUNNING_MODAL"}
    assert not picker.done and window.shown["cursor"] == "EYEDROPPER"


def test_a_closed_window_leaves_nothing_to_restore(window, picker):
    window.context.window = window.context.area = None
    picker.cancel(window.context)
    assert window.shown["status"] is None

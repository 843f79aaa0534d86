# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Drops files on a window as a file manager does, by X's drag and drop protocol (XDND, version 5).

Standard library only.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import time
from collections.abc import Iterable
from pathlib import Path

from x11 import DisplayError

_VERSION = 5
_SECONDS = 10.0
_CLIENT_MESSAGE, _SELECTION_REQUEST, _SELECTION_NOTIFY = 33, 30, 31
_REPLACE = 0
_EVENT_LONGS = 24


class _ClientMessage(ctypes.Structure):
    _fields_ = [
        *(("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int)),
        *(("display", ctypes.c_void_p), ("window", ctypes.c_ulong), ("message", ctypes.c_ulong)),
        *(("format", ctypes.c_int), ("data", ctypes.c_long * 5)),
    ]


class _SelectionRequest(ctypes.Structure):
    _fields_ = [
        *(("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int)),
        *(("display", ctypes.c_void_p), ("owner", ctypes.c_ulong), ("requestor", ctypes.c_ulong)),
        *((name, ctypes.c_ulong) for name in ("selection", "target", "property", "time")),
    ]


class _SelectionNotify(ctypes.Structure):
    _fields_ = [
        *(("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int)),
        *(("display", ctypes.c_void_p), ("requestor", ctypes.c_ulong)),
        *((name, ctypes.c_ulong) for name in ("selection", "target", "property", "time")),
    ]


class _Event(ctypes.Union):
    _fields_ = [
        *(("type", ctypes.c_int), ("client", _ClientMessage), ("request", _SelectionRequest)),
        *(("notify", _SelectionNotify), ("pad", ctypes.c_long * _EVENT_LONGS)),
    ]


class FileDrag:
    """A drag of files that another program offers; use as a `with` block.

    Raises:
        DisplayError: the display can't be opened.
    """

    def __init__(self, display: str, files: Iterable[Path]) -> None:
        self._x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        for name in ("XOpenDisplay", "XDefaultRootWindow", "XCreateSimpleWindow", "XInternAtom"):
            getattr(self._x, name).restype = ctypes.c_void_p if name == "XOpenDisplay" else ctypes.c_ulong
        self._display = ctypes.c_void_p(self._x.XOpenDisplay(display.encode()))
        if not self._display:
            raise DisplayError(f"The display {display} can't be opened")
        self._root = ctypes.c_ulong(self._x.XDefaultRootWindow(self._display))
        box = [ctypes.c_int(value) for value in (-10, -10, 1, 1, 0)]
        zeros = ctypes.c_ulong(0), ctypes.c_ulong(0)
        self._window = ctypes.c_ulong(self._x.XCreateSimpleWindow(self._display, self._root, *box, *zeros))
        self._data = "".join(f"{Path(file).resolve().as_uri()}\r\n" for file in files).encode()
        selection = ctypes.c_ulong(self._atom("XdndSelection"))
        self._x.XSetSelectionOwner(self._display, selection, self._window, ctypes.c_ulong(0))

    def __enter__(self) -> FileDrag:
        return self

    def __exit__(self, *_: object) -> None:
        self._x.XDestroyWindow(self._display, self._window)
        self._x.XCloseDisplay(self._display)

    def drop(self, x: int, y: int) -> None:
        """Move the files over the window at a pixel of the screen, and drop them there.

        Raises:
            DisplayError: no window there takes files, or it does not answer.
        """
        target = self._target(x, y)
        kind, copy = self._atom("text/uri-list"), self._atom("XdndActionCopy")
        self._send(target, "XdndEnter", _VERSION << 24, kind)
        for _ in range(3):  # as the pointer moves
            self._send(target, "XdndPosition", 0, (x << 16) | y, 0, copy)
            self._answer("XdndStatus")
        self._send(target, "XdndDrop", 0, 0)
        self._answer("XdndFinished")

    def _target(self, x: int, y: int) -> int:
        """The window under a pixel that takes drops."""
        aware = self._atom("XdndAware")
        window = self._root.value
        while window:
            if self._has(window, aware):
                return window
            place, child = [ctypes.c_int(), ctypes.c_int()], ctypes.c_ulong()
            at = ctypes.c_int(x), ctypes.c_int(y), *map(ctypes.byref, (*place, child))
            self._x.XTranslateCoordinates(self._display, self._root, ctypes.c_ulong(window), *at)
            window = child.value
        raise DisplayError(f"No window at {x}, {y} takes files")

    def _has(self, window: int, atom: int) -> bool:
        kind, form = ctypes.c_ulong(), ctypes.c_int()
        count, left, data = ctypes.c_ulong(), ctypes.c_ulong(), ctypes.c_void_p()
        where = ctypes.c_ulong(window), ctypes.c_ulong(atom), ctypes.c_long(0), ctypes.c_long(1)
        results = map(ctypes.byref, (kind, form, count, left, data))
        self._x.XGetWindowProperty(self._display, *where, 0, ctypes.c_ulong(0), *results)
        if data:
            self._x.XFree(data)
        return kind.value != 0

    def _send(self, target: int, message: str, *values: int) -> None:
        event = _Event()
        client = event.client
        client.type, client.window, client.format = _CLIENT_MESSAGE, target, 32
        client.message = self._atom(message)
        for index, value in enumerate((self._window.value, *values)):
            client.data[index] = value
        self._x.XSendEvent(self._display, ctypes.c_ulong(target), 0, ctypes.c_long(0), ctypes.byref(event))
        self._x.XSync(self._display, 0)

    def _answer(self, message: str) -> None:
        """Wait for a message of the target, and give it the files meanwhile if it asks for them."""
        atom = self._atom(message)
        end = time.monotonic() + _SECONDS
        while time.monotonic() < end:
            if not self._x.XPending(self._display):
                time.sleep(0.01)
                continue
            event = _Event()
            self._x.XNextEvent(self._display, ctypes.byref(event))
            if event.type == _SELECTION_REQUEST:
                self._give(event.request)
            elif event.type == _CLIENT_MESSAGE and event.client.message == atom:
                return
        raise DisplayError(f"The window did not answer with {message}")

    def _give(self, request: _SelectionRequest) -> None:
        place = [ctypes.c_ulong(value) for value in (request.requestor, request.property, request.target)]
        self._x.XChangeProperty(self._display, *place, 8, _REPLACE, self._data, len(self._data))
        event = _Event()
        notify = event.notify
        notify.type, notify.requestor, notify.time = _SELECTION_NOTIFY, request.requestor, request.time
        notify.selection, notify.target = request.selection, request.target
        notify.property = request.property
        self._x.XSendEvent(self._display, place[0], 0, ctypes.c_long(0), ctypes.byref(event))
        self._x.XSync(self._display, 0)

    def _atom(self, name: str) -> int:
        return int(self._x.XInternAtom(self._display, name.encode(), 0))

# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pointer, keyboard and screenshots through X's test extension, and a separate screen.

Needs libX11, libXtst and, where there is no display, Xvfb. Standard library only.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import shutil
import struct
import subprocess
import time
import zlib
from pathlib import Path

_MOTION_STEPS = 6  # Blender reads the pointer between redraws; a jump would not count as motion
_STEP_SECONDS = 0.008
_PRESS_SECONDS = 0.05
_MODIFIERS = {"ctrl": "Control_L", "shift": "Shift_L", "alt": "Alt_L"}
_Z_PIXMAP, _ALL_PLANES = 2, ctypes.c_ulong(-1).value


class DisplayError(Exception):
    """There is no display, or it lacks a function; the text says why."""


class _XImage(ctypes.Structure):
    """The public first fields of Xlib's XImage."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("width", "height", "xoffset", "format")),
        ("data", ctypes.c_void_p),
        *((name, ctypes.c_int) for name in ("byte_order", "bitmap_unit", "bitmap_bit_order")),
        *((name, ctypes.c_int) for name in ("bitmap_pad", "depth", "bytes_per_line", "bits_per_pixel")),
    ]


def missing() -> str:
    """What this machine lacks for a separate display; empty if nothing."""
    lacking = [name for name in ("X11", "Xtst") if ctypes.util.find_library(name) is None]
    if lacking:
        return f"the libraries {', '.join('lib' + name for name in lacking)}"
    return "" if shutil.which("Xvfb") else "Xvfb"


class Screen:
    """A virtual screen (Xvfb) that ends with the `with` block."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._server: subprocess.Popen[bytes] | None = None
        self.name = ""

    def __enter__(self) -> Screen:
        read, write = os.pipe()
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{self.width}x{self.height}x24"]
        try:
            self._server = subprocess.Popen(
                [*command, "-nolisten", "tcp", "-noreset", "-ac", "+extension", "GLX"],
                pass_fds=(write,),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        except OSError as error:
            raise DisplayError(f"Xvfb can't be started: {error}") from None
        finally:
            os.close(write)
        with os.fdopen(read) as answer:  # ends without a number if the server dies
            number = answer.readline().strip()
        if not number:
            raise DisplayError("Xvfb ended at once")
        self.name = f":{number}"
        return self

    def __exit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.terminate()
        self._server.wait()


class Display:
    """Pointer, keys and pixels of a display; positions are pixels from its top left."""

    def __init__(self, name: str) -> None:
        self._x = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
        self._test = ctypes.CDLL(ctypes.util.find_library("Xtst") or "libXtst.so.6")
        for function, result, arguments in (
            (self._x.XOpenDisplay, ctypes.c_void_p, [ctypes.c_char_p]),
            (self._x.XDefaultRootWindow, ctypes.c_ulong, [ctypes.c_void_p]),
            (self._x.XStringToKeysym, ctypes.c_ulong, [ctypes.c_char_p]),
            (self._x.XKeysymToKeycode, ctypes.c_ubyte, [ctypes.c_void_p, ctypes.c_ulong]),
            (self._x.XkbKeycodeToKeysym, ctypes.c_ulong, [ctypes.c_void_p, *[ctypes.c_uint] * 3]),
            (self._x.XSync, ctypes.c_int, [ctypes.c_void_p, ctypes.c_int]),
            (self._x.XDisplayWidth, ctypes.c_int, [ctypes.c_void_p, ctypes.c_int]),
            (self._x.XDisplayHeight, ctypes.c_int, [ctypes.c_void_p, ctypes.c_int]),
            (self._x.XDestroyImage, ctypes.c_int, [ctypes.POINTER(_XImage)]),
            (
                self._x.XGetImage,
                ctypes.POINTER(_XImage),
                [ctypes.c_void_p, ctypes.c_ulong, *[ctypes.c_int] * 2]
                + [ctypes.c_uint, ctypes.c_uint, ctypes.c_ulong, ctypes.c_int],
            ),
            (
                self._test.XTestFakeMotionEvent,
                ctypes.c_int,
                [ctypes.c_void_p, *[ctypes.c_int] * 3, ctypes.c_ulong],
            ),
            (
                self._test.XTestFakeButtonEvent,
                ctypes.c_int,
                [ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_ulong],
            ),
            (
                self._test.XTestFakeKeyEvent,
                ctypes.c_int,
                [ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_ulong],
            ),
        ):
            function.restype, function.argtypes = result, arguments
        self.name = name
        self._display = self._x.XOpenDisplay(name.encode())
        if not self._display:
            raise DisplayError(f"The display {name} can't be opened")
        self._root = self._x.XDefaultRootWindow(self._display)
        self.width = self._x.XDisplayWidth(self._display, 0)
        self.height = self._x.XDisplayHeight(self._display, 0)
        self.pointer = (self.width // 2, self.height // 2)
        self._move(*self.pointer)

    def close(self) -> None:
        """Close the connection to the display."""
        self._x.XCloseDisplay(ctypes.c_void_p(self._display))

    def move(self, x: int, y: int, steps: int = _MOTION_STEPS) -> None:
        """Move to a pixel in small steps."""
        from_x, from_y = self.pointer
        for step in range(1, steps + 1):
            self._move(from_x + (x - from_x) * step // steps, from_y + (y - from_y) * step // steps)
            if step < steps:
                time.sleep(_STEP_SECONDS)
        self.pointer = (x, y)

    def button(self, button: int, down: bool) -> None:
        """Press a mouse button where the pointer is, or release it; 4 and 5 turn the wheel up and down."""
        self._test.XTestFakeButtonEvent(self._display, button, int(down), 0)
        self._x.XSync(self._display, 0)

    def hold(self, key: str, down: bool) -> None:
        """Press a key by its X name, or release it."""
        code, _ = self._key(key)
        self._test.XTestFakeKeyEvent(self._display, code, int(down), 0)
        self._x.XSync(self._display, 0)

    def key(self, chord: str) -> None:
        """Press keys together: X names joined by `+`, for example `ctrl+z`, `Return`, `F3`."""
        names = [_MODIFIERS.get(name, name) for name in chord.split("+")]
        for name in names:
            self.hold(name, True)
        time.sleep(_PRESS_SECONDS)
        for name in reversed(names):
            self.hold(name, False)

    def type(self, text: str) -> None:
        """Type a text on the keyboard."""
        for character in text:
            code, shift = self._key(f"U{ord(character):04X}")
            if shift:
                self.hold("Shift_L", True)
            for down in (1, 0):
                self._test.XTestFakeKeyEvent(self._display, code, down, 0)
                self._x.XSync(self._display, 0)
                time.sleep(0.006)
            if shift:
                self.hold("Shift_L", False)

    def arrange(self) -> None:
        """Move windows that extend beyond the screen into view, as a window manager does."""
        ids = [ctypes.c_ulong() for _ in range(2)]
        children, count = ctypes.POINTER(ctypes.c_ulong)(), ctypes.c_uint()
        display, root = ctypes.c_void_p(self._display), ctypes.c_ulong(self._root)
        self._x.XQueryTree(display, root, *map(ctypes.byref, (*ids, children, count)))
        for child in children[: count.value]:
            place = [ctypes.c_int() for _ in range(2)]
            sizes = [ctypes.c_uint() for _ in range(4)]
            window = ctypes.c_ulong(child)
            self._x.XGetGeometry(display, window, *map(ctypes.byref, (ids[0], *place, *sizes)))
            x, y, width, height = place[0].value, place[1].value, sizes[0].value, sizes[1].value
            inside = (max(0, min(x, self.width - width)), max(0, min(y, self.height - height)))
            if width > 1 and inside != (x, y):
                self._x.XMoveWindow(display, window, *inside)
        self._x.XSync(self._display, 0)

    def save(self, file: Path, box: tuple[int, int, int, int] | None = None) -> None:
        """Write a PNG of the screen, or of a box of it (left, top, width, height)."""
        left, top, width, height = box or (0, 0, self.width, self.height)
        left, top = max(left, 0), max(top, 0)
        width, height = min(width, self.width - left), min(height, self.height - top)
        image = self._x.XGetImage(self._display, self._root, left, top, width, height, _ALL_PLANES, _Z_PIXMAP)
        if not image or image.contents.bits_per_pixel != 32:
            raise DisplayError("The screen's pixels can't be read; a depth of 24 bits is needed")
        stride = image.contents.bytes_per_line
        data = ctypes.string_at(image.contents.data, stride * height)
        self._x.XDestroyImage(image)
        rows = bytearray()
        for row in range(height):
            line = data[row * stride : row * stride + 4 * width]
            pixels = bytearray(3 * width)
            pixels[0::3], pixels[1::3], pixels[2::3] = line[2::4], line[1::4], line[0::4]
            rows += b"\0" + pixels
        file.write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
            + _chunk(b"IDAT", zlib.compress(bytes(rows), 6))
            + _chunk(b"IEND", b"")
        )

    def _move(self, x: int, y: int) -> None:
        self._test.XTestFakeMotionEvent(self._display, -1, x, y, 0)
        self._x.XSync(self._display, 0)

    def _key(self, name: str) -> tuple[int, bool]:
        """Key code, and whether Shift is needed, of an X key name."""
        keysym = self._x.XStringToKeysym(name.encode())
        code = self._x.XKeysymToKeycode(self._display, keysym) if keysym else 0
        if not code:
            raise DisplayError(f"The keyboard has no {name}")
        return code, self._x.XkbKeycodeToKeysym(self._display, code, 0, 0) != keysym


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

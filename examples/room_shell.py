"""The shell of the example room: floor, walls, mouldings, window, door, ceiling panel. Metres, Z up."""

from __future__ import annotations

import numpy as np
from room_shapes import Form

WIDTH, DEPTH, HEIGHT = 5.0, 4.0, 3.0  # along x, y, z; the floor's centre is the origin
WINDOW_X, WINDOW_WIDTH, SILL, HEAD = 0.55, 1.5, 0.95, 2.35
PANEL_AT = (0.25, 0.05)


def plane(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...], step: float = 0.5) -> np.ndarray:
    """Grid of points over the rectangle with corner `a` and edges to `b` (columns) and `c` (rows)."""
    start, across, up = np.asarray(a), np.subtract(b, a), np.subtract(c, a)
    n = max(1, round(float(np.linalg.norm(across)) / step))
    m = max(1, round(float(np.linalg.norm(up)) / step))
    s, t = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1))
    return start + s[..., None] * across + t[..., None] * up


def build_surfaces() -> None:
    """Floor, ceiling and the four walls, facing inwards; the north wall has the window's opening."""
    x, y, z = WIDTH / 2, DEPTH / 2, HEIGHT
    floor = Form("Floor")
    floor.sheet(plane((-x, -y, 0), (x, -y, 0), (-x, y, 0)), (0, 0, 0), "FloorPlanks")
    floor.finish()
    ceiling = Form("Ceiling")
    ceiling.sheet(plane((-x, -y, z), (-x, y, z), (x, -y, z)), (0, 0, 0), "CeilingPaint")
    ceiling.finish()
    accent = Form("Wall west")
    accent.sheet(plane((-x, -y, 0), (-x, y, 0), (-x, -y, z)), (0, 0, 0), "WallAccent")
    accent.finish()
    walls = Form("Walls")
    walls.sheet(plane((x, y, 0), (x, -y, 0), (x, y, z)), (0, 0, 0), "WallPaint")
    walls.sheet(plane((x, -y, 0), (-x, -y, 0), (x, -y, z)), (0, 0, 0), "WallPaint")
    left, right = WINDOW_X - WINDOW_WIDTH / 2, WINDOW_X + WINDOW_WIDTH / 2
    for a, b, low, high in (
        (-x, left, 0, z),
        (right, x, 0, z),
        (left, right, 0, SILL),
        (left, right, HEAD, z),
    ):
        walls.sheet(plane((a, y, low), (b, y, low), (a, y, high)), (0, 0, 0), "WallPaint")
    walls.finish()


def build_mouldings() -> None:
    """Skirting board and cornice: profiles swept around the room with mitred corners."""
    form = Form("Mouldings", uv=False)
    x, y = WIDTH / 2, DEPTH / 2
    skirting = [(0.0, 0.11), (0.008, 0.11), (0.014, 0.10), (0.018, 0.085), (0.018, 0.0)]
    curve = [
        (0.09 - 0.09 * np.sin(t), HEIGHT - 0.09 + 0.09 * np.cos(t)) for t in np.linspace(0, np.pi / 2, 6)
    ]
    cornice = [(0.10, HEIGHT), (0.09, HEIGHT - 0.004), *curve, (0.0, HEIGHT - 0.10)]
    for profile in (skirting, cornice):
        rows = []
        for inset, height in profile:
            a, b = x - inset, y - inset
            rows.append(
                [(-a, -b, height), (a, -b, height), (a, b, height), (-a, b, height), (-a, -b, height)]
            )
        form.sheet(np.array(rows), (0, 0, 0), "GlossPaint")
    form.finish()


def build_window() -> None:
    """Reveal, sill, frame with glazing bars, and an opaque night-dark pane: nothing is transmitted."""
    form = Form("Window", at=(WINDOW_X, DEPTH / 2, 0), uv=False)
    w, h, middle = WINDOW_WIDTH, HEAD - SILL, (HEAD + SILL) / 2
    form.box((w + 0.02, 0.02, h + 0.02), (0, 0.13, middle), "WindowPane", bevel=0)
    for side in (-1, 1):
        form.box((0.03, 0.14, h + 0.06), (side * (w / 2 + 0.013), 0.068, middle), "GlossPaint", bevel=0.002)
        form.box((0.055, 0.05, h), (side * (w / 2 - 0.025), 0.10, middle), "GlossPaint", bevel=0.008)
    form.box((w + 0.05, 0.14, 0.03), (0, 0.068, HEAD + 0.013), "GlossPaint", bevel=0.002)
    form.box((w + 0.22, 0.24, 0.035), (0, 0.02, SILL - 0.012), "GlossPaint", bevel=0.01)
    for height in (SILL + 0.035, HEAD - 0.025):
        form.box((w, 0.05, 0.055), (0, 0.10, height), "GlossPaint", bevel=0.008)
    for height in (SILL + 0.95,):
        form.box((w, 0.04, 0.03), (0, 0.105, height), "GlossPaint", bevel=0.006)
    form.box((0.06, 0.05, h), (0, 0.10, middle), "GlossPaint", bevel=0.008)
    form.finish()


def build_curtains() -> None:
    """Two linen curtains in folds on a brass rod with rings and finials."""
    rod_y, rod_z, reach = DEPTH / 2 - 0.11, 2.55, 1.22
    rod = Form("Curtain rod", uv=False)
    rod.tube([(WINDOW_X + t * reach, rod_y, rod_z) for t in (-1, -0.5, 0, 0.5, 1)], 0.014, "Brass")
    for side in (-1, 1):
        ball = [(0.03 * np.sin(t), -0.03 * np.cos(t)) for t in np.linspace(0, np.pi, 8)]
        rod.lathe(ball, (WINDOW_X + side * (reach + 0.02), rod_y, rod_z), "Brass", segments=12)
        bracket = [(WINDOW_X + side * (reach - 0.06), y, rod_z) for y in (rod_y, DEPTH / 2)]
        rod.tube(bracket, 0.009, "Brass")
    curtain = Form("Curtains")
    for side in (-1, 1):
        folds = np.linspace(0, 1, 49)
        rows = []
        for t in np.linspace(0, 1, 7):
            swing = 0.030 + 0.022 * t
            x = WINDOW_X + side * (0.70 + 0.46 * folds) + side * 0.03 * np.sin(2.2 * t) * (folds - 0.5)
            y = (
                rod_y
                + swing * np.sin(2 * np.pi * 6 * folds + 0.5 * t)
                + 0.008 * np.sin(2 * np.pi * 2.5 * folds)
            )
            z = np.full_like(x, rod_z - 0.035 - t * (rod_z - 0.06))
            rows.append(np.stack([x, y, z], -1))
        curtain.sheet(np.array(rows), (0, 0, 0), "CurtainLinen")
        for fold in (np.arange(6) + 0.5) / 6:
            angle = np.linspace(0, 2 * np.pi, 7)
            at = WINDOW_X + side * (0.70 + 0.46 * fold)
            ring = [(at, rod_y + 0.024 * np.cos(a), rod_z - 0.008 + 0.024 * np.sin(a)) for a in angle]
            rod.tube(ring, 0.003, "Brass", segments=5)
    curtain.finish()
    rod.finish()


def build_door() -> None:
    """A four-panel door in its casing on the south wall, brass knob and plate."""
    form = Form("Door", at=(1.55, -DEPTH / 2, 0), turn=180, uv=False)
    w, h = 0.84, 2.05
    form.box((w, 0.05, h), (0, -0.01, h / 2 + 0.004), "GlossPaint", bevel=0.004)
    for side in (-1, 1):
        form.box(
            (0.09, 0.07, h + 0.09), (side * (w / 2 + 0.045), -0.02, (h + 0.09) / 2), "GlossPaint", bevel=0.015
        )
        for low, high in ((0.22, 0.92), (1.06, 1.90)):
            at = (side * 0.19, -0.036, (low + high) / 2)
            form.box((0.25, 0.014, high - low), at, "GlossPaint", bevel=0.012)
            form.box((0.17, 0.014, high - low - 0.08), (at[0], -0.044, at[2]), "GlossPaint", bevel=0.006)
    form.box((w + 0.22, 0.08, 0.10), (0, -0.025, h + 0.05), "GlossPaint", bevel=0.018)
    form.box((0.05, 0.008, 0.20), (0.35, -0.038, 1.0), "Brass", bevel=0.003)
    knob = [
        (0.011, 0),
        (0.010, 0.03),
        (0.018, 0.036),
        (0.029, 0.05),
        (0.030, 0.06),
        (0.022, 0.073),
        (0.0, 0.077),
    ]
    form.lathe(knob, (0.35, -0.041, 1.02), "Brass", segments=16, turn=(90, 0, 0))
    form.finish()


def build_ceiling_panel() -> None:
    """A 1 x 0.6 m light panel in a painted tray under the ceiling; it shines downwards only."""
    px, py = PANEL_AT
    tray = Form("Ceiling panel tray", at=(px, py, 0), uv=False)
    tray.box((1.0, 0.6, 0.035), (0, 0, HEIGHT - 0.018), "GlossPaint", bevel=0)
    for side in (-1, 1):
        tray.box((0.03, 0.66, 0.06), (side * 0.515, 0, HEIGHT - 0.028), "GlossPaint", bevel=0.006)
        tray.box((1.0, 0.03, 0.06), (0, side * 0.315, HEIGHT - 0.028), "GlossPaint", bevel=0.006)
    tray.finish()
    light = Form("Ceiling panel light", at=(px, py, HEIGHT - 0.045), uv=False)
    light.sheet(plane((-0.5, -0.3, 0), (-0.5, 0.3, 0), (0.5, -0.3, 0)), (0, 0, 0), "CeilingPanelLight")
    light.finish()


def build_shell() -> None:
    """Everything that is fixed to the building."""
    build_surfaces()
    build_mouldings()
    build_window()
    build_curtains()
    build_door()
    build_ceiling_panel()

"""Thin things for the example room: bars, a grille, rails, a screen, cutlery, cables and strips of light.

Nearly all are a third of a pixel to three pixels wide where the capture's cameras see them. Metres, Z up.
"""

from __future__ import annotations

import numpy as np
from room_furniture import LAMP_AT
from room_materials import RoomMaterial
from room_shapes import Form, Point
from room_shell import DEPTH, HEAD, HEIGHT, PANEL_AT, SILL, WIDTH, WINDOW_WIDTH, WINDOW_X

# The strips of light: name, radiance, centre, size.
STRIPS: list[tuple[str, tuple[float, float, float], Point, Point]] = [
    ("PictureStripLight", (34.0, 29.0, 22.0), (0.022 - WIDTH / 2, -0.25, 2.22), (0.012, 1.9, 0.012)),
    ("MirrorStripLight", (11.0, 11.0, 12.0), (WIDTH / 2 - 0.022, -0.35, 2.16), (0.012, 1.1, 0.016)),
    ("DoorStripLight", (70.0, 46.0, 26.0), (1.55, 0.092 - DEPTH / 2, 2.24), (0.7, 0.008, 0.008)),
]

MATERIALS = [
    RoomMaterial("WindowBarIron", 5, (0.030, 0.030, 0.032), 0.4),
    RoomMaterial("LouvreBlack", 10, (0.012, 0.012, 0.012)),
    RoomMaterial("RailSteel", 16, (0.62, 0.60, 0.58), 0.3, 1.0),
    RoomMaterial("GrilleEnamel", 12, (0.70, 0.70, 0.68), 0.35),
    RoomMaterial("GrilleBack", 12, (0.020, 0.020, 0.020)),
    RoomMaterial("ScreenLacquer", 16, (0.45, 0.06, 0.04), 0.25),
    RoomMaterial("CutlerySilver", 16, (0.80, 0.78, 0.74), 0.2, 1.0),
    RoomMaterial("CableRubber", 16, (0.025, 0.025, 0.025), 0.5),
    RoomMaterial("CableCloth", 16, (0.50, 0.08, 0.05)),
    RoomMaterial("StripProfile", 10, (0.70, 0.70, 0.71), 0.5, 1.0),
    *(RoomMaterial(name, 1, (0.0, 0.0, 0.0), radiance=radiance) for name, radiance, _, _ in STRIPS),
]


def build_window_bars(rng: np.random.Generator) -> None:
    """Upright round bars in the opening of the window."""
    form = Form("Window bars", at=(WINDOW_X, DEPTH / 2, 0), uv=False)
    radius, count = rng.uniform(0.003, 0.008), int(rng.integers(10, 15))
    for x in (np.arange(count) + 0.5) / count * WINDOW_WIDTH - WINDOW_WIDTH / 2:
        form.tube([(x, 0.045, SILL), (x, 0.045, HEAD)], radius, "WindowBarIron", segments=6)
    form.finish()


def build_louvre(rng: np.random.Generator) -> None:
    """Black blades across the ceiling panel: dark things right beside a bright one."""
    form = Form("Panel louvre", at=(*PANEL_AT, HEIGHT - 0.062), uv=False)
    width = rng.uniform(0.006, 0.014)
    for x in np.linspace(-0.4, 0.4, 5):
        form.box((width, 0.62, 0.012), (x, 0, 0), "LouvreBlack", bevel=0)
    form.finish()


def build_grille(rng: np.random.Generator) -> None:
    """A ventilation grille in the south wall, between the rails: enamelled slats before a dark duct."""
    form = Form("Grille", at=(0.1, -DEPTH / 2, 1.4), turn=180, uv=False)
    w, h, slat = 0.7, 0.36, rng.uniform(0.007, 0.014)
    form.box((w, 0.006, h), (0, -0.004, 0), "GrilleBack", bevel=0)
    for z in np.linspace(-h / 2, h / 2, 13):
        form.box((w, 0.012, slat), (0, -0.02, z), "GrilleEnamel", bevel=0)
    for x in (-w / 2, 0, w / 2):
        form.box((0.014, 0.02, h + slat), (x, -0.02, 0), "GrilleEnamel", bevel=0)
    form.finish()


def build_rails(rng: np.random.Generator) -> None:
    """Two steel rails on brackets along the south wall between bookshelf and door."""
    form = Form("Rails", at=(0.1, -DEPTH / 2, 0), turn=180, uv=False)
    for height in (1.05, 1.75):
        radius = rng.uniform(0.004, 0.012)
        form.tube([(x, -0.06, height) for x in (-0.75, 0, 0.75)], radius, "RailSteel")
        for x in (-0.7, 0, 0.7):
            form.tube([(x, -0.06, height), (x, 0, height)], 0.6 * radius, "RailSteel", segments=6)
    form.finish()


def build_screen(rng: np.random.Generator) -> None:
    """A standing screen of lacquered rods beside the window."""
    form = Form("Screen", at=(-1.0, 1.62, 0), turn=float(rng.uniform(-12, 12)), uv=False)
    radius, half, top = rng.uniform(0.003, 0.007), 0.45, 1.15
    for x in np.linspace(-half, half, 13):
        form.tube([(x, 0, 0.04), (x, 0, top)], radius, "ScreenLacquer", segments=6)
    for z in (0.04, 0.6, top):
        form.tube([(-half, 0, z), (half, 0, z)], 1.5 * radius, "ScreenLacquer", segments=6)
    for x in (-half, half):
        form.box((0.03, 0.24, 0.012), (x, 0, 0.02), "ScreenLacquer", bevel=0)
    form.finish()


def build_cutlery(rng: np.random.Generator) -> None:
    """Knives, forks and spoons in a row on the cabinet."""
    form = Form("Cutlery", at=(WIDTH / 2 - 0.26, -0.35, 0.817), turn=-90, uv=False)
    for k, x in enumerate(np.linspace(-0.36, 0.2, 9)):
        turn = (0.0, 0.0, float(rng.uniform(-8, 8)))
        form.box((0.009, 0.11, 0.004), (x, -0.09, 0.0), "CutlerySilver", bevel=0, turn=turn)
        if k % 3 == 0:
            form.box((0.018, 0.10, 0.002), (x, 0.015, 0.0), "CutlerySilver", bevel=0)
        elif k % 3 == 1:
            for tine in (-0.009, -0.003, 0.003, 0.009):
                form.box((0.003, 0.06, 0.002), (x + tine, 0.02, 0.0), "CutlerySilver", bevel=0)
        else:
            bowl = [(0.0, 0.0), (0.018, 0.002), (0.022, 0.008), (0.02, 0.008), (0.0, 0.004)]
            form.lathe(bowl, (x, 0.0, 0.0), "CutlerySilver", segments=14)
    form.finish()


def build_cables(rng: np.random.Generator) -> None:
    """A pendant on a cloth cable, and the lamp's rubber cable down to the floor and along the wall."""
    form = Form("Cables", uv=False)
    x, y = -0.2 + rng.uniform(-0.2, 0.2), 0.9 + rng.uniform(-0.1, 0.1)
    form.tube(
        [(x, y, 2.05), (x, y, 2.5), (x, y, HEIGHT)], rng.uniform(0.003, 0.006), "CableCloth", segments=6
    )
    ball = [(0.03 * np.sin(t), -0.03 * np.cos(t)) for t in np.linspace(0, np.pi, 8)]
    form.lathe(ball, (x, y, 2.03), "CableCloth", segments=12)
    lx, ly = LAMP_AT
    wall = 0.03 - WIDTH / 2
    lamp = [(lx, ly + 0.08, 0.505), (lx, ly + 0.26, 0.5), (lx - 0.05, ly + 0.27, 0.02), (wall, 1.75, 0.02)]
    form.tube([*lamp, (wall, 1.93, 0.3), (wall, 1.95, 1.6)], rng.uniform(0.003, 0.006), "CableRubber", 6)
    along = np.linspace(-0.8, 1.0, 25)
    swag = [(float(u), 0.02 - DEPTH / 2, 2.05 - 0.12 * float(np.sin(7 * u) ** 2)) for u in along]
    form.tube(swag, rng.uniform(0.003, 0.006), "CableCloth", segments=6)
    form.finish()


def build_strips() -> None:
    """Strips of light, each on a metal profile at the wall."""
    for name, _, centre, size in STRIPS:
        light = Form(name.replace("Light", " light"), at=centre, uv=False)
        light.box(size, (0, 0, 0), name, bevel=0)
        light.finish()
        across = int(np.argmin(size[:2]))  # the axis that points away from the wall
        inwards = -float(np.sign(centre[across]))
        profile = [size[0], size[1], size[2] + 0.012]
        profile[across] = 0.008
        offset = [0.0, 0.0, 0.0]
        offset[across] = -inwards * (size[across] / 2 + 0.0045)
        holder = Form(name.replace("Light", " profile"), at=centre, uv=False)
        holder.box((profile[0], profile[1], profile[2]), (offset[0], offset[1], 0), "StripProfile", bevel=0)
        holder.finish()


def build_thin(rng: np.random.Generator) -> None:
    """All of them; their widths follow `rng`."""
    build_window_bars(rng)
    build_louvre(rng)
    build_grille(rng)
    build_rails(rng)
    build_screen(rng)
    build_cutlery(rng)
    build_cables(rng)
    build_strips()

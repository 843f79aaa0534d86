"""The lamp, rug, plant, radiator, clock and bin of the example room. Metres, Z up."""

from __future__ import annotations

import math

import numpy as np
from room_furniture import BULB_CENTRE, BULB_RADIUS, LAMP_AT
from room_shapes import Form
from room_shell import DEPTH, SILL, WIDTH, WINDOW_WIDTH, WINDOW_X


def build_lamp() -> None:
    """A glazed lamp on a brushed-steel drum; the bulb shows only through the open top of its opaque shade."""
    drum = Form("Drum table", at=(*LAMP_AT, 0), uv=False)
    body = [
        (0.0, 0.0),
        (0.22, 0.0),
        (0.235, 0.012),
        (0.24, 0.03),
        (0.225, 0.25),
        (0.24, 0.47),
        (0.25, 0.485),
        (0.25, 0.495),
        (0.24, 0.50),
        (0.0, 0.50),
    ]
    drum.lathe(body, (0, 0, 0), "BrushedSteel", segments=40)
    drum.finish()
    lamp = Form("Table lamp", at=(*LAMP_AT, 0.50), uv=False)
    base = [
        (0.0, 0.0),
        (0.075, 0.0),
        (0.08, 0.008),
        (0.075, 0.018),
        (0.045, 0.03),
        (0.05, 0.05),
        (0.095, 0.12),
        (0.105, 0.17),
        (0.09, 0.23),
        (0.045, 0.285),
        (0.025, 0.30),
        (0.0, 0.302),
    ]
    lamp.lathe(base, (0, 0, 0), "LampGlaze", segments=28)
    bulb_base = BULB_CENTRE[2] - BULB_RADIUS - 0.50
    stem = [
        (0.012, 0.29),
        (0.009, 0.31),
        (0.009, bulb_base - 0.05),
        (0.018, bulb_base - 0.048),
        (0.018, bulb_base + 0.001),
        (0.0, bulb_base + 0.001),
    ]
    lamp.lathe(stem, (0, 0, 0), "Brass", segments=14)
    low, high, wide, narrow = 0.37, 0.63, 0.20, 0.145  # the shade above the table top
    for k in range(3):
        a = math.radians(120 * k + 20)
        z, r = bulb_base - 0.03, wide - (wide - narrow) * (bulb_base - 0.03 - low) / (high - low)
        lamp.tube([(0, 0, z), (r * math.cos(a), r * math.sin(a), z)], 0.0025, "Brass", segments=6)
    lamp.finish()
    shade = Form("Lamp shade", at=(*LAMP_AT, 0.50), uv=False)
    outside = [
        (wide - 0.003, low),
        (wide, low - 0.002),
        (wide, low + 0.01),
        (narrow, high - 0.01),
        (narrow, high + 0.002),
        (narrow - 0.003, high),
    ]
    shade.lathe(outside, (0, 0, 0), "ShadeOutside", segments=40)
    shade.lathe([(narrow - 0.003, high), (wide - 0.003, low)], (0, 0, 0), "ShadeInside", segments=40)
    shade.finish()
    bulb = Form("Bulb", at=BULB_CENTRE, uv=False)
    sphere = [(BULB_RADIUS * math.sin(t), -BULB_RADIUS * math.cos(t)) for t in np.linspace(0, math.pi, 9)]
    bulb.lathe(sphere, (0, 0, 0), "BulbLight", segments=14)
    bulb.finish()


def build_rug() -> None:
    """A rug of slightly wavy pile with a bound edge."""
    form = Form("Rug", at=(-0.62, -0.2, 0), turn=3)
    w, d = 2.3, 1.65
    s, t = np.meshgrid(np.linspace(-1, 1, 18), np.linspace(-1, 1, 13))
    edge = np.clip(np.minimum((1 - np.abs(s)) * w / 2, (1 - np.abs(t)) * d / 2) / 0.02, 0, 1)
    wave = 0.003 * np.sin(4 * s + 1) * np.sin(5 * t)
    form.sheet(np.stack([s * w / 2, t * d / 2, 0.001 + (0.011 + wave) * edge], -1), (0, 0, 0), "Rug")
    form.finish()


def build_plant(rng: np.random.Generator) -> None:
    """A broad-leaved plant in a terracotta pot with saucer and soil."""
    at = (2.02, 1.42)
    pot = Form("Plant pot", at=(*at, 0))
    body = [
        (0.0, 0.02),
        (0.13, 0.02),
        (0.14, 0.03),
        (0.18, 0.28),
        (0.20, 0.285),
        (0.205, 0.30),
        (0.205, 0.345),
        (0.195, 0.35),
        (0.175, 0.345),
        (0.168, 0.29),
    ]
    pot.lathe(body, (0, 0, 0), "Terracotta", segments=32)
    pot.lathe(
        [(0, 0), (0.18, 0), (0.20, 0.03), (0.192, 0.032), (0.17, 0.014), (0, 0.014)],
        (0, 0, 0),
        "Terracotta",
        32,
    )
    pot.lathe([(0.174, 0.315), (0.12, 0.322), (0.06, 0.318), (0.0, 0.325)], (0, 0, 0), "Soil", segments=24)
    pot.finish()
    plant = Form("Plant", at=(*at, 0), uv=False)
    for k in range(24):
        turn = math.radians(137.5 * k)
        rise, reach = 0.50 + 0.026 * k + rng.uniform(-0.03, 0.03), 0.36 - 0.010 * k
        length, breadth = rng.uniform(0.28, 0.36), rng.uniform(0.11, 0.15)
        direction = np.array([math.cos(turn), math.sin(turn), 0.0])
        side = np.array([-direction[1], direction[0], 0.0])
        foot = np.array([0.03 * direction[0], 0.03 * direction[1], 0.32])
        joint = foot + direction * reach * 0.55 + np.array([0, 0, rise - 0.32])
        bend = (foot + joint) / 2 + np.array([0, 0, 0.06]) - direction * 0.04
        plant.tube([tuple(foot), tuple(bend), tuple(joint)], 0.006, "LeafLight", segments=5)
        u = np.linspace(0, 1, 8)[:, None]
        v = np.linspace(-1, 1, 5)[None, :]
        outline = np.sin(np.pi * (0.04 + 0.96 * u) ** 0.75) * breadth / 2
        droop = (0.22 * u - 0.62 * u**2) * length
        points = joint + (u * length)[..., None] * direction * 0.9 + (outline * v)[..., None] * side
        points[..., 2] += droop + 0.25 * np.abs(v) * outline
        reachable = np.array([WIDTH / 2 - 0.04 - at[0], DEPTH / 2 - 0.04 - at[1]])
        points[..., :2] = np.where(
            points[..., :2] > reachable, reachable - 0.15 * (points[..., :2] - reachable), points[..., :2]
        )
        plant.sheet(points, (0, 0, 0), "LeafDark" if k % 3 else "LeafLight")
    plant.finish()


def build_radiator() -> None:
    """An enamelled column radiator under the window."""
    form = Form("Radiator", at=(WINDOW_X, DEPTH / 2 - 0.10, 0), uv=False)
    count, pitch = 16, 0.07
    for k in range(count):
        x = (k - (count - 1) / 2) * pitch
        form.box((0.045, 0.10, 0.60), (x, 0, 0.42), "RadiatorEnamel", bevel=0.02, segments=1)
    for z in (0.17, 0.67):
        half = count * pitch / 2
        form.tube(
            [(-half - 0.02, 0, z), (0, 0, z), (half + 0.02, 0, z)], 0.022, "RadiatorEnamel", segments=10
        )
    form.tube([(0.58, 0, 0.17), (0.64, 0, 0.17), (0.64, 0, 0.0)], 0.009, "Brass", segments=8)
    form.lathe(
        [(0, 0), (0.018, 0), (0.022, 0.02), (0.018, 0.055), (0, 0.06)], (0.64, 0, 0.18), "GlazeWhite", 14
    )
    form.finish()


def build_clock() -> None:
    """A wall clock with a steel rim between window and plant."""
    form = Form("Clock", at=(1.98, DEPTH / 2, 1.95), uv=False)
    rim = [(0.165, 0.0), (0.165, 0.03), (0.158, 0.042), (0.148, 0.042), (0.143, 0.025)]
    form.lathe(rim, (0, 0, 0), "BrushedSteel", segments=36, turn=(90, 0, 0))
    form.lathe([(0.145, 0.022), (0.0, 0.022)], (0, 0, 0), "ClockFace", segments=36, turn=(90, 0, 0))
    for hour in range(12):
        a = math.radians(30 * hour)
        at = (0.12 * math.sin(a), -0.024, 0.12 * math.cos(a))
        form.box((0.008, 0.004, 0.025), at, "BlackFrame", bevel=0, turn=(0, math.degrees(a), 0))
    for length, width, turn in ((0.075, 0.012, 305.0), (0.11, 0.008, 54.0)):
        a = math.radians(turn)
        at = (0.45 * length * math.sin(a), -0.029, 0.45 * length * math.cos(a))
        form.box((width, 0.004, length), at, "BlackFrame", bevel=0, turn=(0, turn, 0))
    form.finish()


def build_bin() -> None:
    """A brushed-steel umbrella stand by the door, and a wicker basket beside the armchair."""
    stand = Form("Umbrella stand", at=(2.27, -1.72, 0), uv=False)
    body = [
        (0.0, 0.0),
        (0.11, 0.0),
        (0.12, 0.01),
        (0.12, 0.50),
        (0.127, 0.507),
        (0.127, 0.52),
        (0.12, 0.525),
        (0.115, 0.515),
        (0.115, 0.03),
        (0.0, 0.03),
    ]
    stand.lathe(body, (0, 0, 0), "BrushedSteel", segments=32)
    stand.finish()
    basket = Form("Basket", at=(-0.45, -1.62, 0))
    weave = [(0.0, 0.0), (0.17, 0.0)]
    weave += [(0.175 + 0.03 * k / 14 + 0.006 * (k % 2), 0.02 + 0.02 * k) for k in range(15)]
    weave += [(0.205, 0.315), (0.19, 0.31), (0.165, 0.04), (0.0, 0.03)]
    basket.lathe(weave, (0, 0, 0), "Wicker", segments=26)
    basket.finish()


def build_sill_bottles() -> None:
    """Two glazed bottles on the window sill."""
    form = Form("Sill bottles", at=(WINDOW_X, DEPTH / 2 - 0.03, SILL + 0.006), uv=False)
    bottle = [
        (0.0, 0.0),
        (0.035, 0.0),
        (0.042, 0.01),
        (0.042, 0.12),
        (0.035, 0.15),
        (0.014, 0.18),
        (0.013, 0.24),
        (0.017, 0.245),
        (0.017, 0.255),
        (0.0, 0.256),
    ]
    for x, size, glaze in (
        (0.25 * WINDOW_WIDTH, 1.0, "GlazeGreen"),
        (0.33 * WINDOW_WIDTH, 0.75, "GlazeWhite"),
    ):
        form.lathe([(r * size, z * size) for r, z in bottle], (x, 0, 0), glaze, segments=18)
    form.finish()

"""The furniture of the example room. Each builder makes one piece; metres, Z up, fronts face local -Y."""

from __future__ import annotations

import math

import numpy as np
from room_shapes import Form
from room_shell import DEPTH, WIDTH

LAMP_AT = (-2.02, 1.22)  # the drum table under the lamp
BULB_CENTRE = (*LAMP_AT, 1.05)
BULB_RADIUS = 0.0275
TURNED_LEG = [
    (0.0, 0.0),
    (0.014, 0.0),
    (0.017, 0.02),
    (0.013, 0.06),
    (0.022, 0.14),
    (0.026, 0.22),
    (0.018, 0.28),
    (0.024, 0.30),
    (0.018, 0.32),
    (0.027, 0.36),
    (0.027, 0.40),
    (0.0, 0.40),
]


def scaled(profile: list[tuple[float, float]], radius: float, height: float) -> list[tuple[float, float]]:
    """A profile stretched by `radius` and `height`."""
    return [(r * radius, z * height) for r, z in profile]


def build_sofa() -> None:
    """Two-seater: frame, rounded arms, swelling seat and back cushions, throw pillows, turned legs."""
    form = Form("Sofa", at=(-WIDTH / 2 + 0.52, -0.25, 0), turn=90)
    form.box((1.86, 0.82, 0.20), (0, 0, 0.25), "SofaCloth", bevel=0.03)
    form.box((1.80, 0.18, 0.50), (0, 0.34, 0.55), "SofaCloth", bevel=0.07, segments=4)
    for side in (-1, 1):
        form.box((0.20, 0.84, 0.46), (side * 0.86, -0.01, 0.38), "SofaCloth", bevel=0.075, segments=4)
        form.cushion((0.78, 0.66, 0.17), (side * 0.385, -0.09, 0.42), "SofaCloth", puff=0.35)
        form.cushion((0.76, 0.19, 0.46), (side * 0.385, 0.19, 0.68), "SofaCloth", turn=(-12, 0, 0), puff=0.1)
        for depth in (-0.32, 0.32):
            form.lathe(scaled(TURNED_LEG, 1.0, 0.40), (side * 0.82, depth, 0), "Walnut", segments=10)
    form.finish()
    pillows = Form("Pillows", at=(-WIDTH / 2 + 0.52, -0.25, 0), turn=90)
    pillows.pillow(0.46, 0.46, 0.17, (-0.60, -0.03, 0.70), "ZigzagCloth", (68, 0, 14))
    pillows.pillow(0.42, 0.42, 0.16, (0.62, -0.02, 0.68), "CoralCloth", (66, 0, -16))
    pillows.pillow(0.50, 0.32, 0.14, (0.18, -0.08, 0.65), "StripedCloth", (62, 0, 5))
    pillows.finish()


def build_armchair() -> None:
    """A wing-less reading chair with a curved back and a seat cushion."""
    form = Form("Armchair", at=(0.75, -0.95, 0), turn=-122)
    form.cushion((0.66, 0.64, 0.20), (0, -0.06, 0.42), "ArmchairCloth", puff=0.35)
    form.box((0.70, 0.68, 0.14), (0, -0.03, 0.28), "ArmchairCloth", bevel=0.05, segments=3)
    angle = np.radians(np.linspace(-28, 208, 25))
    height = 0.62 + 0.26 * np.clip(np.sin(angle), 0, 1) ** 1.5
    rows = []
    for inset, level in (
        (0.0, 0.24),
        (0.0, 0.5),
        (0.005, 0.9),
        (0.04, 0.985),
        (0.085, 1.0),
        (0.12, 0.97),
        (0.13, 0.9),
        (0.14, 0.5),
        (0.14, 0.3),
    ):
        top = 0.24 + (height - 0.24) * level
        lean = 0.10 * np.clip(np.sin(angle), 0, 1) * (top - 0.24) / 0.6
        x, y = (0.44 - inset) * np.cos(angle), (0.42 - inset) * np.sin(angle) + lean
        rows.append(np.stack([x, y, top], -1))
    shell = np.array(rows)
    form.sheet(shell, (0, 0, 0), "ArmchairCloth")
    for end in (0, -1):
        rim = shell[:, end]
        form.sheet(np.stack([rim, np.repeat(rim.mean(0)[None], len(rim), 0)]), (0, 0, 0), "ArmchairCloth")
    for x, y in ((-0.28, -0.28), (0.28, -0.28), (-0.26, 0.26), (0.26, 0.26)):
        form.lathe(scaled(TURNED_LEG, 1.0, 0.55), (x, y, 0), "Walnut", segments=10)
    form.finish()


def build_coffee_table() -> None:
    """Round walnut table on turned legs with an under-shelf; a vase, a bowl of fruit and books on it."""
    form = Form("Coffee table", at=(-0.72, -0.2, 0))
    top = [
        (0.0, 0.40),
        (0.40, 0.40),
        (0.425, 0.405),
        (0.44, 0.415),
        (0.445, 0.428),
        (0.435, 0.438),
        (0.42, 0.44),
        (0.0, 0.44),
    ]
    form.lathe(top, (0, 0, 0), "Walnut", segments=40)
    form.lathe(
        [(0, 0.15), (0.28, 0.15), (0.29, 0.16), (0.28, 0.17), (0, 0.17)], (0, 0, 0), "Walnut", segments=28
    )
    for k in range(4):
        a = math.radians(45 + 90 * k)
        form.lathe(
            scaled(TURNED_LEG, 1.1, 1.0), (0.29 * math.cos(a), 0.29 * math.sin(a), 0), "Walnut", segments=12
        )
    form.finish()
    vase = Form("Vase", at=(-0.86, 0.02, 0.44))
    profile = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.055, 0.012),
        (0.085, 0.07),
        (0.092, 0.12),
        (0.075, 0.18),
        (0.04, 0.23),
        (0.032, 0.26),
        (0.045, 0.295),
        (0.05, 0.30),
        (0.042, 0.296),
        (0.028, 0.26),
        (0.034, 0.23),
        (0.03, 0.18),
    ]
    vase.lathe(profile, (0, 0, 0), "GlazeGreen", segments=28)
    vase.finish()
    bowl = Form("Fruit bowl", at=(-0.55, -0.36, 0.44), uv=False)
    profile = [
        (0.0, 0.006),
        (0.05, 0.0),
        (0.06, 0.012),
        (0.055, 0.02),
        (0.10, 0.04),
        (0.135, 0.075),
        (0.15, 0.11),
        (0.145, 0.112),
        (0.128, 0.08),
        (0.09, 0.048),
        (0.0, 0.03),
    ]
    bowl.lathe(profile, (0, 0, 0), "BrushedSteel", segments=32)
    fruit = [
        ((0.055, 0.03, 0.088), 0.038, "FruitOrange"),
        ((-0.05, 0.045, 0.087), 0.037, "FruitOrange"),
        ((-0.005, -0.058, 0.088), 0.038, "FruitApple"),
        ((0.0, 0.01, 0.142), 0.036, "FruitApple"),
    ]
    for at, radius, material in fruit:
        ball = [(radius * math.sin(t), -radius * math.cos(t) * 0.94) for t in np.linspace(0, math.pi, 9)]
        ball[-1] = (0.0, ball[-2][1] - 0.003)  # the dimple of the stalk
        bowl.lathe(ball, at, material, segments=14)
    bowl.finish()
    pile = Form("Books on the table", at=(-0.60, 0.05, 0.44), turn=24)
    height = 0.0
    for k, (w, d, t) in enumerate(((0.25, 0.18, 0.032), (0.23, 0.16, 0.025), (0.20, 0.14, 0.030))):
        add_book(
            pile, (w, d, t), (0.03 * k, 0.0, height + t / 2), tile=20 + k, turn=(0, 0, 9 * k - 6), lying=True
        )
        height += t
    pile.finish()


def add_book(
    form: Form,
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    tile: int,
    turn: tuple[float, float, float] = (0, 0, 0),
    lying: bool = False,
) -> None:
    """A book of two boards, a spine and pages. Upright: (thickness, depth, height), spine at -Y."""
    w, d, h = size
    uv = ((tile % 8) / 8, (tile // 8 % 8) / 8, 1 / 8)
    cos, sin = math.cos(math.radians(turn[2])), math.sin(math.radians(turn[2]))

    def put(piece: tuple[float, float, float], offset: tuple[float, float, float], cover: bool) -> None:
        x, y, z = offset
        where = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, at[2] + z)
        tilted = (
            at[0] + x * math.cos(math.radians(turn[1])) + z * math.sin(math.radians(turn[1])),
            at[1] + y,
            at[2] + z * math.cos(math.radians(turn[1])) - x * math.sin(math.radians(turn[1])),
        )
        where = tilted if turn[1] else where
        material = "BookCovers" if cover else "BookPages"
        form.box(piece, where, material, bevel=0, turn=turn, uv_tile=uv if cover else None)

    board = 0.0025
    if lying:  # boards above and below, spine at -Y
        for side in (-1, 1):
            put((w, d, board), (0, 0, side * (h - board) / 2), True)
        put((w, board, h - 2 * board), (0, -(d - board) / 2, 0), True)
        put((w - 0.008, d - 0.007, h - 2 * board), (0, 0.001, 0), False)
    else:
        for side in (-1, 1):
            put((board, d, h), (side * (w - board) / 2, 0, 0), True)
        put((w - 2 * board, board, h), (0, -(d - board) / 2, 0), True)
        put((w - 2 * board, d - 0.007, h - 0.008), (0, 0.001, 0), False)


def build_bookshelf(rng: np.random.Generator) -> None:
    """Oak shelves against the south wall with rows of books, a vase and a wicker box."""
    width, depth, height = 1.05, 0.30, 1.95
    at = (-1.45, -DEPTH / 2 + depth / 2 + 0.01, 0)
    case = Form("Bookshelf", at=at, turn=180)
    for side in (-1, 1):
        case.box((0.03, depth, height), (side * (width / 2 - 0.015), 0, height / 2), "Oak", bevel=0.004)
    levels = np.linspace(0.08, height - 0.02, 6)
    for level in levels:
        case.box((width - 0.06, depth - 0.01, 0.026), (0, 0, float(level)), "Oak", bevel=0.004)
    case.box((width - 0.05, 0.012, height - 0.1), (0, depth / 2 - 0.008, height / 2 + 0.03), "Oak", bevel=0)
    case.box((width - 0.05, 0.02, 0.075), (0, -depth / 2 + 0.03, 0.04), "Oak", bevel=0.003)
    case.finish()
    books = Form("Books", at=at, turn=180)
    tile = 0
    for row, level in enumerate(levels[:-1]):
        x, end = -width / 2 + 0.045, width / 2 - 0.06 - (0.0, 0.36, 0.12, 0.30, 0.05)[row]
        base = float(level) + 0.0135
        while x < end:
            t, d, h = rng.uniform(0.022, 0.05), rng.uniform(0.17, 0.23), rng.uniform(0.20, 0.30)
            lean = 9.0 if x + t > end and row in (1, 3) else 0.0
            drop = math.sin(math.radians(lean)) * t / 2
            add_book(
                books,
                (t, d, h),
                (x + t / 2 + 0.04 * (lean > 0), -0.02, base + h / 2 + drop),
                tile,
                turn=(0, -lean, 0),
            )
            tile, x = tile + 1, x + t + 0.0015
    books.finish()
    things = Form("Shelf ornaments", at=at, turn=180, uv=False)
    jar = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.07, 0.04),
        (0.075, 0.09),
        (0.055, 0.14),
        (0.035, 0.155),
        (0.04, 0.175),
        (0.036, 0.175),
        (0.03, 0.155),
        (0.03, 0.13),
    ]
    things.lathe(jar, (0.34, -0.02, float(levels[1]) + 0.013), "GlazeWhite", segments=20)
    basket = [(0.0, 0.0), (0.085, 0.0)]
    basket += [(0.088 + 0.018 * k / 10 + 0.004 * (k % 2), 0.02 + 0.016 * k) for k in range(11)]
    basket += [(0.10, 0.182), (0.09, 0.17), (0.08, 0.03), (0.0, 0.02)]
    things.lathe(basket, (0.33, -0.02, float(levels[3]) + 0.013), "Wicker", segments=22)
    things.finish()


def build_cabinet() -> None:
    """A lacquered sideboard on turned legs: four doors with raised panels and brass knobs, things on top."""
    form = Form("Cabinet", at=(WIDTH / 2 - 0.26, -0.35, 0), turn=-90, uv=False)
    form.box((1.60, 0.44, 0.60), (0, 0, 0.48), "CabinetLacquer", bevel=0.008)
    form.box((1.68, 0.48, 0.03), (0, -0.01, 0.80), "CabinetLacquer", bevel=0.012, segments=3)
    knob = [(0.006, 0), (0.006, 0.012), (0.014, 0.018), (0.016, 0.026), (0.010, 0.033), (0.0, 0.035)]
    for k in range(4):
        x = -0.585 + 0.39 * k
        form.box((0.375, 0.02, 0.55), (x, -0.228, 0.48), "CabinetLacquer", bevel=0.006)
        form.box((0.275, 0.02, 0.45), (x, -0.234, 0.48), "CabinetLacquer", bevel=0.009)
        form.lathe(knob, (x + (0.155 if k % 2 == 0 else -0.155), -0.236, 0.52), "Brass", 14, turn=(90, 0, 0))
    for x in (-0.72, 0.72):
        for y in (-0.15, 0.15):
            form.lathe(scaled(TURNED_LEG, 1.1, 0.5), (x, y, 0), "Walnut", segments=10)
    form.finish()
    things = Form("Cabinet ornaments", at=(WIDTH / 2 - 0.26, -0.35, 0.815), turn=-90, uv=False)
    jug = [
        (0.0, 0.0),
        (0.055, 0.0),
        (0.075, 0.03),
        (0.085, 0.09),
        (0.07, 0.16),
        (0.045, 0.21),
        (0.04, 0.25),
        (0.055, 0.285),
        (0.05, 0.286),
        (0.034, 0.25),
        (0.035, 0.2),
    ]
    things.lathe(jug, (-0.56, 0.0, 0), "GlazeWhite", segments=24)
    handle = [
        (-0.56 - 0.075 - 0.045 * math.sin(t), 0, 0.17 - 0.075 * math.cos(t))
        for t in np.linspace(0, math.pi, 9)
    ]
    things.tube(handle, 0.008, "GlazeWhite", segments=7)
    things.lathe(
        [(0, 0), (0.17, 0), (0.185, 0.016), (0.18, 0.018), (0.165, 0.006), (0, 0.006)],
        (0.45, -0.01, 0),
        "Brass",
        segments=32,
    )
    for x, tall in ((0.40, 0.22), (0.50, 0.15)):
        stick = [
            (0.0, 0.006),
            (0.035, 0.006),
            (0.03, 0.014),
            (0.010, 0.03),
            (0.014, 0.45 * tall),
            (0.008, 0.5 * tall),
            (0.008, 0.9 * tall),
            (0.022, 0.95 * tall),
            (0.022, tall),
            (0.0, tall),
        ]
        things.lathe(stick, (x, 0.0, 0), "BrushedSteel", segments=16)
        things.lathe(
            [(0.010, tall), (0.010, tall + 0.12), (0.004, tall + 0.127), (0, tall + 0.128)],
            (x, 0.0, 0),
            "GlazeWhite",
            segments=10,
        )
    things.finish()


def build_mirror() -> None:
    """A wall mirror over the cabinet in a gilt, profiled frame."""
    form = Form("Mirror", at=(WIDTH / 2, -0.35, 1.62), turn=-90, uv=False)
    w, h = 1.15, 0.80
    form.box((w, 0.012, h), (0, -0.018, 0), "MirrorSilver", bevel=0)
    add_frame(form, w, h, "GiltFrame", 0.065, 0.045)
    form.finish()


def add_frame(form: Form, w: float, h: float, material: str, width: float, depth: float) -> None:
    """A mitred frame around a w x h opening: one profile swept around it, the wall at Y = 0."""
    profile = [
        (0.0, -0.012),
        (0.004, -0.6 * depth),
        (0.3 * width, -0.7 * depth),
        (0.45 * width, -depth),
        (0.75 * width, -depth),
        (width, -0.5 * depth),
        (width, 0.0),
    ]
    rows = []
    for out, y in profile:
        a, b = w / 2 + out, h / 2 + out
        rows.append([(-a, y, -b), (a, y, -b), (a, y, b), (-a, y, b), (-a, y, -b)])
    form.sheet(np.array(rows), (0, 0, 0), material)


def build_pictures() -> None:
    """Three framed pictures over the sofa."""
    hangings = [
        ("Landscape", 0.02, 1.62, 0.93, 0.62, "GiltFrame", 0.0),
        ("AbstractA", -0.98, 1.60, 0.36, 0.48, "BlackFrame", 0.06),
        ("AbstractB", 1.05, 1.95, 0.27, 0.36, "BlackFrame", 0.05),
    ]
    for canvas, along, height, w, h, frame, mount in hangings:
        form = Form(f"Picture {canvas}", at=(-WIDTH / 2, -0.25 + along, height), turn=90)
        y = -0.014
        form.sheet(
            np.array([[(-w / 2, y, -h / 2), (w / 2, y, -h / 2)], [(-w / 2, y, h / 2), (w / 2, y, h / 2)]]),
            (0, 0, 0),
            canvas,
        )
        form.finish()
        border = Form(f"Frame {canvas}", at=(-WIDTH / 2, -0.25 + along, height), turn=90, uv=False)
        if mount:
            rows = [
                [
                    (s * (w / 2 + m), y, t * (h / 2 + m))
                    for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
                ]
                for m in (0.0, mount)
            ]
            border.sheet(np.array(rows), (0, 0, 0), "Mount")
        add_frame(border, w + 2 * mount, h + 2 * mount, frame, 0.045, 0.035)
        border.finish()

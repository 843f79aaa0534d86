# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How good a result is, by photographs that the estimation has not seen, and what limits it.

Each of them is rendered from the estimate, and projected from the training photographs (:mod:`.projection`),
which knows neither materials nor light. Both are compared with the photograph in its own display values after
one factor of exposure. What the projection gets wrong too is due to surfaces, poses or photographs; the rest
is due to light, where it is smooth over the picture, or to materials.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from ..capture.averaging import majority, means
from ..capture.encoded import CLIPPED_CODE, srgb_encoded
from ..capture.views import View
from ..pixels.store import PixelStore, trace_view
from ..radiometry.adjustment import falloff_terms
from .projection import Projection, projected
from .registration import register
from .rerender import Estimate, Renderer

MOST_VIEWS = 8  # photographs that are judged, evenly spread; more only cost time
POOR = 25.0  # dB, below which a result's causes are named to the user
GAMMA = 1.0 / 2.2  # of display values of HDR photographs (paper, Sec. 6.2)
MIDDLE = 0.18  # display exposure: radiance of the capture's median
# Display values within which a pixel counts for the factor of exposure.
USABLE = (0.05, 0.95)
# Difference of the logarithm of radiance between photographs, above which they do not show the same point: a
# surface is not where the mesh has it. Gloss causes 0.1.
DISAGREE = 0.25
# An estimate of them may be twice as far off as their mean; this is the ratio of squares.
AMPLIFIED = 4.0
LEAST_SHIFT = 0.5  # pixels, of a motion that counts
BLUR = 1.5  # pixels, by which a photograph may be blurred more than the others
SMOOTH = 1.0 / 12.0  # of a picture's width: errors of light are smooth over it, as its fall-off is
LEAST_SHARE = 0.05  # of the error, of a cause that is named
DARK = 0.02  # display value below which ratios do not matter
FLOOR = 1e-4  # radiance in units of the capture's median


@dataclass(frozen=True)
class Cause:
    """A share (0 to 1) of the squared error, what it is due to, and what helps."""

    name: str
    share: float
    remedy: str


@dataclass(frozen=True, eq=False)
class JudgedView:
    """A photograph that was held back.

    Attributes:
        name: of the view.
        pictures: (3, H, W, 3) float32 display values: photograph, render, projection.
        errors: (2, 3) mean squared errors of render and projection in each channel.
    """

    name: str
    pictures: np.ndarray
    errors: np.ndarray


@dataclass(frozen=True, eq=False)
class Quality:
    """How good a result is.

    Attributes:
        held_back_db, projection_db: PSNR over the pixels of all judged photographs.
        causes: of the error, the largest first.
        views: what was judged.
    """

    held_back_db: float
    projection_db: float
    causes: tuple[Cause, ...]
    views: tuple[JudgedView, ...]

    @property
    def deviation(self) -> float:
        """Root mean square error of the renders' display values."""
        return float(10.0 ** (-self.held_back_db / 20.0))

    def document(self) -> dict[str, Any]:
        """For quality.json."""
        return {
            "held_back_db": round(self.held_back_db, 2),
            "projection_db": round(self.projection_db, 2),
            "causes": [
                {"name": cause.name, "share": round(cause.share, 3), "remedy": cause.remedy}
                for cause in self.causes
            ],
            "views": [
                {"name": view.name, "errors": [[round(float(x), 7) for x in row] for row in view.errors]}
                for view in self.views
            ],
        }

    def warning(self) -> tuple[str, str, str] | None:
        """Code, text and remedy where the result is poor, else None."""
        if self.held_back_db >= POOR or not self.causes:
            return None
        listed = ", ".join(f"{cause.name} ({100.0 * cause.share:.0f} %)" for cause in self.causes)
        text = (
            f"Photographs that were held back are re-rendered with {self.held_back_db:.1f} dB only (plain"
            f" projection of the others: {self.projection_db:.1f} dB). The error is due to: {listed}."
        )
        return "result-poor", text, self.causes[0].remedy


REMEDIES = {
    "surfaces": (
        "The mesh is missing or wrong where photographs disagree: scan these places again, or use Find"
        " Missing Surfaces in the section Capture."
    ),
    "light that nothing shows": (
        "Add photographs that show the ceiling, lamps and windows, from which most of the light comes."
    ),
    "lamps": "Check the lamps in the section Lights; photograph each lamp that is on, from near, unclipped.",
    "poses": "Check camera poses and lens with Check Views; solve or align the cameras again.",
    "photographs": "Use sharp photographs with equal exposure and white balance, without clipped pixels.",
    "materials": (
        "Use a higher preset, add part masks, or photographs of glossy surfaces from more directions."
    ),
}


@dataclass(frozen=True, eq=False)
class Display:
    """From radiance in units of the capture's median to a photograph's display values, 0 to 1, and back.

    Attributes:
        curve: (256,) logarithm of the light of each code of a camera; None for HDR photographs.
        falloff: terms of the logarithm of light that is missing away from the centre.
    """

    curve: np.ndarray | None = None
    falloff: np.ndarray | None = None

    @classmethod
    def of(cls, view: View, photometry: Mapping[str, Any]) -> Display:
        """Of a view; `photometry` as statistics.json holds it, empty where all photographs are HDR."""
        if not view.encoded or not photometry:
            return cls()
        return cls(np.array(photometry["log_curve"]), np.array(photometry["falloff"]))

    def shown(self, radiance: np.ndarray, view: View, factor: float) -> np.ndarray:
        """Display values of radiance (H, W, 3) after a factor of exposure."""
        if self.curve is None:
            return np.clip(factor * radiance, 0.0, 1.0) ** GAMMA
        light = self._centred(radiance, view) + np.log(factor)
        return np.interp(light, self.curve, np.arange(len(self.curve)) / (len(self.curve) - 1.0))

    def factor(self, photograph: np.ndarray, radiance: np.ndarray, view: View) -> float:
        """The exposure with which radiance (H, W, 3) has a photograph's display values in the median."""
        low, high = USABLE
        good = ((photograph > low) & (photograph < high)).all(axis=2) & (radiance > FLOOR).all(axis=2)
        if not good.any():
            return MIDDLE
        if self.curve is None:
            ratio = np.log(photograph[good]) / GAMMA - np.log(radiance[good])
        else:
            codes = photograph[good] * (len(self.curve) - 1.0)
            light = np.interp(codes, np.arange(len(self.curve)), self.curve)
            ratio = light - self._centred(radiance, view)[good]
        return float(np.exp(np.median(ratio.mean(axis=1))))

    def _centred(self, radiance: np.ndarray, view: View) -> np.ndarray:
        """Logarithm of the light that reaches the sensor."""
        light = np.log(np.maximum(radiance, FLOOR))
        if self.falloff is None:
            return light
        y, x = np.mgrid[: view.height, : view.width] + 0.5
        squared = (x - view.cx) ** 2 + (y - view.cy) ** 2
        radius = np.sqrt(squared / squared.max()).ravel()
        share = falloff_terms(radius) @ self.falloff
        return np.asarray(light + share.reshape(view.height, view.width, -1))


def judge(
    pixels: PixelStore,
    held_back: Sequence[View],
    estimate: Estimate,
    photometry: Mapping[str, Any],
    scale: float,
    seed: int,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Quality | None:
    """Judge an estimate by photographs that it was not made of; None without any that can be used.

    Args:
        pixels: of the training views.
        held_back: at full size; at most `MOST_VIEWS` of them are judged, with the training views' size.
        photometry: what was found of photographs that are not HDR; empty without any.
        scale: the capture's median radiance, by which `pixels` was divided.

    Raises:
        FiptError: a photograph can't be read.
    """
    chosen = judged_views(held_back)
    count = len(chosen)
    if not chosen or not pixels.views:
        return None
    renderer, place = Renderer(estimate, seed), estimate.room.place
    light = estimate.unseen_light, estimate.lamp_doubt
    area = float(np.median([view.width * view.height for view in pixels.views]))
    views, errors, causes = [], [], []
    for number, full in enumerate(chosen):
        view, photograph, used = judged_photograph(full, area, scale)
        display = Display.of(view, photometry)
        from_others = projected(pixels, place, view, trace_view(estimate.room, view))
        pictures = [photograph]
        for image in (renderer.render(view, number), from_others.radiance):
            pictures.append(display.shown(image, view, display.factor(photograph, image, view)))
        squared = (np.array(pictures[1:]) - pictures[0]) ** 2
        errors.append(squared[:, used].reshape(2, -1, 3).mean(axis=1))
        views.append(JudgedView(view.name, np.array(pictures, np.float32), errors[-1]))
        causes.append(shares(views[-1], from_others, used, view, *light))
        progress((number + 1) / count)
    rendered, plain = (float(-10.0 * np.log10(max(np.mean(e), 1e-10))) for e in np.swapaxes(errors, 0, 1))
    weight = np.array([float(error[0].mean()) for error in errors])
    total = {
        name: float(weight @ [each[name] for each in causes]) / max(weight.sum(), 1e-12) for name in REMEDIES
    }
    named = [Cause(name, share, REMEDIES[name]) for name, share in total.items() if share >= LEAST_SHARE]
    return Quality(rendered, plain, tuple(sorted(named, key=lambda cause: -cause.share)), tuple(views))


def judged_views(held_back: Sequence[View]) -> list[View]:
    """The photographs that are judged."""
    count = min(MOST_VIEWS, len(held_back))
    return [held_back[i * len(held_back) // count] for i in range(count)]


def judged_photograph(full: View, area: float, scale: float) -> tuple[View, np.ndarray, np.ndarray]:
    """A view with about `area` pixels, its display values (H, W, 3), and (H, W) bool, pixels that count."""
    shrink = min(1.0, np.sqrt(area / (full.width * full.height)))
    width, height = max(1, round(full.width * shrink)), max(1, round(full.height * shrink))
    image = means(full.radiance(), width, height)
    masked, view = full.masked(), full.resized(width, height)
    used = np.ones((height, width), bool)
    if masked is not None:
        used = majority((~masked).astype(np.int32), width, height) > 0
    if view.encoded:  # by sRGB's curve, like the files
        return view, np.clip(srgb_encoded(image.astype(np.float64)), 0.0, 1.0), used
    return view, np.clip(image * (MIDDLE / scale), 0.0, 1.0) ** GAMMA, used


def shares(
    judged: JudgedView,
    projection: Projection,
    used: np.ndarray,
    view: View,
    unseen_light: float,
    lamp_doubt: float,
) -> dict[str, float]:
    """Share of each cause in the squared error of a render; they sum to 1.

    Args:
        used: (H, W) bool, pixels that count.
        unseen_light, lamp_doubt: as of `Estimate`.
    """
    photograph, render, plain = judged.pictures.astype(np.float64)
    of_render, of_plain = (((image - photograph) ** 2).sum(axis=2) for image in (render, plain))
    total = max(float(of_render[used].sum()), 1e-12)
    found = dict.fromkeys(REMEDIES, 0.0)
    clipped = used & view.encoded & (photograph * 255.0 >= CLIPPED_CODE).any(axis=2)  # HDR ones are not
    found["photographs"] = float(of_render[clipped].sum()) / total
    missed = used & ~clipped & projection.missed  # what is outside of windows is as others show it
    common = np.minimum(of_render, of_plain)
    found["surfaces"] = float(common[missed].sum()) / total
    used = used & ~clipped & ~missed
    explained, off = _capture_causes(photograph, plain, projection, used, view)
    common = np.where(off, np.minimum(of_render, AMPLIFIED * of_plain), common)
    for name, share in explained.items():
        found[name] += share * float(common[used].sum()) / total
    left = 1.0 - sum(explained.values())
    found["surfaces"] += left * float(common[used & off].sum()) / total
    found["materials"] += left * float(common[used & ~off].sum()) / total  # gloss differs between directions
    rest = max(1.0 - sum(found.values()), 0.0)
    smooth = _smooth_share(photograph, render, used)
    found["light that nothing shows"] += rest * smooth * unseen_light
    found["lamps"] += rest * smooth * (1.0 - unseen_light)
    doubted = lamp_doubt * (1.0 - smooth)  # sharp shadows and the lamps' own pixels
    found["lamps"] += rest * doubted
    found["materials"] += rest * (1.0 - smooth - doubted)
    # A motion that explains the render's error explains it all: materials and light can't move a picture.
    moved = _moved(photograph, render, used, view)
    found = {name: (1.0 - moved) * share for name, share in found.items()}
    return found | {"poses": found["poses"] + moved}


def _moved(photograph: np.ndarray, other: np.ndarray, used: np.ndarray, view: View) -> float:
    """The share of a picture's error that a motion of the camera or another lens explains."""
    gray, predicted = (np.log(image.mean(axis=2) + DARK) for image in (photograph, other))
    fit = register(gray, predicted, used, view.intrinsics, affine=True)
    return 1.0 - fit.improvement if fit.shift > LEAST_SHIFT else 0.0


def _capture_causes(
    photograph: np.ndarray, plain: np.ndarray, projection: Projection, used: np.ndarray, view: View
) -> tuple[dict[str, float], np.ndarray]:
    """What a turn of the camera, gains and blur explain of the projection's error, and (H, W) bool, where
    photographs, this one included, do not show the same point."""
    error = ((plain - photograph) ** 2).sum(axis=2)
    total = max(float(error[used].sum()), 1e-12)
    found = {}
    found["poses"] = _moved(photograph, plain, used & (projection.seen > 0), view)
    gains = np.median((photograph[used] + DARK) / (plain[used] + DARK), axis=0) if used.any() else 1.0
    balanced = ((plain * gains - photograph) ** 2).sum(axis=2)
    blurred = ((gaussian_filter(plain, (BLUR, BLUR, 0.0)) - photograph) ** 2).sum(axis=2)
    better = [1.0 - float(other[used].sum()) / total for other in (balanced, blurred)]
    found["photographs"] = sum(max(share, 0.0) for share in better)
    most = max(sum(found.values()), 1.0)
    apart = np.log((photograph + DARK) / (plain * gains + DARK)) / GAMMA
    off = (projection.spread > DISAGREE) | (projection.seen == 0)
    off |= np.sqrt((apart**2).mean(axis=2)) > DISAGREE
    return {name: share / most for name, share in found.items()}, off


def _smooth_share(photograph: np.ndarray, render: np.ndarray, used: np.ndarray) -> float:
    """Share of the squared error of a render that a smooth factor of each channel takes away."""
    width = SMOOTH * photograph.shape[1]
    known = used.astype(np.float64)
    norm = np.maximum(gaussian_filter(known, width), 1e-6)

    def smooth(image: np.ndarray) -> np.ndarray:
        return np.stack([gaussian_filter(image[..., c] * known, width) / norm for c in range(3)], axis=2)

    factor = (smooth(photograph) + DARK) / (smooth(render) + DARK)
    before = float(((render - photograph)[used] ** 2).sum())
    after = float(((render * factor - photograph)[used] ** 2).sum())
    return float(np.clip(1.0 - after / max(before, 1e-12), 0.0, 1.0))

"""How good a result is, by photographs that the estimation has not seen.

Each of them is rendered from the estimate, and projected from the training photographs (:mod:`.projection`),
which knows neither materials nor light. Both are compared with the photograph in its own display values after
one factor of exposure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..capture.averaging import majority, means
from ..capture.encoded import srgb_decoded, srgb_encoded
from ..capture.views import View
from ..pixels.store import NO_TRIANGLE, PixelStore, trace_view
from ..radiometry.adjustment import falloff_terms
from .projection import projected
from .rerender import Estimate, Renderer

MOST_VIEWS = 8  # photographs that are judged, evenly spread; more only cost time
GAMMA = 1.0 / 2.2  # of display values of HDR photographs (paper, Sec. 6.2)
MIDDLE = 0.18  # display exposure: radiance of the capture's median
# Display values within which a pixel counts for the factor of exposure.
USABLE = (0.05, 0.95)
FLOOR = 1e-4  # radiance in units of the capture's median
EXPOSURE_PIXELS = 4096  # of a photograph, that tell its exposure


@dataclass(frozen=True, eq=False)
class JudgedView:
    """A photograph that was held back."""

    name: str  # of the view
    pictures: np.ndarray  # (3, H, W, 3) float32 display values: photograph, render, projection
    # (2, 3) mean squared errors of render, without its noise, and projection in each channel
    errors: np.ndarray


@dataclass(frozen=True, eq=False)
class Quality:
    """How good a result is."""

    # held_back_db, projection_db: PSNR over the pixels of all judged photographs
    held_back_db: float
    projection_db: float
    # on_mesh_db, projection_on_mesh_db: the same over those of them that see the mesh; None without any
    on_mesh_db: float | None
    projection_on_mesh_db: float | None
    on_mesh_share: float  # 0..1, how many these are
    views: tuple[JudgedView, ...]  # what was judged
    # of photographs that were held back and are not HDR, stops after the median one's, by view
    exposures: Mapping[str, float] = field(default_factory=dict)

    @property
    def deviation(self) -> float:
        """Root mean square error of the renders' display values."""
        return float(10.0 ** (-self.held_back_db / 20.0))

    def document(self) -> dict[str, Any]:
        """For quality.json."""
        figures = {name: value for name, value in vars(self).items() if name not in ("views", "exposures")}
        return {
            **{name: None if value is None else round(value, 3) for name, value in figures.items()},
            "views": [
                {"name": view.name, "errors": [[round(float(x), 7) for x in row] for row in view.errors]}
                for view in self.views
            ],
            "exposures": {name: round(value, 4) for name, value in self.exposures.items()},
        }


@dataclass(frozen=True, eq=False)
class Display:
    """From radiance in units of the capture's median to a photograph's display values, 0 to 1, and back."""

    # (256,) logarithm of the light of each code of a camera; None for HDR photographs
    curve: np.ndarray | None = None
    falloff: np.ndarray | None = None  # terms of the logarithm of light that is missing away from the centre

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
    """
    chosen = judged_views(held_back)
    count = len(chosen)
    if not chosen or not pixels.views:
        return None
    renderer, place = Renderer(estimate, seed), estimate.room.place
    area = float(np.median([view.width * view.height for view in pixels.views]))
    views, errors, on_mesh = [], [], []
    for number, full in enumerate(chosen):
        view, photograph, used = judged_photograph(full, area, scale)
        display, traced = Display.of(view, photometry), trace_view(estimate.room, view)
        pair = np.array([renderer.render(view, 2 * number + half) for half in range(2)])
        projection = projected(pixels, place, view, traced)
        factors = [display.factor(photograph, image, view) for image in (pair.mean(axis=0), projection)]
        pair = np.array([display.shown(image, view, factors[0]) for image in pair])
        pictures = [photograph, pair.mean(axis=0), display.shown(projection, view, factors[1])]
        # The noise of one render is independent of the other's: their product has none on average.
        squared = np.array([(pair - photograph).prod(axis=0), (pictures[2] - photograph) ** 2])[:, used]
        errors.append(squared)
        on_mesh.append(traced.triangle.reshape(used.shape)[used] != NO_TRIANGLE)
        mean = np.maximum(squared.mean(axis=1), 0.0)
        views.append(JudgedView(view.name, np.array(pictures, np.float32), mean))
        progress((number + 1) / count)
    every, hit = np.concatenate(errors, axis=1), np.concatenate(on_mesh)
    rendered, plain = map(_psnr, every)
    of_render, of_plain = (_psnr(error) if hit.any() else None for error in every[:, hit])
    exposures = _exposures(pixels, held_back, estimate, photometry, scale)
    return Quality(rendered, plain, of_render, of_plain, float(hit.mean()), tuple(views), exposures)


def _exposures(
    pixels: PixelStore, held_back: Sequence[View], estimate: Estimate, facts: Mapping[str, Any], scale: float
) -> dict[str, float]:
    """Exposures by what the training photographs, projected, show of the same surfaces."""
    found, middle, room = {}, facts.get("median_shown"), estimate.room
    # Whatever the camera's curve is, Blender displays by sRGB's.
    display = Display(np.log(np.maximum(srgb_decoded(np.linspace(0.0, 1.0, 256)), FLOOR)))
    for full in held_back:
        if full.encoded and middle:
            view, photograph, used = judged_photograph(full, EXPOSURE_PIXELS, scale)
            image = projected(pixels, room.place, view, trace_view(room, view))
            factor = display.factor(photograph * used[..., None], image, view)
            found[full.name] = float(np.log2(factor / middle))
    return found


def _psnr(squared: np.ndarray) -> float:
    """PSNR in dB of display values with these squared errors."""
    return float(-10.0 * np.log10(max(squared.mean(), 1e-10)))


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

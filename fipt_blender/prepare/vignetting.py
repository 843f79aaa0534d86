"""Step `vignetting`: a point of the room looks darker where it lies nearer to a corner of a photograph.

The merge corrects what lensfun's database knows. It does not know all lenses, and a camera may have corrected
its JPEGs already: there, what is left is measured from points of the camera solve that views share; what
reflects differently from view to view is an outlier. An image's header says how it is corrected, so that none
is corrected twice.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..core.capture.exr_file import ExrFile
from ..core.capture.images import read_radiance, write_exr
from ..core.pixels.grouped import grouped_sums
from ..core.radiometry.adjustment import falloff_terms
from ..core.robust import deviation, without_means
from ..core.run.messages import Reporter
from . import lens
from .facts import LensFacts, VignettingFacts
from .lens import RADII, light_share
from .preparation import Group, Photograph, Preparation, PreparationFolder
from .solve_step import read_model

TERMS = 3  # r², r⁴ and r⁶ of the logarithm of the share of light
LEAST_OBSERVATIONS = 300  # of points that at least two views see
LEAST_SIGNIFICANCE = 4.0  # standard errors by which the corner must be darker
LEAST_FALLOFF = 0.02  # of the light in the corner; less is not worth a correction
_OUTLIER = 4.685  # times the noise, beyond which Tukey's weights are zero (95 % efficient for normal noise)
_PATCH = 2  # pixels on each side of a point over which radiance is averaged
# Share of an image's pixels, the brightest ones, that are not used: lamps may be clipped.
_BRIGHTEST = 0.02


@dataclass(frozen=True, eq=False)
class Observations:
    """Where and how bright views see solved points."""

    point: np.ndarray  # (N,) number of the point
    view: np.ndarray  # (N,) number of the view
    radius: np.ndarray  # (N,) distance from the image's center; 1 in the corner
    log_radiance: np.ndarray  # (N,) natural logarithm


@dataclass(frozen=True, eq=False)
class Falloff:
    """Vignetting of one lens."""

    # (TERMS,) of r², r⁴, r⁶ of the logarithm of the share of light; r is 1 in the corner
    coefficients: np.ndarray
    corner: float  # share of light in the corner
    corner_error: float  # its standard error
    noise: float  # relative standard deviation of an observation

    @property
    def certain(self) -> bool:
        """Whether the corner is darker, by more than its error and by more than nothing."""
        return 1.0 - self.corner > max(LEAST_FALLOFF, LEAST_SIGNIFICANCE * self.corner_error)


def fit_falloff(observations: Observations) -> Falloff | None:
    """The vignetting that makes points equally bright in all views, which may differ by one factor each.

    The logarithm of an observation is that of the point's radiance, the view's factor and the share of
    light. The first is eliminated by subtracting means over each point; the others are fitted by least
    squares with Tukey's weights.

    Returns:
        None with too few observations of points that several views see.
    """
    _, point, counts = np.unique(observations.point, return_inverse=True, return_counts=True)
    shared = counts[point] > 1
    if shared.sum() < LEAST_OBSERVATIONS:
        return None
    point = point[shared]
    _, view = np.unique(observations.view[shared], return_inverse=True)
    columns = np.zeros((len(point), TERMS + int(view.max()) + 1))
    columns[:, :TERMS] = falloff_terms(observations.radius[shared], TERMS)
    columns[np.arange(len(point)), TERMS + view] = 1.0
    values = observations.log_radiance[shared]
    weights, residual = np.ones(len(point)), np.zeros(len(point))
    for _ in range(12):
        centered = without_means(columns, point, weights)
        target = without_means(values, point, weights)
        # A weak pull towards zero decides only where radii are not covered.
        normal = centered.T @ (weights[:, None] * centered) + 1e-3 * np.eye(columns.shape[1])
        solution = np.linalg.solve(normal, centered.T @ (weights * target))
        residual = target - centered @ solution
        sigma = deviation(residual, 1e-6)
        weights = np.clip(1.0 - (residual / (_OUTLIER * sigma)) ** 2, 0.0, None) ** 2
    # Errors of one view's or point's observations are alike, so that they count by points, not by pixels.
    scores = grouped_sums(centered * (weights * residual)[:, None], point)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (scores.T @ scores) @ inverse
    corner = float(np.exp(solution[:TERMS].sum()))
    error = corner * float(np.sqrt(covariance[:TERMS, :TERMS].sum()))
    return Falloff(solution[:TERMS], corner, error, sigma)


def profile_of(coefficients: np.ndarray) -> np.ndarray:
    """(RADII,) profile of `lens.light_share` that never rises outwards, of `Falloff.coefficients`."""
    share = np.exp(falloff_terms(np.linspace(0.0, 1.0, RADII), TERMS) @ coefficients)
    return np.minimum.accumulate(share.clip(max=1.0))


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the correction depends on besides cameras and merged images."""
    groups = {name: [group.name for group in groups] for name, groups in _lenses(preparation).items()}
    known = list(_lenses(preparation, by_database=True))
    return {"lenses": groups, "database": known, "vignetting": preparation.settings.vignetting}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> VignettingFacts:
    """Fit and divide out the vignetting of each lens that the database did not correct; returns facts."""
    wanted = preparation.settings.vignetting == "auto"
    lenses = _lenses(preparation) if wanted else {}
    known = _lenses(preparation, by_database=True) if wanted else {}
    model = read_model(folder.model) if lenses else pycolmap.Reconstruction()
    images = {image.name: image for image in model.images.values()}
    facts, corrections, done = [], dict[str, np.ndarray](), 0
    for name, groups in known.items():
        profile = lens.vignetting(preparation.of(groups[0])[0])
        assert profile is not None
        facts.append(LensFacts(name, True, len(groups), "database", round(float(profile[-1]), 4)))
    for name, groups in lenses.items():
        samples: list[np.ndarray] = []
        for group in groups:
            if f"{group.name}.exr" in images:
                samples.append(_observations(images[f"{group.name}.exr"], folder.image(group), len(samples)))
            done += 1
            reporter.progress(0.5 * done / sum(map(len, lenses.values())))
        falloff = fit_falloff(Observations(*np.concatenate(samples).T)) if samples else None
        if falloff is not None:
            figures = (round(value, 4) for value in (falloff.corner, falloff.corner_error, falloff.noise))
            source = "overlap" if falloff.certain else "none"
            facts.append(LensFacts(name, falloff.certain, len(groups), source, *figures))
            if falloff.certain:
                corrections |= {group.name: falloff.coefficients for group in groups}
            continue
        facts.append(LensFacts(name, False, len(groups), "unknown"))
        if preparation.of(groups[0])[0].corrected is None:
            reporter.warning("vignetting-unknown", name=name)
    for group in preparation.used_groups:
        _correct(folder.image(group), corrections.get(group.name, np.zeros(TERMS)))
    return VignettingFacts(tuple(facts))


def _lenses(preparation: Preparation, by_database: bool = False) -> dict[str, list[Group]]:
    """The used groups of each lens, focal length and aperture that the merge has not corrected, or has."""
    lenses: dict[str, list[Group]] = {}
    for group in preparation.used_groups:
        photograph = preparation.of(group)[0]
        known = photograph.has_vignetting and lens.vignetting(photograph) is not None
        # Radiance files are renders, or were corrected by the program that merged them.
        if photograph.kind != "linear" and known == by_database:
            lenses.setdefault(_lens_name(photograph), []).append(group)
    return lenses


def _lens_name(photograph: Photograph) -> str:
    values = (photograph.make, photograph.model, photograph.lens)
    words = [value for value in values if value]
    words += [f"{photograph.focal_length:g} mm"] if photograph.focal_length else []
    words += [f"f/{photograph.aperture:g}"] if photograph.aperture else []
    return ", ".join(words) or "unknown lens"


def _observations(image: pycolmap.Image, file: Path, view: int) -> np.ndarray:
    """(N, 4) as `Observations`: the solved points that a view sees in its image without its correction."""
    pixels = read_radiance(file)
    height, width = pixels.shape[:2]
    seen = [point for point in image.points2D if point.has_point3D()]
    position = np.array([point.xy for point in seen], np.float64).reshape(-1, 2)
    number = np.array([point.point3D_id for point in seen], np.int64)
    luminance = pixels.mean(axis=-1) * light_share(profile_of(_applied(file)), width, height)
    column = np.clip(position[:, 0].astype(np.int64), _PATCH, width - 1 - _PATCH)
    row = np.clip(position[:, 1].astype(np.int64), _PATCH, height - 1 - _PATCH)
    steps = range(-_PATCH, _PATCH + 1)
    value = np.mean([luminance[row + dy, column + dx] for dy in steps for dx in steps], axis=0)
    usable = (value > 0.0) & (value < np.quantile(luminance, 1.0 - _BRIGHTEST))
    radius = np.linalg.norm(position - [0.5 * width, 0.5 * height], axis=1) / (0.5 * np.hypot(width, height))
    views = np.full(len(value), view)
    return np.stack([number, views, radius, np.log(np.maximum(value, 1e-30))], axis=1)[usable]


def _applied(file: Path) -> np.ndarray:
    """(TERMS,) coefficients by which an image is corrected; zeros for one that was merged again."""
    note = ExrFile(file).note
    return np.array(json.loads(note)) if note else np.zeros(TERMS)


def _correct(file: Path, coefficients: np.ndarray) -> None:
    """Correct an image by coefficients instead of those by which it is corrected, if it is there."""
    if not file.is_file() or np.array_equal(before := _applied(file), coefficients):
        return
    pixels = read_radiance(file)
    height, width = pixels.shape[:2]
    shares = [light_share(profile_of(each), width, height) for each in (before, coefficients)]
    pixels *= (shares[0] / shares[1])[..., None]
    write_exr(file, pixels, note=json.dumps(coefficients.tolist()))

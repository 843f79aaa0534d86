# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `vignetting`: corrects merged images by their overlap where lensfun's database did not.

It does not know all lenses, and a camera may have corrected its JPEGs already: there, what is left is
measured. stage/corrected.json lists which images are corrected and how, so that none is corrected twice.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..core.capture.images import read_radiance, write_exr
from ..core.run.documents import optional_document
from ..core.run.messages import Reporter
from ..core.run.runfolder import write_json
from . import lens
from .facts import LensFacts, VignettingFacts
from .models import read_model
from .preparation import Group, Photograph, Preparation, PreparationFolder
from .solve_step import model_folder
from .vignetting import TERMS, Falloff, Observations, fit_falloff, light_share

_PATCH = 2  # pixels on each side of a point over which radiance is averaged
# Share of an image's pixels, the brightest ones, that are not used: lamps may be clipped.
_BRIGHTEST = 0.02


@dataclass(frozen=True)
class _Correction:
    """The digest of an image, and the `TERMS` coefficients by which it is corrected."""

    digest: str
    coefficients: tuple[float, ...]


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the correction depends on besides cameras and merged images."""
    groups = {name: [group.name for group in groups] for name, groups in _lenses(preparation).items()}
    known = list(_lenses(preparation, by_database=True))
    return {"lenses": groups, "database": known, "vignetting": preparation.settings.vignetting}


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> VignettingFacts:
    """Fit and divide out the vignetting of each lens that the database did not correct; returns facts.

    Raises:
        FiptError: of reading the model and of reading and writing images.
    """
    wanted = preparation.settings.vignetting == "auto"
    lenses = _lenses(preparation) if wanted else {}
    model = read_model(model_folder(folder)) if lenses else pycolmap.Reconstruction()
    images = {image.name: image for image in model.images.values()}
    corrected = _Corrected(folder)
    facts, done = _database_facts(preparation) if wanted else [], 0
    for name, groups in lenses.items():
        samples: list[Observations] = []
        for group in groups:
            if f"{group.name}.exr" in images:
                pixels = corrected.original(group)
                samples.append(_observations(images[f"{group.name}.exr"], pixels, len(samples)))
            done += 1
            reporter.progress(0.5 * done / sum(map(len, lenses.values())))
        falloff = fit_falloff(_joined(samples)) if samples else None
        applied = falloff is not None and falloff.certain
        for group in groups:
            corrected.apply(group, falloff.coefficients if applied and falloff else np.zeros(TERMS))
        facts.append(_fact(name, groups, falloff, applied))
        if falloff is None and preparation.of(groups[0])[0].corrected is None:
            reporter.warning(
                "vignetting-unknown",
                f"The vignetting of {name} is unknown: neither the lens database nor the files, and"
                " the views have too little in common to measure it.",
                "Use RAW photographs, switch the camera's correction on, or take views that overlap more.",
            )
    corrected.restore_others({group.name for groups in lenses.values() for group in groups})
    return VignettingFacts(tuple(facts))


def _fact(name: str, groups: list[Group], falloff: Falloff | None, applied: bool) -> LensFacts:
    if falloff is None:
        return LensFacts(name, applied, len(groups), "unknown")
    figures = (round(value, 4) for value in (falloff.corner, falloff.corner_error, falloff.noise))
    return LensFacts(name, applied, len(groups), "overlap" if applied else "none", *figures)


def _lenses(preparation: Preparation, by_database: bool = False) -> dict[str, list[Group]]:
    """The used groups of each lens, focal length and aperture that the merge has not corrected, or has."""
    lenses: dict[str, list[Group]] = {}
    for group in preparation.used_groups:
        photograph = preparation.of(group)[0]
        known = photograph.has_vignetting and lens.vignetting(photograph, 3, 2) is not None
        # Radiance files are renders, or were corrected by the program that merged them.
        if photograph.kind != "linear" and known == by_database:
            lenses.setdefault(_lens_name(photograph), []).append(group)
    return lenses


def _database_facts(preparation: Preparation) -> list[LensFacts]:
    """What the merge has corrected by lensfun's database."""
    facts = []
    for name, groups in _lenses(preparation, by_database=True).items():
        photograph = preparation.of(groups[0])[0]
        reduction = max(1, max(photograph.width, photograph.height) // 256)
        gain = lens.vignetting(photograph, photograph.width // reduction, photograph.height // reduction)
        corner = 1.0 if gain is None else 1.0 / float(gain[0, 0])
        facts.append(LensFacts(name, True, len(groups), "database", round(corner, 4)))
    return facts


def _lens_name(photograph: Photograph) -> str:
    values = (photograph.make, photograph.model, photograph.lens)
    words = [value for value in values if value]
    words += [f"{photograph.focal_length:g} mm"] if photograph.focal_length else []
    words += [f"f/{photograph.aperture:g}"] if photograph.aperture else []
    return ", ".join(words) or "unknown lens"


def _observations(image: pycolmap.Image, pixels: np.ndarray, view: int) -> Observations:
    """What a view (height, width, 3) sees of the solved points."""
    height, width = pixels.shape[:2]
    seen = [point for point in image.points2D if point.has_point3D()]
    position = np.array([point.xy for point in seen], np.float64).reshape(-1, 2)
    number = np.array([point.point3D_id for point in seen], np.int64)
    luminance = pixels.mean(axis=-1)
    column = np.clip(position[:, 0].astype(np.int64), _PATCH, width - 1 - _PATCH)
    row = np.clip(position[:, 1].astype(np.int64), _PATCH, height - 1 - _PATCH)
    steps = range(-_PATCH, _PATCH + 1)
    value = np.mean([luminance[row + dy, column + dx] for dy in steps for dx in steps], axis=0)
    usable = (value > 0.0) & (value < np.quantile(luminance, 1.0 - _BRIGHTEST))
    radius = np.hypot(position[:, 0] - 0.5 * width, position[:, 1] - 0.5 * height)
    radius /= np.hypot(0.5 * width, 0.5 * height)
    return Observations(
        number[usable], np.full(int(usable.sum()), view), radius[usable], np.log(value[usable])
    )


def _joined(samples: list[Observations]) -> Observations:
    return Observations(
        np.concatenate([item.point for item in samples]),
        np.concatenate([item.view for item in samples]),
        np.concatenate([item.radius for item in samples]),
        np.concatenate([item.log_radiance for item in samples]),
    )


class _Corrected:
    """The merged images, and which of them are corrected by what."""

    def __init__(self, folder: PreparationFolder) -> None:
        self._folder = folder
        self._path = folder.stage / "corrected.json"
        # Without the file no image was corrected.
        self._known = optional_document(self._path, dict[str, tuple[_Correction, ...]]) or {}

    def coefficients(self, name: str) -> np.ndarray:
        """By what the image of a view is corrected at present; zeros for an image that was merged again."""
        file = self._file(name)
        digest = _digest(file) if self._known.get(name) and file.is_file() else ""
        valid = [each.coefficients for each in self._known.get(name, ()) if each.digest == digest]
        return np.array(valid[-1]) if valid and len(valid[-1]) == TERMS else np.zeros(TERMS)

    def original(self, group: Group) -> np.ndarray:
        """The image without correction."""
        pixels = read_radiance(self._file(group.name))
        return pixels * self._share(self.coefficients(group.name), pixels)

    def apply(self, group: Group, coefficients: np.ndarray) -> None:
        """Correct an image by coefficients instead of those by which it is corrected."""
        self._replace(group.name, coefficients)

    def restore_others(self, names: set[str]) -> None:
        """Undo the correction of all other images."""
        for name in sorted(set(self._known) - names):
            if self._file(name).is_file():
                self._replace(name, np.zeros(TERMS))

    def _replace(self, name: str, coefficients: np.ndarray) -> None:
        before = self.coefficients(name)
        if np.array_equal(before, coefficients):
            return
        file = self._file(name)
        pixels = read_radiance(file)
        pixels *= (self._share(before, pixels) / self._share(coefficients, pixels)).astype(np.float32)
        # The entries first: wherever the process is stopped, the image's digest shows which one is valid.
        temporary = self._folder.stage / "corrected.exr"
        write_exr(temporary, pixels)
        entries = [(_digest(file), before), (_digest(temporary), coefficients)]
        self._known[name] = tuple(_Correction(digest, tuple(map(float, c))) for digest, c in entries)
        write_json(self._path, self._known)
        temporary.replace(file)

    @staticmethod
    def _share(coefficients: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        if not coefficients.any():
            return np.ones((1, 1, 1), np.float32)
        return light_share(coefficients, pixels.shape[1], pixels.shape[0])[..., None]

    def _file(self, name: str) -> Path:
        return self._folder.images / f"{name}.exr"


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()

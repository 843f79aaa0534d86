"""The resolution at which light is solved, and what an estimation at it costs.

Standard library only: both processes import it.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import FiptError

if TYPE_CHECKING:
    from .settings import Settings

# With fewer pixels a view, fewer views are taken: the example room has these (192 x 108), and with a third of
# them lost 5 dB of base colour and the metals.
LEAST_PIXELS = 20_000
# Bytes that are left free on a disk.
SPARE_BYTES = 200_000_000


def light_size(sizes: Sequence[tuple[int, int]], light_pixels: float) -> list[tuple[int, int]]:
    """Width and height of each view at the resolution of light.

    All views get the same largest number of pixels; those that have fewer keep their size. Where the budget
    suffices, all do.

    Args:
        sizes: width and height of each view in pixels.
        light_pixels: the budget, millions of pixels of all views together.
    """
    areas = [width * height for width, height in sizes]
    most = _even_share(areas, light_pixels * 1e6)
    result = []
    for (width, height), area in zip(sizes, areas, strict=True):
        factor = math.sqrt(most / area) if area > most else 1.0
        result.append((max(1, int(width * factor)), max(1, int(height * factor))))
    return result


def light_views_count(sizes: Sequence[tuple[int, int]], light_pixels: float) -> int:
    """How many of the views the budget can serve with `LEAST_PIXELS` each, or all pixels of smaller ones.

    Args:
        sizes, light_pixels: as of :func:`light_size`.
    """
    least = sum(min(width * height, LEAST_PIXELS) for width, height in sizes)
    if least <= light_pixels * 1e6:
        return len(sizes)
    return max(1, int(len(sizes) * light_pixels * 1e6 / least))


def _even_share(areas: Sequence[int], budget: float) -> float:
    """The limit of areas at which their sum is the budget; infinite where the sum is below."""
    if sum(areas) <= budget:
        return math.inf
    left, count = budget, len(areas)
    for area in sorted(areas):
        if area * count >= left:
            break
        left, count = left - area, count - 1
    return left / count


@dataclass(frozen=True)
class LightPlan:
    """What an estimation does with its photographs, and what that is expected to cost.

    Attributes:
        photographs: how many there are. used: how many of them the budget can serve.
        megapixels: millions of pixels of a photograph, mean. light_megapixels: of a view as it is solved.
        seconds: expected time with this machine's processor.
        bytes: expected size of the run folder, without photographs.
        memory: expected peak of the engine's memory in bytes, with what it maps from the run folder.
    """

    photographs: int
    used: int
    megapixels: float
    light_megapixels: float
    seconds: float
    bytes: int
    memory: int

    @property
    def resolution(self) -> str:
        """A sentence on the photographs and their resolution."""
        text = f"{self.photographs} photographs of {self.megapixels:.{_digits(self.megapixels)}f} megapixels"
        if self.light_megapixels == self.megapixels:
            return text
        used = "" if self.used == self.photographs else f" of {self.used} of them"
        light = f"{self.light_megapixels:.{_digits(self.light_megapixels)}f}"
        return f"{text}; light is solved at {light} megapixels each{used}"

    @property
    def cost(self) -> str:
        """A sentence on time, memory and disk."""
        minutes = max(1, round(self.seconds / 60.0))
        time = f"{minutes} minute{'s' if minutes > 1 else ''}"
        if minutes >= 100:
            time = f"{round(minutes / 60.0)} hours"
        disk = max(self.bytes / 1e9, 0.1)
        return f"about {time}, {self.memory / 1e9:.1f} GB of memory, {disk:.1f} GB on the disk"


def _digits(megapixels: float) -> int:
    """Decimals of a number of megapixels that are worth showing."""
    return 1 if megapixels >= 1.0 else 2 if megapixels >= 0.095 else 3


def light_plan(sizes: Sequence[tuple[int, int]], settings: Settings) -> LightPlan:
    """What an estimation does with photographs of these sizes (width and height in pixels).

    Args:
        sizes: of one photograph at least.
        settings: of the estimation.
    """
    used = light_views_count(sizes, settings.light_pixels)
    # Which views are chosen does not matter for the costs.
    full = list(sizes)[:used]
    light = sum(width * height for width, height in light_size(full, settings.light_pixels)) / 1e6
    megapixels = sum(width * height for width, height in sizes) / 1e6
    levels = settings.roughness_levels
    rays = settings.diffuse_spp + settings.light_spp + settings.specular_spp * levels
    refined = settings.refine_diffuse_spp + settings.refine_light_spp + settings.refine_specular_spp * levels
    samples = settings.training_steps * settings.batch_size / 1e6
    # Processor seconds, measured on two cores in whole runs of six captures; stages keep 70 % of the cores
    # busy.
    seconds = (
        42.0 + 0.07 * megapixels + light * (42.0 + 0.56 * (rays + settings.rounds * refined)) + 14.0 * samples
    )
    cores = max(1.0, 0.7 * (os.cpu_count() or 1))
    # The run folder: the radiance cache, networks and results (of the example room); for each pixel of light
    # what is seen and photographed, and shadings of each level.
    disk = 270_000_000 + int(light * 1e6 * (125 + 12 * levels))
    # Packages, networks and Mitsuba; what is mapped from the run folder; a pixel of light that is worked on,
    # and its averaged photograph and masks; a photograph's pixel while it is decoded.
    largest = max(width * height for width, height in sizes)
    memory = 1_700_000_000 + disk + int(57 * light * 1e6) + 45 * largest
    return LightPlan(
        photographs=len(sizes),
        used=used,
        megapixels=megapixels / len(sizes),
        light_megapixels=light / used,
        seconds=seconds / cores,
        bytes=disk,
        memory=memory,
    )


def refuse_full_disk(folder: Path, needed: int, remedy: str) -> None:
    """Refuse work for which a disk lacks the space.

    Args:
        folder: where files will be written; files that are there will be written over. It need not exist.
        needed: bytes of all files there afterwards.
        remedy: what else the user can do than to free space.
    """
    present = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(parent).free
    if needed - present + SPARE_BYTES > free:
        raise FiptError(
            "disk-space",
            present=max(needed - present, 0) / 1e9,
            folder=folder,
            free=free / 1e9,
            remedy=remedy,
        )

"""A capture whose part masks are those of a network that sees one photograph at a time: `own_masks.py CAPTURE
--output DIR --seed N`.

Each connected piece of a true mask becomes a region, numbered by its size, as segmentation tools do. Regions
are missed, cut and joined by chance and their borders are wrong. All other files are links to the original's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, label

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.ldr import link_others
from fipt_blender.core.capture.images import read_ids, write_exr

MASKS = "IndexMA"
LEAST_PIXELS = 12  # of a region


@dataclass(frozen=True)
class Faults:
    """What a network gets wrong.

    Attributes:
        cut: share of the regions that a straight line divides.
        joined: number of neighbours that are joined, as a share of the regions.
        missed: share of the regions that are not found.
        shift: pixels by which borders are off, standard deviation, smooth over four pixels.
        large: share of the photographs in which the largest region is joined to its largest neighbour, as a
            wall to the ceiling.

    With the first three, true pieces are missed and cut, and regions join parts, as often as MobileSAM's in
    the living room (0.03, 0.21 and 0.09 against 0.05, 0.21 and 0.14).
    """

    cut: float = 0.35
    joined: float = 0.3
    missed: float = 0.04
    shift: float = 0.3
    large: float = 0.1


def own_regions(parts: np.ndarray, faults: Faults, rng: np.random.Generator) -> np.ndarray:
    """(H, W) int64 regions from 1, the largest first, 0 for none.

    Args:
        parts: (H, W) int ids of parts, 0 or less for none.
    """
    parts = _shifted(parts, faults.shift, rng)
    regions, count = np.zeros(parts.shape, np.int64), 0
    for part in np.unique(parts[parts > 0]):
        pieces, number = label(parts == part)
        for piece in range(1, number + 1):
            rows, columns = np.nonzero(pieces == piece)
            if len(rows) < LEAST_PIXELS or rng.random() < faults.missed:
                continue
            count += 1
            regions[rows, columns] = count
            if rng.random() < faults.cut:
                angle = np.pi * rng.random()
                along = columns * np.cos(angle) + rows * np.sin(angle)
                beyond = along > np.quantile(along, rng.uniform(0.2, 0.8))
                count += 1
                regions[rows[beyond], columns[beyond]] = count
    for _ in range(int(faults.joined * count)):
        region = rng.integers(1, count + 1)
        beside = _beside(regions, region)
        if len(beside):
            regions[regions == region] = rng.choice(beside)
    if count and rng.random() < faults.large:
        area = np.bincount(regions[regions > 0])
        region = int(area.argmax())
        beside = _beside(regions, region)
        if len(beside):
            regions[regions == region] = beside[area[beside].argmax()]
    size = np.bincount(regions.reshape(-1), minlength=count + 1)
    rank = np.zeros(count + 1, np.int64)
    rank[1 + np.argsort(-size[1:], kind="stable")] = np.arange(1, count + 1)
    return rank[regions]


def _beside(regions: np.ndarray, region: int) -> np.ndarray:
    """The regions that touch one."""
    beside = np.unique(regions[binary_dilation(regions == region)])
    return beside[(beside > 0) & (beside != region)]


def _shifted(image: np.ndarray, deviation: float, rng: np.random.Generator) -> np.ndarray:
    """An image whose pixels are those from beside them, smoothly."""
    if not deviation:
        return image
    width = 2.0  # of the Gaussian; it leaves 1 / (2 sqrt(pi) width) of the noise
    shifts = [
        gaussian_filter(rng.normal(size=image.shape), width) * deviation * 2.0 * np.sqrt(np.pi) * width
        for _ in range(2)
    ]
    places = [
        np.clip(np.rint(place + shift), 0, length - 1).astype(np.int64)
        for place, shift, length in zip(np.indices(image.shape), shifts, image.shape, strict=True)
    ]
    return np.asarray(image[tuple(places)])


def make_capture(source: Path, target: Path, faults: Faults, seed: int) -> float:
    """Write the capture; the mean number of regions of a photograph.

    Args:
        source: in the FIPT authors' synthetic layout, with part masks of its training views.
    """
    link_others(source, target, {"train"})
    link_others(source / "train", target / "train", {MASKS})
    counts = []
    for index, path in enumerate(sorted((source / "train" / MASKS).glob("*.exr"))):
        regions = own_regions(read_ids(path), faults, np.random.default_rng([seed, index]))
        write_exr(target / "train" / MASKS / path.name, regions)
        counts.append(int(regions.max()))
    return float(np.mean(counts))


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Give each view of a capture masks of its own.")
    parser.add_argument("capture", type=Path, help="in the FIPT authors' synthetic layout, with part masks")
    parser.add_argument("--output", type=Path, required=True, help="folder of the new capture")
    parser.add_argument("--seed", type=int, default=0)
    for fault in fields(Faults):
        parser.add_argument(f"--{fault.name}", type=float, default=fault.default)
    arguments = parser.parse_args(list(argv))
    faults = Faults(**{fault.name: getattr(arguments, fault.name) for fault in fields(Faults)})
    count = make_capture(arguments.capture, arguments.output, faults, arguments.seed)
    print(f"{count:.1f} regions in a photograph")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

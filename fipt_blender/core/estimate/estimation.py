"""One estimation on a run folder: the stages of :mod:`.pipeline`, pictures of them, and the results."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..parts.labels import NO_PART
from ..pixels.store import PixelStore
from ..run.chain import Chain, Watch
from ..run.messages import Reporter
from ..run.per_view import Workers
from ..run.runfolder import RunFolder, explained_write_errors
from .input import EstimationInput
from .previews import Preview
from .results import Solution, write_solution


def estimate_room(
    given: EstimationInput, reporter: Reporter, workers: Workers | None = None, watch: Watch | None = None
) -> dict[str, Any]:
    """Do all stages that are not finished yet, and write the results; returns the statistics.

    Args:
        watch: is told of the stages; None: sends pictures of them.
    """
    chain = given.chain(reporter, workers)
    solution = chain.run(Solution, watch or Pictures(given.folder, chain, reporter))
    with explained_write_errors(given.folder.stage):
        return write_solution(given, solution, chain.facts(), reporter)


class Pictures(Watch):
    """Sends the window pictures of what the stages have found.

    Args:
        run: its folder. chain: of the stages. reporter: gets the pictures.
    """

    def __init__(self, run: RunFolder, chain: Chain, reporter: Reporter) -> None:
        self._run, self._chain, self._reporter = run, chain, reporter

    def after(self, name: str, new: bool) -> None:
        """Make the pictures of a stage, or send those that it has."""
        if name != "shadings" and not name.endswith("training") and not name.startswith("estimate-"):
            return
        folder = self._run.stage / name / "previews"
        paths = self._made(name, folder) if new else sorted(folder.glob("*.png"))
        if paths:
            relative = [path.relative_to(self._run.root).as_posix() for path in paths]
            self._reporter.progress(1.0, force=True, pictures=relative)

    def _made(self, name: str, folder: Path) -> list[Path]:
        chain = self._chain
        pixels = chain.value("pixels", name)
        preview = Preview(folder, pixels, chain.given["room"].value.triangle_object)
        if name == "shadings":
            return preview.first_guess(name, chain.value("shadings", name))
        names = [stage.name for stage in chain.stages]
        value = partial(chain.value, after=names[names.index(name) + 1])  # which makes lamps or fields of it
        colors = _network_colors if name.endswith("training") else _closed_form_colors
        return preview.estimate(name, partial(colors, value, pixels), value("emitters"))


def _network_colors(value: Any, pixels: PixelStore, rows: np.ndarray) -> np.ndarray:
    """(R, 3) base colour that the network has for the pixels `rows` (R,)."""
    unit = np.append(value("units").triangle, NO_PART)[np.asarray(pixels.triangle[rows])]
    return np.asarray(value("fields").query(np.asarray(pixels.position[rows]), unit)[:, :3])


def _closed_form_colors(value: Any, pixels: PixelStore, rows: np.ndarray) -> np.ndarray:
    """(R, 3) base colour of the last closed-form estimate in the pixels `rows` (R,)."""
    cells = value("cells")
    place = cells.of_pixels(value("data"), rows)
    return np.where(place[:, None] >= 0, cells.color[place], np.float32(0.5))

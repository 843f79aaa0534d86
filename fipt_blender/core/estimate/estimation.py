# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One estimation on a run folder: the stages of :mod:`.pipeline`, pictures of them, and the results."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..parts.labels import NO_PART
from ..pixels.store import PixelStore
from ..run.chain import Chain, Given, Stage, Watch
from ..run.hints import hints_digest, references
from ..run.messages import Reporter
from ..run.per_view import Workers
from ..run.runfolder import RunFolder, explained_write_errors
from .input import EstimationInput
from .pipeline import pipeline, round_numbers
from .previews import Preview
from .results import Solution, write_solution


def estimate_room(
    given: EstimationInput, reporter: Reporter, workers: Workers | None = None
) -> dict[str, Any]:
    """Do all stages that are not finished yet, and write the results; returns the statistics.

    Raises:
        FiptError: those of the stages, ``disk-full`` or ``run-unwritable``.
    """
    chain = chain_of(given, stages_of(given), reporter, workers)
    return finish(given, chain, Pictures(given.folder, chain, reporter), reporter)


def finish(given: EstimationInput, chain: Chain, watch: Watch, reporter: Reporter) -> dict[str, Any]:
    """Run a chain and write the results; as of :func:`estimate_room`."""
    solution = chain.run(Solution, watch)
    with explained_write_errors(given.folder.stage):
        return write_solution(given, solution, chain.facts(), reporter)


def stages_of(given: EstimationInput) -> list[Stage]:
    """The stages for this input."""
    encoded = any(view.encoded for view in given.views)
    rerun = given.hints_rerun is not None
    return pipeline(given.settings.rounds, encoded, rerun, given.light_changes, bool(given.held_back))


def chain_of(
    given: EstimationInput, stages: Sequence[Stage], reporter: Reporter, workers: Workers | None = None
) -> Chain:
    """A chain of stages on the input's run folder."""
    hints, rerun = given.hints, given.hints_rerun or []
    known = references(hints if given.hints_rerun is None else rerun)
    values = {
        **{name: Given(getattr(given, name), given.key) for name in ("room", "views", "far_off")},
        "held_back": Given(given.held_back, given.held_back_key),
        "hints": Given(hints, hints_digest(hints)),
        "hints_rerun": Given(rerun, hints_digest(rerun)),
        "references": Given(known, hints_digest(known)),
        **{name: Given(index, str(index)) for name, index in round_numbers(given.settings.rounds).items()},
    }
    return Chain(stages, values, given.settings, given.folder.stage, reporter, workers)


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

"""The jury of benchmarks/trial.py: captures of rooms with other meshes, photographs and masks.

A capture of the jury is a room (a capture with ground truth in the FIPT authors' synthetic layout), its mesh
(exact, disturbed by 1 cm as in the paper, or scanned with voxels of so many centimetres), its photographs
(hdr, jpeg) and its masks (parts, linked: masks of single photographs with faults, semantics, none).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import accuracy, disturb, ldr, own_masks, prepared
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder

SCAN, JPEG, MASKS, SHARED, OWN, NO_MASKS = "scan", "jpeg", "masks", "parts", "linked", "none"
EXACT, DISTURBED, SIGMA = "exact", "disturbed", 0.01  # metres, as in the paper
PARTS = {SHARED: "auto", OWN: "auto", "semantics": "semantics", NO_MASKS: "none"}  # as `estimate` has them


@dataclass(frozen=True)
class Case:
    """A capture of the jury: see the module's docstring."""

    room: str
    mesh: str
    light: str
    masks: str

    @property
    def name(self) -> str:
        """As on the command line."""
        return ":".join((self.room, self.mesh, self.light, self.masks))

    @property
    def folder(self) -> str:
        """Name for files."""
        return self.name.replace(":", "-")

    @property
    def voxel(self) -> float | None:
        """Metres; None where the mesh is no scan."""
        return None if self.mesh in (EXACT, DISTURBED) else float(self.mesh.removesuffix("cm")) / 100.0

    def has(self, needs: Sequence[str]) -> bool:
        """Whether it has what a mechanism needs."""
        scan = {SCAN} if self.voxel is not None else set()
        masked = {MASKS} if self.masks in (SHARED, OWN) else set()
        return set(needs) <= {self.light, self.masks} | scan | masked


def cases(text: str) -> list[Case]:
    """The captures that ROOM:MESH:LIGHT:MASKS stands for.

    Raises:
        FiptError: ``trial-unknown``.
    """
    found = []
    for word in text.split():
        choices = [part.split(",") for part in word.split(":")]
        if len(choices) != 4:
            raise FiptError.of("trial-unknown", f"{word} is no capture.", "Write ROOM:MESH:LIGHT:MASKS.")
        found += [Case(*values) for values in itertools.product(*choices)]
    for case in found:
        mesh = re.fullmatch(rf"{EXACT}|{DISTURBED}|\d+(\.\d+)?cm", case.mesh)
        if not mesh or case.light not in ("hdr", JPEG) or case.masks not in PARTS:
            raise FiptError.of(
                "trial-unknown",
                f"{case.name} is no capture.",
                "Use exact, disturbed, 2cm; hdr, jpeg; parts, linked, semantics, none.",
            )
    return found


class Jury:
    """Makes the captures of a jury below a folder.

    Args:
        work: the folder.
        rooms: name to capture.
        seed: of scans, cameras and masks.
    """

    def __init__(self, work: Path, rooms: Mapping[str, Path], seed: int = 0) -> None:
        self.work, self.rooms, self.seed = work.absolute(), dict(rooms), seed

    def capture(self, case: Case) -> Path:
        """The folder of a capture with its photographs and masks, made if it is missing."""
        made = self.rooms[case.room].absolute()
        if case.masks == OWN:
            source, made = made, self.work / "captures" / f"{case.room}-{OWN}-{self.seed}"
            if not made.exists():
                own_masks.make_capture(source, made, own_masks.Faults(), self.seed)
        if case.light == JPEG:
            source, made = made, self.work / "captures" / f"{made.name}-{JPEG}-{self.seed}"
            if not made.exists():
                ldr.make_capture(source, made, self.seed)
        return made

    def mesh(self, case: Case) -> Path | None:
        """The scanned or disturbed mesh of a capture, made if it is missing; None for the exact one."""
        if case.mesh == DISTURBED:
            mesh = self.work / "scans" / f"{case.room}-{DISTURBED}.obj"
            if not mesh.exists():
                mesh.parent.mkdir(parents=True, exist_ok=True)
                disturb.disturb_obj(self.rooms[case.room] / "scene.obj", mesh, SIGMA)
            return mesh
        if case.voxel is None:
            return None
        mesh = self.work / "scans" / f"{case.room}-{case.mesh}-{self.seed}.ply"
        if not mesh.exists():
            options = ["--voxel", str(case.voxel), "--seed", str(self.seed)]
            accuracy.scan_capture(self.rooms[case.room], mesh, options)
        return mesh

    def prepared(self, case: Case, capture: Path) -> RunFolder:
        """The run folder with a capture's input, made if it is missing."""
        run = RunFolder(self.work / "prepared" / f"{case.folder}-{self.seed}")
        if not run.room_npz.exists():
            mesh, options = self.mesh(case), ["--parts", PARTS[case.masks]]
            prepared.prepare(capture, run.root, options + (["--mesh", str(mesh)] if mesh else []))
        return run

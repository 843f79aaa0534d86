"""Work that the add-on does in slices, done at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

from fipt_blender.blend.results import applying
from fipt_blender.blend.room import atlas, exporting
from fipt_blender.bridge.process import Message
from fipt_blender.bridge.step import Result, Slices
from fipt_blender.core.run.runfolder import RunFolder


def at_once(function: Callable[..., Slices[Result]]) -> Callable[..., Result]:
    """A function that runs all slices of another one and returns its result."""

    def run(*arguments, **options):
        slices = function(*arguments, **options)
        while True:
            try:
                next(slices)
            except StopIteration as end:
                return end.value

    return run


export_room = at_once(exporting.export_room)
collect_room = at_once(exporting.collect_room)
make_atlas = at_once(atlas.make_atlas)


def apply_results(run: RunFolder, objects: Iterable[bpy.types.Object]) -> list[Message]:
    """In the context's scene."""
    return at_once(applying.apply_results)(run, objects, bpy.context.scene)

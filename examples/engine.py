"""The method on one page: from a capture to textures by the engine's functions, without Blender's side.

    FIPT_BLENDER=BLENDER ENGINE_PYTHON examples/engine.py CAPTURE OUTPUT [SETTING=VALUE ...]

Blender only reads the mesh file. To try another method for a stage of core/estimate/pipeline.py, give a
function of the same signature, `swaps={"training": mine}`, and an OUTPUT of its own: stages are kept by the
engine's code.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.mesh_file import read_mesh
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.contents import RoomNames
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.result_contents import AtlasImage, AtlasImages
from fipt_blender.core.run.run_files import AtlasArrays, RoomArrays, read_capture, read_room
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.run.store import write_arrays
from fipt_blender.core.surface.adjacency import face_vectors


def estimate(capture: Path, run: RunFolder, changes: dict, swaps: dict) -> None:
    """Do everything: the run folder gets results/ and textures/."""
    reporter, settings = Reporter(sys.stdout), make_settings("draft", changes)
    run.create(settings)
    ingest(capture, run, CaptureOptions(), reporter)
    write_room(run)
    set_variant(settings.device)
    from fipt_blender.core.estimate.estimation import estimate_room  # Mitsuba's types exist only now
    from fipt_blender.core.estimate.input import prepare_input
    from fipt_blender.core.material.fields import RoomFields
    from fipt_blender.core.textures.bake import bake

    given = prepare_input(run, settings, reporter)
    stages = [replace(stage, work=swaps.get(stage.name, stage.work)) for stage in given.stages]
    estimate_room(replace(given, stages=stages), reporter)
    write_atlas(run)
    bake(run, RoomFields.load(run))


def write_room(run: RunFolder) -> None:
    """The capture's mesh in world metres, as one object without materials."""
    captured = read_capture(run.capture_json)
    world = np.array(captured.world_from_source)
    vertices, faces = read_mesh(Path(captured.mesh))
    vertices = (vertices - captured.offset) @ world[:3, :3].T + world[:3, 3]
    normals = np.repeat(face_vectors(vertices, faces)[0][:, None], 3, axis=1)
    zero, number = np.zeros(len(faces), np.int32), np.arange(len(faces), dtype=np.int32)
    meshes = {"vertices": vertices.astype(np.float32), "triangles": faces.astype(np.int32)}
    of_triangle = {"triangle_object": zero, "triangle_material": zero - 1, "triangle_polygon": number}
    room = RoomArrays(**meshes, corner_normals=normals.astype(np.float32), **of_triangle)
    write_arrays(run.room_npz, room)
    write_json(run.room_json, RoomNames(objects=("Room",), materials=(), parts="auto"))


def write_atlas(run: RunFolder, texels: int = 16) -> None:
    """A texture in which each triangle has half a square of its own, so many texels wide."""
    count = len(read_room(run).triangles)
    side = int(np.ceil(np.sqrt(count)))
    place = np.stack(np.divmod(np.arange(count), side)[::-1], axis=1)
    uv = (place[:, None] + np.array([(0.1, 0.1), (0.9, 0.1), (0.1, 0.9)])) / side
    write_arrays(run.atlas_npz, AtlasArrays(uv.astype(np.float32), np.zeros(count, np.int32)))
    write_json(run.atlas_json, AtlasImages("uv", (AtlasImage("Room", side * texels, side * texels),)))


if __name__ == "__main__":
    chosen = dict(text.split("=", 1) for text in sys.argv[3:])
    estimate(Path(sys.argv[1]), RunFolder(sys.argv[2]), chosen, swaps={})

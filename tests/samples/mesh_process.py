"""One Blender that reads the mesh files of many tests, of which each would otherwise start its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path


class MeshProcess:
    """Reads mesh files as `mesh_reading` does, in a process of its own that stays until `close`."""

    _process: subprocess.Popen[str] | None = None

    def read(self, path: Path, arrays: Path) -> bool:
        """Write the arrays of a mesh file as .npz; false where that fails for any reason."""
        if self._process is None:
            command = [sys.executable, "-P", __file__]  # its folder is no place of modules
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        print(json.dumps([str(path), str(arrays)]), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:  # it has crashed
            self.close()
        return answer == "read\n"

    def close(self) -> None:
        """End the process; the next file starts another one."""
        if self._process is not None:
            self._process.communicate()
            self._process = None


def serve() -> None:
    """Answer each line of stdin, a file and where its arrays go, by a line of stdout, which is else kept free."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))
    import bpy

    from fipt_blender.blend.capture import mesh_reading

    for line in sys.stdin:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        answer = "refused"
        with suppress(Exception):
            mesh_reading.read(*map(Path, json.loads(line)))
            answer = "read"
        print(answer, file=answers, flush=True)
    os._exit(0)  # the destructors of bpy may hang


if __name__ == "__main__":
    serve()

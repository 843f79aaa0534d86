# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""python benchmarks/export_page.py room.blend THREE OUT [N]: an exported room in a browser, against Cycles.

Exports the room as glTF, draws the first N held-back views with three.js in a headless Chromium, and
compares them with Cycles by pixel: base colour alone, and the light of the lamps that comes without a
reflection, which is all that three.js computes.
THREE is a folder in which `npm install three` was run. OUT/page.json gets the figures: PSNR in sRGB, and the
ratio of the means.
"""

from __future__ import annotations

import base64
import functools
import http.server
import json
import math
import queue
import subprocess
import sys
import threading
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.eevee_views import figures, opened, render, set_size
from fipt_blender.core.capture.encoded import srgb_decoded

SAMPLES = 64
_PAGE_SECONDS = 600.0
LUMENS_PER_WATT = 683.0  # a file's candela and nit for Blender's W/sr and W/(m² sr)
_PAGE = """<!DOCTYPE html><script type="importmap">{"imports": {"three": "/three/build/three.module.js",
"three/addons/": "/three/examples/jsm/"}}</script><body><script type="module">
import * as THREE from 'three';
import {GLTFLoader} from 'three/addons/loaders/GLTFLoader.js';
const order = ORDER;
const renderer = new THREE.WebGLRenderer({antialias: true, preserveDrawingBuffer: true});
renderer.setSize(order.width, order.height);
renderer.shadowMap.enabled = true;
renderer.toneMapping = THREE.LinearToneMapping;
const scene = (await new GLTFLoader().loadAsync('/room.glb')).scene;
const world = new THREE.Scene();
world.add(scene);
scene.traverse(item => {
  item.castShadow = item.receiveShadow = item.isMesh && !item.material.emissive?.getHex();
  if (!item.isLight) return;
  item.castShadow = true;
  item.shadow.mapSize.set(1024, 1024);
  item.shadow.normalBias = 0.04;
});
const pictures = [];
const draw = exposure => {
  renderer.toneMappingExposure = exposure;
  for (const view of order.views) {
    const camera = new THREE.PerspectiveCamera(view.fov, order.width / order.height, 0.01, 100);
    camera.matrixAutoUpdate = false;
    camera.matrix.fromArray(view.matrix);
    camera.updateMatrixWorld(true);
    renderer.render(world, camera);
    pictures.push(renderer.domElement.toDataURL('image/png'));
  }
};
draw(order.exposure);
scene.traverse(item => { if (item.isMesh) {
  const {map, color} = item.material;
  item.material = new THREE.MeshBasicMaterial({map, color, side: THREE.DoubleSide});
} });
draw(1);
await fetch('/pictures', {method: 'POST', body: JSON.stringify(pictures)});
</script>"""


def main(argv: list[str]) -> int:
    """Export, draw, render, compare and write."""
    three, out, count = Path(argv[1]), Path(argv[2]).absolute(), int(argv[3]) if len(argv) > 3 else 2
    out.mkdir(parents=True, exist_ok=True)
    scene, cameras = opened(argv[0], count)
    set_size(scene, cameras[0])
    bpy.ops.fipt.export_room(filepath=str(out / "room.glb"))
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.max_bounces = SAMPLES, False, 0
    lit = [render(scene, camera, out / f"lit_{n}.exr") for n, camera in enumerate(cameras)]
    show_base_color()
    scene.cycles.use_denoising = False
    base = [render(scene, camera, out / f"base_{n}.exr") for n, camera in enumerate(cameras)]
    exposure = 0.18 / float(np.median(np.concatenate([image.reshape(-1) for image in lit])))
    drawn = draw(three, out, scene, cameras, exposure / LUMENS_PER_WATT)
    found = {
        "lit": [figures(a / exposure, b, exposure) for a, b in zip(drawn[:count], lit, strict=True)],
        "base color": [figures(a, b, 1.0) for a, b in zip(drawn[count:], base, strict=True)],
    }
    (out / "page.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1), flush=True)
    return 0


def show_base_color() -> None:
    """Let every Principled material emit its base colour."""
    for material in bpy.data.materials:
        nodes = material.node_tree.nodes if material.node_tree else ()
        shader = next((node for node in nodes if node.type == "BSDF_PRINCIPLED"), None)
        output = next((node for node in nodes if node.type == "OUTPUT_MATERIAL"), None)
        if shader is None or output is None:
            continue
        emission, color = nodes.new("ShaderNodeEmission"), shader.inputs["Base Color"]
        emission.inputs["Color"].default_value = color.default_value
        if color.links:
            material.node_tree.links.new(color.links[0].from_socket, emission.inputs["Color"])
        material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])


def draw(
    three: Path, out: Path, scene: bpy.types.Scene, cameras: list[bpy.types.Object], exposure: float
) -> list[np.ndarray]:
    """Linear pictures (H, W, 3) of the page: each view's light, exposed, then each one's base colour."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    views = [
        {
            "fov": math.degrees(2.0 * math.atan(math.tan(camera.data.angle_x / 2.0) * height / width)),
            "matrix": [value for column in _upright(camera).col for value in column],
        }
        for camera in cameras
    ]
    order = {"width": width, "height": height, "views": views, "exposure": exposure}
    (out / "page.html").write_text(_PAGE.replace("ORDER", json.dumps(order)), encoding="utf-8")
    if not (out / "three").exists():
        (out / "three").symlink_to(three.absolute() / "node_modules" / "three")
    posted: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_POST(self) -> None:
            posted.put(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(204)
            self.end_headers()

    handler = functools.partial(Handler, directory=str(out))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        command = ["chromium", "--headless", "--no-sandbox", "--use-angle=swiftshader"]
        command += ["--enable-unsafe-swiftshader", "--remote-debugging-port=0"]
        browser = subprocess.Popen([*command, f"http://127.0.0.1:{server.server_address[1]}/page.html"])
        try:
            pictures = json.loads(posted.get(timeout=_PAGE_SECONDS))
        finally:
            browser.terminate()
            server.shutdown()
    return [_linear(out / f"page_{n}.png", url) for n, url in enumerate(pictures)]


def _upright(camera: bpy.types.Object) -> object:
    """The pose of a camera in glTF's world, whose Y is up."""
    from mathutils import Matrix

    return Matrix.Rotation(-math.pi / 2.0, 4, "X") @ camera.matrix_world


def _linear(path: Path, url: str) -> np.ndarray:
    """A picture of the page, linear."""
    from PIL import Image

    path.write_bytes(base64.b64decode(url.partition(",")[2]))
    return srgb_decoded(np.asarray(Image.open(path).convert("RGB"), np.float32) / 255.0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

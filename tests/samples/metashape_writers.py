"""Camera files of Metashape and RealityScan, written by the rules of their documentation.

Nothing here uses the readers' code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from samples.rig_writers import FLIP_YZ, Shot, quaternion, text, write_photographs


@dataclass
class Chunk:
    """A Metashape chunk: shots in world coordinates, and the similarity that leads from it to the world."""

    shots: list[Shot]
    scale: float = 1.0
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def inside(self, shot: Shot) -> np.ndarray:
        """Camera to chunk (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation.T @ shot.rotation.T
        matrix[:3, 3] = self.rotation.T @ (shot.centre - self.translation) / self.scale
        return matrix


def metashape_sensor(index: int, shot: Shot, extra: str = "") -> str:
    """A sensor: B1 widens the pixels, the principal point is an offset, P1 and P2 in Metashape's order."""
    kind = "fisheye" if shot.fisheye else "frame"
    k = "".join(f"<k{i + 1}>{value!r}</k{i + 1}>" for i, value in enumerate(shot.k))
    return (
        f'<sensor id="{index}" label="camera {index}" type="{kind}">{extra}'
        f'<resolution width="{shot.width}" height="{shot.height}"/>'
        f'<calibration type="{kind}" class="initial"><f>1</f></calibration>'
        f'<calibration type="{kind}" class="adjusted">'
        f'<resolution width="{shot.width}" height="{shot.height}"/>'
        f"<f>{shot.fy!r}</f><b1>{shot.fx - shot.fy!r}</b1>"
        f"<cx>{shot.cx - shot.width / 2!r}</cx><cy>{shot.cy - shot.height / 2!r}</cy>{k}"
        f"<p1>{shot.p[1]!r}</p1><p2>{shot.p[0]!r}</p2></calibration></sensor>"
    )


def metashape_chunk(chunk: Chunk, component: bool = False) -> str:
    """One chunk; with its transform at a component or, as older versions had it, at the chunk."""
    sensors = "".join(metashape_sensor(i, shot) for i, shot in enumerate(chunk.shots))
    at = ' component_id="0"' if component else ""
    cameras = "".join(
        f'<camera id="{i}" sensor_id="{i}"{at} label="{Path(shot.name).stem}" enabled="true">'
        f"<transform>{text(chunk.inside(shot))}</transform></camera>"
        for i, shot in enumerate(chunk.shots)
    )
    transform = (
        f"<transform><rotation>{text(chunk.rotation)}</rotation>"
        f"<translation>{text(chunk.translation)}</translation><scale>{chunk.scale!r}</scale></transform>"
    )
    inside = f'<components><component id="0">{transform}</component></components>' if component else transform
    return (
        f'<chunk label="Chunk 1" enabled="true"><sensors>{sensors}</sensors>{inside}'
        f'<cameras>{cameras}<camera id="90" sensor_id="0" label="not aligned"/></cameras></chunk>'
    )


def write_metashape(folder: Path, chunks: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    document = f'<?xml version="1.0" encoding="UTF-8"?>\n<document version="1.5.0">{"".join(chunks)}</document>'
    (folder / "cameras.xml").write_text(document)


def write_realityscan_csv(folder: Path, shots: list[Shot]) -> None:
    """Angles that turn a camera which looks down, its top to the north: roll, pitch, then heading."""
    lines = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for shot in shots:
        axes = shot.rotation.T @ FLIP_YZ  # columns: right, up and back of the camera in the world
        pitch = math.asin(axes[2, 1])
        heading = math.atan2(axes[0, 1], axes[1, 1])
        roll = math.atan2(-axes[2, 0], axes[2, 2])
        side = max(shot.width, shot.height)
        values = [
            *shot.centre,
            *(math.degrees(angle) for angle in (heading, pitch, roll)),
            shot.fx * 36.0 / side,
            (shot.cx - shot.width / 2) / side,
            (shot.cy - shot.height / 2) / side,
            *(*shot.k, 0.0, 0.0, 0.0, 0.0)[:4],
            shot.p[1],
            shot.p[0],
        ]
        lines.append(",".join([shot.name, *(f"{value:.12g}" for value in values)]))
    write_photographs(folder, shots)
    (folder / "cameras.csv").write_text("\n".join(lines) + "\n")


XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/">
  <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
    <rdf:Description xcr:Version="3" xcr:PosePrior="locked" xcr:Coordinates="absolute"
       xcr:DistortionModel="{model}" xcr:FocalLength35mm="{focal!r}" xcr:Skew="0" xcr:AspectRatio="1"
       xcr:PrincipalPointU="{u!r}" xcr:PrincipalPointV="{v!r}"
       xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">
      <xcr:Rotation>{rotation}</xcr:Rotation>
      <xcr:Position>{position}</xcr:Position>
      <xcr:DistortionCoeficients>{coefficients}</xcr:DistortionCoeficients>
    </rdf:Description>
  </rdf:RDF>
</x:xmpmeta>
"""


def write_realityscan_xmp(folder: Path, shots: list[Shot], model: str = "brown4t2") -> None:
    write_photographs(folder, shots)
    for shot in shots:
        side = max(shot.width, shot.height)
        document = XMP.format(
            model=model,
            focal=shot.fx * 36.0 / side,
            u=(shot.cx - shot.width / 2) / side,
            v=(shot.cy - shot.height / 2) / side,
            rotation=text(shot.rotation),
            position=text(shot.centre),
            coefficients=text([*(*shot.k, 0.0, 0.0, 0.0, 0.0)[:4], shot.p[1], shot.p[0]]),
        )
        (folder / f"{Path(shot.name).stem}.xmp").write_text(document)


def write_realityscan_colmap(folder: Path, shots: list[Shot]) -> None:
    """RealityScan's COLMAP export: text files in the folder itself, no 2D points, points without tracks."""
    cameras, images = ["# Camera list"], ["# Image list"]
    for index, shot in enumerate(shots, start=1):
        cameras.append(f"{index} PINHOLE {shot.width} {shot.height} {shot.fx!r} {shot.fy!r} {shot.cx!r} {shot.cy!r}")
        translation = -shot.rotation @ shot.centre
        images += [f"{index} {text([*quaternion(shot.rotation), *translation])} {index} {shot.name}", ""]
    write_photographs(folder / "images", shots)
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")
    (folder / "points3D.txt").write_text("# 3D point list\n1 0.1 0.2 0.3 90 90 90 0.5\n")

"""How a capture is read: the options of the engine's `ingest` and of the command line's `estimate`.

Needs the standard library and numpy alone, since Blender's side imports it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ..run.declared import Option, arguments_of
from ..run.errors import FiptError
from ..run.shapes import SCALES, UP_AXES

FORMATS = (  # identifier, label, tooltip
    ("auto", "Automatic", "Recognize the layout by the files"),
    ("colmap", "COLMAP", "A COLMAP model, binary or text"),
    ("transforms", "transforms.json", "The format of nerfstudio, instant-ngp and NeRF"),
    ("metashape", "Metashape", "The camera XML that Metashape exports"),
    ("blocksexchange", "BlocksExchange", "The XML of ContextCapture and iTwin Capture, also by Metashape"),
    (
        "realityscan",
        "RealityScan",
        "XMP files beside the photographs, or a CSV file of the camera parameters",
    ),
    ("meshroom", "Meshroom", "A .sfm or .json file of Meshroom's cameras"),
    ("opensfm", "OpenSfM", "A file reconstruction.json, also written by OpenDroneMap"),
    ("openmvg", "OpenMVG", "A file sfm_data.json, also written by Regard3D"),
    ("bundler", "Bundler", "A file bundle.out with the list of its photographs"),
    ("nvm", "VisualSFM", "An .nvm file"),
    ("polycam", "Polycam", "The raw data that Polycam exports"),
    ("record3d", "Record3D", "A file metadata.json beside the folder rgb or rgbd"),
    ("3d-scanner-app", "3D Scanner App", "The export All Data, with files frame_00000.json"),
    ("stray-scanner", "Stray Scanner", "Folders of the app Stray Scanner, with the video's pictures in rgb"),
    ("rgbd", "RGB-D Frames", "Photographs, depth images and poses of 7-Scenes, tsdf-fusion or ScanNet"),
    ("scannetpp", "ScanNet++", "The DSLR photographs of a ScanNet++ scene"),
    ("fipt-synthetic", "FIPT Synthetic", "Folders train and val with Image, IndexMA and segmentation"),
    ("fipt-real", "FIPT Real", "Files cam.txt and K_list.txt beside the folder Image"),
)
UP = (
    ("auto", "Automatic", "Use the format's up axis, otherwise find it by the room's planes and the cameras"),
    *((axis, axis.upper(), f"The capture's {axis.upper()} axis points up") for axis in UP_AXES),
)
LAYER_TEXT = (
    "Layer or part of OpenEXR photographs that have several. If empty, the one without a name or with one"
    " like Combined, beauty, rgba, C or image is used"
)
# Identifier, label, tooltip, icon. The engine knows "folder" as "masks", with the artist's own images.
PART_SOURCES = (
    (
        "auto",
        "Automatic",
        "Material slots or objects, divided further where the capture's masks agree; one of them if no "
        "others; with a scan, masks or nothing",
        "SHADERFX",
    ),
    (
        "masks",
        "Part Masks",
        "ID images beside the photographs alone, with one ID per material; for meshes whose slots are wrong",
        "IMAGE",
    ),
    (
        "folder",
        "Mask Folder",
        "Your own ID images, named like the photographs, e.g. painted or made by a segmentation tool, whose "
        "IDs may differ from photograph to photograph",
        "FILE_FOLDER",
    ),
    (
        "semantics",
        "Semantic Masks",
        "ID images of classes (wall, chair, ...), which may have several materials. Less precise than parts",
        "IMAGE_RGB",
    ),
    (
        "materials",
        "Material Slots",
        "One part per material slot, for rooms that were modeled or have assigned materials",
        "MATERIAL",
    ),
    (
        "objects",
        "Objects",
        "One part per object, for rooms where each object has one material",
        "OBJECT_DATA",
    ),
    (
        "loose",
        "Loose Pieces",
        "One part per connected piece of mesh, for models that are joined into one object",
        "MESH_DATA",
    ),
    ("none", "None", "Each point is estimated separately, for a single scan without masks", "X"),
)
LEAST_TRIANGLES = 100  # of a budget; fewer are no room


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """How a capture is read. Lengths are in metres."""

    format: Annotated[str, Option("Layout of the capture", "Layout", choices=FORMATS)] = "auto"
    mesh: Annotated[
        Path | None,
        Option(
            "Mesh file of the room, in the capture's coordinates. If empty, the one beside the cameras",
            shown={"subtype": "FILE_PATH"},
        ),
    ] = None
    images: Annotated[
        Path | None,
        Option(
            "Folder of the photographs, if they are not where the camera file says",
            "Photographs",
            shown={"subtype": "DIR_PATH"},
        ),
    ] = None
    panorama: Annotated[
        Path | None,
        Option(
            "Equirectangular photograph (OpenEXR, Radiance or JPEG) that the cameras do not include. It shows"
            " the lamps that they miss. Black pixels of the image of its name in the folder masks beside it"
            " are left out",
            shown={"subtype": "FILE_PATH"},
        ),
    ] = None
    panorama_place: Annotated[
        tuple[float, ...],
        Option(
            "Where the panorama was taken, its camera upright, in the coordinates of the import, Z up",
            "Place",
            shown={"subtype": "TRANSLATION"},
        ),
    ] = (0.0, 0.0, 1.5)
    panorama_heading: Annotated[
        float,
        Option(
            "Rotation about Z in degrees of a camera in Blender that looks at the panorama's centre, from Y"
            " to the left",
            "Heading",
            low=-3600,
            high=3600,
            shown={"subtype": "ANGLE"},
        ),
    ] = 0.0
    layer: Annotated[str, LAYER_TEXT] = ""
    colorspace: Annotated[
        str, Option("OpenColorIO's name of the photographs' color space, such as ACEScg", "Color Space")
    ] = ""
    scale: Annotated[
        float,
        Option(
            "Length of one unit of the capture in meters",
            low=SCALES[0],
            high=SCALES[1],
            shown={"soft_min": 0.001, "soft_max": 1000.0, "precision": 4},
        ),
    ] = 1.0
    up_axis: Annotated[str, Option("Axis of the capture that points up; --up-axis=-y for -y", choices=UP)] = (
        "auto"
    )
    correct: Annotated[
        str,
        Option(
            "Correction of a usual mistake of the program that wrote the capture, as the import names it:"
            " axes-opencv, inverse, transpose, quaternion, scale-39.3701, turn-x90, ... If empty, they are"
            " tried where something does not fit; none for not at all",
            "Correction",
        ),
    ] = ""
    hold_back: Annotated[
        int,
        Option(
            "Hold back every N-th photograph for comparison with the result, if the capture does not define"
            " held-back views itself. 0 holds back none",
            "Hold Back Every",
            low=2,
            zero=True,
            shown={"soft_max": 50},
        ),
    ] = 8
    clamp_negative: Annotated[
        bool, "Treat all negative pixel values as black, instead of refusing large ones"
    ] = False
    keep_poses: Annotated[
        bool,
        "Keep the photographs' poses as they are. Otherwise those that are off by more than 0.7 pixels, as in"
        " scanning apps, are refined by bundle adjustment",
    ] = False
    triangles: Annotated[
        int,
        Option(
            "Simplify a mesh with more triangles to about this number: a scan when it is imported, or any"
            " room by Simplify Room. 0 keeps all",
            low=LEAST_TRIANGLES,
            zero=True,
            shown={"soft_max": 2_000_000, "step": 10_000},
        ),
    ] = 0
    undo_applied_transform: Annotated[
        bool, "For transforms.json: the mesh has the coordinates from before nerfstudio applied its transform"
    ] = False
    views: Annotated[int, Option("Use N photographs, evenly spread; 0 for all", zero=True, panel=False)] = 0
    voxel: Annotated[
        float,
        Option(
            "Voxels in meters of a mesh that is fused from depth images; 0 to follow their pixels",
            low=0.002,
            high=1.0,
            zero=True,
            panel=False,
        ),
    ] = 0.0
    depth_unit: Annotated[float, Option("Unit of 16-bit depth images in meters", high=1.0, panel=False)] = (
        0.001
    )
    own_paths: Annotated[
        bool,
        Option(
            "For transforms.json: its paths may lead anywhere; only for files that you wrote yourself",
            panel=False,
        ),
    ] = False

    def refuse_missing(self) -> None:
        """Look whether what is named exists."""
        remedy = "Correct the path, in Import Settings or on the command line, or give none."
        if self.mesh is not None and not self.mesh.is_file():
            raise FiptError("mesh-missing.refuse-missing", mesh=self.mesh, remedy=remedy)
        for path, exists in ((self.images, Path.is_dir), (self.panorama, Path.is_file)):
            if path is not None and not exists(path):
                raise FiptError("images-missing", path=path, remedy=remedy)

    def arguments(self) -> list[str]:
        """Arguments of `ingest`."""
        return arguments_of(self, CaptureOptions)

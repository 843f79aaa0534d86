"""Bundle adjustment of the photographs' poses, where those of the capture are not exact.

The poses of scanning apps are off by some pixels. SIFT features are matched between photographs that overlap
by these poses, and triangulated; poses and points are adjusted with the given places as priors (pycolmap).

Depth images that were taken with the photographs move with them. Where the lens of the photographs is
unknown, depth images are those of another camera, beside it and at other moments. They stay: the lens is
adjusted, too, and all photographs together are moved to what the depth images measure.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from ..alignment.registration import MIN_POINTS, refine
from ..alignment.turns import cross_matrix
from ..conventions import similarity_of_poses, transform_points, transform_poses
from ..run.contents import PoseErrors
from ..run.messages import Progress, Reporter, within
from ..run.threads import in_threads
from .depth_images import read_depth
from .distortion import lens_camera, lens_pinhole
from .encoded import tone_mapped
from .images import threads_for
from .photograph import Photograph
from .rig import EQUIRECTANGULAR, DepthView, Lens, Rig, RigView

EXACT = 0.7  # pixels of mean reprojection error, up to which poses stay as they are
BETTER = 0.9  # of the error before: adjusted poses are used below it
SIDE = 960  # pixels of the longer side, to which photographs are reduced; all errors are in pixels of it
SMALL = 500  # a longer side below which features are also sought between the pixels
FEATURES, CONTRAST = 3000, 0.002  # most features of a photograph, and their least contrast
RATIO = 0.85  # of the distances of the best and the next match
# Partners of a photograph, and the least share of its pixels that they see at these distances in metres.
PARTNERS, OVERLAP, DISTANCES = 15, 0.25, (1.0, 2.0, 3.5)
LEAST_MATCHES, LEAST_SEEN = 15, 30  # of two photographs; observations of a photograph that is adjusted
VERIFIED, PRIOR = 2.0, 0.04  # distances from epipolar lines: pixels by matches, share of the side by poses
LIMITS = (24.0, 8.0, 4.0, 3.0)  # pixels of reprojection error that observations may have, round by round
LEAST_ANGLE = 1.5  # degrees between the rays of a point
PLACE = 0.05  # metres, standard deviation of the given places
MOST_MOVED = (0.3, 10.0)  # metres and degrees; larger corrections are mistakes
DEPTHS, COLUMNS, STEEP = 60, 80, 0.1  # depth images that place points; of each; relative step at edges

Matches = dict[tuple[int, int], np.ndarray]  # (M, 2) uint32 features of two photographs


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """Photographs and depth images with better poses, or the given ones.

    Attributes:
        views, depths: in their order.
        errors: before and after; None where too few features were found.
    """

    views: list[RigView]
    depths: tuple[DepthView, ...]
    errors: PoseErrors | None = None


def refine_poses(rig: Rig, views: Sequence[RigView], scale: float, reporter: Reporter) -> RefinedPoses:
    """Refine the poses of photographs, and of the rig's depth images; says what was found.

    Args:
        views: photographs of the rig, by whatever names; panoramas stay as they are.
        scale: metres per unit of the capture's coordinates.

    Raises:
        FiptError: an image can't be read.
    """
    chosen = [index for index, view in enumerate(views) if view.lens.model != EQUIRECTANGULAR]
    used = [views[index] for index in chosen]
    if len(used) < 3:
        return RefinedPoses(list(views), rig.depths)
    pycolmap.logging.minloglevel = 2  # errors only
    features = _find_features(used, within(reporter.progress, 0.0, 0.5))
    shared = rig.one_camera and len({(view.width, view.height, view.lens) for view in used}) == 1
    bundle = _Bundle(used, features, shared, scale)
    before = bundle.adjust(reporter.progress)
    seen = bundle.observations >= LEAST_SEEN
    if len(bundle.points) < MIN_POINTS or 2 * np.count_nonzero(seen) < len(used):
        reporter.note("The photographs' poses are not checked: several show too few of the same features.")
        return RefinedPoses(list(views), rig.depths)
    after = bundle.error if before > EXACT and bundle.error < BETTER * before else before
    errors = PoseErrors(before, after, int(np.count_nonzero(seen)))
    if after == before:
        reporter.note(f"The photographs' poses stay as they are: they are off by {before:.2f} pixels.")
        return RefinedPoses(list(views), rig.depths, errors)
    given = np.array([view.camera_to_world for view in used])
    back = similarity_of_poses(bundle.poses[seen], given[seen])
    poses, points = transform_poses(back, bundle.poses), transform_points(back, bundle.points)
    shifts = scale * np.linalg.norm(poses[:, :3, 3] - given[:, :3, 3], axis=1)
    turns = np.degrees(_turns(given, poses).magnitude())
    seen &= (shifts < MOST_MOVED[0]) & (turns < MOST_MOVED[1])
    order = {view.image: index for index, view in enumerate(used)}
    depths = rig.depths if shared else _followed(rig.depths, order, given, poses, seen)
    if shared:  # also in scale: all places are near those of the depth images, of which the errors are random
        poses = transform_poses(refine(points, _Measured(rig.depths, scale)).similarity, poses)
    result = list(views)
    for index, pose, sure in zip(chosen, poses, seen, strict=True):
        view = replace(views[index], camera_to_world=pose) if sure else views[index]
        result[index] = replace(view, lens=bundle.lens(view)) if shared else view
    reporter.warning(
        "poses-refined",
        count=errors.photographs,
        before=before,
        after=after,
        shift=100.0 * np.median(shifts[seen]),
        turn=np.median(turns[seen]),
        lens=f" The focal length is {bundle.focal_ratio:.3f} of the given one." if shared else "",
    )
    shown = {view.image: view for view in result}  # others would color the mesh in the wrong place
    photographs = (each.photograph and shown.get(each.photograph.image) for each in depths)
    moved = (replace(each, photograph=own) for each, own in zip(depths, photographs, strict=True))
    return RefinedPoses(result, tuple(moved), errors)


@dataclass(frozen=True, eq=False)
class _Features:
    """Of a photograph: places (N, 2) float64, pixels of its copy, and descriptors (N, 128) of length 1."""

    places: np.ndarray
    descriptors: np.ndarray


def _find_features(views: Sequence[RigView], progress: Progress) -> list[_Features]:
    """Features of reduced copies; equal contrast counts alike at any brightness."""
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1)
    options.sift.max_num_features, options.sift.peak_threshold = FEATURES, CONTRAST
    options.sift.first_octave = -1 if max(max(view.width, view.height) for view in views) < SMALL else 0
    of_thread = threading.local()

    def find(view: RigView) -> _Features:
        if not hasattr(of_thread, "sift"):
            of_thread.sift = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
        # What is not finite is refused where photographs are checked.
        radiance = np.nan_to_num(Photograph((view,)).picture.shown()[0], posinf=0.0, neginf=0.0)
        share = _share(view)
        if share < 1.0:
            size = round(share * view.width), round(share * view.height)
            planes = (Image.fromarray(np.ascontiguousarray(radiance[..., k]), "F") for k in range(3))
            reduced = [np.asarray(plane.resize(size, Image.Resampling.BOX)) for plane in planes]
            radiance = np.stack(reduced, axis=2)
        keypoints, found = of_thread.sift.extract_from_uint8_array(tone_mapped(radiance))
        places, descriptors = pycolmap.keypoints_to_matrix(keypoints), np.asarray(found.data, np.float32)
        largest = np.argsort(-places[:, 2], kind="stable")[:FEATURES]
        lengths = np.linalg.norm(descriptors[largest], axis=1, keepdims=True)
        return _Features(places[largest, :2].astype(np.float64), descriptors[largest] / lengths)

    found = []
    for each in in_threads(find, views, threads_for(view.width * view.height for view in views)):
        found.append(each)
        progress(len(found) / len(views))
    return found


def _share(view: RigView) -> float:
    """By which a photograph is reduced."""
    return min(1.0, SIDE / max(view.width, view.height))


def _pairs(cameras: Sequence[pycolmap.Camera], poses: np.ndarray, scale: float) -> list[tuple[int, int]]:
    """Photographs that show the same by their poses; of each, those that share most with it."""
    points = []
    for camera, pose in zip(cameras, poses, strict=True):
        grid = np.meshgrid(np.linspace(0.1, 0.9, 5) * camera.width, np.linspace(0.1, 0.9, 4) * camera.height)
        ray = _rays(camera, np.stack(grid, axis=2).reshape(-1, 2))
        points.append(transform_points(pose, np.concatenate([ray * z / scale for z in DISTANCES])))
    shared = np.zeros((len(poses), len(poses)))
    for index, (camera, pose) in enumerate(zip(cameras, poses, strict=True)):
        local = (np.array(points) - pose[:3, 3]) @ pose[:3, :3]
        ahead = local[..., 2] > 0.1 * DISTANCES[0] / scale
        where = camera.img_from_cam(np.where(ahead[..., None], local, [0.0, 0.0, 1.0]).reshape(-1, 3))
        inside = ((where > 0.0) & (where < [camera.width, camera.height])).all(axis=1).reshape(ahead.shape)
        shared[:, index] = (inside & ahead).mean(axis=1)
    shared = np.minimum(shared, shared.T)
    shared[poses[:, :3, 2] @ poses[:, :3, 2].T < 0.5] = 0.0  # farther aside, SIFT knows no surface again
    np.fill_diagonal(shared, 0.0)
    found = set()
    for first, row in enumerate(shared):
        best = np.argsort(-row, kind="stable")[:PARTNERS].tolist()
        found |= {(min(first, each), max(first, each)) for each in best if row[each] > OVERLAP}
    return sorted(found)


def _rays(camera: pycolmap.Camera, places: np.ndarray) -> np.ndarray:
    """(N, 3) directions of depth 1 before a camera, of places (N, 2) in its image."""
    return np.column_stack([camera.cam_from_img(places), np.ones(len(places))])


def _nearest(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(M, 2) uint32 descriptors that are each other's nearest, and clearly nearer than the next."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.uint32)
    alike = first @ second.T
    best, rows = alike.argmax(axis=1), np.arange(len(first))
    mutual = alike.argmax(axis=0)[best] == rows
    most, next_best = alike[rows, best], np.partition(alike, -2, axis=1)[:, -2]
    index = np.flatnonzero(mutual & (1.0 - most < RATIO**2 * (1.0 - next_best)))  # half squared distances
    return np.column_stack([index, best[index]]).astype(np.uint32)


class _Bundle:
    """Poses, points and cameras that are adjusted together.

    Args:
        views: the photographs. features: of each.
        shared: whether all have one lens, which is adjusted.
        scale: metres per unit.

    Attributes:
        poses: (V, 4, 4) camera to world.
        points: (N, 3).
        observations: (V,) of the points in each photograph.
        error: mean reprojection error, pixels.
    """

    def __init__(
        self, views: Sequence[RigView], features: Sequence[_Features], shared: bool, scale: float
    ) -> None:
        self._features, self._shared, self._scale = features, shared, scale
        self._cameras = []
        for number, view in enumerate(views, 1):
            camera = lens_camera(self._start(view), view.width, view.height)
            camera.rescale(round(_share(view) * view.width), round(_share(view) * view.height))
            camera.camera_id = 1 if shared else number
            self._cameras.append(camera)
        self._focal = self._cameras[0].mean_focal_length()
        self.poses = np.array([view.camera_to_world for view in views], np.float64)
        self._places = self.poses[:, :3, 3].copy()
        self.points, self.observations, self.error = np.zeros((0, 3)), np.zeros(len(views), int), 0.0

    @property
    def focal_ratio(self) -> float:
        """The focal length in units of the given one."""
        return float(self._cameras[0].mean_focal_length() / self._focal)

    def _start(self, view: RigView) -> Lens:
        """From which the lens is adjusted: with distortion, which would change its focal length otherwise."""
        if not self._shared:
            return view.lens
        pinhole = lens_pinhole(view.lens, view.width, view.height)
        return Lens("SIMPLE_RADIAL", (pinhole.fx, pinhole.cx, pinhole.cy, 0.0))

    def lens(self, view: RigView) -> Lens:
        """The lens of a photograph of full size."""
        camera = lens_camera(self._start(view), self._cameras[0].width, self._cameras[0].height)
        camera.params = self._cameras[0].params
        camera.rescale(view.width, view.height)
        return Lens(camera.model.name, tuple(camera.params.tolist()))

    def adjust(self, progress: Progress) -> float:
        """Adjust all, unless the poses are exact; returns the mean reprojection error with the given ones."""
        graph, before = pycolmap.CorrespondenceGraph(), 0.0
        for number, each in enumerate(self._features, 1):
            graph.add_image(number, len(each.places))
        for (first, second), found in self._match(within(progress, 0.5, 0.8)).items():
            geometry = pycolmap.TwoViewGeometry(config=2, inlier_matches=found)
            graph.add_two_view_geometry(first + 1, second + 1, geometry)
        graph.finalize()
        for number, limit in enumerate(LIMITS):
            model = self._triangulated(graph, limit)
            self._read(model)
            before = before or self.error
            if not len(self.points) or (number == 0 and before <= EXACT):
                break
            self._solve(model, number > 0)
            self._read(model)
            progress(0.8 + 0.2 * (number + 1) / len(LIMITS))
        return before

    def _match(self, progress: Progress) -> Matches:
        """Matches that agree with each other, and roughly with the poses."""
        options = pycolmap.RANSACOptions(max_error=VERIFIED, max_num_trials=1000, random_seed=0)
        prior = (2.0 if self._shared else 1.0) * PRIOR

        def match(pair: tuple[int, int]) -> np.ndarray:
            (one, first), (other, second) = ((self._cameras[index], self._features[index]) for index in pair)
            found, result = _nearest(first.descriptors, second.descriptors), None
            places = first.places[found[:, 0]], second.places[found[:, 1]]
            if len(found) >= LEAST_MATCHES and self._shared:
                result = pycolmap.estimate_fundamental_matrix(*places, options)
            elif len(found) >= LEAST_MATCHES:
                result = pycolmap.estimate_essential_matrix(*places, one, other, options)
            if result is None:
                return found[:0]
            relative = np.linalg.inv(self.poses[pair[1]]) @ self.poses[pair[0]]
            lines = _rays(one, places[0]) @ (cross_matrix(relative[:3, 3]) @ relative[:3, :3]).T
            off = np.abs((_rays(other, places[1]) * lines).sum(axis=1))
            off /= np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12)
            near = off * other.mean_focal_length() < prior * max(other.width, other.height)
            return found[np.asarray(result["inlier_mask"], bool) & near]

        pairs, matches = _pairs(self._cameras, self.poses, self._scale), {}
        for number, (pair, found) in enumerate(zip(pairs, in_threads(match, pairs), strict=True)):
            if len(found) >= LEAST_MATCHES:
                matches[pair] = found
            progress((number + 1) / len(pairs))
        return matches

    def _triangulated(self, graph: pycolmap.CorrespondenceGraph, limit: float) -> pycolmap.Reconstruction:
        """A model with the points that matches and poses give."""
        model = pycolmap.Reconstruction()
        for number, pose in enumerate(self.poses, 1):
            camera, places = self._cameras[number - 1], self._features[number - 1].places
            if not model.exists_camera(camera.camera_id):
                model.add_camera_with_trivial_rig(camera)
            names = {"name": str(number), "camera_id": camera.camera_id, "image_id": number}
            image = pycolmap.Image(keypoints=places, **names)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
        options = pycolmap.IncrementalTriangulatorOptions(random_seed=0, ignore_two_view_tracks=False)
        options.complete_max_reproj_error = options.merge_max_reproj_error = limit
        angle = float(np.degrees(limit / self._cameras[0].mean_focal_length()))
        options.create_max_angle_error = options.continue_max_angle_error = angle
        observed = pycolmap.ObservationManager(model, graph)
        triangulator = pycolmap.IncrementalTriangulator(graph, model, observed)
        for number in range(1, len(self.poses) + 1):
            triangulator.triangulate_image(options, number)
        triangulator.complete_all_tracks(options)
        triangulator.merge_all_tracks(options)
        observed.filter_all_points3D(limit, LEAST_ANGLE)
        return model

    def _solve(self, model: pycolmap.Reconstruction, whole_lens: bool) -> None:
        """Adjust a model; of a shared lens, the principal point only once the focal length is right."""
        config, priors = pycolmap.BundleAdjustmentConfig(), []
        for number, place in enumerate(self._places, 1):
            config.add_image(number)
            prior = pycolmap.PosePrior(position=place, corr_data_id=model.image(number).data_id)
            prior.position_covariance = np.eye(3) * (PLACE / self._scale) ** 2
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
            priors.append(prior)
            if not self._shared:
                config.set_constant_cam_intrinsics(number)
        options = pycolmap.BundleAdjustmentOptions(print_summary=False)
        options.refine_focal_length = options.refine_extra_params = self._shared
        options.refine_principal_point = self._shared and whole_lens
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.solver_options.max_num_iterations = 50
        options.ceres.solver_options.function_tolerance = 1e-5
        prior_options = pycolmap.PosePriorBundleAdjustmentOptions()
        pycolmap.create_pose_prior_bundle_adjuster(options, prior_options, config, priors, model).solve()

    def _read(self, model: pycolmap.Reconstruction) -> None:
        """Take over what a model has."""
        images = [model.image(number) for number in range(1, len(self.poses) + 1)]
        self.poses[:, :3] = [image.cam_from_world().inverse().matrix() for image in images]
        self.observations = np.array([image.num_points3D for image in images])
        self.points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
        model.update_point_3d_errors()
        self.error = float(model.compute_mean_reprojection_error())
        for camera in self._cameras:
            camera.params = model.camera(camera.camera_id).params


def _turns(given: np.ndarray, poses: np.ndarray) -> Rotation:
    """Rotations of the world by which poses (V, 4, 4) differ from the given ones."""
    return Rotation.from_matrix(poses[:, :3, :3] @ given[:, :3, :3].swapaxes(1, 2))


def _followed(
    depths: tuple[DepthView, ...],
    order: Mapping[Path, int],
    given: np.ndarray,
    poses: np.ndarray,
    seen: np.ndarray,
) -> tuple[DepthView, ...]:
    """Depth images that move with their photographs; between these, in proportion to the order.

    Args:
        order: index of each photograph by its file.
        given, poses: (V, 4, 4) of the photographs, before and after.
        seen: (V,) whether a photograph was adjusted.
    """
    numbers = [-1 if depth.photograph is None else order.get(depth.photograph.image, -1) for depth in depths]
    at = [index for index, number in enumerate(numbers) if number >= 0 and seen[number]]
    if len(at) < 2:
        return depths
    rows = [numbers[index] for index in at]
    times = np.clip(np.arange(len(depths)), at[0], at[-1])
    turns = Slerp(at, _turns(given[rows], poses[rows]))(times).as_matrix()
    shift = poses[rows, :3, 3] - given[rows, :3, 3]
    shifts = np.stack([np.interp(times, at, shift[:, axis]) for axis in range(3)], axis=1)
    moved = []
    for depth, turn, by in zip(depths, turns, shifts, strict=True):
        pose = depth.camera_to_world.copy()
        pose[:3, :3], pose[:3, 3] = turn @ pose[:3, :3], pose[:3, 3] + by
        moved.append(replace(depth, camera_to_world=pose))
    return tuple(moved)


class _Measured:
    """The surface that depth images measure, onto which points are moved; see `alignment.surface.Surface`.

    Args:
        depths: of which some are used.
        scale: metres per unit of the capture.
    """

    def __init__(self, depths: Sequence[DepthView], scale: float) -> None:
        points, normals = [], []
        for view in depths[:: -(-len(depths) // DEPTHS)]:
            image = read_depth(replace(view, photograph=None), scale)
            step = max(1, view.width // COLUMNS)
            depth = image.depth[::step, ::step].astype(np.float64)
            y, x = np.mgrid[: view.height : step, : view.width : step] + 0.5
            local = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=2)
            place = transform_points(image.camera_to_world, local * depth[..., None]) / scale
            middle, right, left = depth[1:-1, 1:-1], depth[1:-1, 2:], depth[1:-1, :-2]
            near = np.array([right, left, depth[2:, 1:-1], depth[:-2, 1:-1]])
            normal = np.cross(place[1:-1, 2:] - place[1:-1, :-2], place[2:, 1:-1] - place[:-2, 1:-1])
            length = np.linalg.norm(normal, axis=2)
            flat = (np.abs(near - middle) < STEEP * middle).all(axis=0) & (length > 0.0)
            points.append(place[1:-1, 1:-1][flat])
            normals.append(normal[flat] / length[flat, None])
        self._points, self._normals = np.concatenate(points), np.concatenate(normals)
        self._tree = cKDTree(self._points)

    def nearest(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) of positions (N, 3) from the planes at the nearest points, and directions (N, 3)."""
        index = self._tree.query(positions)[1]
        off = ((positions - self._points[index]) * self._normals[index]).sum(axis=1)
        return np.abs(off), self._normals[index] * np.where(off < 0.0, -1.0, 1.0)[:, None]

"""Mixed pixels are found, divided into fragments, and their radiance among the surfaces that they see."""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.environment import outside_pixels
from fipt_blender.core.pixels.fragments import OUTSIDE, SUBPIXELS, Fragments, group_samples
from fipt_blender.core.pixels.mixed_pixels import find_donors, mark_pure
from fipt_blender.core.pixels.store import LEFT_OUT, NO_TRIANGLE, PixelStore, create_pixels, fill_pixels
from fipt_blender.core.pixels.unmixing import at_centres, fit_unknown, posterior, standard_error, unmix_pixels, weights
from fipt_blender.core.surface.room import Room
from samples.small_rooms import make_room

WIDTH, HEIGHT = 16, 12
PIXEL = 0.1  # metres on the floor


def floor_camera(image: Path, shift: float = 0.0) -> View:
    """A camera that looks straight down at the floor from two metres, `shift` metres to the right."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [shift, 0.0, 2.0]
    return View("train/0", "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


def strip(left: float, right: float, height: float = 0.0) -> list[list[float]]:
    """A quad of the floor between two x coordinates, `height` metres above it."""
    return [[left, -3, height], [right, -3, height], [right, 3, height], [left, 3, height]]


def photograph(view: View, bounds: list[float], colors: np.ndarray) -> None:
    """Write the exact image of strips of the floor: colour i reaches from bounds[i] to bounds[i + 1]."""
    left = (np.arange(WIDTH) - WIDTH / 2) * PIXEL + float(view.camera_to_world[0, 3])
    image = np.zeros((HEIGHT, WIDTH, 3))
    for low, high, color in zip(bounds[:-1], bounds[1:], colors, strict=True):
        share = np.clip(np.minimum(high, left + PIXEL) - np.maximum(low, left), 0.0, None) / PIXEL
        image += share[None, :, None] * color
    write_exr(view.image, image.astype(np.float32))


def unmixed(room: Room, views: list[View], folder: Path, labels: np.ndarray, workers: Any = None) -> PixelStore:
    store = create_pixels(folder, views)
    scale = fill_pixels(store, room, lambda done: None)
    store.radiance[:] *= scale
    mark_pure(store, room, labels, lambda done: None)
    unmix_pixels(store, room, labels, lambda done: None, workers)
    return store


def test_a_mixed_pixel_takes_a_donor_of_its_own_part(tmp_path: Path) -> None:
    """A floor of two coplanar halves that meet at x = 0.03: inside a column of pixels."""
    write_exr(tmp_path / "image.exr", np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    room = make_room([strip(-3, 0.03), strip(0.03, 3)])
    store = create_pixels(tmp_path / "pixels", [floor_camera(tmp_path / "image.exr")])
    assert fill_pixels(store, room, lambda done: None) == pytest.approx(0.5)
    labels = np.array([0, 0, 1, 1])
    mark_pure(store, room, labels, lambda done: None)
    pure, part = np.asarray(store.pure).reshape(HEIGHT, WIDTH), labels[store.triangle]
    assert not pure[:, 8].any()  # the column over x = 0 to 0.1 m
    assert pure[:, :8].all() and pure[:, 9:].all()
    donors = find_donors(store, 0, part, 2).reshape(HEIGHT, WIDTH)
    own = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    assert (part.reshape(HEIGHT, WIDTH)[:, 8] == 1).all()  # its centre lies on the right half
    assert (donors[:, 8] == own[:, 9]).all()
    assert (np.delete(donors, 8, axis=1) == np.delete(own, 8, axis=1)).all()
    # No pixel of another part, beyond the image's border or out of reach is a donor.
    alone = np.where(np.arange(WIDTH * HEIGHT) % WIDTH == 8, 7, 0)
    assert (find_donors(store, 0, alone, 4).reshape(HEIGHT, WIDTH)[:, 8] == -1).all()
    assert (find_donors(store, 0, part, 0).reshape(HEIGHT, WIDTH)[:, 8] == -1).all()


def test_masked_pixels_are_neither_room_nor_outside(tmp_path: Path) -> None:
    """The left half is masked; its glare must not affect the scale, the pixels or the environment."""
    image, mask = tmp_path / "image.exr", tmp_path / "mask.exr"
    pixels = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    pixels[:, :8] = 1000.0
    write_exr(image, pixels)
    ids = np.ones((HEIGHT, WIDTH), np.float32)
    ids[:, :8] = 0.0
    write_exr(mask, ids)
    room = make_room([[[-3, -3, 0], [3, -3, 0], [3, 0.3, 0], [-3, 0.3, 0]]])  # the upper rows look outside
    store = create_pixels(tmp_path / "pixels", [replace(floor_camera(image), mask=mask)])
    assert fill_pixels(store, room, lambda done: None) == pytest.approx(0.5)
    mark_pure(store, room, np.zeros(2, int), lambda done: None)
    triangle = np.asarray(store.triangle).reshape(HEIGHT, WIDTH)
    assert (triangle[:, :8] == LEFT_OUT).all() and not np.asarray(store.pure).reshape(HEIGHT, WIDTH)[:, :8].any()
    assert (triangle[:2, 8:] == NO_TRIANGLE).all() and (triangle[4:, 8:] >= 0).all()
    ((_, radiance),) = outside_pixels(store)
    assert len(radiance) and np.allclose(radiance, 1.0)


def test_two_halves_of_known_colours_are_recovered(tmp_path: Path) -> None:
    """Whatever the coverage: each mixed pixel gets the colour of the half at its centre, and keeps it."""
    colors = np.array([[0.2, 0.4, 0.6], [3.0, 2.0, 1.0]])
    labels = np.array([0, 0, 1, 1])
    for number, edge in enumerate(np.linspace(0.015, 0.085, 8)):
        view = floor_camera(tmp_path / f"{number}.exr")
        photograph(view, [-3, edge, 3], colors)
        store = unmixed(make_room([strip(-3, edge), strip(edge, 3)]), [view], tmp_path / str(number), labels)
        mixed = ~np.asarray(store.pure)
        assert mixed.any() and np.asarray(store.weight)[~mixed].min() == 1.0
        np.testing.assert_array_equal(store.own[~mixed], store.radiance[~mixed])
        true = colors[labels[store.triangle[mixed]]]
        assert np.abs(store.own[mixed] / true - 1.0).max() < 0.08
        assert (np.abs(store.own[mixed] - true).mean(axis=1) < np.abs(store.radiance[mixed] - true).mean(axis=1)).all()


def test_a_strip_of_a_third_of_a_pixel_gets_its_own_radiance(tmp_path: Path) -> None:
    """No pixel sees it alone; over many positions its mean agrees, and errors are as large as they claim."""
    wall, lamp, width = np.array([0.4, 0.5, 0.6]), np.array([9.0, 10.0, 11.0]), PIXEL / 3
    scores, values = [], []
    for number, left in enumerate(np.linspace(0.0, PIXEL - width, 15)):
        view = floor_camera(tmp_path / f"{number}.exr")
        edges = [-3, left, left + width, 3]
        photograph(view, edges, np.stack([wall, lamp, wall]))
        room = make_room([strip(a, b) for a, b in itertools.pairwise(edges)])
        labels = np.array([0, 0, 1, 1, 0, 0])
        store = unmixed(room, [view], tmp_path / str(number), labels)
        seen = np.flatnonzero(labels[store.triangle] == 1)
        if len(seen):  # its centre lies on the strip
            assert not np.asarray(store.pure)[seen].any()
            error = standard_error(store.own[seen], store.weight[seen])
            scores.append(float((store.own[seen].mean(axis=1) - lamp.mean())[0] / error[0]))
            values.append(store.own[seen[0]].mean())
    assert len(scores) >= 5
    assert np.abs(scores).max() < 3.0 and np.abs(np.array(values) / lamp.mean() - 1.0).max() < 0.2
    assert abs(np.mean(values) / lamp.mean() - 1.0) < 0.05


def test_a_dark_bar_before_a_lamp_tells_little(tmp_path: Path) -> None:
    lamp, bar = np.full(3, 20.0), np.full(3, 0.1)
    edges = [-3, 0.04, 0.06, 3]
    view = floor_camera(tmp_path / "bar.exr")
    photograph(view, edges, np.stack([lamp, bar, lamp]))
    room = make_room([strip(a, b) for a, b in itertools.pairwise(edges)])
    labels = np.array([0, 0, 1, 1, 0, 0])
    store = unmixed(room, [view], tmp_path / "pixels", labels)
    seen = labels[store.triangle] == 1
    assert seen.any() and store.weight[seen].max() < 0.15
    error = standard_error(store.own[seen], store.weight[seen])
    assert (store.own[seen].mean(axis=1) - 3.0 * error < 0.1).all()


def test_coverage_of_the_samples_is_unbiased(rng: np.random.Generator) -> None:
    """Over half planes of any slope and offset; each single error is small."""
    samples = np.array(SUBPIXELS)
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    grid = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    angle, offset = rng.uniform(0.0, 2.0 * np.pi, 400), rng.uniform(-0.5, 0.5, 400)
    normal = np.stack([np.cos(angle), np.sin(angle)])
    error = (samples @ normal < offset).mean(axis=0) - (grid @ normal < offset).mean(axis=0)
    assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(len(error)) and error.std() < 0.04
    for axis in range(2):  # each sixteenth of either axis holds one sample
        assert sorted(np.floor((samples[:, axis] + 0.5) * 16).astype(int)) == list(range(16))


def test_samples_of_one_label_are_divided_where_depth_jumps() -> None:
    count = len(SUBPIXELS)
    pixel = np.repeat([0, 1], count)
    label = np.zeros(2 * count, np.int64)
    label[count:] = np.where(np.arange(count) < 4, 5, OUTSIDE)
    depth = np.where(np.arange(2 * count) % 4 == 0, 2.0, 1.0)
    depth[count:] = 1.0
    found = group_samples(pixel, label, depth, np.full(2 * count, 0.1), np.repeat(depth[:, None], 3, axis=1))
    assert found.pixel.tolist() == [0, 0, 1, 1]
    assert found.label.tolist() == [0, 0, OUTSIDE, 5]
    assert found.coverage.tolist() == [0.75, 0.25, 0.75, 0.25]
    assert found.position[:, 0].tolist() == [1.0, 2.0, 1.0, 1.0]
    joined, index = found.merged(np.zeros(4, np.int64))
    assert joined.coverage.tolist() == [1.0, 0.75, 0.25] and index.tolist() == [0, 2, 3]
    assert joined.position[0, 0] == pytest.approx(1.25)


def test_the_posterior_is_calibrated(rng: np.random.Generator) -> None:
    """Over pixels whose fragments are drawn from what is expected; what is certain keeps its radiance."""
    count, coverage = 4000, np.array([0.4, 0.3, 0.2, 0.1])
    pixel, label = np.repeat(np.arange(count), 4), np.tile(np.arange(4), count)
    fragments = Fragments(pixel, label, np.tile(coverage, count), np.zeros((4 * count, 3)))
    mean = np.tile(rng.uniform(1.0, 2.0, (4, 3)), (count, 1))
    variance = np.tile([[0.2], [0.1], [0.02], [0.0]], (count, 3))
    true = mean + np.sqrt(variance) * rng.normal(size=mean.shape)
    radiance = (coverage[:, None] * true.reshape(count, 4, 3)).sum(axis=1)
    found, spread = posterior(fragments, radiance, mean, variance)
    np.testing.assert_array_equal(found[label == 3], mean[label == 3])
    for each in range(3):
        error, claimed = (found - true)[label == each], spread[label == each].mean()
        assert abs(error.mean()) < 4.0 * np.sqrt(claimed / error.size)
        assert 0.8 < (error**2).mean() / claimed < 1.1
        # The least certain learns most.
        assert (error**2).mean() < (0.3, 0.85, 1.05)[each] * variance[each, 0]


def test_weights_and_standard_errors_are_inverse() -> None:
    own, variance = np.full((4, 3), 2.0), np.array([0.0, 0.01, 1.0, 100.0])
    found = weights(own, np.repeat(variance[:, None], 3, axis=1))
    assert found[0] == 1.0 and (np.diff(found) < 0).all()
    np.testing.assert_allclose(standard_error(own, found), np.sqrt(variance), rtol=1e-6)


def test_the_fragment_at_the_centre_is_the_nearest_of_its_label() -> None:
    position = np.array([[0.0, 0, 0], [0, 0, 5], [0, 0, 1], [0, 0, 0]])
    fragments = Fragments(np.array([0, 0, 0, 1]), np.array([3, 3, 4, 3]), np.full(4, 0.25), position)
    chosen = at_centres(fragments, np.array([3, 4, 3]), np.array([[0.0, 0, 4], [0, 0, 0], [0, 0, 0]]))
    assert chosen.tolist() == [1, -1, -1]


def test_a_strip_and_its_frame_that_no_pixel_sees_alone_are_told_apart(rng: np.random.Generator) -> None:
    """Their shares differ from pixel to pixel, and both radiances are those of all pixels of the view."""
    count, wall, frame, lamp = 60, 0.5, 0.2, 30.0
    shares = np.stack([rng.uniform(0.2, 0.5, count), rng.uniform(0.0, 0.4, count)], axis=1)
    shares = np.concatenate([1.0 - shares.sum(axis=1, keepdims=True), shares], axis=1)
    radiance = np.repeat((shares @ [wall, frame, lamp])[:, None], 3, axis=1)
    pixel, label = np.repeat(np.arange(count), 3), np.tile([0, 1, 2], count)
    fragments = Fragments(pixel, label, shares.reshape(-1), np.zeros((3 * count, 3)))
    known = label == 0
    mean = np.where(known[:, None], wall, radiance[pixel])
    variance = np.where(known[:, None], (0.1 * wall) ** 2, (3.0 * radiance[pixel]) ** 2)
    mean, variance = fit_unknown(fragments, radiance, mean, variance, known)
    assert mean[label == 2].mean() == pytest.approx(lamp, rel=0.03)
    assert abs(mean[label == 1].mean() - frame) < 3.0 * np.sqrt(variance[label == 1].mean())
    found, _ = posterior(fragments, radiance, mean, variance)
    assert np.abs(found[label == 2] / lamp - 1.0).max() < 0.15
    alone = fit_unknown(fragments, radiance, mean, variance, np.ones_like(known))
    np.testing.assert_array_equal(alone[0], mean)


class _Backwards:
    """Workers that do the views in the opposite order, each with what it prepares itself."""

    def map(self, work: Any, items: Iterable[Any]) -> Iterator[tuple[int, Any]]:
        for index, item in reversed(list(enumerate(items))):
            yield index, work.prepare()(item)


def test_neither_order_nor_workers_change_a_bit(tmp_path: Path) -> None:
    colors, labels = np.array([[0.2, 0.4, 0.6], [3.0, 2.0, 1.0]]), np.array([0, 0, 1, 1])
    views = []
    for number, shift in enumerate((0.0, 0.23, -0.31)):
        view = replace(floor_camera(tmp_path / f"{number}.exr", shift), name=f"train/{number}")
        photograph(view, [-4, 0.03, 4], colors)
        views.append(view)
    room = make_room([strip(-4, 0.03), strip(0.03, 4)])
    one = unmixed(room, views, tmp_path / "one", labels)
    other = unmixed(room, views[::-1], tmp_path / "other", labels, _Backwards())
    for index in range(3):
        rows, reverse = one.rows(index), other.rows(2 - index)
        np.testing.assert_array_equal(one.own[rows], other.own[reverse])
        np.testing.assert_array_equal(one.weight[rows], other.weight[reverse])

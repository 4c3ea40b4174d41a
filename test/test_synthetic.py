# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Synthetic scenes: truth against closed forms, images against truth, reproducible bytes."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.core.camera import CameraModel
from stereo_depth_ros.core.errors import BagError, ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.messages.disparity import published_disparity
from stereo_depth_ros.synthetic import Cylinder, Rectangle, Scene, Sphere, SyntheticFrame, SyntheticSequence, Texture
from stereo_depth_ros.synthetic.bag import TRUTH_STEP_PX, write_synthetic_bag
from stereo_depth_ros.synthetic.rays import depth_and_shadow, pixel_rays, render
from stereo_depth_ros.synthetic.rig import R_RIGHT_LEFT

WIDTH, HEIGHT = 161, 120
ORIGIN, STRAIGHT = np.zeros(3), np.identity(3)
P = np.array([[150.0, 0.0, 70.0, 0.0], [0.0, 140.0, 50.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
BASELINE_M = 0.12
FLAT = Texture(mean=120.0, contrast=0.0)


@pytest.fixture(scope="module")
def room() -> SyntheticSequence:
    return SyntheticSequence(frames=4, width=WIDTH, height=HEIGHT)


def depth_of(*primitives: Rectangle | Sphere | Cylinder) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Depth and shadow for a straight camera with projection P, the other camera a baseline to its right."""
    depth_m, shadow = np.empty((HEIGHT, WIDTH)), np.empty((HEIGHT, WIDTH), np.bool_)
    other = np.array([BASELINE_M, 0.0, 0.0])
    packed = Scene(primitives, seed=1).packed()
    depth_and_shadow(0, HEIGHT, packed, ORIGIN, STRAIGHT, P, other, depth_m, shadow)
    return depth_m, shadow


def rectified_rays(rig: StereoRig) -> npt.NDArray[np.float64]:
    y, x = np.indices((rig.height, rig.width))
    return np.stack([(x - rig.cx_left) / rig.f_px, (y - rig.cy) / rig.fy_px, np.ones(x.shape)], axis=-1)


def rectify(camera: CameraModel, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    size = (camera.width, camera.height)
    maps = cv2.initUndistortRectifyMap(camera.K, camera.D, camera.R, camera.P[:, :3], size, cv2.CV_32FC1)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_CUBIC), np.uint8)


def digest(frame: SyntheticFrame) -> str:
    arrays = (frame.pair.left.pixels, frame.pair.right.pixels, frame.truth_disparity_px, frame.truth_depth_m)
    return hashlib.sha256(b"".join(a.tobytes() for a in (*arrays, frame.occluded))).hexdigest()


def test_slanted_plane_has_its_analytic_depth_from_the_moving_camera() -> None:
    corner, u, v = np.array([-0.9, -0.7, 2.5]), np.array([1.6, 0.0, 0.8]), np.array([0.0, 1.5, 0.0])
    board = Rectangle(tuple(corner), tuple(u), tuple(v))
    sequence = SyntheticSequence(5, WIDTH, HEIGHT, scene=Scene((board,), seed=1))
    R_world_left, center = sequence.pose(4)
    to_rectified = sequence.rig.left.R @ R_world_left.T
    rays, origin = rectified_rays(sequence.rig), to_rectified @ (corner - center)
    normal = to_rectified @ np.cross(u, v)
    depth_m = (normal @ origin) / (rays @ normal)
    on_plane = depth_m[..., None] * rays - origin
    a, b = (on_plane @ (to_rectified @ edge) / (edge @ edge) for edge in (u, v))
    inside = (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)

    truth = sequence[4].truth_depth_m
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(np.isfinite(truth), inside)
    # float32 at 3 m; the rotations are rounded to 12 decimals
    np.testing.assert_allclose(truth[inside], depth_m[inside], rtol=1e-7)


def test_sphere_is_hit_at_distance_minus_radius() -> None:
    depth_m, _ = depth_of(Sphere((0.0, 0.0, 3.0), 0.4))
    assert depth_m[50, 70] == pytest.approx(2.6, abs=1e-12)  # the ray along the axis
    y, x = np.indices(depth_m.shape)
    rays = np.stack([(x - 70) / 150, (y - 50) / 140, np.ones(x.shape)], axis=-1)
    # |t r - c|^2 = R^2 with c = (0, 0, 3)
    squared = (rays**2).sum(axis=-1)
    root = 9.0 - squared * (9.0 - 0.16)
    np.testing.assert_array_equal(np.isfinite(depth_m), root >= 0)
    hit = root >= 0
    np.testing.assert_allclose(depth_m[hit], (3.0 - np.sqrt(root[hit])) / squared[hit], rtol=1e-12)


def test_cylinder_has_its_closed_form_and_ends_with_its_axis() -> None:
    depth_m, _ = depth_of(Cylinder((0.0, -0.2, 2.0), (0.0, 0.5, 0.0), 0.03))
    middle = depth_m[:, 70]
    y_m = (np.arange(HEIGHT) - 50) / 140 * 1.97
    np.testing.assert_array_equal(np.isfinite(middle), (y_m >= -0.2) & (y_m <= 0.3))
    np.testing.assert_allclose(middle[np.isfinite(middle)], 1.97, rtol=1e-12)
    slope = 2 / 150  # two pixels beside the axis: (t slope)^2 + (t - 2)^2 = 0.03^2
    t = (2 - math.sqrt(4 - (1 + slope**2) * (4 - 0.03**2))) / (1 + slope**2)
    np.testing.assert_allclose(depth_m[50, [68, 72]], t, rtol=1e-12)
    assert np.isfinite(depth_m[50]).sum() == 5  # 0.06 m at 2 m is 4.5 px wide


def test_nearer_surface_is_visible_and_nothing_behind_the_camera() -> None:
    wall = Rectangle((-9.0, -9.0, 4.0), (18.0, 0.0, 0.0), (0.0, 18.0, 0.0))
    behind = Rectangle((-9.0, -9.0, -2.0), (18.0, 0.0, 0.0), (0.0, 18.0, 0.0))
    depth_m, _ = depth_of(behind, wall, Sphere((0.0, 0.0, 3.0), 0.4), Sphere((0.0, 0.0, -3.0), 0.4))
    assert depth_m[50, 70] == pytest.approx(2.6)
    assert depth_m[0, 0] == pytest.approx(4.0)


def test_wall_to_the_left_of_a_near_board_is_occluded_in_the_right_camera() -> None:
    near_m, far_m, half_m = 1.5, 3.0, 0.205
    wall = Rectangle((-9.0, -9.0, far_m), (18.0, 0.0, 0.0), (0.0, 18.0, 0.0))
    board = Rectangle((-half_m, -9.0, near_m), (2 * half_m, 0.0, 0.0), (0.0, 18.0, 0.0))
    depth_m, shadow = depth_of(wall, board)
    x = np.arange(WIDTH)
    on_board = np.abs(x - 70) <= half_m / near_m * 150
    # Through the board's left edge the right camera sees the wall at B + (-half - B) far / near.
    hidden_from = 70 + (BASELINE_M + (-half_m - BASELINE_M) * far_m / near_m) / far_m * 150
    hidden = (x > hidden_from) & (x < 70) & ~on_board
    assert hidden.sum() == 6  # f B (1 / near - 1 / far), the step in disparity
    np.testing.assert_array_equal(shadow, np.broadcast_to(hidden, shadow.shape))
    np.testing.assert_array_equal(depth_m[7], np.where(on_board, near_m, far_m))


def test_rays_of_the_raw_pixels_project_back_onto_them(room: SyntheticSequence) -> None:
    for camera in (room.rig.left, room.rig.right):
        rays = np.empty((2 * HEIGHT, 2 * WIDTH, 2))
        pixel_rays(0, 2 * HEIGHT, camera.K, camera.D, rays)
        points = np.dstack([rays, np.ones(rays.shape[:2])]).reshape(-1, 1, 3)
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.D)
        y, x = np.indices(rays.shape[:2]) / 2 - 0.25
        # The iteration converges to rounding error: nanopixels.
        np.testing.assert_allclose(pixels.reshape(2 * HEIGHT, 2 * WIDTH, 2), np.stack([x, y], axis=-1), atol=1e-9)


def test_rig_is_verged_and_asymmetric_and_its_rows_agree(room: SyntheticSequence) -> None:
    rig = room.rig
    assert rig.f_px != rig.fy_px and rig.cx_left != rig.cx_right and not np.allclose(rig.left.D, rig.right.D)
    assert math.degrees(math.asin(-R_RIGHT_LEFT[2, 0])) == pytest.approx(2.0, abs=0.01)
    world = np.array([[-0.8, 0.3, 2.2], [0.9, -0.7, 3.1], [0.1, 0.6, 1.4], [-0.2, -0.1, 7.0]])  # raw left frame, meters
    R_right_left = rig.right.R.T @ rig.left.R
    center = rig.left.R.T @ np.array([rig.baseline_m, 0, 0])
    pixels = []
    for camera, points in ((rig.left, world), (rig.right, (world - center) @ R_right_left.T)):
        raw, _ = cv2.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.K, camera.D)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-12)
        undistort = getattr(cv2, "undistortPointsIter", None)  # folded into undistortPoints by OpenCV 5
        arguments = (raw, camera.K, camera.D)
        if undistort is None:
            flat = cv2.undistortPoints(*arguments, R=camera.R, P=camera.P, criteria=criteria)
        else:
            flat = undistort(*arguments, camera.R, camera.P, criteria)
        pixels.append(flat.reshape(-1, 2))
    np.testing.assert_allclose(R_right_left, R_RIGHT_LEFT, atol=1e-11)
    np.testing.assert_allclose(pixels[0][:, 1], pixels[1][:, 1], atol=1e-6)
    depth_m = (world @ rig.left.R.T)[:, 2]
    expected = rig.f_px * rig.baseline_m / depth_m + rig.doffs_px
    np.testing.assert_allclose(pixels[0][:, 0] - pixels[1][:, 0], expected, atol=1e-6)


def test_disparity_is_that_of_the_depth_and_in_the_default_search_range() -> None:
    sequence = SyntheticSequence(1)
    frame, rig = sequence[0], sequence.rig
    expected = rig.f_px * rig.baseline_m / frame.truth_depth_m.astype(np.float64) + rig.cx_left - rig.cx_right
    np.testing.assert_allclose(frame.truth_disparity_px, expected, rtol=3e-7)  # two roundings to float32
    assert frame.truth_disparity_px.dtype == frame.truth_depth_m.dtype == np.float32
    assert 0 < frame.truth_disparity_px.min() < 20 and 35 < frame.truth_disparity_px.max() < 63


def test_block_matching_finds_the_room() -> None:
    sequence = SyntheticSequence(1)
    frame = sequence[0]
    left, right = (
        rectify(sequence.rig.left, frame.pair.left.pixels),
        rectify(sequence.rig.right, frame.pair.right.pixels),
    )
    disparity = cv2.StereoBM.create(64, 15).compute(left, right) / 16.0
    valid = disparity >= 0
    error = np.abs(disparity - frame.truth_disparity_px)[valid & ~frame.occluded]
    assert valid.mean() > 0.7  # 11 % are left of the search range
    assert np.median(error) < 0.1  # the step of block matching is 1/16 px


def test_truth_warps_the_right_image_onto_the_left(room: SyntheticSequence) -> None:
    frame, rig = room[2], room.rig
    left = rectify(rig.left, frame.pair.left.pixels).astype(np.float32)
    right = rectify(rig.right, frame.pair.right.pixels).astype(np.float32) / np.float32(0.97)
    y, x = np.indices(left.shape, dtype=np.float32)

    def difference(disparity_px: npt.NDArray[np.float32]) -> float:
        warped = cv2.remap(right, x - disparity_px, y, cv2.INTER_CUBIC)
        return float(np.abs(warped - left)[~frame.occluded].mean())

    truth = frame.truth_disparity_px
    best = difference(truth)
    for wrong in (
        truth - 1,
        truth + 1,
        truth * np.float32(1.1),
        truth * np.float32(0.9),
        truth - np.float32(rig.doffs_px),
    ):
        assert difference(wrong) > 2 * best
    for near in (truth - np.float32(0.25), truth + np.float32(0.25)):
        assert difference(near) > 1.1 * best
    # Occluded pixels cannot be predicted.
    hidden = frame.occluded & (x - truth > 1)
    assert np.abs(cv2.remap(right, x - truth, y, cv2.INTER_CUBIC) - left)[hidden].mean() > 4 * best


def test_sphere_is_in_the_image_where_the_truth_is() -> None:
    ball = Sphere((-0.35, 0.25, 1.8), 0.3, Texture(mean=220.0, contrast=0.0))
    sequence = SyntheticSequence(3, 2 * WIDTH, 2 * HEIGHT, scene=Scene((ball,), seed=1))
    frame = sequence[2]
    seen = rectify(sequence.rig.left, frame.pair.left.pixels) > 120  # half way from background to ball
    truth = np.isfinite(frame.truth_depth_m)
    assert truth.sum() > 4000
    for axis in (0, 1):
        # Centroids of some thousand pixels: the silhouette's rounding averages out.
        assert np.argwhere(seen)[:, axis].mean() == pytest.approx(np.argwhere(truth)[:, axis].mean(), abs=0.05)
    assert (seen ^ truth).sum() < 0.02 * truth.sum()
    assert not frame.occluded[~truth].any()


def test_left_border_is_outside_the_right_image(room: SyntheticSequence) -> None:
    frame = room[0]
    x_right = np.arange(WIDTH) - frame.truth_disparity_px
    assert frame.occluded[x_right < 0].all() and (x_right < 0).mean() > 0.01
    assert 0.03 < frame.occluded.mean() < 0.15


def test_point_outside_the_raw_right_image_counts_as_occluded() -> None:
    # So close that the two images hardly overlap.
    wall = Rectangle((-9.0, -9.0, 0.4), (18.0, 0.0, 0.0), (0.0, 18.0, 0.0))
    sequence = SyntheticSequence(1, WIDTH, HEIGHT, scene=Scene((wall,), seed=1))
    rig, frame = sequence.rig, sequence[0]
    points = rectified_rays(rig) * frame.truth_depth_m[..., None] - np.array([rig.baseline_m, 0, 0])
    raw, _ = cv2.projectPoints(
        (points @ rig.right.R).reshape(-1, 1, 3), np.zeros(3), np.zeros(3), rig.right.K, rig.right.D
    )
    u, v = raw.reshape(HEIGHT, WIDTH, 2).transpose(2, 0, 1)
    x_right = np.arange(WIDTH) - frame.truth_disparity_px
    inside = (u >= 0) & (u <= WIDTH - 1) & (v >= 0) & (v <= HEIGHT - 1) & (x_right >= 0) & (x_right <= WIDTH - 1)
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(frame.occluded, ~inside)


def test_right_camera_is_darker_and_noise_has_its_deviation() -> None:
    wall = Rectangle((-99.0, -99.0, 4.0), (198.0, 0.0, 0.0), (0.0, 198.0, 0.0), FLAT)
    pair = SyntheticSequence(1, WIDTH, HEIGHT, scene=Scene((wall,), seed=1))[0].pair
    # 19320 pixels: the mean is known to 0.005 gray levels, the deviation to 0.5 %
    assert pair.left.pixels.mean() == pytest.approx(120.0, abs=0.03)
    assert pair.right.pixels.mean() == pytest.approx(0.97 * 120.0, abs=0.03)
    deviation = math.sqrt(1.5**2 / 6 + 1 / 12)  # triangular noise and rounding
    assert pair.left.pixels.std() == pytest.approx(deviation, rel=0.03)
    noise = pair.left.pixels - pair.left.pixels.mean(), pair.right.pixels - pair.right.pixels.mean()
    assert abs((noise[0] * noise[1]).mean()) < 0.02  # the cameras' noise is independent
    assert abs((noise[0][:, 1:] * noise[0][:, :-1]).mean()) < 0.02


@pytest.mark.parametrize(("period_m", "repeats"), [(0.16, True), (0.0, False)])
def test_grid_repeats_and_noise_does_not(period_m: float, repeats: bool) -> None:
    wall = Rectangle((-9.0, -9.0, 2.0), (18.0, 0.0, 0.0), (0.0, 18.0, 0.0), Texture(period_m=period_m))
    image = np.empty((HEIGHT, WIDTH), np.uint8)
    rays = np.empty((2 * HEIGHT, 2 * WIDTH, 2))
    K = np.array([[200.0, 0.0, 70.0], [0.0, 200.0, 50.0], [0.0, 0.0, 1.0]])  # 16 px a period at 2 m
    pixel_rays(0, 2 * HEIGHT, K, np.zeros(5), rays)
    render(0, HEIGHT, Scene((wall,), 3).packed(), ORIGIN, STRAIGHT, rays, 1 / 200, 1.0, 0.0, 3, 0, image)
    level = image.astype(np.float64)
    assert level.std() > 15
    correlation = np.corrcoef(level[:, 16:].ravel(), level[:, :-16].ravel())[0, 1]
    assert (correlation > 0.999) if repeats else (abs(correlation) < 0.5)


def test_equal_arguments_give_equal_bytes_and_another_seed_gives_other_textures(room: SyntheticSequence) -> None:
    first, longer = room[1], SyntheticSequence(frames=9, width=WIDTH, height=HEIGHT)[1]
    other = SyntheticSequence(frames=4, width=WIDTH, height=HEIGHT, seed=8)[1]
    assert digest(first) == digest(room[1]) == digest(longer)
    assert (first.pair.left.pixels != other.pair.left.pixels).mean() > 0.9
    np.testing.assert_array_equal(first.truth_depth_m, other.truth_depth_m)
    assert (first.truth_depth_m != room[2].truth_depth_m).mean() > 0.9  # the camera moves


def test_bytes_are_the_same_on_every_machine(room: SyntheticSequence) -> None:
    assert digest(room[3]) == "8f7ea97e0e76c91ffa5de55a548a8ea343b0410500dd56419e93f7d2ef967bba"


def test_sequence_protocol_and_stamps(room: SyntheticSequence) -> None:
    assert len(room) == 4
    stamps = [frame.pair.left.stamp_ns for frame in room]
    assert stamps == [1_700_000_000_000_000_000 + i * 100_000_000 for i in range(4)]
    assert [frame.pair.right.stamp_ns for frame in room[1:3]] == stamps[1:3]
    assert digest(room[-1]) == digest(room[3])
    pair = room[0].pair
    assert (pair.left.frame_id, pair.right.frame_id) == ("left_camera_optical_frame", "right_camera_optical_frame")
    assert pair.left.pixels.shape == (HEIGHT, WIDTH) and pair.left.encoding == "mono8"
    with pytest.raises(IndexError):
        room[4]
    thirds = SyntheticSequence(frames=4, width=WIDTH, height=HEIGHT, rate_hz=3.0)
    assert [thirds.stamp_ns(i) - thirds.stamp_ns(0) for i in range(4)] == [0, 333333333, 666666667, 1000000000]


@pytest.mark.parametrize("name", ["frames", "width", "height", "rate_hz"])
def test_zero_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} = 0 is not above 0: set a positive number"):
        SyntheticSequence(**{name: 0})


@pytest.mark.parametrize("seed", [-1, 2**31])
def test_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(ConfigError, match=f"seed = {seed} is outside 0..2147483647"):
        SyntheticSequence(seed=seed)


def test_bag_contains_the_sequence(room: SyntheticSequence, tmp_path: Path) -> None:
    path = tmp_path / "room.mcap"
    write_synthetic_bag(path, room)
    with BagReader(path) as bag:
        messages = [(message, bag.deserialize(message)) for message in bag.messages()]
    by_topic: dict[str, list[object]] = {}
    for message, content in messages:
        by_topic.setdefault(message.topic, []).append(content)
    sides = [f"/{side}/{name}" for side in ("left", "right") for name in ("camera_info", "image_raw")]
    assert sorted(by_topic) == [*sides, "/truth/disparity"]
    assert {len(contents) for contents in by_topic.values()} == {4}

    rig = StereoRig.from_infos(by_topic["/left/camera_info"][0], by_topic["/right/camera_info"][0])
    np.testing.assert_array_equal(rig.right.P, room.rig.right.P)
    np.testing.assert_array_equal(rig.left.D, room.rig.left.D)
    for i, frame in enumerate(room):
        for side, raw in (("left", frame.pair.left), ("right", frame.pair.right)):
            image = by_topic[f"/{side}/image_raw"][i]
            assert bytes(image.data) == raw.pixels.tobytes() and image.header.frame_id == raw.frame_id
        truth = by_topic["/truth/disparity"][i]
        assert truth.header.stamp.nanosec == i * 100_000_000 and truth.delta_d == TRUTH_STEP_PX
        published = published_disparity(truth)
        error_px = published + rig.doffs_px - frame.truth_disparity_px
        assert np.abs(error_px).max() <= TRUTH_STEP_PX / 2 + 1e-5
        # dZ = Z^2 / (f T) dd
        bound_m = frame.truth_depth_m**2 / (truth.f * truth.t) * TRUTH_STEP_PX
        assert (np.abs(truth.f * truth.t / published - frame.truth_depth_m) < bound_m).all()


def test_bag_marks_pixels_without_surface(tmp_path: Path) -> None:
    ball = Scene((Sphere((0.0, 0.0, 2.0), 0.3),), seed=1)
    for name, scene in (("ball", ball), ("nothing", Scene((Sphere((0.0, 0.0, -2.0), 0.3),), seed=1))):
        sequence = SyntheticSequence(1, WIDTH, HEIGHT, scene=scene)
        write_synthetic_bag(tmp_path / f"{name}.mcap", sequence)
        with BagReader(tmp_path / f"{name}.mcap") as bag:
            truth = next(bag.deserialize(m) for m in bag.messages() if m.topic == "/truth/disparity")
        surface = np.isfinite(sequence[0].truth_depth_m)
        assert surface.any() == (name == "ball")
        np.testing.assert_array_equal(np.isfinite(published_disparity(truth)), surface)


def test_bag_is_reproducible_and_not_replaced_without_overwrite(room: SyntheticSequence, tmp_path: Path) -> None:
    path, again = tmp_path / "room.mcap", tmp_path / "again.mcap"
    write_synthetic_bag(path, room)
    write_synthetic_bag(again, room)
    assert path.read_bytes() == again.read_bytes()
    with pytest.raises(BagError, match=r"room\.mcap: already exists: remove it"):
        write_synthetic_bag(path, room)
    path.write_bytes(b"")
    write_synthetic_bag(path, room, overwrite=True)
    assert path.read_bytes() == again.read_bytes()

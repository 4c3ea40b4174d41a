# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stereo pair among topics of any names."""

from __future__ import annotations

import pytest

from stereo_depth_ros.bags.topics import StereoTopics, find_stereo_topics
from stereo_depth_ros.core.errors import TopicError

IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))


def topics(*names: str) -> dict[str, str]:
    """Types by name: .../compressed is a CompressedImage, a name with info is a CameraInfo."""
    return {n: INFO if "info" in n else COMPRESSED if n.endswith("compressed") else IMAGE for n in names}


@pytest.mark.parametrize(
    ("left", "right", "left_info", "right_info"),
    [
        ("/left/image_raw", "/right/image_raw", "/left/camera_info", "/right/camera_info"),
        ("/cam0/image_raw", "/cam1/image_raw", "/cam0/camera_info", "/cam1/camera_info"),
        ("/camera/infra1/image", "/camera/infra2/image", "/camera/infra1/camera_info", "/camera/infra2/camera_info"),
        ("/kitti/image_00", "/kitti/image_01", "/kitti/info_00", "/kitti/info_01"),
        ("/kitti/image_02", "/kitti/image_03", "/kitti/info_02", "/kitti/info_03"),
        ("/img_l", "/img_r", "/info_l", "/info_r"),
        ("/leftImage", "/rightImage", "/leftImage_info", "/rightImage_info"),
        ("/camleft/raw", "/camright/raw", "/camleft/camera_info", "/camright/camera_info"),
        ("/rig/left/left_image", "/rig/right/right_image", "/rig/left/camera_info", "/rig/right/camera_info"),
        ("/cam9/image", "/cam10/image", "/cam9/camera_info", "/cam10/camera_info"),
    ],
)
def test_names_of_cameras(left: str, right: str, left_info: str, right_info: str) -> None:
    found = find_stereo_topics(topics("/rear/image", right_info, right, left, left_info, "/rear/camera_info"))
    assert found == StereoTopics(left, right, left_info, right_info, compressed=False, rectified=False)


def test_the_best_of_several_pairs() -> None:
    raw = ["/left/image_raw", "/right/image_raw"]
    packed = ["/left/image_raw/compressed", "/right/image_raw/compressed"]
    rectified = ["/left/image_rect", "/right/image_rect"]
    color = ["/left/image_color", "/right/image_color"]
    infos = ["/left/camera_info", "/right/camera_info"]
    best_first = [raw, packed, color, rectified]
    for index, best in enumerate(best_first):
        found = find_stereo_topics(topics(*infos, *(name for pair in best_first[index:] for name in pair)))
        assert [found.left_image, found.right_image] == best
        assert [found.left_info, found.right_info] == infos
        assert (found.compressed, found.rectified) == (best is packed, best is rectified)


def test_a_pair_with_camera_infos_is_preferred_over_a_raw_one_without() -> None:
    found = find_stereo_topics(
        topics("/a/cam0/image", "/a/cam1/image", "/b/left/image_rect", "/b/right/image_rect")
        | topics("/b/left/camera_info", "/b/right/camera_info")
    )
    assert (found.left_image, found.left_info) == ("/b/left/image_rect", "/b/left/camera_info")


def test_camera_infos_that_are_not_siblings_are_found_by_similarity() -> None:
    found = find_stereo_topics(
        topics("/front/left", "/front/right", "/rear/info/left", "/rear/info/right", "/front/info_l", "/front/info_r")
    )
    assert (found.left_info, found.right_info) == ("/front/info_l", "/front/info_r")


def test_missing_camera_infos() -> None:
    found = find_stereo_topics(topics("/cam0/image_raw", "/cam1/image_raw", "/imu_info"))
    assert (found.left_info, found.right_info) == (None, None)


def test_given_names_are_used() -> None:
    names = topics("/left/image_raw", "/right/image_raw", "/x/up", "/x/down", "/x/camera_info", "/a/left", "/a/right")
    assert find_stereo_topics(names, left="/x/up", right="/left/image_raw").left_image == "/x/up"
    assert find_stereo_topics(names, left="/a/left").right_image == "/a/right"
    assert find_stereo_topics(names, right="/right/image_raw").left_image == "/left/image_raw"
    found = find_stereo_topics(names, left="/right/image_raw", right="/left/image_raw")  # given names are not exchanged
    assert found.left_image == "/right/image_raw"


@pytest.mark.parametrize(
    ("names", "left", "right", "match"),
    [
        ([], None, None, r"no image topics: record sensor_msgs/Image or"),
        (["/a", "/b"], None, None, r"no stereo pair among the image topics /a, /b: name both"),
        (["/left/a", "/right/b"], None, None, r"no stereo pair among the image topics /left/a, /right/b"),
        (["/left/a", "/right/a/compressed"], None, None, "no stereo pair"),
        (["/cam0", "/cam1", "/cam2"], None, None, r"2 stereo pairs are equally good \(/cam0 with /cam1; /cam1 with"),
        (["/left", "/right"], "/left", "/left", "left and right are the same topic /left"),
        (["/left", "/right"], "/west", None, "no topic /west: choose among the image topics /left, /right"),
        (["/left", "/right"], None, "/east", "no topic /east: choose among the image topics /left, /right"),
        (
            ["/left", "/info"],
            "/info",
            None,
            "topic /info is sensor_msgs/msg/CameraInfo, not an image: choose among the image topics /left",
        ),
        (["/left", "/up"], "/up", None, "no partner for /up among the image topics /left, /up"),
        (
            ["/left", "/right/compressed"],
            "/left",
            "/right/compressed",
            r"left /left is sensor_msgs/msg/Image and right",
        ),
    ],
)
def test_errors_list_the_topics(names: list[str], left: str | None, right: str | None, match: str) -> None:
    with pytest.raises(TopicError, match=match) as caught:
        find_stereo_topics(topics(*names), left, right)
    assert caught.value.settings == ("left", "right")
    assert caught.value.remedy and caught.value.remedy not in caught.value.problem


@pytest.mark.parametrize(
    "kind",
    ["foxglove_msgs/msg/CompressedVideo", "foxglove.CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"],
)
def test_video_is_named_with_its_remedy(kind: str) -> None:
    video = {"/left/image_raw/ffmpeg": kind, "/right/image_raw/ffmpeg": kind}
    text = (
        r"^/left/image_raw/ffmpeg, /right/image_raw/ffmpeg are video .*H\.264.*: decode it by ros2 run image_transport"
    )
    with pytest.raises(TopicError, match=text):
        find_stereo_topics(video)
    with pytest.raises(TopicError, match=r"not an image.*: decode it by ros2 run image_transport"):
        find_stereo_topics(video, *video)
    images = {"/left/image_raw": "sensor_msgs/msg/Image", "/right/image_raw": "sensor_msgs/msg/Image"}
    assert find_stereo_topics(video | images).left_image == "/left/image_raw"


@pytest.mark.parametrize(
    ("names", "image", "info"),
    [  # of both cameras, with * for left and right
        (["/zed/*/image_raw_color", "/zed/*/image_rect_color", "/zed/*/camera_info", "/zed/*/camera_info_raw"],
         "/zed/*/image_raw_color", "/zed/*/camera_info_raw"),
        (["/zed/*/image_rect_color", "/zed/*/camera_info", "/zed/*/camera_info_raw"],
         "/zed/*/image_rect_color", "/zed/*/camera_info"),
        (["/zed/*_raw/image_raw_gray", "/zed/*_raw/camera_info", "/zed/*/image_rect_gray", "/zed/*/camera_info"],
         "/zed/*_raw/image_raw_gray", "/zed/*_raw/camera_info"),
        (["/zed/*/color/raw/image", "/zed/*/color/raw/camera_info", "/zed/*/color/rect/image",
          "/zed/*/color/rect/camera_info", "/zed/*/gray/rect/image", "/zed/*/gray/rect/image/camera_info"],
         "/zed/*/color/raw/image", "/zed/*/color/raw/camera_info"),
        (["/oak/*/image_raw", "/oak/*/image_rect", "/oak/*/camera_info"], "/oak/*/image_raw", "/oak/*/camera_info"),
        (["/*/image_raw", "/*/camera_info", "/*/image_rect", "/*/camera_info_rect"],
         "/*/image_raw", "/*/camera_info"),
        (["/*/image_rect", "/*/camera_info", "/*/camera_info_rect"], "/*/image_rect", "/*/camera_info_rect"),
        (["/*/image_rect", "/*/camera_info_raw"], "/*/image_rect", "/*/camera_info_raw"),  # of it only P counts
        (["/*/image_raw", "/*/camera_info_rect"], "/*/image_raw", None),
        (["/stereo/*/image_raw", "/stereo/*/image_mono", "/stereo/*/image_color", "/stereo/*/image_rect",
          "/stereo/*/image_rect_color", "/stereo/*/camera_info"], "/stereo/*/image_raw", "/stereo/*/camera_info"),
        (["/stereo/*/image_mono", "/stereo/*/image_color", "/stereo/*/camera_info"],
         "/stereo/*/image_mono", "/stereo/*/camera_info"),
        (["/rgb_*", "/depth_*", "/camera_info_*"], "/rgb_*", "/camera_info_*"),  # Isaac Sim
        (["/front/*/rgb", "/front/*/depth", "/front/*/camera_info"], "/front/*/rgb", "/front/*/camera_info"),
        (["/carla/ego/rgb_*/image", "/carla/ego/depth_*/image", "/carla/ego/semantic_segmentation_*/image",
          "/carla/ego/rgb_*/camera_info", "/carla/ego/depth_*/camera_info"],
         "/carla/ego/rgb_*/image", "/carla/ego/rgb_*/camera_info"),
        (["/*_camera", "/*_camera/camera_info"], "/*_camera", "/*_camera/camera_info"),  # Gazebo
        (["/cam/*", "/info_raw/*", "/info/*"], "/cam/*", "/info/*"),
        (["/cam/*_raw", "/info_raw/*", "/info/*"], "/cam/*_raw", "/info_raw/*"),
        (["/depth_camera/*/image_raw", "/depth_camera/*/camera_info"],
         "/depth_camera/*/image_raw", "/depth_camera/*/camera_info"),
    ],
)  # fmt: skip
def test_kinds_of_images_have_camera_infos_of_their_kind(names: list[str], image: str, info: str | None) -> None:
    found = find_stereo_topics(topics(*(name.replace("*", side) for name in names for side in ("left", "right"))))
    assert (found.left_image, found.right_image) == (image.replace("*", "left"), image.replace("*", "right"))
    expected = (None, None) if info is None else (info.replace("*", "left"), info.replace("*", "right"))
    assert (found.left_info, found.right_info) == expected


def test_of_the_transports_of_an_image_the_readable_ones_are_found() -> None:
    base = ["/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"]
    infos = topics("/camera/infra1/camera_info", "/camera/infra2/camera_info")
    theora = "theora_image_transport/msg/Packet"
    subtopics = {f"{name}/{last}": COMPRESSED for name in base for last in ("compressedDepth", "zstd", "compressed")}
    subtopics |= {f"{name}/theora": theora for name in base}
    found = find_stereo_topics(topics(*base) | infos | subtopics)
    assert (found.left_image, found.left_info, found.rectified) == (base[0], "/camera/infra1/camera_info", True)
    found = find_stereo_topics(infos | subtopics)
    assert (found.left_image, found.left_info) == (f"{base[0]}/compressed", "/camera/infra1/camera_info")
    for last, why in (("zstd", "are compressed by zstd"), ("theora", r"are video \(theora_image_transport")):
        only = {name: kind for name, kind in subtopics.items() if name.endswith(last)}
        with pytest.raises(TopicError, match=rf"infra1/image_rect_raw/{last}, .* {why}.*: decode it by ros2 run"):
            find_stereo_topics(infos | only)


def test_left_and_right_are_preferred_over_numbers() -> None:
    of_rig = topics("/left_1/image", "/left_2/image", "/right_1/image", "/right_2/image", "/cam0/image", "/cam1/image")
    with pytest.raises(TopicError, match=r"2 stereo pairs .* \(/left_1/image with /right_1/image; /left_2"):
        find_stereo_topics(of_rig)
    assert find_stereo_topics(of_rig, left="/left_2/image").right_image == "/right_2/image"
    assert find_stereo_topics(of_rig, left="/cam0/image").right_image == "/cam1/image"


def test_the_camera_info_of_another_camera_is_not_taken() -> None:
    found = find_stereo_topics(topics("/left/image", "/right/image", "/left/camera_info", "/camera_info"))
    assert (found.left_info, found.right_info) == (None, None)


def test_both_images_side_by_side_in_one_topic() -> None:
    infos = ["/stereo/left/camera_info", "/stereo/right/camera_info"]
    found = find_stereo_topics(topics("/stereo/image_raw", "/stereo/image_raw/compressed", *infos), side_by_side=True)
    assert found == StereoTopics(*["/stereo/image_raw"] * 2, *infos, False, False, side_by_side=True)
    zed = topics("/zed/stereo/image_rect_color", "/zed/left/image_rect_color", "/zed/right/image_rect_color")
    zed |= topics(*(f"/zed/{side}/camera_info{raw}" for side in ("left", "right") for raw in ("", "_raw")))
    found = find_stereo_topics(zed, side_by_side=True)
    assert (found.left_image, found.left_info) == ("/zed/stereo/image_rect_color", "/zed/left/camera_info")
    with pytest.raises(TopicError, match=r"no topic holds both .*/left, /right are of one camera each: read them"):
        find_stereo_topics(topics("/left", "/right"), side_by_side=True)
    with pytest.raises(TopicError, match=r"2 topics are equally good \(/a; /b\): name the topic"):
        find_stereo_topics(topics("/a", "/b"), side_by_side=True)
    assert find_stereo_topics(topics("/a", "/b"), left="/b", side_by_side=True).right_image == "/b"
    with pytest.raises(TopicError, match="left /a and right /b are two topics, side by side is one"):
        find_stereo_topics(topics("/a", "/b"), "/a", "/b", side_by_side=True)

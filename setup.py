# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ament_python package, also installable with pip; the version is the one of package.xml."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

NAME = "stereo_depth_ros"
NODES = (
    "rectify_node",
    "disparity_node",
    "point_cloud_node",
    "depth_node",
    "stereo_depth_node",
    "feature_node",
    "calibration_monitor",
    "calibration_node",
    "replay_node",
)
# setup.py may be a link in a build folder (colcon --symlink-install)
MANIFEST = ElementTree.parse(Path(__file__).resolve().with_name("package.xml")).getroot()


def manifest_text(tag: str) -> str:
    """Text of an element of package.xml on one line."""
    return " ".join((MANIFEST.findtext(tag) or "").split())


def shared_files(folder: str) -> tuple[str, list[str]]:
    """Files of a folder of the repository, to be installed into share/stereo_depth_ros/<folder>."""
    return f"share/{NAME}/{folder}", sorted(str(path) for path in Path(folder).glob("*") if path.is_file())


setup(
    name=NAME,
    version=manifest_text("version"),
    description=manifest_text("description"),
    license=manifest_text("license"),
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(shared_files(folder) for folder in ("launch", "config", "bags")),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=[
        "lz4",
        "mcap",
        "numba",
        "numpy",
        "opencv-python-headless",
        "rich",
        "rosbags",
        "ruamel.yaml",
        "typer",
        "zstandard",
    ],
    extras_require={
        # for machines without ROS 2; common-interfaces brings sensor_msgs, stereo_msgs, diagnostic_msgs and std_srvs,
        # rclpy brings rcl_interfaces and rosgraph_msgs
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp"],
        "graph_cut": ["PyMaxflow"],  # optional because it is under the GPL
        "onnx": ["onnxruntime"],
        "test": [
            *("PyMaxflow", "colcon-common-extensions", "mypy", "onnx", "onnxruntime"),
            *("pytest", "pytest-xdist", "ruff"),
        ],
    },
    entry_points={
        "console_scripts": [
            "stereo-depth = stereo_depth_ros.cli.main:main",
            *(f"{node} = stereo_depth_ros.nodes.{node}:main" for node in NODES),
            "health_node = stereo_depth_ros.nodes.calibration_monitor:main",  # its earlier name
        ]
    },
)

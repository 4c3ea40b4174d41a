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
    "view_node",
    "light_stripe_node",
    "calibration_monitor",
    "calibration_node",
    "structured_light_node",
    "replay_node",
)
ROOT = Path(__file__).resolve().parent  # setup.py may be a link in a build folder (colcon --symlink-install)
MANIFEST = ElementTree.parse(ROOT / "package.xml").getroot()

# The oldest versions with which the tests pass, on Python 3.10.
REQUIREMENTS = [
    "lz4>=4.0.2",
    "mcap>=1.1.1",
    "numba>=0.58.1",
    "numpy>=1.26.4",
    "opencv-python-headless>=4.6.0.66",
    "rich>=14.3.0",
    "rosbags>=0.11.6",  # earlier ones mix up the order of messages and do not refuse cut ones
    "ruamel.yaml>=0.17.21",
    "shellingham>=1.5.4",
    "typer>=0.26.0",  # earlier ones lose the help of arguments with the newest click
    "zstandard>=0.22.0",
]
GRAPH_CUT = ["PyMaxflow>=1.3.0"]  # optional because it is under the GPL
ONNX = ["onnxruntime>=1.21.0"]
LAS = ["laspy>=2.6.1", "lazrs>=0.7.0"]
EXTRAS = {
    # for machines without ROS 2; common-interfaces brings sensor_msgs, stereo_msgs, diagnostic_msgs and std_srvs,
    # rclpy brings rcl_interfaces and rosgraph_msgs
    "ros": ["ros-jazzy-common-interfaces>=5.3.6", "ros-jazzy-rclpy>=7.1.6", "ros-jazzy-rmw-fastrtps-cpp>=8.4.3"],
    "ros-kilted": [
        *("ros-kilted-common-interfaces>=5.5.1", "ros-kilted-rclpy>=9.1.2"),
        "ros-kilted-rmw-fastrtps-cpp>=9.3.3",
    ],
    "graph_cut": GRAPH_CUT,
    "onnx": ONNX,
    "las": LAS,
    "test": [
        *GRAPH_CUT,
        *ONNX,
        *LAS,
        *("catkin-pkg>=1.0.0", "colcon-common-extensions>=0.3.0", "hypothesis>=6.98.0", "onnx>=1.16.0"),
        "PyYAML>=6.0.1",
        *("pytest>=8.0.0", "pytest-xdist>=3.5.0"),
        "setuptools>=70.1",  # the first that builds a wheel by itself
        "trimesh>=4.6.0",
    ],
    "lint": ["mypy>=2.0.0", "ruff>=0.14.0"],
}


def manifest_text(tag: str) -> str:
    """Text of an element of package.xml on one line."""
    return " ".join((MANIFEST.findtext(tag) or "").split())


def shared_files(folder: str) -> tuple[str, list[str]]:
    """Files of a folder of the repository, to be installed into share/stereo_depth_ros/<folder>."""
    return f"share/{NAME}/{folder}", sorted(str(path) for path in Path(folder).glob("*") if path.is_file())


def maintainer_email() -> str:
    """The address of the maintainer in package.xml."""
    maintainer = MANIFEST.find("maintainer")
    return "" if maintainer is None else maintainer.get("email", "")


setup(
    name=NAME,
    version=manifest_text("version"),
    description=manifest_text("description"),
    long_description=(ROOT / "README.md").read_text("utf-8"),
    long_description_content_type="text/markdown",
    maintainer=manifest_text("maintainer"),
    maintainer_email=maintainer_email(),
    license=manifest_text("license"),
    license_files=["LICENSE"],
    keywords=["ROS", "stereo", "depth", "disparity", "point cloud", "calibration", "rectification", "computer vision"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Developers",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 14)),
        "Topic :: Scientific/Engineering :: Image Processing",
        "Topic :: Scientific/Engineering :: Image Recognition",
        "Typing :: Typed",
    ],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(shared_files(folder) for folder in ("launch", "config", "bags")),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=REQUIREMENTS,
    extras_require=EXTRAS,
    entry_points={
        "console_scripts": [
            "stereo-depth = stereo_depth_ros.cli.start:main",
            *(f"{node} = stereo_depth_ros.nodes.start:{node}" for node in NODES),
            "health_node = stereo_depth_ros.nodes.start:calibration_monitor",  # its earlier name
        ]
    },
)

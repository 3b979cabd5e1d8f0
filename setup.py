# SPDX-License-Identifier: BSD-3-Clause
"""Installation, by colcon (ament_python) and by pip alike; name and version come from package.xml."""

import sys
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

PACKAGE = ElementTree.parse("package.xml").getroot()
NAME = PACKAGE.findtext("name")

# What runs without ROS; an installation of ROS has the same by package.xml. Pinned versions are in requirements.txt.
REQUIRED = ["numpy>=1.26", "scipy", "pin", "numba", "rosbags", "mcap", "pyyaml", "typer>=0.12.5", "rich"]
REQUIRED += ["jinja2", "matplotlib"]
EXTRAS = {
    "sim": ["mujoco>=3.2"],  # the virtual robot, and coman export
    "drake": ["mujoco>=3.2", "drake"],  # its second physics engine
    "archive": ["pyarrow", "fsspec", "duckdb", "ray"],  # coman archive; only --address needs ray
    "view": ["rerun-sdk>=0.41"],  # coman view
}


def shared_files(*folders):
    """List what goes below share/NAME, folder by folder, as setuptools wants it."""
    files = (path for folder in folders for path in sorted(Path(folder).rglob("*")) if path.is_file())
    by_folder = {}
    for path in files:
        if "__pycache__" not in path.parts:
            by_folder.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(by_folder.items())


setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    maintainer=PACKAGE.findtext("maintainer"),
    maintainer_email=PACKAGE.find("maintainer").get("email"),
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["*.html", "*.j2", "*.css", "*.js", "*.svg", "*.yaml", "*.schema.json", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # A wheel goes without the recorded bags, which are larger than all the rest: they come with the sources.
        *shared_files("config", "launch", "rviz", "msg_defs/msg", *([] if "bdist_wheel" in sys.argv else ["bags"])),
    ],
    install_requires=REQUIRED,
    extras_require=EXTRAS,
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"predictor = {NAME}.ros.main:predictor",
            f"trajectory = {NAME}.ros.main:trajectory",
            f"virtual_robot = {NAME}.ros.main:virtual_robot",
            f"coman = {NAME}.cli.entry:main",
        ],
    },
)

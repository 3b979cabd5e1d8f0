# SPDX-License-Identifier: BSD-3-Clause
"""Installation, by colcon (ament_python) and by pip alike; name and version come from package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

PACKAGE = ElementTree.parse("package.xml").getroot()
NAME = PACKAGE.findtext("name")


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
    package_data={"": ["*.html", "*.j2", "*.css", "*.js", "*.svg", "*.yaml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared_files("config", "launch", "bags", "msg_defs/msg"),
    ],
    extras_require={"drake": ["drake"]},  # a second physics engine for the virtual robot
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"predictor = {NAME}.ros.main:predictor",
            f"trajectory = {NAME}.ros.main:trajectory",
            f"virtual_robot = {NAME}.ros.main:virtual_robot",
            f"coman = {NAME}.cli.main:main",
        ],
    },
)

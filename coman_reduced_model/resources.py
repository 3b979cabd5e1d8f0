# SPDX-License-Identifier: BSD-3-Clause
"""The files that the package ships: configurations and recorded bags.

They are found next to the sources (a checkout, an editable install, `colcon build --symlink-install`) or
in share/coman_reduced_model of the installation that this file belongs to. Neither needs ROS to be sourced.
"""

from __future__ import annotations

from pathlib import Path

from .errors import BagError, ConfigError

PACKAGE = "coman_reduced_model"


def share_path() -> Path:
    """Folder that holds config/, launch/ and bags/.

    Raises:
        ConfigError: the package was installed without them.
    """
    here = Path(__file__).resolve()
    if (here.parents[1] / "package.xml").is_file():
        return here.parents[1]
    for prefix in here.parents:  # <prefix>/lib/python3.x/site-packages/coman_reduced_model/resources.py
        share = prefix / "share" / PACKAGE
        if (share / "package.xml").is_file():
            return share
    raise ConfigError(f"{here.parent}: installed without its share/{PACKAGE} folder (config, launch, bags)")


def version() -> str:
    """Version of the package, as package.xml says."""
    text = (share_path() / "package.xml").read_text(encoding="utf-8")
    return text.partition("<version>")[2].partition("</version>")[0].strip()


def _names(folder: Path) -> str:
    return ", ".join(sorted(path.name for path in folder.glob("[!.]*"))) or "nothing"


def config_path(name: str = "coman") -> Path:
    """Shipped configuration or robot description.

    Args:
        name: file name in config/; `.yaml` is added to a name without suffix.

    Raises:
        ConfigError: there is no such file.
    """
    folder = share_path() / "config"
    path = folder / (name if Path(name).suffix else f"{name}.yaml")
    if not path.is_file():
        raise ConfigError(f"no shipped configuration '{name}'; there are: {_names(folder)}")
    return path


def bag_path(name: str) -> Path:
    """Shipped recorded bag, a folder or a file in bags/.

    Raises:
        BagError: there is no such bag.
    """
    folder = share_path() / "bags"
    path = folder / name
    if not name or not path.exists():
        raise BagError(f"no shipped bag '{name}'; there are: {_names(folder)}")
    return path

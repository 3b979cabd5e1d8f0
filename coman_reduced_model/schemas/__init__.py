# SPDX-License-Identifier: BSD-3-Clause
"""JSON Schemas of the files that commands write, and how these files are read, those of older versions too.

`summary.schema.json` and `diagnosis.schema.json` are beside this file, and `archive.schema.json` of the rows of an
archive's tables, which `doc/generate.py` writes. Within a schema version fields are only added.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import BagError

VERSION = 1  # of both; files of versions up to 0.2.0 have none and count as 0
KINDS = ("summary", "diagnosis")


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of `summary`, `diagnosis` or the rows of an `archive`."""
    found: dict[str, Any] = json.loads((Path(__file__).parent / f"{kind}.schema.json").read_text(encoding="utf-8"))
    return found


def read_result(path: str | Path) -> dict[str, Any]:
    """`summary.json` or `diagnosis.json`, of this or an older version: what that did not know is absent.

    Args:
        path: of the file.

    Raises:
        BagError: it cannot be read, is no JSON object, or is of a newer version.

    Example:
        >>> import coman_reduced_model as coman
        >>> coman.read_result("result/summary.json")["schema_version"]  # doctest: +SKIP
        1
    """
    path = Path(path)
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # of JSON or of the encoding
        raise BagError(f"{path}: is not JSON: {error}") from None
    if not isinstance(result, dict):
        raise BagError(f"{path}: wanted a JSON object")
    version = result.setdefault("schema_version", 0)
    if not isinstance(version, int) or version > VERSION:
        raise BagError(f"{path}: schema_version {version!r}: this version of the package reads up to {VERSION}")
    return result

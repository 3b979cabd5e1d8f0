# SPDX-License-Identifier: BSD-3-Clause
"""The three tables of an archive: their columns, and how they are written and read."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from ..errors import BagError
from .store import Store

VERSION = 1  # within one, columns are only added
_KEY = b"coman_schema_version"

Column = tuple[str, pa.DataType, str]  # name, type, and what it is

_XYZ = ("x", "y", "z")
_SKILL = pa.struct([("horizon_s", pa.float64()), *((axis, pa.float64()) for axis in _XYZ)])
_PARAMETER = pa.struct(
    [
        ("name", pa.string()),
        ("value", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
        ("unit", pa.string()),
    ]
)


def _list(kind: pa.DataType) -> pa.DataType:
    return pa.list_(pa.field("element", kind))  # as Parquet names it


def _errors(where: str) -> list[Column]:
    kinds = (("rmse", "free run"), ("rmse_rigid", "rigid robot"))
    return [
        (f"{key}_{axis}_m", pa.float64(), f"RMS error of the {what}{where}, {axis}")
        for key, what in kinds
        for axis in _XYZ
    ]


_STATUS = (
    "`ok`, `damaged` (read as far as it goes), `bad` (cannot be used), `failed` (an error of the package), `memory` "
    "(took more than `--memory`), `died` (its process was killed twice)"
)
_BAG: list[Column] = [
    ("archive", pa.string(), "URI that was searched, as it was given"),
    ("bag", pa.string(), "path below it"),
    ("hash", pa.string(), "SHA-256 over names and contents of the files of the bag; null if they could not be read"),
    ("robot", pa.string(), "which robot"),
    ("date", pa.date32(), "day, UTC; null if it has none"),
]
_MADE: list[Column] = [
    ("version", pa.string(), "of the package"),
    ("settings", pa.string(), "hash of configuration, URDF and options"),
]
TABLES: dict[str, list[Column]] = {
    "bags": [
        *_BAG,
        *_MADE,
        ("status", pa.string(), _STATUS),
        ("reason", pa.string(), "one line; null if `ok`"),
        ("start_ns", pa.int64(), "log time of the first message"),
        ("duration_s", pa.float64(), "from the first message to the last"),
        ("size_bytes", pa.int64(), "of the files"),
        ("mass_kg", pa.float64(), "of the robot description"),
        ("samples", pa.int64(), "joint states predicted; this and all below: null without `--predict`"),
        ("judged_samples", pa.int64(), "those with a measured and a predicted COM"),
        *_errors(""),
        ("skill", _list(_SKILL), "by horizon: 1 - RMSE / RMSE of the best baseline"),
        ("rejected", pa.int64(), "messages that were not used"),
        ("restarts", pa.int64(), "times that the joint states broke off or went back"),
        ("warnings", _list(pa.string()), "everything that is worth a sentence"),
    ],
    "phases": [
        *_BAG,
        *_MADE,
        ("phase", pa.string(), "`LEFT`, `RIGHT`, `DOUBLE` or `FLIGHT`"),
        ("duration_s", pa.float64(), "in this phase"),
        ("samples", pa.int64(), "with a measured and a predicted COM"),
        *_errors(" in this phase"),
    ],
    "findings": [
        ("kind", pa.string(), "`mismatch` (of the monitor, one bag) or `diagnosis` (bags of a robot in a period)"),
        ("robot", pa.string(), "which robot"),
        ("date", pa.date32(), "day of its first bag"),
        ("period", pa.string(), "week (`2026-W12`) or month (`2026-03`) of that day"),
        ("archive", pa.string(), "of a mismatch: as in `bags`"),
        ("bag", pa.string(), "of a mismatch: as in `bags`"),
        ("bags", _list(pa.string()), "of a diagnosis: training bags, then the held-out ones"),
        ("hash", pa.string(), "of the bag, or over the hashes of the bags"),
        *_MADE,
        ("status", pa.string(), "as in `bags`"),
        ("reason", pa.string(), "as in `bags`"),
        ("verdict", pa.string(), "`effect` (a row each), `none`, `unknown`, `not_excited`"),
        ("effect", pa.string(), "name in the catalogue, where the verdict is `effect`"),
        ("place", pa.string(), "joint, leg, foot or link; or the channel of a mismatch"),
        ("parameters", _list(_PARAMETER), "of the effect with 95 % intervals; of a mismatch: `size` and `sigma`"),
        ("since_s", pa.float64(), "of a mismatch: its onset after the first sample"),
        ("evidence", pa.float64(), "of the effect [nats]"),
        ("share", pa.float64(), "of what is missing that the effect explains, as squares"),
        ("sentence", pa.string(), "the same in words"),
    ],
}


def arrow_schema(table: str) -> pa.Schema:
    """The Arrow schema of `bags`, `phases` or `findings`; each field has its description, the schema its version."""
    fields = [pa.field(name, kind, metadata={"description": text}) for name, kind, text in TABLES[table]]
    return pa.schema(fields, metadata={_KEY: str(VERSION).encode()})


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of rows: `$defs` has one of `bags`, `phases` and `findings`."""
    rows = {
        table: {
            "title": f"a row of {table}.parquet; null: not known",
            "type": "object",
            "properties": {name: {**_json_type(kind), "description": text} for name, kind, text in columns},
        }
        for table, columns in TABLES.items()
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "archive.schema.json",
        "title": f"rows of the tables of coman archive, schema version {VERSION} (in the metadata of each table)",
        "$defs": rows,
    }


def _json_type(kind: pa.DataType) -> dict[str, Any]:
    if pa.types.is_list(kind):
        return {"type": ["array", "null"], "items": _json_type(kind.value_type)}
    if pa.types.is_struct(kind):
        return {"type": ["object", "null"], "properties": {field.name: _json_type(field.type) for field in kind}}
    if pa.types.is_date(kind):
        return {"type": ["string", "null"], "format": "date"}
    name = "string" if pa.types.is_string(kind) else "integer" if pa.types.is_integer(kind) else "number"
    return {"type": [name, "null"]}


def write_table(store: Store, table: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write TABLE.parquet: the same rows give the same bytes.

    Raises:
        OutputError: it cannot be written.
    """
    schema = arrow_schema(table)
    made = pa.Table.from_pylist([{name: row.get(name) for name in schema.names} for row in rows], schema=schema)
    buffer = io.BytesIO()
    parquet.write_table(made, buffer, compression="zstd")
    store.write(f"{table}.parquet", buffer.getvalue())


def read_table(store: Store, table: str) -> pa.Table:
    """Read TABLE.parquet, of this or an older version: what that did not know is null.

    Raises:
        BagError: it is not there, is no Parquet file, or is of a newer version.
    """
    name = f"{table}.parquet"
    if not store.exists(name):
        raise BagError(f"{store.uri}: no {name}: not the output of coman archive, or it is not finished")
    try:
        found = parquet.read_table(io.BytesIO(store.read(name)))
    except pa.ArrowException as error:
        raise BagError(f"{store.uri}: {name} is no Parquet file: {' '.join(str(error).split())[:120]}") from None
    version = (found.schema.metadata or {}).get(_KEY, b"").decode()
    if not version.isdecimal() or int(version) > VERSION:
        raise BagError(
            f"{store.uri}: {name}: schema version {version!r}: this version of the package reads up to {VERSION}"
        )
    for column, kind, _ in TABLES[table]:
        if column not in found.column_names:
            found = found.append_column(column, pa.nulls(len(found), kind))
    return found

"""Named arrays in one file, in the layout of safetensors; reading one never runs code.

    8 bytes    length of the header, little-endian
    header     JSON: {"__metadata__": {name: text}, name: {"dtype", "shape", "data_offsets": [begin, end]}}, padded
    data       the arrays, little-endian, in row-major order, without holes or overlaps

Everything a file says is checked before an array is made, so that a damaged or hostile one is refused by name. The
`safetensors` package reads what is written here, and the other way round, types that NumPy has not apart.
"""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from odaf.errors import CheckpointError
from odaf.training.files import write_atomically

HEADER_LIMIT = 100_000_000  # bytes, as in the layout's own library
REMEDY = "Write it again with `Policy.save`, or copy it again from where it came."
_TYPES = {
    "BOOL": "|b1",
    "U8": "|u1",
    "I8": "|i1",
    "U16": "<u2",
    "I16": "<i2",
    "U32": "<u4",
    "I32": "<i4",
    "U64": "<u8",
    "I64": "<i8",
    "F16": "<f2",
    "F32": "<f4",
    "F64": "<f8",
}
_NAMES = {np.dtype(code): name for name, code in _TYPES.items()}


def write_tensors(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Writes the arrays whole or not at all; a file of that name is replaced. Equal content gives equal bytes.

    Raises:
        CheckpointError: the file cannot be written, or an array is of a type that the layout has no name for.
    """
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    pieces, begin = [], 0
    for name, array in arrays.items():
        plain = np.asarray(array)
        kind = _NAMES.get(plain.dtype.newbyteorder("<"))
        if kind is None:
            raise CheckpointError(f"{path}: {name}: arrays of type {plain.dtype} cannot be written")
        content = plain.astype(_TYPES[kind]).tobytes()
        end = begin + len(content)
        header[name] = {"dtype": kind, "shape": list(plain.shape), "data_offsets": [begin, end]}
        pieces.append(content)
        begin = end
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 8)  # so that the arrays begin at a multiple of 8 bytes
    content = b"".join([len(text).to_bytes(8, "little"), text, *pieces])
    try:
        write_atomically(path, lambda file: file.write(content))
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be written ({error.strerror}). Name a folder that exists.") from None


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays, in memory of their own, and the metadata.

    Raises:
        CheckpointError: the file is missing, cut short, or breaks a rule of the layout.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            length = int.from_bytes(file.read(8), "little")
            if size < 8 or length > min(size - 8, HEADER_LIMIT):
                _refuse(path, f"has {size} bytes and claims a header of {length}, so it was cut or is no such file")
            text = file.read(length)
            header, metadata = _header(path, text)
            extents = _extents(path, header, size - 8 - length)
            data = file.read(size - 8 - length)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror}). {REMEDY}") from None
    if len(data) != size - 8 - length:
        _refuse(path, "was cut while it was read")
    arrays = {}
    for name, (kind, shape, begin, end) in extents.items():
        if kind == "BOOL" and data[begin:end].strip(b"\0\1"):
            _refuse(path, f"{name!r}: holds truth values other than 0 and 1")
        little = np.frombuffer(data[begin:end], _TYPES[kind])
        try:
            arrays[name] = little.astype(little.dtype.newbyteorder("=")).reshape(shape)
        except ValueError:  # an empty array whose other sizes no address space holds
            _refuse(path, f"{name!r}: shape {list(shape)} is too large")
    return arrays, metadata


def parsed(path: Path, what: str, text: bytes | str) -> dict[str, Any]:
    """JSON of a stranger: one object, every key once, no NaN.

    Raises:
        CheckpointError: it is not that.
    """
    try:
        content = json.loads(text, object_pairs_hook=_each_once, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        _refuse(path, f"{what}: cannot be read as JSON ({error or type(error).__name__})")
    if not isinstance(content, dict):
        _refuse(path, f"{what}: expected a JSON object, found {type(content).__name__}")
    return content


def _header(path: Path, text: bytes) -> tuple[dict[str, Any], dict[str, str]]:
    header = parsed(path, "header", text)
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        _refuse(path, "header: __metadata__: must hold texts alone")
    return header, metadata


def _extents(path: Path, header: Mapping[str, Any], available: int) -> dict[str, tuple[str, tuple[int, ...], int, int]]:
    """Type, shape, begin and end of every array, checked against one another and the bytes there are."""
    extents = {}
    for name, entry in header.items():
        if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
            _refuse(path, f"{name!r}: its entry must hold dtype, shape and data_offsets, nothing else")
        kind, shape, offsets = entry["dtype"], entry["shape"], entry["data_offsets"]
        if not isinstance(kind, str) or kind not in _TYPES:
            _refuse(path, f"{name!r}: dtype {kind!r} is not known; known are {', '.join(_TYPES)}")
        if not _counts(shape) or len(shape) > 32:
            _refuse(path, f"{name!r}: shape {shape!r} is not a short list of counts")
        if not _counts(offsets) or len(offsets) != 2:
            _refuse(path, f"{name!r}: data_offsets {offsets!r} are not two counts")
        begin, end = offsets
        wanted = math.prod(shape) * np.dtype(_TYPES[kind]).itemsize
        if end - begin != wanted:
            _refuse(path, f"{name!r}: {kind}{shape} takes {wanted} bytes, its data_offsets give {end - begin}")
        extents[name] = (kind, tuple(shape), begin, end)
    expected = 0
    for name, (_, _, begin, end) in sorted(extents.items(), key=lambda item: item[1][2:]):
        if begin != expected:
            _refuse(path, f"{name!r}: begins at byte {begin}, where {expected} was due: a hole or an overlap")
        expected = end
    if expected != available:
        _refuse(path, f"its arrays take {expected} bytes, and {available} follow the header: it was cut or grew")
    return extents


def _counts(value: Any) -> bool:
    return isinstance(value, list) and all(type(item) is int and 0 <= item < 2**63 for item in value)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key stands twice")
    return content


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _refuse(path: Path, what: str) -> NoReturn:
    raise CheckpointError(f"{path}: {what}. {REMEDY}")

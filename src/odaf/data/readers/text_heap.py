"""Texts of variable length in HDF5 files, read without the library's help.

HDF5 keeps them in collections of objects, each with its size in front. The library walks through a whole collection
before it returns one text, and where damage has set a size to zero, it walks on the spot for ever. We go to the same
bytes ourselves, and stop where a size cannot be right.

Source: HDF5 File Format Specification, version 3, section III.E (global heap) and IV.A.1.d (variable-length types).
"""

import mmap
import struct
from typing import BinaryIO

import h5py

from odaf.errors import DatasetError

_REFERENCE = struct.Struct("<IQI")  # length of the text, address of the collection, number of the object in it
_COLLECTION = struct.Struct("<4sB3xQ")  # signature, version, size of the whole collection
_OBJECT = struct.Struct("<HH4xQ")  # number, reference count, size without this heading and the padding to 8 bytes


def read(file: h5py.File, source: str, name: str, item: h5py.Dataset) -> bytes:
    """The only text in `item`, which must be stored in one stretch, as single texts are.

    Raises:
        DatasetError: it is no text, it is stored in a way that is not read here, or the collection is damaged.
    """
    place = item.id.get_offset()
    if h5py.check_string_dtype(item.dtype) is None or place is None or file.id.get_create_plist().get_sizes() != (8, 8):
        raise DatasetError(f"{source}: field '{name}' is no text in the usual form; write it as a text of fixed length")
    with open(file.filename, "rb") as handle:
        handle.seek(place)
        length, address, number = _REFERENCE.unpack(_take(handle, _REFERENCE.size, source, name))
        if length == 0:
            return b""
        handle.seek(file.userblock_size + address if address < file.id.get_filesize() else 0)
        signature, version, left = _COLLECTION.unpack(_take(handle, _COLLECTION.size, source, name))
        if signature != b"GCOL" or version != 1:
            raise _damaged(source, name)
        left = min(left, file.id.get_filesize()) - _COLLECTION.size
        while left >= _OBJECT.size:
            found, _, size = _OBJECT.unpack(_take(handle, _OBJECT.size, source, name))
            step = -(-size // 8) * 8
            left -= _OBJECT.size + step
            if found == 0 or left < 0:  # object 0 is the free rest of the collection
                break
            if found == number:
                if length > size:
                    break
                return _take(handle, length, source, name)
            handle.seek(step, 1)
    raise _damaged(source, name)


def refuse_endless(path: str, source: str) -> None:
    """Raises `DatasetError` where the library would walk on the spot in one of the file's collections.

    For files whose attributes are to be read: texts among them come through the library alone. Looks at every
    collection, so it passes over the whole file once; the signature with its version is not met by chance in numbers.
    """
    with open(path, "rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(b"GCOL\x01")
        while start >= 0:
            if start + _COLLECTION.size <= len(content):
                size = _COLLECTION.unpack_from(content, start)[2]
                place, end = start + _COLLECTION.size, min(start + size, len(content))
                while place + _OBJECT.size <= end:
                    number, _, length = _OBJECT.unpack_from(content, place)
                    step = length if number == 0 else _OBJECT.size + -(-length // 8) * 8
                    if step == 0:
                        raise DatasetError(
                            f"{source}: the file is damaged at byte {place:,}, where its texts are; "
                            "copy or generate it again"
                        )
                    place += step
            start = content.find(b"GCOL\x01", start + 1)


def _take(handle: BinaryIO, count: int, source: str, name: str) -> bytes:
    content = handle.read(count)
    if len(content) < count:
        raise _damaged(source, name)
    return content


def _damaged(source: str, name: str) -> DatasetError:
    return DatasetError(f"{source}: field '{name}' has lost its text; the file is damaged: copy or generate it again")

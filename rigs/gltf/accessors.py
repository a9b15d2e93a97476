"""Accessors: typed arrays in the buffers of a glTF file, with every access checked against the buffer view.

Source: the glTF 2.0 specification, sections 3.6.2 (accessors) and 3.11 (normalised integers).
"""

from typing import Any

import numpy as np

from riginv.errors import InputError
from rigs.gltf.container import GltfFile

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
UNSIGNED = (5121, 5123, 5125)
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
MOST_NUMBERS = 250_000_000  # of an avatar: 1 GB as float32; an untrusted file can claim any count


def count_of(file: GltfFile, index: int, user: str) -> int:
    """Number of elements of an accessor, without reading them.

    Raises:
        InputError: the accessor does not exist, is empty, or too large.
    """
    count = file.item("accessors", index, user)["count"]
    if not 1 <= count <= MOST_NUMBERS:
        raise InputError(f"{file.path}: accessors[{index}], {user}, has a count of {count}, expected 1 to {MOST_NUMBERS}")
    return count


def read_numbers(file: GltfFile, index: int, kind: str, user: str) -> np.ndarray:
    """Values of an accessor; normalised integers become fractions.

    Args:
        kind: expected type, such as `VEC3`.
        user: what refers to it, for messages: `POSITION of mesh 'head'`.

    Returns:
        `(count, component)`, float64.

    Raises:
        InputError: wrong type, outside its buffer view, or NaN or infinite values; the message names the accessor and the
            bytes found and expected.
    """
    accessor = _checked(file, index, kind, user)
    values = _values(file, index, accessor, user)
    with np.errstate(invalid="ignore"):  # refused below
        numbers = values.astype(np.float64)
    if accessor.get("normalized") and values.dtype.kind != "f":
        numbers = np.maximum(numbers / np.iinfo(values.dtype).max, -1.0)
    finite = np.isfinite(numbers).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError(f"{file.path}: accessors[{index}], {user}, holds NaN or infinity at element {row}: export it again")
    return numbers


def read_indices(file: GltfFile, index: int, kind: str, user: str) -> np.ndarray:
    """Values of an index accessor: `(count, component)`, int64.

    Raises:
        InputError: as `read_numbers`, or the components are not unsigned integers.
    """
    accessor = _checked(file, index, kind, user)
    if accessor["componentType"] not in UNSIGNED:
        raise InputError(
            f"{file.path}: accessors[{index}], {user}, has component type {accessor['componentType']}, expected unsigned "
            f"integers (5121, 5123 or 5125): export it again"
        )
    if "bufferView" not in accessor:
        raise InputError(f"{file.path}: accessors[{index}], {user}, has no data: the file is damaged; export it again")
    return _values(file, index, accessor, user).astype(np.int64)


def quantised_step(file: GltfFile, index: int) -> float:
    """Quantisation step of a normalised accessor; 0 for floats."""
    dtype = np.dtype(COMPONENTS[file.item("accessors", index, "")["componentType"]])
    return 0.0 if dtype.kind == "f" else 1.0 / np.iinfo(dtype).max


def _checked(file: GltfFile, index: int, kind: str, user: str) -> dict[str, Any]:
    accessor = file.item("accessors", index, user)
    count_of(file, index, user)
    for field, known in (("type", (kind,)), ("componentType", tuple(COMPONENTS))):
        if accessor[field] not in known:
            names = " or ".join(map(str, known))
            raise InputError(f"{file.path}: accessors[{index}], {user}, has {field} {accessor[field]!r:.20}, expected {names}")
    if accessor["count"] * WIDTHS[kind] > MOST_NUMBERS:
        raise InputError(f"{file.path}: accessors[{index}], {user}, has {accessor['count']} elements: too many to be meant")
    return accessor


def _values(file: GltfFile, index: int, accessor: dict[str, Any], user: str) -> np.ndarray:
    dtype, width, count = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]], accessor["count"]
    where, sparse = f"accessors[{index}], {user}", accessor.get("sparse")
    if "bufferView" in accessor:
        values = _strided(file, accessor["bufferView"], accessor.get("byteOffset", 0), dtype, width, count, where)
    else:  # zeros by the specification, broadcast to save memory
        values = np.broadcast_to(np.zeros(1, dtype), (count, width))
    if not sparse:
        return values
    indices, changes = sparse["indices"], sparse["values"]
    if indices["componentType"] not in UNSIGNED:
        raise InputError(
            f"{file.path}: {where}: sparse indices have component type {indices['componentType']}, expected unsigned"
        )
    if not 1 <= sparse["count"] <= count:
        raise InputError(f"{file.path}: {where}: {sparse['count']} sparse values, expected 1 to {count}, its elements")
    rows = _strided(
        file,
        indices["bufferView"],
        indices.get("byteOffset", 0),
        np.dtype(COMPONENTS[indices["componentType"]]),
        1,
        sparse["count"],
        f"{where}, sparse indices",
    )[:, 0].astype(np.int64)
    if (np.diff(rows) <= 0).any() or rows[-1] >= count:
        raise InputError(f"{file.path}: {where}: its sparse indices must rise and stay below {count}: export it again")
    values = values.copy()
    values[rows] = _strided(
        file, changes["bufferView"], changes.get("byteOffset", 0), dtype, width, sparse["count"], f"{where}, sparse values"
    )
    return values


def _strided(file: GltfFile, view: int, offset: int, dtype: np.dtype, width: int, count: int, where: str) -> np.ndarray:
    """Elements `(count, width)` of a buffer view, without copying."""
    data, stride = file.view(view, where)
    size = dtype.itemsize * width
    stride = stride or size
    if stride < size:
        raise InputError(f"{file.path}: {where}: bufferViews[{view}] has byteStride {stride}, expected at least {size}")
    needed = offset + stride * (count - 1) + size
    if needed > len(data):
        raise InputError(
            f"{file.path}: {where}, needs {needed} bytes of bufferViews[{view}], which has {len(data)}: "
            f"the file is damaged; export it again"
        )
    return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

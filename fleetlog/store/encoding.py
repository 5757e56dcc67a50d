"""Dataclasses of arrays, numbers and texts as bytes and back, without running anything found in them."""

import dataclasses
import io
import json
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEVEL = 1
"""Of zlib: most of a partial result are small numbers and zeros."""


def encode(value: Any) -> bytes:
    """Bytes that depend on the value alone, not on the process or on the order of a set."""
    arrays: list[NDArray[Any]] = []
    head = json.dumps(_tree(value, arrays)).encode()
    return b"".join([len(head).to_bytes(8, "little"), head, *(np.ascontiguousarray(a).data for a in arrays)])


def pack(value: Any) -> bytes:
    """Encoded and compressed, with zlib's checksum."""
    return zlib.compress(encode(value), LEVEL)


def unpack(data: bytes, kinds: Iterable[type] = ()) -> Any:
    """What was packed; dataclasses of ``kinds`` alone.  ValueError where it is damaged or something else."""
    try:
        plain = io.BytesIO(zlib.decompress(data))
        tree = json.loads(plain.read(int.from_bytes(plain.read(8), "little")))
        return _value(tree, plain, {k.__name__: k for k in kinds})
    except (zlib.error, LookupError, TypeError, StopIteration) as error:
        raise ValueError(f"not plain data: {error}") from None


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return _tree(value.item(), arrays)
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects is not plain data")
        arrays.append(value)
        return {"array": value.dtype.str, "shape": value.shape}
    if isinstance(value, list | tuple):
        return {type(value).__name__: [_tree(v, arrays) for v in value]}
    if isinstance(value, set | frozenset):
        return {"set": [_tree(v, arrays) for v in sorted(value)]}
    if isinstance(value, dict):
        return {"dict": [[_tree(k, arrays), _tree(v, arrays)] for k, v in value.items()]}
    if dataclasses.is_dataclass(value):
        names = [f.name for f in dataclasses.fields(value)]
        return {"kind": type(value).__name__, "fields": {n: _tree(getattr(value, n), arrays) for n in names}}
    raise TypeError(f"{type(value).__name__} is not plain data")


def _value(tree: Any, data: io.BytesIO, kinds: Mapping[str, type]) -> Any:
    """The value of a tree; arrays are taken from ``data`` in order."""
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        dtype = np.dtype(tree["array"])
        if dtype.hasobject:
            raise ValueError("an array of objects is not plain data")
        size = int(np.prod(tree["shape"], dtype=np.int64)) * dtype.itemsize
        return np.frombuffer(data.read(size), dtype).reshape(tree["shape"])
    if "kind" in tree:
        return kinds[tree["kind"]](**{n: _value(v, data, kinds) for n, v in tree["fields"].items()})
    if "dict" in tree:
        return {_value(k, data, kinds): _value(v, data, kinds) for k, v in tree["dict"]}
    name, items = next(iter(tree.items()))
    return {"list": list, "tuple": tuple, "set": frozenset}[name](_value(v, data, kinds) for v in items)

"""Dataclasses back from plain values, as JSON has them, with every type checked."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Union, get_args, get_origin, get_type_hints


def from_plain(kind: Any, value: Any, name: str = "value") -> Any:
    """``value`` as a ``kind``: a dataclass from a mapping, a tuple from a list; an integer passes as a float.

    Args:
        kind: a dataclass, int, float, str, bool, None, Any, a ``list``, ``tuple`` or ``dict`` of such, or a union.
        name: what the value is called in errors.

    Raises:
        TypeError: ``value``, or something in it, is no such thing.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        for one in arguments:
            try:
                return from_plain(one, value, name)
            except TypeError:
                pass
    elif is_dataclass(kind) and isinstance(kind, type) and isinstance(value, Mapping):
        hints = get_type_hints(kind)
        expected = {f.name for f in fields(kind)}
        if set(value) != expected:
            raise TypeError(f"{name}: {', '.join(sorted(map(str, expected ^ set(value))))}")
        return kind(**{key: from_plain(hints[key], item, f"{name}.{key}") for key, item in value.items()})
    elif origin in (list, tuple) and isinstance(value, list | tuple):
        return origin(from_plain(arguments[0], item, name) for item in value)
    elif origin is dict and isinstance(value, Mapping):
        return {from_plain(arguments[0], k, name): from_plain(arguments[1], v, f"{name}.{k}") for k, v in value.items()}
    elif kind is float and type(value) in (int, float):
        return value
    elif kind in (type(None), None):
        if value is None:
            return None
    elif isinstance(kind, type) and type(value) is kind:
        return value
    raise TypeError(f"{name}: expected {getattr(kind, '__name__', kind)}, got {value!r:.40}")

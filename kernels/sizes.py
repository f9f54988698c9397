"""What is asked of a kernel's arguments, once: when it is launched or recorded. A replay asks nothing.

Dtypes and ranks stand in a kernel's signature, and its arrays must be contiguous and on one device. How long they must
be no signature says, so every kernel carries a table above its head:

    @sizes("threads: T*V; row: V+1; rest: V; vertices rotation_out: T V; source: <T")

A capital stands for one number throughout; an entry that is nothing but the capital tells it. The entry of an array is
its shape, and ``?`` behind it allows None; that of an int is the number it must be or, behind ``<``, stay below;
``P=T*V`` asks for both. ``threads``: as far as a launch may go, from the argument ``begin`` on where there is one.
Structs carry tables of their own, in the same letters. What arrays of indices hold is not looked at: it lies on the
device.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import warp as wp

T = TypeVar("T")
Axes = tuple["_Size", ...]


@dataclass(frozen=True)
class _Size:
    """A sum of products of numbers and names; ``name`` where it is a name alone; ``axis`` that it is about."""

    axis: int
    text: str
    name: str
    terms: tuple[tuple[int, tuple[str, ...]], ...]

    def number(self, known: dict[str, tuple[int, str]]) -> int:
        return sum(factor * math.prod(known[name][0] for name in names) for factor, names in self.terms)


@dataclass(frozen=True)
class _Argument:
    """An array or an int: ``position`` among the inputs, ``member`` of a struct there, dotted."""

    label: str
    position: int
    member: str
    dtype: Any
    rank: int
    optional: bool
    below: bool
    names: Axes
    sums: Axes


@dataclass
class _Table:
    kernel: Any
    name: str
    begin: int | None
    threads: Axes
    arguments: list[_Argument] = field(default_factory=list)


_TABLES: dict[Any, _Table] = {}
_OF_STRUCTS: dict[Any, dict[str, str]] = {}


def tables() -> list[wp.Kernel]:
    """All kernels that have one."""
    return list(_TABLES)


def _parse(entry: str) -> tuple[Axes, Axes, int]:
    """The names of an entry, its sums, and how many axes it has."""
    axes, found = entry.strip("<?").split(), []
    for axis, choices in enumerate(axes):
        for text in choices.split("="):
            products = [product.split("*") for product in text.split("+")]
            terms = tuple(
                (math.prod(int(p) for p in product if p.isdigit()), tuple(p for p in product if not p.isdigit()))
                for product in products
            )
            if not all(p.isidentifier() or p.isdigit() for product in products for p in product):
                raise TypeError(f"sizes: expected a sum of products such as T*V+1, got {text}")
            found.append(_Size(axis, text, text if text.isidentifier() else "", terms))
    return tuple(s for s in found if s.name), tuple(s for s in found if not s.name), len(axes)


def sizes(table: str) -> Callable[[T], T]:
    """Give a kernel or a struct its table, see the head of this file; read once, when the module is loaded.

    Raises:
        TypeError: an array without an entry or of another rank, an entry without an argument, a name that none tells.
    """
    entries = {}
    for group in table.split(";"):
        labels, _, entry = group.partition(":")
        entries.update(dict.fromkeys(labels.split(), entry.strip()))

    def keep(subject: Any) -> Any:
        if isinstance(subject, wp.Kernel):
            _TABLES[subject] = _table_of(subject, dict(entries))
        else:
            _OF_STRUCTS[subject] = entries
        return subject

    return keep


def _table_of(kernel: wp.Kernel, entries: dict[str, str]) -> _Table:
    threads = entries.pop("threads", "")
    kinds = {argument.label: argument.type for argument in kernel.adj.args}
    names, sums, _ = _parse(threads)
    begin = list(kinds).index("begin") if "begin" in kinds else None
    table = _Table(kernel, kernel.func.__name__.lstrip("_"), begin, (*names, *sums))

    def add(label: str, position: int, member: str, kind: Any, entry: str) -> None:
        names, sums, rank = _parse(entry)
        expected = getattr(kind, "ndim", 0)
        if rank != max(expected, 1):
            raise TypeError(f"sizes of {table.name}: {label}: expected {max(expected, 1)} axes, got {entry!r}")
        below = entry.startswith("<")
        told = () if below else names
        asked = (*names, *sums) if below else sums
        dtype = getattr(kind, "dtype", None)
        optional = entry.endswith("?")
        table.arguments.append(_Argument(label, position, member, dtype, expected, optional, below, told, asked))

    for position, (label, kind) in enumerate(kinds.items()):
        if kind in _OF_STRUCTS:
            for member, (of, entry) in _members(kind):
                add(f"{label}.{member}", position, member, of, entry)
        elif label in entries or hasattr(kind, "ndim"):
            add(label, position, "", kind, entries.pop(label, ""))
    told = {size.name for argument in table.arguments for size in argument.names if not argument.optional}
    asked = [size for argument in table.arguments for size in argument.sums] + list(table.threads)
    lost = {name for size in asked for _, names in size.terms for name in names} - told
    if not threads:
        raise TypeError(f"sizes of {table.name}: expected an entry for threads, got none")
    if entries or lost:
        raise TypeError(f"sizes of {table.name}: no such arguments: {sorted(entries)}; told by none: {sorted(lost)}")
    return table


def _members(struct: Any, path: str = "") -> Iterator[tuple[str, tuple[Any, str]]]:
    """Type and entry of everything in a struct's table, and in the tables of structs inside it."""
    for name, member in struct.vars.items():
        if member.type in _OF_STRUCTS:
            yield from _members(member.type, f"{path}{name}.")
        elif name in _OF_STRUCTS[struct]:
            yield f"{path}{name}", (member.type, _OF_STRUCTS[struct][name])


def check(kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: Sequence[Any], device: wp.Device) -> None:
    """Hold the arguments of a launch against the kernel's signature and table.

    Raises:
        TypeError: no array where one is asked for, or one of another dtype; a kernel without a table.
        ValueError: another rank, shape or device, strides, an index or a span beyond its end.
    """
    table = _TABLES.get(kernel)
    if table is None:
        raise TypeError(f"{kernel.key}: expected a kernel with a table of sizes, got none")
    known: dict[str, tuple[int, str]] = {}
    shapes: list[tuple[int, ...] | None] = []
    generic = None
    for a in table.arguments:
        value = inputs[a.position]
        if a.member:
            value = functools.reduce(getattr, a.member.split("."), value)
        if not a.rank:
            shape = (int(value),)
        elif value is None and a.optional:
            shapes.append(None)
            continue
        else:
            if not isinstance(value, wp.array):
                raise TypeError(
                    f"{table.name}: {a.label}: expected an array of {_name(a.dtype)}, got {type(value).__name__}"
                )
            dtype = a.dtype
            if dtype is Any:
                dtype = generic = generic or _overload(table, a, value)
            if value.dtype is not dtype and not wp.types.types_equal(value.dtype, dtype):
                raise TypeError(f"{table.name}: {a.label}: expected dtype {_name(dtype)}, got {_name(value.dtype)}")
            if value.ndim != a.rank:
                raise ValueError(f"{table.name}: {a.label}: expected {a.rank}-dimensional, got shape {value.shape}")
            if value.device is not device and value.device != device:
                raise ValueError(f"{table.name}: {a.label}: expected an array on {device}, got one on {value.device}")
            if not value.is_contiguous:
                raise ValueError(f"{table.name}: {a.label}: expected a contiguous array, got strides {value.strides}")
            shape = value.shape
        shapes.append(shape)
        for size in a.names:
            if known.setdefault(size.name, (shape[size.axis], a.label))[0] != shape[size.axis]:
                _refuse(table, a, shape, size, known)
    for a, shape in zip(table.arguments, shapes, strict=True):
        if shape is not None:
            for size in a.sums:
                number = size.number(known)
                if not (0 <= shape[0] < number or dim == 0) if a.below else shape[size.axis] != number:
                    _refuse(table, a, shape, size, known)
    begin = 0 if table.begin is None else inputs[table.begin]
    for size in table.threads:
        count = dim[size.axis] if isinstance(dim, tuple) else dim
        require_span(f"{table.name}: threads", begin, count, size.number(known), size.text)


def _overload(table: _Table, argument: _Argument, value: wp.array) -> Any:
    """The dtype of a generic array, if the kernel was made for it."""
    at = argument.position
    made_for = [kernel.adj.args[at].type.dtype for kernel in table.kernel.overloads.values()]
    if value.dtype not in made_for:
        names = " or ".join(_name(dtype) for dtype in made_for)
        raise TypeError(f"{table.name}: {argument.label}: expected dtype {names}, got {_name(value.dtype)}")
    return value.dtype


def _name(dtype: Any) -> str:
    return wp.types.type_repr(dtype).removeprefix("wp.")


def _refuse(table: _Table, a: _Argument, shape: tuple[int, ...], size: _Size, known: dict) -> None:
    names = sorted({name for _, names in size.terms for name in names})
    told = ", ".join(f"{name} = {known[name][0]} of {known[name][1]}" for name in names)
    axis = f"axis {size.axis} of length " if a.rank > 1 else "length " if a.rank else "below " if a.below else ""
    number = "" if size.name else f" = {size.number(known)}"
    got = f"shape {shape}" if a.rank > 1 else str(shape[0])
    raise ValueError(f"{table.name}: {a.label}: expected {axis}{size.text}{number}{told and f' ({told})'}, got {got}")


def require(array: wp.array, name: str, dtype: Any, shape: tuple[int | None, ...]) -> None:
    """Check one array; None in ``shape`` accepts any length.

    Raises:
        TypeError: another dtype.
        ValueError: another rank or length.
    """
    if not wp.types.types_equal(array.dtype, dtype):
        raise TypeError(f"{name}: expected dtype {_name(dtype)}, got {_name(array.dtype)}")
    fits = array.ndim == len(shape) and all(w is None or w == g for w, g in zip(shape, array.shape, strict=True))
    if not fits:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")


def require_span(name: str, begin: int, count: int, length: int, meaning: str = "") -> None:
    """Check that ``begin .. begin + count`` lies within an array of ``length``.

    Raises:
        ValueError: it does not.
    """
    if not (0 <= begin and 0 <= count and begin + count <= length):
        of = f" = {meaning}" if meaning else ""
        raise ValueError(f"{name}: expected a span within 0 .. {length}{of}, got {begin} .. {begin + count}")

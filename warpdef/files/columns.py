"""What the columns of a cloud are: by their names, by what people say, or, without names, by their values.

Roles are ``x y z``, ``nx ny nz``, ``red green blue`` and ``alpha``; a column without a role is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from warpdef.cloud import byte_colors
from warpdef.errors import InputError
from warpdef.files.surface import Surface

POINTS, NORMALS, COLORS = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")
PASSED_OVER = "_"

_ALIASES = {
    **{a: (a, f"p{a}", f"pos{a}", f"position{a}", f"coord{a}", f"{a}coord", f"point{a}") for a in POINTS},
    **{f"n{a}": (f"n{a}", f"normal{a}", f"norm{a}", f"normals{a}", f"{a}n", f"{a}normal") for a in POINTS},
    **{name: (name, name[0], f"diffuse{name}", f"color{name[0]}", f"colour{name[0]}", f"{name[0]}f", f"color{name}",
              f"{name[0]}255") for name in COLORS},
    "alpha": ("alpha", "a", "diffusealpha"),
}  # fmt: skip
_NUMBERED = {"points": POINTS, "point": POINTS, "position": POINTS, "coordinates": POINTS, "normals": NORMALS,
             "normal": NORMALS, "colors": COLORS, "color": COLORS, "rgb": COLORS}  # fmt: skip
_ROLES = {alias: role for role, aliases in _ALIASES.items() for alias in aliases}
_ROLES |= {f"{name}{i}": role for name, roles in _NUMBERED.items() for i, role in enumerate(roles)}
_ROLES |= {"easting": "x", "northing": "y", "elevation": "z"}
_ODD_NAN = re.compile(rb"[+-]?1\.#(IND|QNAN|SNAN|INF)[0-9]*|[+-]?nan\([a-z]*\)", re.IGNORECASE)
_UNIT = 0.05  # how far from 1 the length of a normal may be
_MOST = 16  # columns without names; with more it is an image
_NO_NORMAL = 0.05  # of the rows: a normal of length 0 stands for one that is not known


def plain_numbers(text: bytes) -> bytes:
    """Numbers between blanks with a point for a decimal comma, and ``nan`` for Visual C++'s words for it."""
    if b"#" in text or b"(" in text:
        text = _ODD_NAN.sub(b"nan", text)
    return text.replace(b",", b".") if b"," in text else text


def role_of(name: str) -> str:
    """The role of a column by its name, in any usual spelling; empty if it has none."""
    plain = re.sub(r"\([^)]*\)|\[[a-zµ]*\]", "", name.casefold())  # units
    return _ROLES.get(re.sub(r"[\W_]+", "", plain), "")


def roles_of(names: Sequence[str]) -> list[str]:
    """Roles of named columns; of two with one role the one with the plain name has it, else the first."""
    roles = [name.casefold() if name.casefold() in _ALIASES else PASSED_OVER for name in names]
    for i, name in enumerate(names):
        role = role_of(name)
        if role and role not in roles:
            roles[i] = role
    return [role if role not in roles[:i] else PASSED_OVER for i, role in enumerate(roles)]


def parse_columns(text: str) -> tuple[str, ...]:
    """Roles of columns as people list them: ``x,y,z,_,nx,ny,nz,r,g,b``, with ``_`` for a column to be passed over.

    Raises:
        InputError: a name without a role, one twice, or no x, y and z.
    """
    names = [name.strip() for name in text.split(",")] if text.strip() else []
    roles = [PASSED_OVER if name in (PASSED_OVER, "-", "") else role_of(name) for name in names]
    known = "x,y,z,nx,ny,nz,r,g,b,a or _"
    for name, role in zip(names, roles, strict=True):
        if not role or (role != PASSED_OVER and roles.count(role) > 1):
            raise InputError(f"--columns: expected each of {known} once, got '{name}' in '{text:.80}'")
    if names and not set(POINTS) <= set(roles):
        raise InputError(f"--columns: expected x, y and z among the columns, got '{text:.80}'")
    return tuple(roles)


def guess_roles(table: np.ndarray, where: str) -> list[str]:
    """Roles of columns without names, shape (N, K), by their number and their values.

    The first three are the position, unless whole numbers that count the rows stand before them. Of the others, three
    side by side are normals if they have length 1, and colours if they are whole numbers up to 255 or fractions up to
    1; six columns are position and normals of any length, too.

    Raises:
        InputError: fewer than three columns or more than 16, or six of which the last three could be anything.
    """
    count = table.shape[1] if table.ndim == 2 else 0
    if count < 3:
        raise InputError(f"{where}: expected at least 3 columns (x y z), got {count or table.shape}")
    if count > _MOST:
        raise InputError(
            f"{where}: expected at most {_MOST} columns without names (x y z ...), got {count}: depth images go into "
            "an .npz of depth (T, H, W) and intrinsics (3, 3); if it is a table, say what it holds with --columns x,y,z"
        )
    rows = table[np.isfinite(table).all(axis=1)]
    start = 1 if count > 3 and _counts(rows[:, 0]) else 0
    roles = [PASSED_OVER] * start + list(POINTS)
    if count - start < 3:
        return list(POINTS) + [PASSED_OVER] * (count - 3)
    while len(roles) < count:
        at, left = len(roles), count - len(roles)
        three = rows[:, at : at + 3]
        whole = three.shape[1] == 3 and len(rows) > 0
        # Of four that could all be colours the first is the intensity.
        shifted = left == 4 and whole and _is_color(rows[:, at + 1 :])
        if whole and _is_unit(three) and "nx" not in roles:
            roles += NORMALS
        elif whole and "red" not in roles and _is_color(three) and not shifted:
            roles += COLORS
        else:
            roles.append(PASSED_OVER)
    if count - start == 6 and roles[start + 3] == PASSED_OVER and len(rows):
        if (rows[:, start + 3 :] >= 0).all():
            raise InputError(
                f"{where}: expected normals or colours in columns {start + 4} to {start + 6}, got neither; say what "
                "they are with --columns x,y,z,nx,ny,nz, or leave them out with --columns x,y,z"
            )
        roles[start + 3 :] = NORMALS
    return roles


def _counts(column: np.ndarray) -> bool:
    return len(column) > 9 and bool((np.diff(column) == 1).all()) and column[0] in (0, 1)


def _is_unit(three: np.ndarray) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(three, axis=1)
        given = length > 0
        return bool(given.mean() >= 1 - _NO_NORMAL and (np.abs(length[given] - 1) <= _UNIT).all())


def _is_color(three: np.ndarray) -> bool:
    low, high = three.min(), three.max()
    return bool(low >= 0 and (high <= 1 or (high <= 255 and (three == np.rint(three)).all())))


def surface_of(table: np.ndarray, roles: Sequence[str], names: Sequence[str] = ()) -> Surface:
    """Points, normals and colours of a table, shape (N, K), by the roles of its first columns.

    Args:
        names: of the columns, for the line that says what was taken and what was passed over.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        table = np.asarray(table, dtype=np.float64)
    columns = {role: table[:, i] for i, role in enumerate(roles) if role != PASSED_OVER}
    passed = [
        names[i] if i < len(names) else f"column {i + 1}"
        for i in range(table.shape[1])
        if i >= len(roles) or roles[i] == PASSED_OVER
    ]
    return named_surface(columns, passed)


def named_surface(columns: Mapping[str, np.ndarray], passed: Sequence[str], whole: bool = False) -> Surface:
    """Points, normals and colours from columns by role, and the line that says what was taken.

    Args:
        columns: by role, shape (N,) each; x, y and z must be there. passed: names of those passed over.
        whole: colours are bytes whatever their values.
    """
    normals = _stack(columns, NORMALS)
    colors = _stack(columns, (*COLORS, "alpha")) if "alpha" in columns else None
    colors = _stack(columns, COLORS) if colors is None else colors
    if colors is not None and colors.dtype != np.uint8:
        colors = byte_colors(colors, whole)
    points = _stack(columns, POINTS)
    assert points is not None  # the caller has found them
    taken = [*POINTS, *(NORMALS if normals is not None else ()), *(COLORS if colors is not None else ())]
    line = " ".join(taken) + (f"; passed over: {', '.join(passed[:12])}" if passed else "")
    with np.errstate(invalid="ignore", over="ignore"):
        points = points.astype(np.float64)
        normals = None if normals is None else normals.astype(np.float64)
    return Surface(points, normals, colors=colors, columns=line, passed=tuple(passed))


def _stack(columns: Mapping[str, np.ndarray], roles: Sequence[str]) -> np.ndarray | None:
    # A damaged file may hold signalling NaNs, of which NumPy would warn; they are refused later by their frame's name.
    with np.errstate(invalid="ignore"):
        return np.stack([columns[role] for role in roles], axis=1) if all(r in columns for r in roles) else None

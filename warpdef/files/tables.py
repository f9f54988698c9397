"""Tables of numbers as text: .xyz .txt .asc .csv .pts and their kin, a point a line.

Between the columns stand blanks, tabs, commas or semicolons; numbers have a point or a comma before their decimals. In
front of the rows may stand a count, a line of names and comments (``#``, ``//``, ``;``, ``%``), the last of which may
hold the names. Quotes around fields are left out. Exponents may be Fortran's, 1.5D+03. Visual C++'s 1.#IND and 1.#QNAN,
empty fields and NULL are NaN.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warpdef.errors import InputError
from warpdef.files.columns import POINTS, guess_roles, roles_of, surface_of
from warpdef.files.disk import read_bytes
from warpdef.files.surface import Surface

_HEAD = 50  # lines in front of the first row
_LOOKED_AT = 200  # rows from which separators are told
_MARKS = ("#", "//", ";", "%", "!")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
_GROUPED = re.compile(r"[+-]?[0-9]{1,3}((\.[0-9]{3})+,[0-9]+|(,[0-9]{3})+\.[0-9]+)")  # 1.234,56 or 1,234.56
_FORTRAN = re.compile(r"(?<=[0-9.])[dD](?=[+-]?[0-9])")  # the exponent of double precision: 1.5D+03
_ODD_NAN = re.compile(
    r"[+-]?\b1\.#(IND|QNAN|SNAN|INF)[0-9]*|[+-]?nan\((s?nan|q?nan|ind)\)|\bnull\b|\bn/a\b", re.IGNORECASE
)


@dataclass(frozen=True)
class _Head:
    """names: of the columns, or none. count: of rows as declared, or None. rows: the rest. first: its line, from 1."""

    names: list[str]
    count: int | None
    rows: str
    first: int


def read_table(path: Path, columns: Sequence[str] = ()) -> Surface:
    """Points, normals and colours of a table of text.

    Args:
        columns: roles of its columns, as ``columns.parse_columns`` gives them; else by the names in the file, else
            guessed from the values.

    Raises:
        InputError: something that is no number, rows of unequal length, too few columns, or columns that could be
            anything.
    """
    text = _without_quotes(decode(read_bytes(path)))
    head = _read_head(text, str(path))
    table = _numbers(head, str(path))
    if head.count is not None and head.count > len(table):
        raise InputError(
            f"{path}: expected {head.count} points as the first line says, got {len(table)}; it is truncated: write it "
            "again"
        )
    if columns:
        if len(columns) > table.shape[1]:
            raise InputError(f"{path}: --columns names {len(columns)} columns, the file has {table.shape[1]}")
        return surface_of(table, columns)
    roles = roles_of(head.names) if len(head.names) == table.shape[1] else []
    if set(POINTS) <= set(roles):
        return surface_of(table, roles, head.names)
    return surface_of(table, guess_roles(table, str(path)))


def decode(data: bytes) -> str:
    """Text of any usual encoding, without byte order mark, its lines ending in LF."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        text = data.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _without_quotes(text: str) -> str:
    """Fields without the quotes around them; a comma inside those of a number stands before its decimals."""
    if '"' not in text:
        return text
    quoted = re.sub(r'"\s*([+-]?[0-9]*),([0-9]+(?:[eE][+-]?[0-9]+)?)\s*"', r"\1.\2", text)
    return quoted.replace('"', "")


def odd_nans(text: str) -> str:
    """The text with what stands for "no number" in other languages written ``nan``."""
    return _ODD_NAN.sub("nan", text) if "#" in text or "(" in text or re.search("null|n/a", text, re.I) else text


def has_decimal_commas(words: Sequence[str]) -> bool:
    """Whether words between blanks are numbers with a comma before their decimals."""
    return any(_COMMA_NUMBER.fullmatch(word) for word in words) and all(
        _COMMA_NUMBER.fullmatch(word) or _NUMBER.fullmatch(word) for word in words
    )


def _read_head(text: str, where: str) -> _Head:
    names: list[str] = []
    count, plain, at = None, 0, 0
    for number in range(1, _HEAD + 1):
        end = text.find("\n", at)
        line = text[at : end if end >= 0 else len(text)].strip()
        mark = next((m for m in _MARKS if line.startswith(m)), "")
        if line and not mark:
            words = _words(_without_comment(line))
            if words and all(_is_number(word) for word in words):
                if count is not None or not line.isdecimal():
                    return _Head(names, count, text[at:], number)
                count = int(line)
            elif plain:
                break  # a second line of words: this is no table
            else:
                plain, names = plain + 1, _heading(line)
        elif mark:
            found = _heading(line.lstrip("#/;%! "))
            names = found if set(POINTS) <= set(roles_of(found)) else names
        if end < 0:
            break
        at = end + 1
    shown = next((line for line in text.split("\n", _HEAD)[:_HEAD] if line.strip()), "").strip()
    raise InputError(f"{where}: expected rows of numbers (x y z), got {shown[:60]!r}; check what the file is")


def _heading(line: str) -> list[str]:
    for separator in (";", "\t", ","):
        if separator in line:
            return [word.strip().strip("\"'") for word in line.strip(separator).split(separator)]
    return [word.strip("\"'") for word in line.split()]


def _without_comment(line: str) -> str:
    """A row without what stands behind it: a semicolon ends it only where no number follows."""
    line = re.sub(r"(#(?![IQS])|//).*", "", line)
    if ";" in line:
        parts = line.split(";")
        words = [_words(part) for part in parts]
        kept = next((i for i, w in enumerate(words) if not all(map(_is_number, w))), len(parts))
        line = ";".join(parts[:kept])
    return line


def _words(line: str) -> list[str]:
    return re.sub(r"[;\t]", " ", odd_nans(line)).replace(", ", " ").strip(", ").split()


def _is_number(word: str) -> bool:
    return all(not part or _NUMBER.fullmatch(part) for part in word.split(","))


def _numbers(head: _Head, where: str) -> np.ndarray:
    """All rows, shape (N, K) float64."""
    text = head.rows
    if any(mark in text for mark in ("#", "//", "%")) or re.search(r";[^0-9+\-.;\n]*(\n|$)", text):
        text = "\n".join(_without_comment(line) for line in odd_nans(text).split("\n"))
    text = odd_nans(text)
    if "d" in text or "D" in text:  # the expression takes longer over a long text than this
        text = _FORTRAN.sub("e", text)
    sample = [line.strip() for line in text[: _LOOKED_AT * 200].split("\n")[:_LOOKED_AT] if line.strip()]
    text = _with_blanks(text, sample, where)
    try:
        return np.loadtxt(io.StringIO(text), dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _bad_row(text, head.first, where) from None


def _with_blanks(text: str, sample: Sequence[str], where: str) -> str:
    """The rows with points before decimals and blanks between columns; empty fields are NaN."""
    if not any("," in line or ";" in line for line in sample):
        return text
    wide = ";" if any(";" in line for line in sample) else "\t" if any("\t" in line for line in sample) else " "
    words = [word for line in sample for word in line.replace(wide, " ").split()]
    grouped = next((word for word in words if _GROUPED.fullmatch(word)), "")
    if wide != " " and grouped:
        raise InputError(
            f"{where}: expected numbers, got {grouped!r}, which has marks between its thousands; write the numbers "
            "without them"
        )
    if has_decimal_commas(words) and (wide != " " or min(len(line.split()) for line in sample) >= 3):
        text = text.replace(",", ".")
    elif "," in text:
        _refuse_unclear_commas(sample, where)
    if ";" in text or "," in text:
        text = re.sub(r"(?m)(?<=[,;])[ \t]*(?=[,;]|$)", "nan", re.sub(r"(?m)^[ \t]*(?=[,;])", "nan", text))
        text = text.replace(",", " ").replace(";", " ")
    return text


def _refuse_unclear_commas(sample: Sequence[str], where: str) -> None:
    """Whole numbers between commas may be the two halves of numbers with decimals: ``1,0524,1,2579,-2,9111``."""
    rows = [line.split(",") for line in sample]
    width = len(rows[0])
    if width % 2 or width < 6 or any(len(r) != width or not all(w.strip("+- ").isdecimal() for w in r) for r in rows):
        return
    halves = [row[1::2] for row in rows]
    padded = any(len(word) > 1 and word.startswith("0") for half in halves for word in half)
    if padded or len({len(word) for half in halves for word in half}) == 1 and len(halves[0][0]) > 3:
        raise InputError(
            f"{where}: commas stand between the columns and, it seems, before the decimals, too: {sample[0][:60]!r}; "
            "write the numbers with decimal points, or semicolons between the columns"
        )


def _bad_row(text: str, first: int, where: str) -> InputError:
    width = 0
    for number, line in enumerate(text.split("\n"), first):
        words = line.split()
        if not words:
            continue
        odd = next((word for word in words if not _NUMBER.fullmatch(word)), "")
        if odd or width not in (0, len(words)):
            expected = f"{width} columns as before" if width and not odd else "numbers"
            what = f"'{odd[:40]}' in {line.strip()[:60]!r}" if odd else f"{len(words)}: {line.strip()[:60]!r}"
            return InputError(f"{where}: line {number}: expected {expected}, got {what}; write the file again")
        width = len(words)
    return InputError(f"{where}: expected rows of numbers, got something else; write the file again")

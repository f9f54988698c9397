"""What a value of the configuration may be, whatever its field; and the two that are text: frames and a box.

The bounds of a field of its own stand beside it in ``config``.
"""

from __future__ import annotations

from typing import Any

from warpdef.errors import ConfigError

COUNT_MOST = 10**7
NUMBER_LEAST, NUMBER_MOST = 1e-30, 1e9
_MOST = {"points": 10**9, "seed": 2**63 - 1}


def require(ok: bool, key: str, expected: str, got: object) -> None:
    """Refuse the value of a field.

    Raises:
        ConfigError: with the field, what was expected and what it got, unless ``ok``.
    """
    if not ok:
        raise ConfigError(f"configuration: {key}: expected {expected}, got {got!r:.60}")


def require_sane(group: Any, prefix: str = "") -> None:
    """Refuse numbers that no run could hold or that single precision cannot say, whatever their own bounds."""
    for name, value in vars(group).items():
        if type(value) is int:
            most = _MOST.get(name, COUNT_MOST)
            require(abs(value) <= most, prefix + name, f"at most {most}", value)
        elif type(value) is float:
            ok = value == 0 or NUMBER_LEAST <= abs(value) <= NUMBER_MOST
            require(ok, prefix + name, f"0 or from {NUMBER_LEAST:g} to {NUMBER_MOST:g}", value)


def parse_box(text: str) -> tuple[list[float], list[float]]:
    """``"x0:x1,y0:y1,z0:z1"``, any end left out, to the least and the greatest x, y and z; the empty text: no bounds.

    Raises:
        ConfigError: not of that form, or an axis whose end lies before its start.
    """
    axes = [axis.split(":") for axis in text.split(",")] if text else [["", ""]] * 3
    try:
        low, high = zip(*((float(a or "-inf"), float(b or "inf")) for a, b in axes), strict=True)
    except ValueError:
        low, high = (), ()
    ok = len(low) == 3 and all(a < b for a, b in zip(low, high, strict=True))
    require(ok, "crop", "x0:x1,y0:y1,z0:z1, as -1:1,0:2,: in input units", text)
    return list(low), list(high)


def parse_slice(text: str) -> slice:
    """``"a:b:step"`` with any part left out to a slice; the empty text means every frame.

    Raises:
        ConfigError: not of that form, or step 0.
    """
    parts = text.split(":") if text else ["", ""]
    try:
        numbers = [int(p) if p.strip() else None for p in parts]
    except ValueError:
        numbers = []
    ok = len(numbers) in (2, 3) and not (len(numbers) == 3 and numbers[2] == 0)
    require(ok, "frames", "start:stop or start:stop:step, as 10:27", text)
    return slice(*numbers)

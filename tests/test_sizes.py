"""Every launcher refuses what its kernel's signature and table refuse; tables are read for what they say."""

from __future__ import annotations

import functools
import importlib
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import warp as wp
import witness_functions

import warpdef.kernels
from warpdef.kernels import launching
from warpdef.kernels.cells import Targets
from warpdef.kernels.chains import Routes
from warpdef.kernels.launching import recording
from warpdef.kernels.levels import node8
from warpdef.kernels.pairs import Pairs
from warpdef.kernels.sizes import _OF_STRUCTS, _TABLES, check, require, require_span, sizes
from warpdef.kernels.vectors import add_scaled

# Numbers for the letters of the tables, all different but for those that some table calls equal: K = N = P = T V.
LETTERS = dict(
    zip("TVSMLABCEFGHIQRWXYZ", (3, 5, 2, 41, 4, 6, 8, 9, 7, 11, 13, 17, 19, 23, 29, 31, 10, 12, 14), strict=True)
)
KNOWN = {name: (number, "") for name, number in (LETTERS | {"N": 15, "P": 15, "K": 15}).items()}
STRUCTS = {"pairs": Pairs, "routes": Routes, "targets": Targets}
OTHERS = {"betas": (0.9, 0.99), "robust": (1.0, 2, 0.5), "count": 1, "begin": 0}


def array(a: Any) -> wp.array:
    """What an entry asks for."""
    axes = {size.axis: size.number(KNOWN) for size in (*a.names, *a.sums)}
    shape = tuple(axes[k] for k in range(a.rank))
    return wp.zeros(shape, dtype=node8 if a.dtype is Any else a.dtype, device="cpu")


def launchers() -> dict[str, Callable]:
    """Public functions of the kernels folder that launch a kernel."""
    found = {}
    for path in sorted(Path(warpdef.kernels.__path__[0]).glob("*.py")):
        module = importlib.import_module(f"warpdef.kernels.{path.stem}")
        for name, f in vars(module).items():
            own = inspect.isfunction(f) and f.__module__ == module.__name__ and not name.startswith("_")
            if own and re.search(r"\blaunch\(_\w+", inspect.getsource(f)):
                found[f"{path.stem}.{name}"] = f
    return found


class Call:
    """A launcher with arguments that are right: what they are comes from the table of its kernel."""

    def __init__(self, launcher: Callable, patch: pytest.MonkeyPatch) -> None:
        self.launcher, self.patch = launcher, patch
        kernel = launcher.__globals__[re.findall(r"\blaunch\((_\w+)", inspect.getsource(launcher))[0]]
        self.table = _TABLES[kernel]
        self.entries = {a.label: a for a in self.table.arguments}
        self.arguments = {name: self._valid(name, p) for name, p in inspect.signature(launcher).parameters.items()}

    def _valid(self, name: str, parameter: inspect.Parameter) -> Any:
        if name in STRUCTS:
            struct = STRUCTS[name]()
            for a in self.table.arguments:
                if a.member:
                    *outer, last = a.member.split(".")
                    within = functools.reduce(getattr, outer, struct)
                    setattr(within, last, array(a) if a.rank else a.names[0].number(KNOWN))
            return struct
        for label in (name, f"{name}_out", name.removesuffix("_out")):
            if label in self.entries and self.entries[label].rank:
                return array(self.entries[label])
        other = 0 if parameter.default is parameter.empty else parameter.default
        return OTHERS.get(name, other)

    def __call__(self, **changed: Any) -> None:
        self.launcher(**(self.arguments | changed))

    def checked(self, label: str, change: Callable[[Any], Any]) -> None:
        """The call's launch with one argument changed behind the launcher's back."""

        def changed(kernel: Any, dim: Any, inputs: list, device: Any) -> None:
            a, inputs = self.entries[label], list(inputs)
            if not a.member:
                inputs[a.position] = change(inputs[a.position])
                check(kernel, dim, inputs, device)
                return
            struct, right = inputs[a.position], getattr(inputs[a.position], a.member)
            setattr(struct, a.member, change(right))
            try:
                check(kernel, dim, inputs, device)
            finally:
                setattr(struct, a.member, right)

        with self.patch.context() as patch:
            patch.setattr(launching, "check", changed)
            self()

    def arrays(self) -> list[str]:
        return [a.label for a in self.table.arguments if a.rank and not a.optional]


@pytest.fixture(params=sorted(launchers()))
def call(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.setattr(launching.wp, "launch", lambda *_, **__: None)  # what is right need not run
    return Call(launchers()[request.param], monkeypatch)


def test_all_launchers_are_looked_at() -> None:
    assert len(launchers()) >= 35
    assert "motion.move_points" in launchers() and "borders.cloud_borders" in launchers()


def test_what_is_right_passes(call: Call) -> None:
    call()


def test_another_dtype_is_refused(call: Call) -> None:
    for label in call.arrays():
        if call.entries[label].member:
            continue  # Warp itself refuses it, when it is put into the struct
        where = f"{call.table.name}: {label}: expected "
        with pytest.raises(TypeError, match=f"{where}dtype .*, got int64"):
            call.checked(label, lambda a: wp.zeros(a.shape, dtype=wp.int64, device="cpu"))
        with pytest.raises(TypeError, match=f"{where}an array of .*, got ndarray"):
            call.checked(label, lambda a: a.numpy())
        with pytest.raises(ValueError, match=f"{where}{call.entries[label].rank}-dimensional, got shape"):
            call.checked(label, lambda a: wp.zeros((*a.shape, 2), dtype=a.dtype, device="cpu"))


def test_another_length_is_refused(call: Call) -> None:
    """One more or one less than there should be, on every axis that another argument shares or a number fixes."""
    shared = [size.text for a in call.table.arguments if not a.below for size in (*a.names, *a.sums)]
    letters = re.findall(r"[A-Z]", " ".join(shared))
    for label in call.arrays():
        for size in (*call.entries[label].names, *call.entries[label].sums):
            if not size.text.isdigit() and not any(letters.count(x) > 1 for x in re.findall("[A-Z]", size.text)):
                continue
            for by in (1, -1):

                def resized(a: wp.array, axis: int = size.axis, by: int = by) -> wp.array:
                    shape = tuple(n + by * (k == axis) for k, n in enumerate(a.shape))
                    return wp.zeros(shape, dtype=a.dtype, device="cpu")

                with pytest.raises(ValueError, match=f"{call.table.name}: .*: expected .*, got "):
                    call.checked(label, resized)


def test_a_span_beyond_the_end_is_refused(call: Call) -> None:
    if "begin" not in call.arguments:
        pytest.skip("it has no span")
    for begin, count in ((10**6, 1), (0, 10**6), (-1, 1), (0, -1)):
        with pytest.raises(ValueError, match=rf"{call.table.name}: threads: expected a span within 0 \.\. \d+"):
            call(begin=begin, count=count)


def test_an_index_beyond_the_end_is_refused(call: Call) -> None:
    for label in [a.label for a in call.table.arguments if a.below]:
        for wrong in (10**6, -1):
            with pytest.raises(ValueError, match=rf"{call.table.name}: {label}: expected below .*, got {wrong}"):
                call(**{label: wrong})


def vectors(count: int, dtype: Any = wp.vec3) -> wp.array:
    return wp.zeros(count, dtype=dtype, device="cpu")


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((0, 10, 1.0, vectors(5), vectors(10)), ValueError, "target_out: expected length N (N = 5 of change), got 10"),
        ((0, 10, 1.0, vectors(5), vectors(5)), ValueError, "threads: expected a span within 0 .. 5 = N, got 0 .. 10"),
        ((0, 5, 1.0, vectors(5, node8), vectors(5)), TypeError, "change: expected dtype vec3f, got vector(length=8"),
        ((0, 5, 1.0, None, vectors(5)), TypeError, "change: expected an array of vec3f, got NoneType"),
        ((0, 2, 1.0, wp.zeros((5, 2), dtype=wp.vec3, device="cpu")[:, 0], vectors(5)), ValueError, "contiguous"),
    ],
)
def test_what_is_said(arguments: tuple, error: type, message: str) -> None:
    with pytest.raises(error, match=re.escape(message)):
        add_scaled(*arguments)


def test_another_device_is_refused() -> None:
    class Other:
        def __str__(self) -> str:
            return "cuda:7"

    kernel = add_scaled.__globals__["_add_scaled"]
    with pytest.raises(ValueError, match="change: expected an array on cuda:7, got one on cpu"):
        check(kernel, 1, [0, 1.0, vectors(5), vectors(5)], Other())  # type: ignore[arg-type]


def test_recording_checks_and_a_refused_launch_is_not_recorded() -> None:
    with recording() as commands, pytest.raises(ValueError, match="target_out"):
        add_scaled(0, 5, 1.0, vectors(5), vectors(6))
    assert commands == []


def test_an_empty_span_may_stand_at_the_end() -> None:
    add_scaled(5, 0, 1.0, vectors(5), vectors(5))
    add_scaled(0, 0, 1.0, vectors(0), vectors(0))
    with pytest.raises(ValueError, match=r"within 0 \.\. 5"):
        add_scaled(6, 0, 1.0, vectors(5), vectors(5))


plain: Any = witness_functions.plain
"""A kernel, which Warp's annotation calls a function."""


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("threads: V; row: V+1; vertices: V", "vertices: expected 2 axes, got 'V'"),
        ("threads: V; vertices: T V", "row: expected 1 axes, got ''"),
        ("threads: W; row: V+1; vertices: T V", r"told by none: \['W'\]"),
        ("threads: V; row: V+1; vertices: T V; column: E", r"no such arguments: \['column'\]"),
        ("row: V+1; vertices: T V", "expected an entry for threads"),
        ("threads: V; row: V-1; vertices: T V", "expected a sum of products such as"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(table: str, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        sizes(table)(plain)


def test_a_kernel_without_a_table_is_refused() -> None:
    with pytest.raises(TypeError, match="plain: expected a kernel with a table of sizes"):
        check(plain, 1, [], wp.get_device("cpu"))


def test_a_table_is_read(device: str) -> None:
    sizes("threads: T*V; row: V+1; vertices: T V; source: <T")(plain)
    on = wp.get_device(device)
    vertices, row = wp.zeros((2, 3), dtype=wp.vec3, device=on), wp.zeros(4, dtype=wp.int32, device=on)
    check(plain, 6, [0, 1, row, vertices], on)
    check(plain, 1, [5, 1, row, vertices], on)
    for inputs, message in (
        ([0, 2, row, vertices], r"source: expected below T \(T = 2 of vertices\), got 2"),
        ([0, 0, row[:3], vertices], r"row: expected length V\+1 = 4 \(V = 3 of vertices\), got 3"),
        ([1, 0, row, vertices], r"threads: expected a span within 0 \.\. 6 = T\*V, got 1 \.\. 7"),
    ):
        with pytest.raises(ValueError, match=message):
            check(plain, 6, inputs, on)


def test_structs_have_tables() -> None:
    assert {"K", "N", "P", "T"} <= set(re.findall("[A-Z]", " ".join(_OF_STRUCTS[Pairs].values())))


def test_require(device: str) -> None:
    vertices = wp.zeros((2, 3), dtype=wp.vec3, device=device)
    require(vertices, "vertices", wp.vec3, (2, None))
    with pytest.raises(TypeError, match="vertices: expected dtype float32, got vec3"):
        require(vertices, "vertices", wp.float32, (2, 3))
    with pytest.raises(ValueError, match=r"vertices: expected shape \(2, 4\), got \(2, 3\)"):
        require(vertices, "vertices", wp.vec3, (2, 4))
    with pytest.raises(ValueError, match=r"vertices: expected shape \(None,\), got \(2, 3\)"):
        require(vertices, "vertices", wp.vec3, (None,))
    require_span("frames", 2, 3, 5)
    with pytest.raises(ValueError, match=r"frames: expected a span within 0 \.\. 4, got 2 \.\. 5"):
        require_span("frames", 2, 3, 4)

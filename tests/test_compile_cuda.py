"""Every kernel compiles for a CUDA device (sm_90), without one: NVRTC comes with Warp."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import pytest
import warp as wp
from cubin import Resources, resources

import warpdef.kernels
from warpdef.kernels import block_cg, chains, motion, sizes
from warpdef.kernels.clusters import CLUSTER

ARCHITECTURE = 90
CHAIN_REGISTERS = 64
REGISTERS = 128
WIDE = {"descend_in_blocks": 255, "solve_levels_in_blocks": 255}
"""Of 256 threads a block, of which a multiprocessor holds one: a line of nodes stays with its thread."""
STACKS = {
    "descend_in_blocks": 1024, "solve_levels_in_blocks": 1024, "nearby": 512, "closest_faces": 128, "local_planes": 96,
    "fit_patches": 72, "fit_rotations": 72, "expected_places": 32, "advance": 32,
}  # fmt: skip
"""Bytes of arrays that a kernel indexes as it runs, or hands to Warp's functions by address. All else is spilt."""
OLDER = 80


def modules_with_kernels() -> dict[str, wp.Module]:
    """Warp modules of all files in the kernels folder, and the unique ones of single kernels."""
    found = {}
    for info in pkgutil.iter_modules(warpdef.kernels.__path__):
        name = f"warpdef.kernels.{info.name}"
        importlib.import_module(name)
        module = wp.get_module(name)
        if module.kernels:
            found[info.name] = module
    for kernel in sizes.tables():
        path = Path(kernel.func.__code__.co_filename)
        if path.parent.name == "kernels" and kernel.module not in found.values():
            found[f"{path.stem}-{kernel.module.name.split('.')[-1]}"] = kernel.module
    return found


def compile_for_cuda(module: wp.Module, folder: Path) -> Path:
    (binary,) = wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=folder, use_ptx=False)
    return binary


@pytest.mark.parametrize("name", sorted(modules_with_kernels()))
def test_it_compiles(name: str, tmp_path: Path) -> None:
    binary = compile_for_cuda(modules_with_kernels()[name], tmp_path)
    assert binary.suffix == ".cubin" and binary.stat().st_size > 1000
    for symbol, found in resources(binary).items():
        kernel = symbol.split("__")[-1].lstrip("_").rsplit("_", 4)[0]
        assert found.registers <= WIDE.get(kernel, REGISTERS) and found.stack <= STACKS.get(kernel, 0), (kernel, found)


@pytest.mark.parametrize(
    "module", [block_cg._solve_frames.module, chains._move_chains.module, motion._move_points.module]
)
def test_it_compiles_for_older_devices(module: wp.Module, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What asks for sm_90 has another form there. Of a cluster Warp takes one block on such a device, and says so of
    code that is compiled for none."""
    monkeypatch.setattr("warp._src.context._cluster_dim_target_status", lambda device, compiled: "ignored")
    (text,) = wp.compile_aot_module(module, arch=OLDER, module_dir=tmp_path, use_ptx=True)
    ptx = text.read_text(encoding="utf-8")
    assert f".target sm_{OLDER}" in ptx
    assert not any(word in ptx for word in ("barrier.cluster", "cluster_ctarank", "red.global.add.v4"))
    (binary,) = wp.compile_aot_module(module, arch=OLDER, module_dir=tmp_path, use_ptx=False)
    assert max(found.registers for found in resources(binary).values()) <= REGISTERS


def test_no_file_with_kernels_is_missed() -> None:
    """The folder's own text is the witness: whoever says wp.kernel is on the list."""
    folder = Path(warpdef.kernels.__path__[0])
    files = {path.stem for path in folder.glob("*.py") if "@wp.kernel" in path.read_text(encoding="utf-8")}
    assert files == {name.split("-")[0] for name in modules_with_kernels()}


def test_a_large_system_has_a_cluster(tmp_path: Path) -> None:
    """Of as many blocks as its kernel thinks, which wait for one another."""
    module = block_cg._solve_frames.module
    (text,) = wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
    ptx = text.read_text(encoding="utf-8")
    assert ptx.count("barrier.cluster.arrive.release") == ptx.count("barrier.cluster.wait.acquire") > 1
    assert f".reqnctapercluster {CLUSTER}, 1, 1" in ptx and f".maxntid {block_cg.BLOCK_LANES}, 1, 1" in ptx


def test_chains_fit_into_their_registers(tmp_path: Path) -> None:
    """Four blocks of 256 threads a multiprocessor, and nothing that a register has no room for."""
    found = resources(compile_for_cuda(chains._move_chains.module, tmp_path))
    assert len(found) == 2
    assert all(r.registers <= CHAIN_REGISTERS and r.stack == 0 for r in found.values()), found


def test_what_does_not_fit_into_registers_is_seen(tmp_path: Path) -> None:
    @wp.func_native("float kept[40]; for (int k = 0; k < 40; ++k) kept[k] = i * k; return kept[(i * i) % 40];")
    def many(i: int) -> float: ...

    @wp.kernel(module="unique", enable_backward=False)
    def use_them(out: wp.array[wp.float32]):
        i = wp.tid()
        out[i] = many(i)  # pyright: ignore[reportIndexIssue] - Warp compiles this line

    (found,) = resources(compile_for_cuda(use_them.module, tmp_path)).values()
    assert found.stack >= 4 * 40 and found != Resources(found.registers, 0)


def test_our_adjoints_are_written_by_hand() -> None:
    """Warp's automatic ones would multiply the compile time for nothing."""
    assert [n for n, m in modules_with_kernels().items() if m.options["enable_backward"]] == []


def test_what_does_not_compile_fails(tmp_path: Path) -> None:
    @wp.func_native("return no_such_thing;")
    def broken() -> float: ...

    @wp.kernel(module="unique", enable_backward=False)
    def use_it(out: wp.array[wp.float32]):
        out[wp.tid()] = broken()  # pyright: ignore[reportIndexIssue] - Warp compiles this line

    with pytest.raises(Exception, match="(?i)cuda kernel build failed|nvrtc|compil"):
        compile_for_cuda(use_it.module, tmp_path)

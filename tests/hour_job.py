"""What the parts of an hour on a device work on: a device, sizes, a sequence whose truth is known."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np

if TYPE_CHECKING:
    import warp as wp

    from warpdef.apps.benchmark.sizes import Size
    from warpdef.mesh import MeshSequence


@dataclass(frozen=True)
class Job:
    """device: as ``--device``. quick: tiny. folder: of the results. data: a true sequence, or None for the figure."""

    device: str
    quick: bool
    folder: Path
    data: Path | None = None

    def facts(self) -> dict[str, Any]:
        """What results depend on."""
        from warpdef.apps.experiments.code_version import code_version
        from warpdef.device import find_device

        name = find_device(self.device).name
        return {
            "device": f"{self.device} ({name})",
            "quick": self.quick,
            "data": self.data and self.data.name,
            "code": code_version(),
        }

    @cached_property
    def target(self) -> wp.Device:
        from warpdef.device import find_device

        return find_device(self.device)

    @cached_property
    def cuda(self) -> bool:
        from warpdef.device import is_cuda

        return is_cuda(self.target)

    @cached_property
    def size(self) -> Size:
        """The work that all figures are about."""
        from warpdef.apps.benchmark.sizes import SIZES_QUICK, WORK

        return SIZES_QUICK[0] if self.quick else WORK

    def truth(self, frames: int) -> MeshSequence:
        """The first ``frames`` of the sequence."""
        from warpdef.mesh import MeshSequence

        if self.data is None:
            from bare_figure import bare_figure

            return bare_figure(frames, 0.06) if self.quick else bare_figure(frames)
        with np.load(self.data) as stored:
            vertices = stored["vertices"]
            if len(vertices) < frames:
                raise ValueError(f"{self.data}: expected at least {frames} frames, got {len(vertices)}")
            return MeshSequence(vertices[:frames].astype(np.float64), stored["faces"])

    def used_mb(self) -> float | None:
        """High-water mark of the device's memory pool, MB; None where there is none."""
        import warp as wp

        return wp.get_mempool_used_mem_high(self.target) / 1e6 if self.cuda else None


@contextmanager
def without_graphs() -> Iterator[None]:
    """Iterations made in the block are launched one kernel after the other on CUDA, too."""
    with mock.patch("warpdef.fit.workers.is_cuda", lambda device: False):
        yield


def sized(size: Size, **other: int) -> Size:
    """Another size made of this one."""
    return replace(size, name="made", **other)

"""``warpdef sample``: clouds from a true mesh sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from warpdef.apps.console import clean_stdout
from warpdef.apps.exit_codes import EXIT_OK
from warpdef.config_values import parse_slice
from warpdef.errors import InputError


def sample(
    truth: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    points: Annotated[int, Parameter(validator=Number(gte=10))] = 5000,
    frames: Annotated[str, Parameter(allow_leading_hyphen=True)] = "",
    noise: Annotated[float, Parameter(validator=Number(gte=0))] = 0.0,
    normals: Literal["auto", "true", "estimated", "none"] = "auto",
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Sample point clouds from a true mesh sequence.

    Args:
        truth: An npz with vertices (T, V, 3) and faces, a folder of meshes, or any other that warpdef datasets finds.
        output: File for the clouds, .npz.
        points: Points a frame, uniform by area, drawn anew in every frame.
        frames: Frames used, start:stop:step; empty: all.
        noise: Standard deviation of Gaussian noise, as a fraction of the frame's bounding-box diagonal.
        normals: true: of the sampled faces; estimated: from the cloud itself; auto: estimated where there is noise.
        seed: Seed of points and noise.
        overwrite: Replace OUTPUT if it exists.
    """
    from warpdef.datasets.truth import read_truth
    from warpdef.files import write_clouds_npz
    from warpdef.truth.sample import sample_sequence

    if output.exists() and not overwrite:
        raise InputError(f"{output}: already exists; choose another place, or replace it with --overwrite")
    with clean_stdout():
        meshes = read_truth(truth, parse_slice(frames))
        clouds = sample_sequence(meshes, points, noise=noise, seed=seed, normals=normals)
        write_clouds_npz(output, clouds)
    given = "without" if clouds.normals[0] is None else "with"
    print(f"{len(clouds)} frames of {points} points {given} normals: {output}")
    return EXIT_OK

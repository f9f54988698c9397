"""Which times the frames of a file show."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import bending_bar

from warpdef.apps.main import run
from warpdef.config import Config
from warpdef.errors import InputError
from warpdef.export.pace import frame_names, pace
from warpdef.files.run_folder import RunFolder
from warpdef.files.saved_run import load_run

BAR = bending_bar(5, 20, np.random.default_rng(0), subdivisions=1)


def test_paces():
    frames = range(5)
    np.testing.assert_array_equal(pace(frames, 24.0), [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(pace(frames, 24.0, slow=2.0), np.arange(9) / 2)
    np.testing.assert_array_equal(pace(frames, 60.0, recorded_fps=15.0), np.arange(17) / 4)
    np.testing.assert_array_equal(pace(frames, 24.0, slow=0.5), [0, 2, 4])
    np.testing.assert_array_equal(pace(frames, 24.0, slow=0.3), [0, 1 / 0.3])
    np.testing.assert_array_equal(pace([4, 2, 0], 24.0, slow=4.0), np.arange(8, -1, -1) / 2)
    np.testing.assert_array_equal(pace([3], 24.0, slow=10.0), [3])
    # Thirds are not exact; the last frame is there all the same, and whole frames are whole.
    thirds = pace(range(100), 24.0, slow=3.0)
    assert len(thirds) == 298 and (thirds[::3] == np.arange(100)).all()


@pytest.mark.parametrize("given", [{"fps": 0.0}, {"slow": -1.0}, {"recorded_fps": np.nan}, {"slow": np.inf}])
def test_bad_paces(given):
    with pytest.raises(InputError, match="expected a number above 0"):
        pace(range(3), **({"fps": 24.0} | given))


def test_too_many_frames():
    with pytest.raises(InputError, match="--slow: expected at most"):
        pace(range(3), 24.0, slow=1e7)


def test_names():
    assert frame_names(["a", "b", "c"], np.array([0.0, 0.25, 2.0])) == ("a", "a + 0.25", "c")


def test_slow_motion_reaches_the_file(tmp_path):
    pytest.importorskip("tomli_w")
    out = RunFolder.prepare(tmp_path / "out").save(
        vertices=BAR.vertices, faces=BAR.faces, keyframe=2, config=Config(), report={}, steps=[], names=list("abcde")
    )
    assert run(["export", str(out), str(tmp_path / "a.npz"), "--slow", "2", "--frames", "1:4"]) == 0
    with np.load(tmp_path / "a.npz") as stored:
        assert list(stored["names"]) == ["b", "b + 0.5", "c", "c + 0.5", "d"]
        np.testing.assert_array_equal(stored["vertices"], load_run(out).at([1, 1.5, 2, 2.5, 3]))

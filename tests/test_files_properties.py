"""Properties that hold for any input: what is written is read back, any bytes give a result or one ``InputError``."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass

import numpy as np
import pytest
from mutation_samples import las, lzf_compress, pcd, ply, saved, text

from warpdef.config import Config
from warpdef.errors import ConfigError, InputError
from warpdef.files import read_clouds
from warpdef.files.config_file import config_from_mapping, config_to_toml, known_keys, load_config
from warpdef.files.formats import CLOUD_SUFFIXES, read_surface
from warpdef.files.frame_numbers import natural_key
from warpdef.files.lzf import lzf_decompress
from warpdef.sequence import PointSequence, name_frames

hypothesis = pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402
from hypothesis.extra import numpy as hnp  # noqa: E402

# A file of a fixture is written anew by every example; a slow machine is no failure.
EXAMPLES = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
NUMBERS = st.floats(-1e30, 1e30, allow_nan=False)
CLOUDS = hnp.arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=NUMBERS)
WRITERS = {
    **{f"{form}.ply": lambda p, form=form: ply(p, None, form) for form in ("ascii", "binary_little_endian")},
    "big.ply": lambda p: ply(p, None, "binary_big_endian"),
    "a.obj": lambda p: text(p, "v ").encode(),
    "a.off": lambda p: f"OFF\n{len(p)} 0 0\n{text(p)}".encode(),
    "a.xyz": lambda p: text(p).encode(),
    "a.npy": lambda p: saved(np.save, p),
    **{f"{form}.pcd": lambda p, form=form: pcd(p, None, form) for form in ("ascii", "binary", "binary_compressed")},
}


@pytest.mark.parametrize("name", WRITERS)
@EXAMPLES
@given(points=CLOUDS)
def test_every_reader_gives_back_what_was_written(tmp_path, name, points):
    path = tmp_path / name
    path.write_bytes(WRITERS[name](points))
    np.testing.assert_array_equal(read_surface(path, CLOUD_SUFFIXES).points, points)


@EXAMPLES
@given(
    steps=hnp.arrays(np.int32, st.tuples(st.integers(1, 20), st.just(3))),
    scale=st.floats(1e-6, 1e3),
    offset=st.floats(-1e8, 1e8),
)
def test_las_gives_steps_times_scale_plus_offset(tmp_path, steps, scale, offset):
    data = bytearray(las(np.zeros(steps.shape), scale, offset))
    data[227:] = np.concatenate(
        [steps.view(np.uint8).reshape(-1, 12), np.zeros((len(steps), 8), np.uint8)], 1
    ).tobytes()
    (tmp_path / "a.las").write_bytes(data)
    expected = steps.astype(np.float64) * scale + offset
    np.testing.assert_array_equal(read_surface(tmp_path / "a.las", CLOUD_SUFFIXES).points, expected)


@pytest.mark.parametrize("suffix", [*CLOUD_SUFFIXES, ".npz"])
@EXAMPLES
@given(data=st.data())
def test_any_bytes_give_a_result_or_one_sentence(tmp_path, suffix, data):
    heads = {
        ".npy": b"\x93NUMPY",
        ".npz": b"PK\3\4",
        ".ply": b"ply\nformat ascii 1.0\n",
        ".las": b"LASF",
        ".off": b"OFF",
    }
    head = data.draw(st.sampled_from([b"", heads.get(suffix, b"")]))
    path = tmp_path / f"a{suffix}"
    path.write_bytes(head + data.draw(st.binary(max_size=400)))
    try:
        if suffix == ".npz":
            read_clouds(path)
        else:
            surface = read_surface(path, CLOUD_SUFFIXES)
            assert surface.points.dtype == np.float64 and surface.points.shape[1:] == (3,)
    except InputError as error:
        assert f"a{suffix}" in str(error) and "\n" not in str(error)


@pytest.mark.parametrize("suffix", [".obj", ".off", ".xyz", ".pcd", ".ply"])
@EXAMPLES
@given(lines=st.lists(st.lists(st.sampled_from("v vn f 1 2/1 3//3 -1 0 1e5 nan OFF 9 # \\ x".split()), max_size=8)))
def test_any_words_give_a_result_or_one_sentence(tmp_path, suffix, lines):
    path = tmp_path / f"a{suffix}"
    path.write_text("\n".join(map(" ".join, lines)))
    try:
        assert read_surface(path, CLOUD_SUFFIXES).points.shape[1:] == (3,)
    except InputError as error:
        assert f"a{suffix}" in str(error) and "\n" not in str(error)


SPOILT = {
    "plain": lambda p: p,
    "holes": lambda p: np.where(p > 0.9, np.nan, p),
    "huge": lambda p: np.where(p > 1.2, -1e200, p),
    "repeats": lambda p: np.rint(p),
    "equal": lambda p: 0 * p,
    "tiny": lambda p: p * 1e-200,
}


@EXAMPLES
@given(
    made=st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from(list(SPOILT)), st.integers(0, 99)), min_size=2, max_size=6
    )
)
def test_a_sequence_is_clean_and_loses_no_frame(made):
    clouds = [SPOILT[kind](np.random.default_rng(seed).normal(size=(count, 3))) for count, kind, seed in made]
    try:
        sequence = PointSequence.from_arrays(clouds)
    except InputError as error:
        assert "\n" not in str(error)
        return
    assert sequence.frame_count == len(clouds)
    assert sorted([*sequence.numbers, *(gap.number for gap in sequence.gaps)]) == list(range(len(clouds)))
    for number, points, merged, dropped in zip(
        sequence.numbers, sequence.points, sequence.merged, sequence.dropped, strict=True
    ):
        assert len(points) >= 10 and np.isfinite(points).all()
        assert len(np.unique(points, axis=0)) == len(points)
        assert len(points) + merged + dropped == len(clouds[number])
    backwards = sequence.select(slice(None, None, -1)).select(slice(None, None, -1))
    assert (backwards.numbers, backwards.gaps) == (sequence.numbers, sequence.gaps)
    assert not any("\n" in line for line in sequence.warnings)


@EXAMPLES
@given(data=st.binary(max_size=3000))
def test_lzf_is_undone(data):
    assert lzf_decompress(lzf_compress(data), len(data)) == data


@EXAMPLES
@given(data=st.binary(max_size=300), size=st.integers(0, 600))
def test_any_bytes_unpack_to_what_is_declared_or_not_at_all(data, size):
    try:
        assert len(lzf_decompress(data, size)) == size
    except ValueError:
        pass


@EXAMPLES
@given(numbers=st.lists(st.integers(0, 10**9), min_size=2, unique=True), width=st.integers(0, 12))
def test_numbers_sort_as_numbers(numbers, width):
    names = [f"scan_{number:0{width}d}" for number in numbers]
    assert sorted(names, key=natural_key) == [f"scan_{number:0{width}d}" for number in sorted(numbers)]


@EXAMPLES
@given(numbers=st.lists(st.integers(0, 300), min_size=1, unique=True))
def test_frames_are_named_on_one_short_line(numbers):
    line = name_frames(numbers)
    assert len(line) < 90 and str(min(numbers)) in line and str(max(numbers)) in line


VALUES = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.lists(st.integers(), max_size=2)
)
KEYS = st.sampled_from([*(f.name for f in fields(Config)), "seeds", "Grid", ""]) | st.text(max_size=6)
LEAVES = st.sampled_from([key.rpartition(".")[2] for key in known_keys()]) | st.text(max_size=6)


@EXAMPLES
@given(mapping=st.dictionaries(KEYS, VALUES | st.dictionaries(LEAVES, VALUES, max_size=3), max_size=4))
def test_any_mapping_is_a_configuration_or_one_sentence(mapping):
    try:
        config = config_from_mapping(mapping)
    except ConfigError as error:
        assert "\n" not in str(error)
        return
    whole = asdict(config)
    for key, value in mapping.items():
        for name, inner in value.items() if isinstance(value, dict) else [(None, value)]:
            assert (whole[key] if name is None else whole[key][name]) == inner


@EXAMPLES
@given(data=st.data())
def test_a_configuration_survives_its_file(tmp_path, data):
    """Any valid one: numbers moved a little, where the bounds allow."""
    config = Config()
    for key in data.draw(st.lists(st.sampled_from(known_keys()), max_size=5)):
        group, _, leaf = key.rpartition(".")
        value = getattr(getattr(config, group) if group else config, leaf)
        if isinstance(value, bool):
            moved = data.draw(st.booleans())
        elif isinstance(value, int):
            moved = value + data.draw(st.integers(-3, 3))
        elif isinstance(value, float):
            moved = value * data.draw(st.floats(0.5, 2.0))
        else:
            continue
        try:
            config = config_from_mapping({group: {leaf: moved}} if group else {leaf: moved}, config)
        except ConfigError:
            continue
    (tmp_path / "c.toml").write_text(config_to_toml(config), encoding="utf-8")
    assert load_config(tmp_path / "c.toml") == config


@EXAMPLES
@given(data=st.binary(max_size=200) | st.text(max_size=200).map(lambda t: t.encode("utf-8", "surrogatepass")))
def test_any_toml_is_a_configuration_or_one_sentence(tmp_path, data):
    (tmp_path / "c.toml").write_bytes(data)
    try:
        assert is_dataclass(load_config(tmp_path / "c.toml"))
    except ConfigError as error:
        assert "c.toml" in str(error) and "\n" not in str(error)

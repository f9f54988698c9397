"""The hour's bookkeeping with parts that are none, what it reads of other programs, and its smallest part for real."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import gpu_hour
import hour_machine
import numpy as np
import pytest
from hour_book import DONE, FAILED, SKIPPED, Book, Row, Skip, row
from hour_machine import told_of_counters, told_of_tests

TITLES = {"a": "first", "b": "second", "c": "third"}


class Parts:
    """Parts that count how often each was done; ``trouble`` is what one raises."""

    def __init__(self, **trouble: BaseException) -> None:
        self.trouble, self.done = trouble, ""

    def __call__(self, letter: str) -> list[Row]:
        self.done += letter
        if letter in self.trouble:
            raise self.trouble[letter]
        return [row("figure", 2.0, "ms", 1.0), row("name", "x|y")]


def book(folder: Path, parts: Parts, device: str = "d") -> Book:
    return Book(folder, TITLES, {"device": device}, parts, "the command")


def quiet(text: str) -> None: ...


def test_it_goes_on_where_it_was_ended(tmp_path: Path) -> None:
    first = Parts(b=KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        book(tmp_path, first).go(tell=quiet)
    second = Parts()
    assert book(tmp_path, second).go(tell=quiet)
    assert (first.done, second.done) == ("ab", "bc")
    assert book(tmp_path, second).go(tell=quiet) and second.done == "bc"
    book(tmp_path, second).go("a,c", again=True, tell=quiet)
    assert second.done == "bcac"


def test_what_failed_or_had_nothing_is_tried_again_and_hides_nothing(tmp_path: Path) -> None:
    parts = Parts(a=RuntimeError("no luck"), b=Skip("no tool"))
    assert not book(tmp_path, parts).go(tell=quiet)
    kept = json.loads((tmp_path / "hour.json").read_text())["parts"]
    assert [kept[letter]["state"] for letter in "abc"] == [FAILED, SKIPPED, DONE]
    table = (tmp_path / "hour.md").read_text()
    assert "no luck" in table and "no tool" in table and "| figure | 2 ms | 1 (missed) |" in table and "x/y" in table
    again = Parts()
    assert book(tmp_path, again).go(tell=quiet) and again.done == "ab"


def test_results_of_another_device_are_not_taken(tmp_path: Path) -> None:
    book(tmp_path, Parts()).go(tell=quiet)
    other = Parts()
    book(tmp_path, other, "another").go("b", tell=quiet)
    assert other.done == "b"
    assert book(tmp_path, Parts()).finished("a") and not book(tmp_path, Parts()).finished("b")


def test_a_part_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected letters of abc, got z"):
        book(tmp_path, Parts()).go("a,z", tell=quiet)


def test_a_number_that_is_none_is_missed(tmp_path: Path) -> None:
    Book(tmp_path, TITLES, {}, lambda letter: [row("x", float("nan"), most=1.0)]).go("a", tell=quiet)
    assert "| x | not finite | 1 (missed) |" in (tmp_path / "hour.md").read_text()


def test_a_part_ends_with_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, told = tmp_path / "slow.py", tmp_path / "told"
    program.write_text(
        f"import subprocess, time\nopen({str(told)!r}, 'w').write(str(subprocess.Popen(['sleep', '600']).pid) + '.')\n"
        "time.sleep(600)\n"
    )
    monkeypatch.setattr(gpu_hour, "__file__", str(program))
    with pytest.raises(TimeoutError, match="not done after 2 s"):
        gpu_hour.run_apart("a", [], tmp_path, 2.0)
    wait_for(lambda: is_over(int(float(told.read_text()))))  # it goes with what began it


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process of the end of its parent")
def test_a_part_ends_with_the_program_that_began_it(tmp_path: Path) -> None:
    """Killed, it can clear nothing up; what went on would write where the next attempt does."""
    part, whole, told = tmp_path / "part.py", tmp_path / "whole.py", tmp_path / "told"
    sees = f"import sys; sys.path[:0] = [{str(Path(__file__).parent)!r}]; import gpu_hour\n"
    part.write_text(
        f"{sees}import subprocess, time\ngpu_hour.end_with_parent()\n"
        f"open({str(told)!r}, 'w').write(str(subprocess.Popen(['sleep', '60']).pid) + '.')\ntime.sleep(60)\n"
    )
    whole.write_text(
        f"{sees}from pathlib import Path\ngpu_hour.__file__ = {str(part)!r}\n"
        f"gpu_hour.run_apart('a', [], Path({str(tmp_path)!r}))\n"
    )
    process = subprocess.Popen([sys.executable, str(whole)])
    wait_for(lambda: told.exists() and told.read_text().endswith("."))
    process.kill()
    process.wait()
    wait_for(lambda: is_over(int(float(told.read_text()))))


def is_over(process: int) -> bool:
    """Whether a process of Linux has ended, waited for or not."""
    state = Path(f"/proc/{process}/stat")
    return not state.exists() or state.read_text().rsplit(")", 1)[1].split()[0] == "Z"


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_part_that_dies_says_its_last_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "dies.py"
    program.write_text("raise SystemExit('alas')\n")
    monkeypatch.setattr(gpu_hour, "__file__", str(program))
    (tmp_path / "part-a.json").write_text('{"rows": []}')  # of an earlier time: not this one's answer
    with pytest.raises(RuntimeError, match="code 1: alas"):
        gpu_hour.run_apart("a", [], tmp_path)


def test_without_the_device_nothing_is_begun(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert gpu_hour.main(["--device", "cuda:99", "--out", str(tmp_path / "out")]) == 2
    assert "cuda:99" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_what_a_part_starts_finds_the_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "starts.py"
    program.write_text(
        "import json, subprocess, sys\n"
        "where = [sys.executable, '-c', 'import warpdef.kernels, hour_book; print(warpdef.__file__)']\n"
        "found = subprocess.run(where, capture_output=True, text=True, check=True).stdout\n"
        f"json.dump({{'rows': [found.strip()]}}, open({str(tmp_path / 'part-a.json')!r}, 'w'))\n"
    )
    monkeypatch.setattr(gpu_hour, "__file__", str(program))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "elsewhere"))
    monkeypatch.chdir(tmp_path)
    (found,) = gpu_hour.run_apart("a", [], tmp_path)
    assert Path(str(found)) == Path(__file__).resolve().parents[1] / "warpdef" / "__init__.py"


def test_every_part_is_there() -> None:
    import hour_fits
    import hour_machine

    assert "".join(gpu_hour.TITLES) == "abcdefghij"
    for letter in gpu_hour.TITLES:
        assert hasattr(hour_machine, f"part_{letter}") != hasattr(hour_fits, f"part_{letter}")


REPORT = """<testsuites><testsuite>
<testcase classname="tests.test_a" name="good[cuda:0]"/>
<testcase classname="tests.test_a" name="left"><skipped message="no"/></testcase>
<testcase classname="tests.test_a" name="bad[cuda:0]"><failure message="assert 1 == 2&#10;more">t</failure></testcase>
<testcase classname="" name="tests.test_b"><error message="collection failure">cyclopts</error></testcase>
</testsuite></testsuites>"""


def test_tests_are_counted_and_failures_named() -> None:
    found = {r["what"]: r["value"] for r in told_of_tests([REPORT])}
    assert found == {
        "passed": 1,
        "failed": 1,
        "skipped": 1,
        "files not collected": 1,
        "tests.test_a::bad[cuda:0]": "assert 1 == 2",
    }
    with pytest.raises(RuntimeError, match="no test ran"):
        told_of_tests(["<testsuites/>"])


def test_tests_are_shared_among_processes_and_late_ones_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = hour_machine.Job("cpu", True, tmp_path)
    shared = []

    def run(job: hour_machine.Job, number: int, names: list[str]) -> str | None:
        shared.append((number, names))
        return REPORT if number == 0 else None

    monkeypatch.setattr("warpdef.device.usable_cores", lambda: 2)
    monkeypatch.setattr(hour_machine, "_run_tests", run)
    found = {r["what"]: r["value"] for r in hour_machine.part_c(job)}
    first, second = sorted(shared)
    assert sorted([*first[1], *second[1]]) == sorted(hour_machine.QUICK_TESTS)
    assert found["failed"] == 1 and found["not done in time, one of"] == ", ".join(second[1])


def test_counters_are_means_by_kernel() -> None:
    text = '==PROF== ready\n"ID","Kernel Name","Metric Name","Metric Unit","Metric Value"\n'
    text += (
        '"0","scatter(int)","time","ns","1,000"\n"1","scatter(int)","time","ns","3,000"\n"2","cosine","x","","n/a"\n'
    )
    assert told_of_counters(text) == [row("scatter: time", 2000.0, "ns")]


BARE = """
import sys
class Bare:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {blocked!r}:
            raise ImportError(name)
sys.meta_path.insert(0, Bare())
sys.path[:0] = {folders!r}
import gpu_hour, hour_fits, hour_machine
from pathlib import Path
job = hour_fits.Job("cpu", True, Path({folder!r}))
print(len(job.facts()), len(gpu_hour.run_here("b", job)))
truth = job.truth(3)
hour_fits._fit(job, truth, 200, config=hour_fits._config(job, 1, iterations=4))
"""


def test_the_smallest_part_and_a_fit_need_numpy_scipy_and_warp_alone(tmp_path: Path) -> None:
    tests = Path(__file__).resolve().parent
    blocked = {
        "trimesh",
        "gpytoolbox",
        "pymeshlab",
        "pyvista",
        "cyclopts",
        "rich",
        "tomli_w",
        "matplotlib",
        "distributed",
    }
    text = BARE.format(blocked=blocked, folders=[str(tests.parent), str(tests)], folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-2:] == ["4", "8"]


def test_the_figure_without_a_meshing_library_is_closed_and_outward() -> None:
    from bare_figure import bare_body

    from warpdef.truth.body import body_distance

    vertices, faces = bare_body(0.06)
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 > 0.05  # cubic metres
    assert np.abs(body_distance(vertices)).max() < 2e-3


def test_both_stages_can_be_timed_call_by_call(tmp_path: Path) -> None:
    """The one part that stands on the stages' own classes, at its tiniest."""
    from contextlib import closing

    from hour_fits import Job, Source, _Bench, _config, make_work
    from hour_job import sized

    job = Job("cpu", True, tmp_path)
    work = make_work(Source("", job.truth(3)), sized(job.size, frames=3, points=200))
    bench = _Bench(job, work, _config(job, work.keyframe, chain=True, warmup=1))
    with closing(bench.team):
        times, (rounds, settled) = bench.iterations(2), bench.rounds(1)
    assert len(times) == 2 and len(rounds) == 1 and min(*times, *rounds, settled) > 0

"""Tables, verdicts and pictures, on made-up results whose right answer is known."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from pathlib import Path

import pytest
from experiment_samples import Named, known_data, made_up

from warpdef.apps.experiment import NAMES, _builder
from warpdef.apps.experiments.plan import Experiment, Plan
from warpdef.apps.experiments.plot import plot, require_plotting
from warpdef.apps.experiments.published import published
from warpdef.apps.experiments.report import COLUMNS, csv_text, table_rows, write_report
from warpdef.apps.experiments.session import Outcome, Results
from warpdef.apps.experiments.verdicts import verdicts
from warpdef.errors import MissingPackageError

PAIR = Plan((Named("one"), Named("two")))


def built(name: str, plan: Plan = PAIR) -> Experiment:
    return _builder(name)(plan)


def results(table: Experiment, **errors: float) -> Results:
    """A result for every run; ``errors`` gives Chamfer distances in 1e-5 by setting, underscores for blanks."""
    by_name = {key.replace("_", " "): value for key, value in errors.items()}
    return {
        run.key: made_up(run, 1e-5 * by_name.get(setting.name, 1.0))
        for setting in table.settings
        for run in setting.runs
    }


def test_rows_of_a_setting_are_sequences_mean_and_published() -> None:
    table = built("resolution")
    rows = [row for row in table_rows(table, results(table)) if row["setting"] == "2,500 points"]
    assert [(row["who"], row["data"]) for row in rows] == [
        ("warpdef", "one"),
        ("warpdef", "two"),
        ("warpdef", "mean of 2"),
        ("paper", "AMA (33 sequences)"),
    ]
    assert rows[2]["chamfer_l2"] == pytest.approx(1e-5) and rows[2]["worst"] == pytest.approx(2e-5)
    assert rows[3]["chamfer_l2"] == pytest.approx(0.79e-5) and rows[3]["normal_consistency"] == 0.922


def test_the_mean_is_of_what_is_finished_and_says_so() -> None:
    table = built("noise")
    found = results(table)
    first, second = table.settings[0].runs
    found[first.key]["mean"]["chamfer_l2"] = 3e-5
    del found[second.key]
    mean = next(row for row in table_rows(table, found) if row["data"] == "mean of 1")
    assert mean["chamfer_l2"] == 3e-5 and mean["source"] == "1 of 2 not finished"


def test_a_measure_that_one_sequence_lacks_has_no_mean() -> None:
    table = built("main")
    found = results(table)
    found[table.runs()[0].key]["mean"]["tracking"] = None
    rows = table_rows(table, found)
    assert next(row for row in rows if row["data"] == "mean of 2")["tracking"] is None
    assert next(row for row in rows if row["data"] == "two")["tracking"] == 0.004


def test_csv_reads_back() -> None:
    table = built("components")
    rows = table_rows(table, results(table))
    read = list(csv.DictReader(io.StringIO(csv_text(rows))))
    assert tuple(read[0]) == COLUMNS and len(read) == len(rows)
    assert [float(r["chamfer_l2"]) for r in read] == [r["chamfer_l2"] for r in rows]
    assert {r["tracking"] for r in read if r["who"] == "paper"} == {""}


@pytest.mark.parametrize("name", NAMES)
def test_files_of_every_experiment(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    table = built(name, known_data(tmp_path))
    rows = write_report(table, Outcome(results(table)), tmp_path, "warpdef experiment")
    plot(table, rows, tmp_path / f"{name}.png")
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads((tmp_path / f"{name}.json").read_text())
    assert report["rows"] == json.loads(json.dumps(rows)) and len(report["runs"]) == len(table.settings)
    text = (tmp_path / f"{name}.md").read_text()
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in tables}) == 1
    assert all(setting.name in text for setting in table.settings)
    for row in (row for setting in table.settings for row in published(name, setting.name)):
        assert re.search(rf"\| {re.escape(row.setting)} \| {row.who} \|", text)


def test_nothing_finished_is_no_table_but_no_error(tmp_path: Path) -> None:
    table = built("ideas")
    assert write_report(table, Outcome(failures={"x": "one 0:17: no"}), tmp_path, "c") == []
    assert "one 0:17: no" in (tmp_path / "ideas.md").read_text()
    assert verdicts(table, {}) == []


def test_plotting_without_matplotlib_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'warpdef\[bench\]'"):
        require_plotting()


def test_a_trend_that_holds_and_one_that_does_not() -> None:
    table = built("levels", Plan((Named("one"),)))
    falling = {s.name.replace(" ", "_"): 10.0 - i for i, s in enumerate(table.settings)}
    (said,) = verdicts(table, results(table, **falling))
    assert said.startswith("one: CD falls with the number of levels: yes (10, 9,")
    falling["6_levels"] = 9.5
    (said,) = verdicts(table, results(table, **falling))
    assert "no, not from 4 levels to 6 levels (8 to 9.5)" in said
    (said,) = verdicts(table, results(table))
    assert "no, not from 1 level to 12 levels" in said, "standing still is not falling"


def test_noise_must_make_it_worse() -> None:
    table = built("noise", Plan((Named("one"),)))
    rising = {s.name: 1e-5 * (1 + i) for i, s in enumerate(table.settings)}
    found = {s.runs[0].key: made_up(s.runs[0], rising[s.name]) for s in table.settings}
    assert verdicts(table, found) == ["one: CD grows with noise: yes (1, 2, 3, 4, 5)."]
    found = {s.runs[0].key: made_up(s.runs[0], 1e-5 / (1 + i)) for i, s in enumerate(table.settings)}
    assert "no, not from 0 % to 0.25 %" in verdicts(table, found)[0]


def test_components_are_ranked_by_what_they_are_worth() -> None:
    table = built("components")
    # Multi-resolution divides by 10, preconditioning by 2, isometry by 1.1.
    errors = {
        s.name: 100 / 10 ** ("M" in s.name) / 2 ** ("P" in s.name) / 1.1 ** ("I" in s.name) for s in table.settings
    }
    found = {r.key: made_up(r, 1e-5 * errors[s.name]) for s in table.settings for r in s.runs}
    said = verdicts(table, found)
    assert said[0].endswith("yes (CD without over with: multi-resolution 10.00, preconditioning 2.00, isometry 1.10).")
    assert sum("full method is best: yes" in text for text in said) == 2
    swapped = {r.key: made_up(r, 1e-5 / errors[s.name]) for s in table.settings for r in s.runs}
    said = verdicts(table, swapped)
    assert "next: no" in said[0] and sum("full method is best: no" in text for text in said) == 2


def test_an_unfinished_table_of_components_is_not_ranked() -> None:
    table = built("components", Plan((Named("one"),)))
    found = results(table)
    del found[table.settings[2].runs[0].key]
    said = verdicts(table, found)
    assert said and not any("nan" in text or "matters most" in text for text in said)


def test_isometry_is_judged_by_tracking() -> None:
    table = built("components", Plan((Named("one"),)))
    for on, off, word in ((0.004, 0.005, "yes"), (0.006, 0.005, "no")):
        found = {s.runs[0].key: made_up(s.runs[0], tracking=on if "I" in s.name else off) for s in table.settings}
        assert f"one: isometry helps tracking: {word} ({on:.4f} with, {off:.4f} without)." in verdicts(table, found)


def test_targets_are_judged_one_by_one(tmp_path: Path) -> None:
    table = built("accuracy", known_data(tmp_path))
    found = results(table)
    by_name = {s.name: found[s.runs[0].key] for s in table.settings}
    good = {"chamfer_l2": 0.2804e-5, "normal_consistency": 0.9668, "f_score_0.5": 0.9971, "tracking": 0.00384}
    by_name["ama_crane 10:27"]["mean"].update(good)
    by_name["horse_gallop 0:17"]["mean"].update(chamfer_l2=0.3e-5, tracking=0.004)
    by_name["horse_gallop 0:17"]["worst"] = 0.7e-5
    by_name["face_mmface4d 0:17"]["mean"].update(chamfer_l2=0.29e-5)
    said = {text.split(": ")[0]: text.split(": ", 1)[1] for text in verdicts(table, found)}
    assert said["ama_crane 10:27"].startswith("met: chamfer_l2 0.28 for 0.28"), "as printed in tables"
    assert said["horse_gallop 0:17"] == "missed: worst frame 0.7 for 0.6."
    assert said["face_mmface4d 0:17"] == "met: above the floor by 0.09 for 0.1."
    assert said["crane_clouds"].startswith("missed: chamfer_l2 1 for 0.36; worst frame 2 for 0.5")
    assert set(said) == set(by_name)


def test_what_an_idea_is_worth_is_told_by_sequence() -> None:
    table = built("ideas", Plan((Named("one"),)))
    found = {
        run.key: made_up(run, (2e-5 if i else 1e-5) * (3 if run.noise else 1))
        for i, s in enumerate(table.settings)
        for run in s.runs
    }
    said = verdicts(table, found)
    assert len(said) == len(table.settings) - 1
    assert said[0].endswith("CD times one 2.00 (tracking 1.00), one, noise 0.5 % 2.00 (tracking 1.00).")


def test_an_idea_of_the_descent_is_judged_beside_the_descent() -> None:
    table = built("ideas", Plan((Named("one"),)))
    errors = {"all on": 1e-5, "without mesh that follows its guide": 4e-5, "without isometry": 6e-5}
    found = {run.key: made_up(run, errors.get(s.name, 2e-5)) for s in table.settings for run in s.runs}
    said = {line.split(":")[0]: line for line in verdicts(table, found)}
    assert "CD times one 4.00" in said["without mesh that follows its guide"]
    assert "CD times one 1.50" in said["without isometry, beside without mesh that follows its guide"]
    assert "CD times one 2.00" in said["without vertex stage"]


def test_initialization_compares_keyframes() -> None:
    table = built("initialization")
    said = verdicts(table, results(table, **{"first,_poisson": 2.0, "auto,_poisson": 3.0}))
    assert said[0] == "Keyframe middle is at least as good as the first: yes (1 and 2)."
    assert said[1] == "Keyframe auto is at least as good as the first: no (3 and 2)."
    assert said[2] == "Keyframe first: Poisson is at least as good as tetrahedra: no (2 and 1)."
    assert said[3] == "Keyframe middle: Poisson is at least as good as tetrahedra: yes (1 and 1)."
    found = results(table)
    del found[table.settings[0].runs[0].key], found[table.settings[0].runs[1].key]
    said = verdicts(table, found)
    assert len(said) == 2 and not any("first" in text for text in said), "nothing is said of what is not finished"


def test_long_fits_memory_and_counts_iterations() -> None:
    table = built("long", Plan((Named("one"),)))
    found = results(table)
    for setting in table.settings:
        (run,) = setting.runs
        if setting.x == 80:
            found[run.key]["mean"]["chamfer_l2"] = {50: 3e-5, 100: 1.04e-5, 200: 1e-5}[found[run.key]["iterations"]]
    said = verdicts(table, found)
    assert said[0].startswith("Memory: 1.00 MiB a frame (1,048,576 bytes) and 100 MiB at the start")
    assert "80 frames: 100 iterations come within 5 % of the best CD (50: 3, 100: 1.04, 200: 1)." in said

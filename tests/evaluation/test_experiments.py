"""The experiments run on a few rendered frames, and the report gathers them."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spheremcap.config import load_settings
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrFrame
from spheremcap.errors import UsageError
from spheremcap.evaluation import held_out
from spheremcap.evaluation.experiments import EXPERIMENTS, describe, run_experiment, run_report
from spheremcap.evaluation.hough_tuning import THESIS, hough_samples, tune, tune_hough
from spheremcap.evaluation.lab import Lab
from spheremcap.evaluation.lighting import gain_lut, offset_lut
from spheremcap.evaluation.metrics import TruthRow
from spheremcap.evaluation.report import write_report
from spheremcap.evaluation.result import Plot, Result, Table, load, save
from spheremcap.synth import render

matplotlib = pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    folder = tmp_path_factory.mktemp("lab")
    for scenario, frames in (("clean", 6), ("scale", 6)):
        render(scenario, folder / "sessions" / scenario, frames=frames)
    return Lab(folder, quick=True, only=("clean",), tell=lambda line: None)


def test_the_chain_alone_is_scored_on_a_session(lab: Lab) -> None:
    result = run_experiment("accuracy", lab)
    heading, row = result.tables[0].cells
    values = dict(zip(heading, row, strict=True))
    assert values["frames"] == "5"
    assert float(values["accuracy %"]) > 97
    assert values["failures"] == "0"
    kept = load(lab.folder, "accuracy")
    assert kept is not None
    assert kept.tables == tuple(Table(t.caption, [list(r) for r in t.cells]) for t in result.tables)
    assert kept.pictures[0][1].read_bytes().startswith(b"\x89PNG")


def test_peers_are_read_from_their_tables_when_they_were_run(lab: Lab) -> None:
    folder = lab.folder / "peers" / "clean"
    folder.mkdir(parents=True)
    (folder / "KCF.csv").write_text(
        "marker,frame,stamp_ns,status,x_px,y_px,r_px\nmarker,0,0,SEEDED,9,9,9\nmarker,1,1,LOST,,,\n"
    )
    result = run_experiment("peers", lab)
    heading, row = result.tables[0].cells
    values = dict(zip(heading, row, strict=True))
    assert values["KCF"] == "0.00 (1)"
    assert values["best peer"] == "HSV blob"
    assert values["better"] == "yes"


@pytest.mark.parametrize("name", ["colours", "kalman", "votes", "scale"])
def test_small_experiments_run_and_have_numbers(lab: Lab, name: str) -> None:
    result = run_experiment(name, lab)
    numbers = re.findall(r"\d+\.\d+", " ".join(cell for t in result.tables for row in t.cells for cell in row))
    assert numbers
    assert all(len(row) == len(t.cells[0]) for t in result.tables for row in t.cells)


@pytest.mark.slow
def test_the_exact_formula_beats_the_thesis_at_known_positions(lab: Lab) -> None:
    session = lab.folder / "sessions" / "static"
    if not (session / "seeds.toml").exists():
        render("static", session, frames=450)
    rows = {row[0]: row for row in run_experiment("positions", lab).tables[0].cells[1:]}
    assert abs(float(rows["edge rays"][1])) < 0.3 < abs(float(rows["thesis, l_o = radius"][1]))


@pytest.mark.slow
def test_every_experiment_runs_into_one_report(lab: Lab) -> None:
    page = run_report(lab, again=True).read_text(encoding="utf-8")
    assert all(f'<h2 id="{name}">' in page for name in EXPERIMENTS)


def test_experiments_are_described_and_unknown_ones_refused(lab: Lab) -> None:
    assert all(describe(name).endswith(".") for name in EXPERIMENTS)
    with pytest.raises(UsageError, match="unknown experiment 'speed'"):
        run_experiment("speed", lab)
    with pytest.raises(UsageError, match="unknown scenario 'fog'"):
        Lab(lab.folder).trial("fog")


def test_a_report_is_one_file_with_everything_inside(tmp_path: Path) -> None:
    plot = Plot("dots", "Dots & lines", lambda figure: figure.subplots().plot([1, 2], [3, 4]))
    table = Table("Numbers <raw>", [["", "a"], ["row", "1.5"]])
    save(Result("one", "First", "What it is.", "spheremcap experiment one", (table,), (plot,)), tmp_path)
    page = write_report(tmp_path, ["one", "two"]).read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert "Numbers &lt;raw&gt;" in page
    assert "Not run: two." in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    notes = (tmp_path / "experiments.md").read_text(encoding="utf-8")
    assert "| row | 1.5 |" in notes


def test_brightness_changes_are_what_they_are_called() -> None:
    assert (gain_lut(1.0) == np.arange(256)).all()
    assert gain_lut(2.0)[188] == 255  # sRGB 188 is half the light of white
    assert gain_lut(0.5)[255] == 188
    assert (offset_lut(40.0)[[0, 100, 250]] == [40, 140, 255]).all()


def disc_samples(count: int = 4) -> tuple[list[BgrFrame], list[TruthRow]]:
    frames, rows = [], []
    y, x = np.indices((80, 90))
    for k in range(count):
        circle = Circle(40.3 + k, 41.7, 14.2)
        away = np.hypot(x - circle.x_px, y - circle.y_px)
        gray = 60 + 120 * np.clip(circle.r_px + 0.5 - away, 0, 1)
        frames.append(BgrFrame(k, k, np.repeat(gray[..., None].astype(np.uint8), 3, axis=2)))
        rows.append(TruthRow("m", k, circle))
    return frames, rows


def test_tuning_never_ends_worse_than_the_thesis() -> None:
    frames, rows = disc_samples()
    samples = hough_samples(frames, rows)
    assert len(samples) == 4
    tuned = tune(samples, 12, grid=False)
    assert tuned.error <= tuned.thesis_error
    assert len(tuned.tried) == 13
    assert tune(samples, 12, grid=False).best == tuned.best
    with pytest.raises(UsageError, match="no frame"):
        tune([])


def test_tuned_settings_can_be_used(lab: Lab, tmp_path: Path) -> None:
    session = lab.folder / "sessions" / "clean"
    out = tmp_path / "tuned.toml"
    tuned = tune_hough(session / "session.mp4", session / "truth.csv", out, draws=2, grid=False)
    assert load_settings(out).chain.hough == tuned.best
    with pytest.raises(UsageError, match="--overwrite"):
        tune_hough(session / "session.mp4", session / "truth.csv", out, draws=0)
    whole = tmp_path / "whole.toml"
    tuned = tune_hough(
        session / "session.mp4", session / "truth.csv", whole, session / "settings.toml", draws=0, grid=False
    )
    assert load_settings(whole).camera.fx_px == 1150
    assert load_settings(whole).chain.hough == tuned.best
    assert set(THESIS) < set(tuned.best.model_dump())


def test_settings_are_chosen_without_the_kind_that_they_are_scored_on(lab: Lab, tmp_path: Path) -> None:
    """No kind likes votes that nothing can win."""
    settings = {"jury.th1": (3.5, 6.0), "edge.noise": (0.004,)}
    shutil.copytree(lab.folder / "sessions" / "clean", tmp_path / "clips" / "one")
    trials: list[str] = []
    result = held_out.held_out(replace(lab, clips=(tmp_path / "clips",), tell=trials.append), settings)
    assert trials == ["held-out: clean", "held-out: one"]
    heading, *rows = result.tables[0].cells
    assert [row[0] for row in rows] == ["racing", "clips"]
    for row in rows:
        values = dict(zip(heading, row, strict=True))
        assert 90 < float(values["Dice %, default"]) <= 100
        assert 90 < float(values["Dice %, chosen without it"]) <= 100
        assert "th1 = 6" not in values["chosen instead of the default"]


def test_no_kind_has_a_say_in_its_own_row(lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(lab.folder / "sessions" / "clean", tmp_path / "clips" / "one")
    asked: list[set[str]] = []
    monkeypatch.setattr(held_out, "chosen", lambda loss, settings: asked.append(set(loss)) or {})
    held_out.held_out(replace(lab, clips=(tmp_path / "clips",)), {})
    assert asked == [{"clips"}, {"racing"}]


def test_one_kind_of_footage_alone_cannot_be_left_out(lab: Lab) -> None:
    with pytest.raises(UsageError, match="--clips FOLDER"):
        held_out.held_out(lab)


def test_what_the_other_kinds_like_best_is_chosen_all_kinds_counting_alike() -> None:
    settings = {"a.b": (1.0, 2.0), "a.c": (3.0,)}
    many = {"default": 1.0, "a.b = 1": 0.8, "a.b = 2": 0.9, "a.c = 3": 1.0}
    few = {"default": 1.0, "a.b = 1": 1.1, "a.b = 2": 0.7, "a.c = 3": 1.0}
    assert held_out.chosen({"many": [many] * 9}, settings) == {"a.b": 1.0}
    assert held_out.chosen({"many": [many] * 9, "few": [few]}, settings) == {"a.b": 2.0}
    assert held_out.chosen({"few": [{**few, "a.b = 2": 1.0}]}, settings) == {}


def test_what_is_proposed_without_a_seed_is_held_against_the_truth(lab: Lab) -> None:
    result = run_experiment("proposals", lab)
    heading, clip, total = result.tables[0].cells
    values = dict(zip(heading, clip, strict=True))
    assert (values["clip"], values["markers"], values["found"], values["first"]) == ("clean", "1", "1", "yes")
    assert float(values["least score of a marker"]) > 0.2
    assert total[:4] == ["all", "1", "1", "1 of 1"]
    assert total[4] == values["false"]


def test_strokes_are_scored_on_whatever_was_found(lab: Lab, tmp_path: Path) -> None:
    """A quarter of a second has hardly an event in it: the tables are there all the same."""
    result = run_experiment("strokes", Lab(tmp_path, quick=True, only=("strokes",), tell=lambda line: None))
    events, _, arms = result.tables
    heading, *rows = events.cells
    assert all(len(row) == len(heading) for row in rows)
    assert {row[heading.index("event")] for row in rows} == {"contact", "release"}
    assert [row[0] for row in arms.cells[1:]] == ["strokes"]
    assert "NaN" not in str(arms.cells)

"""What goes out to people without a viewer: marked-up video, plots, tables for a workbook."""

import csv

import av
import numpy as np
import pytest
from session_data import write_session

import spheremcap
from clips import COUNT, STEP_NS
from spheremcap.core.estimate import Status
from spheremcap.io.messages import MARKER_RGB


@pytest.fixture(scope="module")
def tracked(clip, tmp_path_factory):
    out = tmp_path_factory.mktemp("tracked") / "out.mcap"
    seeds = [
        spheremcap.Seed("orange", 0, spheremcap.Circle(100, 90, 18)),
        spheremcap.Seed("blue", 0, spheremcap.Circle(240, 170, 15)),
    ]
    spheremcap.track(clip, out, spheremcap.Settings(), seeds)
    return out


def frames(path):
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        return stream, [frame.to_ndarray(format="rgb24").astype(int) for frame in video.decode(stream)]


def share_of(picture, rgb):
    """How much of a picture has nearly this colour."""
    return float((np.abs(picture - 255 * np.array(rgb)).max(axis=-1) < 60).mean())


def test_a_video_has_all_pictures_with_the_circles_on_them(run, tracked, clip, tmp_path):
    out = tmp_path / "marked.mp4"
    outcome = run("render", tracked, "-o", out)
    assert outcome.code == 0, outcome.err
    assert outcome.out == f"{COUNT} pictures -> {out}\n"
    stream, shown = frames(out)
    assert stream.codec_context.name == "h264"
    _, plain = frames(clip)
    assert len(shown) == len(plain) == COUNT
    track = spheremcap.open(tracked).tracks["blue"]
    for index in (0, COUNT - 1):
        x, y, r = track.circle_px[index]
        around = [(round(x + r * np.cos(a)), round(y + r * np.sin(a))) for a in np.linspace(0, 2 * np.pi, 40)]
        drawn = np.array([shown[index][v, u] for u, v in around]).mean(axis=0)
        before = np.array([plain[index][v, u] for u, v in around]).mean(axis=0)
        wanted = 255 * np.array(MARKER_RGB[1])
        assert np.abs(drawn - wanted).sum() < 0.6 * np.abs(before - wanted).sum()
    assert run("render", tracked, "-o", out).code == 2  # it is there already


def test_it_can_be_slow_cut_out_and_of_some_markers_and_some_time(run, tracked, tmp_path):
    out = tmp_path / "cut.mp4"
    start, end = 4.5 * STEP_NS / 1e9, 9.5 * STEP_NS / 1e9
    flags = ("--crop", "orange", "--slow", "8", "--from", f"{start:.9f}", "--to", f"{end:.9f}", "--marker", "orange")
    outcome = run("render", tracked, "-o", out, *flags)
    assert outcome.code == 0, outcome.err
    stream, shown = frames(out)
    assert len(shown) == 5
    assert float(stream.average_rate) == pytest.approx(240 / 8, rel=1e-3)
    assert {picture.shape for picture in shown} == {(480, 480, 3)}
    middle = shown[2][200:280, 200:280]  # inside of the ball, 40 px of radius there
    assert middle[..., 0].mean() > middle[..., 2].mean() + 40  # which is orange
    assert share_of(shown[2], MARKER_RGB[1]) < share_of(shown[2], MARKER_RGB[0])


def test_what_cannot_be_rendered_is_one_line(run, tracked, tmp_path):
    for arguments, code, word in (
        (("-o", tmp_path / "a.avi"), 2, ".mp4 or .mkv"),
        (("-o", tmp_path / "a.mp4", "--marker", "nose"), 2, "there are: blue, orange"),
        (("-o", tmp_path / "a.mp4", "--crop", "nose"), 2, "to follow"),
        (("-o", tmp_path / "a.mp4", "--from", "50"), 2, "no picture in the time"),
        (("-o", tmp_path / "a.mp4", "--from", "2", "--to", "1"), 2, "not before"),
    ):
        outcome = run("render", tracked, *arguments)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (code, "", 1), outcome
        assert word in outcome.err
    assert not list(tmp_path.iterdir())


def test_plots_are_png_and_svg_and_the_same_each_time(run, tracked, tmp_path):
    made = []
    for name in ("one", "two"):
        outcome = run("plot", tracked, "-o", tmp_path / name, "--marker", "orange")
        assert outcome.code == 0, outcome.err
        files = sorted((tmp_path / name).iterdir())
        assert [file.name for file in files] == ["orange.png", "orange.svg"]
        made.append([file.read_bytes() for file in files])
    assert made[0] == made[1]
    assert made[0][0].startswith(b"\x89PNG")
    assert b"<svg" in made[0][1]
    assert run("plot", tracked, "-o", tmp_path / "one").code == 2
    assert run("plot", tracked, "-o", tmp_path / "none", "--marker", "nose").code == 2
    assert not (tmp_path / "none").exists()


def test_a_workbook_gets_semicolons_decimal_commas_and_units(run, tracked, tmp_path):
    out = tmp_path / "tracks.csv"
    outcome = run("export", tracked, "-o", out, "--excel", "--marker", "blue", "--from", f"{4.5 * STEP_NS / 1e9:.9f}")
    assert outcome.code == 0, outcome.err
    assert out.read_bytes().startswith(b"\xef\xbb\xbftime [s];UTC;marker;frame;status;x_px [px]")
    with out.open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    assert [row["frame"] for row in rows] == [str(k) for k in range(5, COUNT)]
    assert {row["marker"] for row in rows} == {"blue"}
    track = spheremcap.open(tracked).tracks["blue"]
    assert [float(row["x_px [px]"].replace(",", ".")) for row in rows] == track.circle_px[5:, 0].tolist()
    assert float(rows[0]["time [s]"].replace(",", ".")) == pytest.approx(5 * STEP_NS / 1e9, abs=1e-8)
    assert "." not in "".join(value for key, value in rows[0].items() if key.endswith("[px]"))
    assert run("export", tracked, "-o", tmp_path / "x.parquet", "--excel").code == 2
    assert run("export", tracked, "-o", tmp_path / "x.csv", "--marker", "nose").code == 2
    assert not list(tmp_path.glob("x*"))


def test_points_go_to_c3d_and_trc_with_what_is_to_know_on_stderr(run, tracked, tmp_path):
    session = write_session(tmp_path / "r.mcap", range(20), {"left_wrist": {7: Status.LOST}})
    for ending, err in (("c3d", ""), ("trc", "spheremcap: left_wrist: 1 of 10 frames are blank")):
        out = tmp_path / f"points.{ending}"
        outcome = run("export", session, "-o", out, "--marker", "left_wrist", "--to", f"{9.5 * STEP_NS / 1e9:.9f}")
        assert (outcome.code, outcome.out) == (0, f"10 frames -> {out}\n"), outcome.err
        assert outcome.err.startswith(err)
        assert outcome.err.count("\n") == bool(err)
    for words, code, said in (
        (("-o", tmp_path / "a.trc", "--fill", 20), 2, "cannot mark"),
        (("-o", tmp_path / "a.csv", "--fill", 20), 2, "--fill is for .c3d"),
        (("-o", tmp_path / "a.c3d", "--table", "events"), 2, "--table is for"),
        (("-o", tmp_path / "a.xyz"), 2, ".csv, .parquet, .c3d, .trc"),
        (("-o", tmp_path / "a.csv", "--table", "cycles"), 1, "spheremcap analyse"),
        (("-o", tmp_path / "a.c3d"), 1, "needs a --camera"),  # its picture is of a size that no camera is assumed for
    ):
        outcome = run("export", tracked, *words)
        assert (outcome.code, outcome.out, outcome.err.count("\n")) == (code, "", 1)
        assert said in outcome.err
    assert not list(tmp_path.glob("a.*"))


def test_parquet_has_units_in_its_columns(run, tracked, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "tracks.parquet"
    assert run("export", tracked, "-o", out).code == 0
    schema = parquet.read_schema(out)
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in schema}
    assert (units["x_px"], units["x_cam_m"], units["vx_cam_mps"], units["stamp_ns"]) == ("px", "m", "m/s", "ns")
    assert (units["marker"], units["frame"], units["vote_sum"]) == ("", "", "of 6")

"""Answers go into a recording: what they change is tracked again, all else is copied, and track does it at once."""

import shutil
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import pytest
from filmed import (
    COUNT,
    FIRST,
    SETTINGS,
    answers,
    covered,
    decoy,
    elbow,
    knee,
    seed,
    spans,
    wrist,
    write_film,
)
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from clips import START_NS, decoded, rows, write_recording
from clips import seed as clip_seed
from scenes import CAMERA, truth
from spheremcap import api
from spheremcap.config import OutputSettings, Settings, parse_seed, seeds_toml
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Keep, Seed
from spheremcap.errors import SourceError, UsageError
from spheremcap.io.course import STATUSES, courses_of
from spheremcap.io.mcap_log import RUN_METADATA
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.sources import FromMcap
from spheremcap.io.states import is_answered
from spheremcap.io.summary import summarise
from spheremcap.io.topics import REPLACED
from spheremcap.session import HIDDEN
from spheremcap.stretch import BACKWARDS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The film, tracked without answers (base), with them at once (all), and corrected by them (corrected)."""
    folder = tmp_path_factory.mktemp("film")
    write_film(folder / "film.mp4")
    api.track(folder / "film.mp4", folder / "base.mcap", SETTINGS, FIRST)
    api.track(folder / "film.mp4", folder / "all.mcap", SETTINGS, answers())
    api.retrack(folder / "base.mcap", folder / "corrected.mcap", answers())
    return folder


@pytest.fixture(scope="module")
def tracks(folder):
    return api.open(folder / "corrected.mcap").tracks


def chunk_offsets(path):
    with path.open("rb") as file:
        return {c.chunk_start_offset: c.message_start_time for c in make_reader(file).get_summary().chunk_indexes}


def facts(path, prefix="spheremcap/"):
    with McapRecords(path) as records:
        return {r.name: dict(r.metadata) for r in records.metadata if r.name.startswith(prefix)}


# -- the same by whatever way ----------------------------------------------------------------------


def test_tracking_with_all_answers_and_answering_afterwards_give_the_same_bytes(folder):
    assert rows(folder / "corrected.mcap") == rows(folder / "all.mcap")
    assert (folder / "corrected.mcap").read_bytes() == (folder / "all.mcap").read_bytes()


def test_one_answer_after_another_gives_the_same_as_all_at_once(folder, tmp_path):
    given, before = answers(), folder / "base.mcap"
    for k in range(len(FIRST) + 1, len(given) + 1):
        after = tmp_path / f"{k}.mcap"
        api.retrack(before, after, given[:k], source=folder / "film.mp4")
        before = after
    assert rows(before) == rows(folder / "all.mcap")
    assert facts(before) == facts(folder / "all.mcap")


def test_answers_that_are_taken_back_leave_no_trace(folder, tmp_path):
    report = api.retrack(folder / "corrected.mcap", tmp_path / "back.mcap", FIRST)
    assert (report.stretches, report.frames, report.requests) == ([], 0, 1)
    assert rows(tmp_path / "back.mcap") == rows(folder / "base.mcap")
    assert facts(tmp_path / "back.mcap") == facts(folder / "base.mcap")


def test_the_first_circles_need_not_be_given_again(folder, tmp_path):
    api.retrack(folder / "base.mcap", tmp_path / "out.mcap", answers()[len(FIRST) :])
    assert rows(tmp_path / "out.mcap") == rows(folder / "all.mcap")


def test_a_second_correction_looks_at_the_track_before_the_first_one(folder, tmp_path):
    """Corrected already, the knee is where the base has never been: the base counts, not what is read first."""
    again = [*answers(), seed("knee", 40)]
    api.retrack(folder / "corrected.mcap", tmp_path / "one.mcap", again)
    api.retrack(folder / "base.mcap", tmp_path / "two.mcap", again)
    assert rows(tmp_path / "one.mcap") == rows(tmp_path / "two.mcap")


# -- what is changed -------------------------------------------------------------------------------


def test_every_marker_is_where_it_is_or_says_that_it_is_not_to_be_seen(folder, tracks):
    base = api.open(folder / "base.mcap").tracks
    astray = dict.fromkeys(tracks, 0)
    edges = [frame for span in spans(covered) for frame in span]  # where little of the wrist is to be seen
    for name, ball in (("wrist", wrist), ("elbow", elbow), ("knee", knee)):
        for track, most in ((tracks[name], 2.5), (base[name], None)):
            for i in range(1, COUNT):
                if track.status[i] == "VERIFIED":
                    off = abs(track.circle_px[i] - _xyr(truth(ball(i))))[:2].max()
                    assert most is None or off < most or min(abs(i - edge) for edge in edges) <= 4, (name, i, off)
                    astray[name] += most is None and off > 10
    assert astray["wrist"] > 50  # else there was nothing to correct
    assert astray["knee"] > 150
    assert all(tracks["knee"].status[1:90] == "VERIFIED")
    assert tracks["knee"].status[90] == "SEEDED"


def _xyr(circle):
    return circle.x_px, circle.y_px, circle.r_px


def made_backwards(track):
    return [i for i in range(COUNT) if BACKWARDS in track.reasons[i].split(";")]


def test_what_was_made_backwards_says_so_and_what_is_hidden_says_who_says_that(folder, tracks):
    (first, out), (second, again) = spans(covered)
    wrist_ = tracks["wrist"]
    backwards = made_backwards(wrist_)
    assert out + 1 <= backwards[0] <= out + 4  # as long as enough of it is to be seen
    assert backwards == [*range(backwards[0], out + 10), *range(again + 1, again + 12)]
    for i in range(COUNT):
        hidden = first <= i <= out or second <= i <= again
        assert (wrist_.reasons[i] == HIDDEN) == hidden
        if hidden:
            assert wrist_.status[i] == "OUT_OF_VIEW"
            assert not (wrist_.circle_px[i] > 0).any()
    messages = decoded(folder / "corrected.mcap")
    answered = {m.frame_index: m.answer_frame for m in messages["/markers/wrist/state"] if m.HasField("answer_frame")}
    assert {answered[i] for i in range(first, out + 1)} == {first}
    assert {answered[i] for i in range(backwards[0], second)} == {out + 10}
    assert not any(m.HasField("answer_frame") for m in messages["/markers/elbow/state"])


def test_smoothed_poses_inside_are_those_of_the_stretch(folder, tracks):
    track = tracks["knee"]
    for i in range(1, COUNT):
        x, y, z = track.smoothed_xyz_cam_m[i]
        c = truth(knee(i))
        assert abs(x / z * CAMERA.fx_px + CAMERA.cx_px - c.x_px) < 1
        assert abs(y / z * CAMERA.fy_px + CAMERA.cy_px - c.y_px) < 1
    messages = decoded(folder / "corrected.mcap")
    assert len(messages["/markers/knee/smoothed"]) == COUNT
    wrist_at = {m.timestamp.ToNanoseconds() for m in messages["/markers/wrist/smoothed"]}
    (first, out), _ = spans(covered)
    hidden = set(tracks["wrist"].stamp_ns[first : out + 1].tolist())
    assert not wrist_at & hidden


def test_circles_and_paths_are_drawn_anew(folder, tracks):
    messages = decoded(folder / "corrected.mcap")
    assert len(messages["/camera/annotations"]) == COUNT
    for i, drawn in enumerate(messages["/camera/annotations"]):
        shown = {label.text.split()[0] for label in drawn.texts}
        assert shown == {"wrist", "elbow", "knee"}
        c = truth(knee(i))
        if i > 0:
            assert any(
                abs(o.position.x - 0.5 - c.x_px) < 1 and abs(o.position.y - 0.5 - c.y_px) < 1 for o in drawn.circles
            )
    last = messages["/scene"][-1]
    (path,) = next(e for e in last.entities if e.id == "knee").lines
    for point in path.points:
        assert min(abs(point.x - knee(i).xyz[0]) + abs(point.y - knee(i).xyz[1]) for i in range(COUNT)) < 0.005
    stamps = [m.entities[0].timestamp.ToNanoseconds() for m in messages["/scene"]]
    assert stamps == sorted(set(stamps))


def test_debug_pictures_inside_are_those_of_the_stretch(folder):
    """The base's show the decoy."""
    base, corrected = (decoded(folder / f"{name}.mcap")["/markers/knee/debug"] for name in ("base", "corrected"))
    assert len(corrected) > 1
    assert not {m.data for m in corrected[1:]} & {m.data for m in base[1:]}


def test_requests_say_what_was_answered_and_by_whom(folder):
    messages = decoded(folder / "corrected.mcap")["/requests"]
    (first, out), _ = spans(covered)
    assert [m.answered for m in messages] == [f"hidden on frames {first} to {out}, anna"]
    (request,) = api.open(folder / "corrected.mcap").requests
    assert request.answered
    assert [r.answered for r in api.open(folder / "base.mcap").requests] == [""]
    (marker,) = [m for m in summarise(folder / "corrected.mcap").markers if m.marker == "wrist"]
    assert [r.answered for r in marker.requests] == [request.answered]


@pytest.mark.parametrize(("frame", "begins"), [(20, 1), (120, 89)])
def test_a_circle_answers_the_request_that_its_stretch_has_and_the_one_since_which_the_marker_was_lost(
    folder, tmp_path, frame, begins
):
    settings = SETTINGS.model_copy(update={"markers": SETTINGS.markers[1:2]})
    first = [Seed("elbow", 0, Circle(285, 25, 12))]
    api.track(folder / "film.mp4", tmp_path / "base.mcap", settings, first)
    report = api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", [*first, seed("elbow", frame)])
    # By a frame it is another processor's arithmetic.
    begun = {f"elbow: frames {index} to 179" for index in (begins - 1, begins)}
    assert any(words in report.stretches[0] for words in begun) or frame == 20
    request = api.open(tmp_path / "out.mcap").requests[0]
    assert (request.frame_index, request.raised_at_frame_index) == (1, 5)
    assert request.answered == f"circle on frame {frame}"


def test_paths_behind_a_stretch_are_those_that_were_corrected(folder, tmp_path):
    """For a second they are drawn of what was before, and the base was on another ball then."""
    out = spans(covered)[0][1]
    report = api.retrack(folder / "base.mcap", tmp_path / "out.mcap", [*FIRST, seed("wrist", out + 10)])
    assert "meets the track on frame 10" in report.stretches[0]
    behind = 1_748_772_000_000_000_000 + 125 * 1_000_000_000 // 120
    scenes = [m for m in decoded(tmp_path / "out.mcap")["/scene"] if m.entities[0].timestamp.ToNanoseconds() >= behind]
    lines = next(e for e in scenes[0].entities if e.id == "wrist").lines
    path = [(p.x, p.y) for line in lines for p in line.points]
    on_it = [
        p for p in path if any(abs(p[0] - wrist(i).xyz[0]) + abs(p[1] - wrist(i).xyz[1]) < 0.01 for i in range(60, 100))
    ]
    assert len(on_it) > 5


def test_the_log_and_the_run_say_what_was_answered(folder):
    log = [m.message for m in decoded(folder / "corrected.mcap")["/log"]]
    told = "knee: frames 1 to 179 by the circle on frame 90, anna (the circle before, on frame 0; the last frame)"
    assert told in log
    runs = facts(folder / "corrected.mcap", "spheremcap/run/")
    assert len(runs) == 1
    assert told in next(iter(runs.values()))["answers"]
    recording = api.open(folder / "corrected.mcap")
    assert recording.seeds_toml == seeds_toml(answers())
    assert api.open(folder / "base.mcap").seeds_toml == seeds_toml(FIRST)


def test_who_is_lost_at_the_end_is_said_by_what_holds_in_the_end(folder, tmp_path):
    """One marker is lost without answers and found with them, one the other way round."""
    nothing = Circle(285, 25, 12)
    settings = SETTINGS.model_copy(update={"markers": tuple(m for m in SETTINGS.markers if m.name != "wrist")})
    first = [Seed("elbow", 0, nothing), seed("knee", 0)]
    report = api.track(folder / "film.mp4", tmp_path / "base.mcap", settings, first)
    assert [line.partition(",")[0] for line in report.lost] == ["elbow is LOST at the end"]
    more = [seed("elbow", 120), Seed("knee", 174, Circle(300, 110, 12))]
    after = api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", [*first, *more])
    assert [line.partition(",")[0] for line in after.lost] == ["knee is LOST at the end"]
    assert not after.complete
    assert api.open(tmp_path / "out.mcap").info["lost"] == after.lost[0]
    at_once = api.track(folder / "film.mp4", tmp_path / "all.mcap", settings, [*first, *more])
    assert at_once.lost == after.lost
    statuses = api.open(tmp_path / "out.mcap").tracks["knee"].status
    assert {s.value: n for s, n in at_once.statuses["knee"].items()} == dict(Counter(statuses.tolist()))


# -- what is not -----------------------------------------------------------------------------------


def test_every_other_message_is_copied_byte_for_byte_in_its_order(folder, tracks):
    before, after = rows(folder / "base.mcap"), rows(folder / "corrected.mcap")
    made = defaultdict(list)
    with (folder / "corrected.mcap").open("rb") as file:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            made[is_answered(channel.metadata), channel.topic.startswith(f"{REPLACED}/")].append(
                (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            )
    kept = made[False, False]
    at, outside = 0, 0
    for row in before:  # what is kept is a part of it, in its order
        if at < len(kept) and kept[at] == row:
            at += 1
        else:
            outside += 1
    assert at == len(kept)
    assert outside == len(made[False, True])
    assert not [row for row in before if row[0].startswith("/markers/elbow") and row not in kept]
    assert {row for row in before if row[0] in ("/camera/video", "/camera/calibration", "/tf", "/log")} <= set(kept)
    assert len(after) == sum(map(len, made.values()))
    wrist_state = [row for row in kept if row[0] == "/markers/wrist/state"]
    first, out = spans(covered)[0]
    between = made_backwards(tracks["wrist"])[0] - out - 1  # frames behind what is hidden and before the stretch
    assert len(wrist_state) == first + between


@pytest.mark.parametrize("name", ["base", "corrected"])
def test_sequence_numbers_rise_within_a_topic_whoever_wrote_its_messages(folder, name):
    last: dict[str, int] = {}
    with (folder / f"{name}.mcap").open("rb") as file:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            assert message.sequence > last.get(channel.topic, -1), (channel.topic, message.log_time)
            last[channel.topic] = message.sequence


@pytest.mark.parametrize("name", ["base", "corrected"])
def test_the_course_that_it_says_is_the_one_that_its_messages_have(folder, name):
    with McapRecords(folder / f"{name}.mcap") as records:
        (id_,) = (r.name.removeprefix(RUN_METADATA) for r in records.metadata if r.name.startswith(RUN_METADATA))
        said = courses_of(records, id_)
    tracks = api.open(folder / f"{name}.mcap").tracks
    assert said.keys() == tracks.keys()
    for marker, track in tracks.items():
        assert [STATUSES[said[marker].number_at(index)] for index in track.frame] == list(track.status)
        assert said[marker].runs()[-1] == (track.frame[-1] + 1, 0)


def test_estimates_outside_the_stretches_are_those_of_the_base(folder, tracks):
    base = api.open(folder / "base.mcap").tracks["elbow"]
    for name in ("status", "frame", "reasons", "stamp_ns"):
        assert (getattr(base, name) == getattr(tracks["elbow"], name)).all()


def test_chunks_in_which_nothing_changes_are_not_opened(folder, tmp_path, monkeypatch):
    long = write_film(tmp_path / "long.mp4", COUNT)
    api.track(long, tmp_path / "base.mcap", Settings(markers=SETTINGS.markers), FIRST)  # without paths in space
    opened = []
    load = McapRecords.messages_of
    monkeypatch.setattr(McapRecords, "messages_of", lambda self, piece: opened.append(piece) or load(self, piece))
    report = api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", [*FIRST, Hidden("elbow", 2, 5)])
    assert report.stretches == ["elbow: hidden on frames 2 to 5"]
    with McapRecords(tmp_path / "base.mcap") as records:
        assert opened == records.pieces[:1]
        assert records.chunk_count > 1


def test_the_file_is_whole_by_every_reader(folder):
    for name in ("corrected", "all"):
        path = folder / f"{name}.mcap"
        assert summarise(path, check=True).lost == ()
        with path.open("rb") as file:
            assert list(StreamReader(file, validate_crcs=True).records)
        with path.open("rb") as file:
            seeking = make_reader(file)
            summary = seeking.get_summary()
            found = [(c.topic, m.log_time, m.data) for _, c, m in seeking.iter_messages(log_time_order=False)]
        assert [(t, log, data) for t, log, _, _, data in rows(path)] == found
        assert summary.statistics.message_count == len(found)
        data = path.read_bytes()
        for chunk in summary.chunk_indexes:
            assert data[chunk.chunk_start_offset] == Opcode.CHUNK
            for channel, offset in chunk.message_index_offsets.items():
                assert data[offset] == Opcode.MESSAGE_INDEX
                assert int.from_bytes(data[offset + 9 : offset + 11], "little") == channel
        with path.open("rb") as file:
            whole = make_reader(file)
            assert [a.name for a in whole.iter_attachments()] == ["settings.toml", "seeds.toml"]
            assert len(list(whole.iter_metadata())) == summary.statistics.metadata_count


def test_a_channel_all_of_whose_first_messages_were_replaced_is_still_known_to_who_reads_on(folder, tmp_path):
    """Its record was in the chunk that was written anew, and its next messages are in one that was copied."""
    api.track(folder / "film.mp4", tmp_path / "base.mcap", Settings(markers=SETTINGS.markers), FIRST)
    second = [Hidden("elbow", 1, 119)]  # chunks end at half seconds
    api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", [*FIRST, *second])
    before, after = (
        [row for row in rows(tmp_path / f"{name}.mcap") if row[0] == "/markers/elbow/votes"] for name in ("base", "out")
    )
    assert after == [row for row in before if row[1] % 10**9 < 5 * 10**8 and row[1] // 10**9 > before[0][1] // 10**9]
    assert after


def test_a_merge_and_a_recovery_keep_the_answers(folder, tmp_path):
    """And what they wrote can be corrected further."""
    api.merge([api.Source(folder / "corrected.mcap")], tmp_path / "merged.mcap")
    assert rows(tmp_path / "merged.mcap") == rows(folder / "corrected.mcap")
    api.retrack(tmp_path / "merged.mcap", tmp_path / "back.mcap", FIRST)
    assert rows(tmp_path / "back.mcap") == rows(folder / "base.mcap")


# -- whose pictures --------------------------------------------------------------------------------


@pytest.mark.parametrize("video", ["h264", "none"])
def test_pictures_that_are_not_those_of_the_input_are_taken_from_the_input(folder, tmp_path, video):
    settings = SETTINGS.model_copy(update={"output": OutputSettings(video=video)})
    film = shutil.copy(folder / "film.mp4", tmp_path / "film.mp4")
    api.track(film, tmp_path / "base.mcap", settings, FIRST)
    api.track(film, tmp_path / "all.mcap", settings, answers())
    assert api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", answers()).notes == []
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    away = tmp_path / "away" / "other name.mp4"
    away.parent.mkdir()
    Path(film).rename(away)
    again = tmp_path / "again.mcap"
    if video == "none":
        with pytest.raises(SourceError, match=r"put film.mp4 beside it, or say with --source where it is"):
            api.retrack(tmp_path / "base.mcap", again, answers())
    else:
        (note,) = api.retrack(tmp_path / "base.mcap", again, answers(), overwrite=True).notes
        assert "its own pictures" in note or "own pictures" in note
    api.retrack(tmp_path / "base.mcap", again, answers(), source=away, overwrite=True)
    assert rows(again) == rows(tmp_path / "all.mcap")
    changed = bytearray(away.read_bytes())
    changed[len(changed) // 2] ^= 1
    away.write_bytes(changed)
    with pytest.raises(UsageError, match="its content is another"):
        api.retrack(tmp_path / "base.mcap", tmp_path / "never.mcap", answers(), source=away)
    away.write_bytes(b"x")
    with pytest.raises(UsageError, match="another size, or not there"):
        api.retrack(tmp_path / "base.mcap", tmp_path / "never.mcap", answers(), source=away)
    assert not list(tmp_path.glob("never*"))


def test_a_start_time_that_was_given_is_kept(folder, tmp_path):
    settings = SETTINGS.model_copy(update={"output": OutputSettings(video="none")})
    film = folder / "film.mp4"
    api.track(film, tmp_path / "base.mcap", settings, FIRST, start_time_ns=START_NS)
    api.track(film, tmp_path / "all.mcap", settings, answers(), start_time_ns=START_NS)
    api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", answers(), source=film)
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    both = (decoded(tmp_path / f"{name}.mcap")["/markers/knee/state"] for name in ("base", "out"))
    before, after = ([m.timestamp.ToNanoseconds() for m in states] for states in both)
    assert after == before
    assert before[0] == START_NS


def test_whole_frames_with_circles_are_drawn_anew(folder, tmp_path):
    settings = SETTINGS.model_copy(update={"output": OutputSettings(debug_images="full", debug_rate_hz=20)})
    api.track(folder / "film.mp4", tmp_path / "base.mcap", settings, FIRST)
    api.track(folder / "film.mp4", tmp_path / "all.mcap", settings, answers())
    api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", answers())
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    base, out = (decoded(tmp_path / f"{name}.mcap")["/debug/overview"] for name in ("base", "out"))
    assert len(base) == len(out)
    assert sum(a.data != b.data for a, b in zip(base, out, strict=True)) > len(base) - 3


def test_without_a_camera_there_are_no_metres_and_the_same_answers(folder, tmp_path):
    settings = Settings(markers=SETTINGS.markers)
    api.track(folder / "film.mp4", tmp_path / "base.mcap", settings, FIRST)
    api.track(folder / "film.mp4", tmp_path / "all.mcap", settings, answers())
    api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", answers())
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    assert "/scene" not in decoded(tmp_path / "out.mcap")


@pytest.mark.parametrize("topics", [["/front/image"], ["/front/image", "/left/image"]])
def test_image_topics_of_a_recording_are_corrected_beside_all_that_was_copied(tmp_path, topics):
    log = write_recording(tmp_path / "log.mcap", topics)
    names = ["orange"] if len(topics) == 1 else ["front/orange", "left/orange"]
    first = [replace(parse_seed(clip_seed("orange")), marker=name) for name in names]
    more = [replace(parse_seed(clip_seed("orange", index=9)), marker=names[-1]), Hidden(names[0], 3, 4)]
    choice = FromMcap(tuple(topics))
    settings = Settings()
    api.track(log, tmp_path / "base.mcap", settings, first, mcap=choice)
    api.track(log, tmp_path / "all.mcap", settings, [*first, *more], mcap=choice)
    report = api.retrack(tmp_path / "base.mcap", tmp_path / "out.mcap", [*first, *more])
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    assert set(report.statuses) == set(names)
    input_rows = [row for row in rows(tmp_path / "out.mcap") if row[0] in {r[0] for r in rows(log)}]
    assert input_rows == rows(log)
    with pytest.raises(UsageError, match=r"which camera|not among"):
        api.retrack(tmp_path / "base.mcap", tmp_path / "no.mcap", [*first, Hidden("nose", 3, 4)])


def test_a_recording_of_ours_that_was_tracked_again_has_two_runs_and_each_its_own_answers(folder, tmp_path):
    """The first run's markers keep their names, the second one's begin with where its topics are."""
    settings = Settings(markers=SETTINGS.markers[2:])
    first, later = seed("knee", 0), seed("knee", 90)
    choice = FromMcap(("/camera/video",))
    api.track(folder / "base.mcap", tmp_path / "two.mcap", settings, [first], mcap=choice)
    api.track(folder / "base.mcap", tmp_path / "all.mcap", settings, [first, later], mcap=choice)
    api.retrack(tmp_path / "two.mcap", tmp_path / "out.mcap", [replace(later, marker="tracked/knee")])
    assert rows(tmp_path / "out.mcap") == rows(tmp_path / "all.mcap")
    report = api.retrack(tmp_path / "two.mcap", tmp_path / "first.mcap", [later], source=folder / "film.mp4")
    assert list(report.statuses) == ["knee"]
    tracks = api.open(tmp_path / "first.mcap").tracks
    assert {"knee", "tracked/knee"} <= set(tracks)
    assert all(abs(tracks["knee"].circle_px[i][0] - truth(knee(i)).x_px) < 2 for i in range(1, COUNT))


# -- a part of a recording --------------------------------------------------------------------------


def test_a_run_that_was_stopped_can_be_corrected_as_far_as_it_came(folder, tmp_path):
    left = iter(range(10_000))
    report = api.track(folder / "film.mp4", tmp_path / "cut.mcap", SETTINGS, FIRST, stop=lambda: next(left) >= 100)
    part = report.part
    assert part is not None
    shutil.copy(folder / "film.mp4", tmp_path)
    out = tmp_path / "out.mcap"
    last = [a for a in answers() if a.frame_index < 100]
    api.retrack(part, out, last)
    recording = api.open(out)
    assert recording.tracks["knee"].frame[-1] == 99
    assert recording.info["complete"] == "no"
    assert all(recording.tracks["knee"].status[1:90] == "VERIFIED")
    with pytest.raises(UsageError, match="there are frames 0 to 99"):
        api.retrack(part, tmp_path / "no.mcap", answers())


def test_a_damaged_recording_is_refused_with_what_to_do(folder, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((folder / "base.mcap").read_bytes()[:-5000])
    with pytest.raises(SourceError, match=r"is damaged.*spheremcap recover"):
        api.retrack(cut, tmp_path / "out.mcap", answers())


def test_what_track_did_not_write_is_refused(tmp_path):
    log = write_recording(tmp_path / "log.mcap", ["/front/image"])
    with pytest.raises(SourceError, match="no run of spheremcap track is in it"):
        api.retrack(log, tmp_path / "out.mcap", [Hidden("wrist", 1, 2)])


# -- errors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (Hidden("nose", 3, 4), "'nose', which is not among wrist, elbow, knee"),
        (seed("knee", 0), "knee was tracked from another circle on frame 0"),
        (Seed("knee", 50, truth(knee(50)).shifted(850, 0)), "outside the 320x240 picture"),
        (Seed("knee", COUNT, truth(knee(50))), "seed of knee on frame 180: there are frames 0 to 179"),
        (Keep("knee", COUNT, COUNT + 5), "there are frames 0 to 179"),
        (Hidden("knee", 85, 95), "knee has a circle on frame 90 and is hidden from frame 85 to 95"),
        (seed("knee", 90, of="decoy"), "two seeds of knee on frame 90"),
    ],
)
def test_answers_that_cannot_be_are_said_before_anything_is_tracked(folder, tmp_path, answer, message):
    told = []
    with pytest.raises(UsageError, match=message):
        api.retrack(
            folder / "base.mcap", tmp_path / "out.mcap", [*answers(), answer], progress=lambda *n: told.append(n)
        )
    assert not list(tmp_path.iterdir())
    assert not told


def test_the_output_is_none_of_the_inputs(folder):
    for path in ("base.mcap", "film.mp4"):
        with pytest.raises(UsageError, match=r"is an input"):
            api.retrack(folder / "base.mcap", folder / path, answers(), source=folder / "film.mp4", overwrite=True)
    with pytest.raises(UsageError, match="exists already"):
        api.retrack(folder / "base.mcap", folder / "all.mcap", answers())


def test_answers_beyond_the_end_cost_no_run_and_leave_no_part(folder, tmp_path):
    mkv = write_film(tmp_path / "film.mkv", 20)  # does not say how many frames it has
    with pytest.raises(UsageError, match="there are frames 0 to 19"):
        api.track(mkv, tmp_path / "out.mcap", SETTINGS, [*FIRST, seed("knee", 60)])
    assert list(tmp_path.iterdir()) == [mkv]
    with pytest.raises(UsageError, match="hidden from frame 3 to 9"):
        api.track(folder / "film.mp4", tmp_path / "out.mcap", SETTINGS, [*FIRST, seed("knee", 6), Hidden("knee", 3, 9)])


# -- stopping --------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [0, 5, 200, 260])
def test_stopping_leaves_the_recording_as_it_was(folder, tmp_path, after):
    left = iter(range(10_000))
    out = tmp_path / "out.mcap"
    report = api.retrack(folder / "base.mcap", out, answers(), stop=lambda: next(left) >= after)
    assert report.stopped
    assert not report.complete
    assert not out.exists()
    assert list(tmp_path.iterdir()) == ([report.part] if report.part else [])


def test_tracking_that_is_stopped_among_the_answers_leaves_the_track_without_them(folder, tmp_path):
    left = iter(range(10_000))
    out = tmp_path / "out.mcap"
    report = api.track(folder / "film.mp4", out, SETTINGS, answers(), stop=lambda: next(left) >= COUNT + 100)
    assert report.stopped
    assert list(tmp_path.iterdir()) == [report.part]
    assert rows(report.part) == rows(folder / "base.mcap")


# -- one circle, seen before it is written ---------------------------------------------------------


def test_a_stretch_can_be_seen_before_anything_is_written(folder, tmp_path):
    base = folder / "base.mcap"
    before = {path: path.read_bytes() for path in folder.iterdir()}
    given = answers()
    answer = next(a for a in given if isinstance(a, Seed) and a.marker == "knee" and a not in FIRST)
    stretch = api.stretch_of(base, answer)
    assert (stretch.marker, stretch.frames[0], stretch.frames[-1]) == ("knee", 1, COUNT - 1)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    shown = api.open(folder / "corrected.mcap").tracks["knee"]
    for result in stretch:
        (estimate,) = result.estimates
        assert _xyr(estimate.circle) == tuple(shown.circle_px[result.frame_index])
    second = max((a for a in given if isinstance(a, Seed) and a.marker == "wrist"), key=lambda a: a.frame_index)
    alone = api.stretch_of(base, second)
    beside = api.stretch_of(base, second, others=[a for a in given if a is not second])
    assert alone.before != beside.before
    assert beside.before == f"hidden on frame {spans(covered)[1][1]}"
    with pytest.raises(UsageError, match="nothing changes"):
        api.stretch_of(base, FIRST[0])
    assert len(api.stretch_of(base, answer, stop=lambda: True)) <= 1


def test_other_markers_bases_are_what_a_stretch_is_told_of(folder):
    """The decoy is where the knee's base is; a wrist that is given there by mistake goes on to it all the same."""
    stretch = api.stretch_of(folder / "base.mcap", Seed("wrist", 70, truth(decoy(70))))
    assert all(e.status.measured for r in stretch for e in r.estimates if 70 <= r.frame_index < 100)

"""Settings and seeds: TOML in, TOML out, and errors that name the key."""

import tomllib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremcap.chain import ChainConfig
from spheremcap.config import (
    CameraSettings,
    MarkerSettings,
    OutputSettings,
    Settings,
    load_seeds,
    load_settings,
    parse_seed,
    seeds_toml,
)
from spheremcap.core.chair import CLICKED, RIMS, ChairClick
from spheremcap.core.circle import Circle
from spheremcap.core.marker import Hidden, Keep, Seed
from spheremcap.core.stage import StageConfig
from spheremcap.errors import SettingsError, SpheremcapError
from spheremcap.io.chair_file import chair_toml, load_chair
from spheremcap.tracking.kcf import KcfConfig


@pytest.fixture
def settings_file(tmp_path):
    def write(text):
        path = tmp_path / "settings.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("colour = 1", "colour"),
        ("[camera]\nfoo = 1", "camera.foo"),
        ("[chain.kcf]\ncells = 3", "chain.kcf.cells"),
        ('[[markers]]\nname = "a"\nsize = 3', "markers.0.size"),
    ],
)
def test_an_unknown_key_is_named_with_its_place_and_where_to_look(settings_file, text, key):
    path = settings_file(text)
    with pytest.raises(SettingsError, match="unknown key") as caught:
        load_settings(path)
    message = str(caught.value)
    assert f"'{key}'" in message
    assert str(path) in message
    assert "spheremcap config show" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "key", "found"),
    [
        ("[chain.jury]\nth1 = 7", "chain.jury.th1", "7"),
        ('[chain]\nwhen_sure = "guess"', "chain.when_sure", "guess"),
        ("[chain.jury]\nth2 = 4.5", "chain.jury", "th2 = 4.5 is above th1 = 4"),
        ('[chain.kcf]\nkernel = "cubic"', "chain.kcf.kernel", "cubic"),
        ("[session]\nsmoother_lag_frames = 0", "session.smoother_lag_frames", "0"),
        ('[[markers]]\nname = "left wrist"', "markers.0.name", "left wrist"),
        ("[camera]\nfx_px = -3", "camera.fx_px", "-3"),
        ("[[markers]]\ndiameter_m = 0.04", "markers.0.name", ""),
    ],
)
def test_a_value_out_of_range_is_named_with_what_was_found(settings_file, text, key, found):
    with pytest.raises(SettingsError) as caught:
        load_settings(settings_file(text))
    assert key in str(caught.value)
    assert found in str(caught.value)


def test_what_is_not_toml_or_not_there_says_so(settings_file, tmp_path):
    with pytest.raises(SettingsError, match="not TOML"):
        load_settings(settings_file("this is = = not"))
    with pytest.raises(SettingsError, match="no such file"):
        load_settings(tmp_path / "missing.toml")
    with pytest.raises(SettingsError, match="is a folder"):
        load_settings(tmp_path)


def test_every_settings_error_is_the_projects_own():
    assert issubclass(SettingsError, SpheremcapError)


def test_defaults_come_back_from_their_own_toml(settings_file):
    assert load_settings(settings_file(Settings().to_toml())) == Settings()


def test_changed_settings_come_back_from_their_own_toml(settings_file):
    settings = Settings(
        camera=CameraSettings(
            width_px=1280, height_px=720, fx_px=1150.5, fy_px=1151.0, cx_px=639.5, cy_px=359.5,
            model="plumb_bob", distortion=(-0.31, 0.17, 1e-5, 0.0), exposure_s=0.002,
        ),
        markers=(MarkerSettings(name="left_wrist", diameter_m=0.038), MarkerSettings(name="elbow")),
        chain=ChainConfig(kcf=KcfConfig(kernel="linear", padding=2.25)),
        output=OutputSettings(video="jpeg", debug_images="none"),
    )  # fmt: skip
    assert load_settings(settings_file(settings.to_toml())) == settings


def test_the_toml_shows_every_key_that_has_a_value():
    tables = tomllib.loads(Settings().to_toml())
    assert set(tables["chain"]) == set(ChainConfig.model_fields)
    for name, stage in ChainConfig():
        if isinstance(stage, StageConfig):
            assert set(tables["chain"][name]) == set(type(stage).model_fields)
        else:
            assert tables["chain"][name] == stage
    assert tables["session"]["smoother_lag_frames"] == 60


@pytest.mark.parametrize(
    ("text", "metres"),
    [("4 cm", 0.04), ("40mm", 0.04), ("0.04 m", 0.04), ("1.5 in", 0.0381), (" 3.8cm ", 0.038)],
)
def test_lengths_have_units(settings_file, text, metres):
    settings = load_settings(settings_file(f'[[markers]]\nname = "a"\ndiameter = "{text}"'))
    assert settings.markers[0].diameter_m == pytest.approx(metres, abs=1e-12)
    assert settings.markers[0].spec().radius_m == pytest.approx(metres / 2)


@pytest.mark.parametrize("text", ["4", "4 km", "cm", "four cm", "-4 cm"])
def test_what_is_no_length_is_refused(settings_file, text):
    with pytest.raises(SettingsError, match="is not a length such as"):
        load_settings(settings_file(f'[[markers]]\nname = "a"\ndiameter = "{text}"'))


@pytest.mark.parametrize("text", ["1.2.3 cm", ". cm"])
def test_what_only_looks_like_a_length_is_refused_too(settings_file, text):
    with pytest.raises(SettingsError):
        load_settings(settings_file(f'[[markers]]\nname = "a"\ndiameter = "{text}"'))


def test_both_diameters_at_once_are_refused(settings_file):
    with pytest.raises(SettingsError):
        load_settings(settings_file('[[markers]]\nname = "a"\ndiameter = "4 cm"\ndiameter_m = 0.05'))


def test_two_markers_of_one_name_are_refused(settings_file):
    with pytest.raises(SettingsError, match="'a' is there twice"):
        load_settings(settings_file('[[markers]]\nname = "a"\n[[markers]]\nname = "a"'))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('preset = "thesis"\nfile = "a.yaml"', "not several"),
        ('preset = "thesis"\nfx_px = 1000', "not several"),
        ("fx_px = 1000\nfy_px = 1000\ncx_px = 640", "need width_px, height_px"),
    ],
)
def test_the_camera_is_given_in_one_way_and_wholly(settings_file, text, message):
    with pytest.raises(SettingsError, match=message):
        load_settings(settings_file("[camera]\n" + text))


def test_settings_do_not_change():
    with pytest.raises(ValueError, match="frozen"):
        Settings().chain.kcf.padding = 3  # type: ignore[misc]


# -- seeds -----------------------------------------------------------------------------------------

numbers = st.floats(-1e5, 1e5)
authors = st.text(max_size=20)
times = st.sampled_from(["", "2026-11-30T03:31:00Z", "2026-11-30T03:31:00.123456789+01:00"])
seeds = st.builds(
    Seed,
    st.text("abcXYZ019_", min_size=1, max_size=12),
    st.integers(0, 10**6),
    st.builds(Circle, numbers, numbers, st.floats(1e-3, 1e5)),
    authors,
    times,
)
spans = st.builds(
    lambda kind, marker, frame, more, author, time: kind(marker, frame, frame + more, author, time),
    st.sampled_from([Hidden, Keep]),
    st.text("abc_", min_size=1),
    st.integers(0, 10**6),
    st.integers(0, 1000),
    authors,
    times,
)


def test_a_seed_on_the_command_line():
    assert parse_seed("left_wrist@0=812,430,24") == Seed("left_wrist", 0, Circle(812, 430, 24))
    assert parse_seed(" a@17=-1.5,2e2,.5 ") == Seed("a", 17, Circle(-1.5, 200, 0.5))


@given(seeds)
def test_a_seed_written_for_the_command_line_is_read_back(seed):
    c = seed.circle
    told = f"{seed.marker}@{seed.frame_index}={c.x_px!r},{c.y_px!r},{c.r_px!r}"
    assert parse_seed(told) == replace(seed, author="", time="")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "left_wrist",
        "a@0=1,2",
        "a@0=1,2,3,4",
        "a@-1=1,2,3",
        "a=1,2,3",
        "a@0=x,2,3",
        "a b@0=1,2,3",
        "a@0=1,2,--3",
        "a@0=1,2,e",
    ],
)
def test_what_is_no_seed_says_what_one_looks_like(text):
    with pytest.raises(SettingsError, match="MARKER@FRAME=X,Y,R, such as left_wrist@0=812,430,24"):
        parse_seed(text)


@given(st.lists(seeds | spans, max_size=4, unique_by=lambda answer: (answer.marker, answer.frame_index)))
def test_a_seeds_file_is_read_back_as_written(tmp_path_factory, given_seeds):
    path = tmp_path_factory.getbasetemp() / "seeds.toml"
    path.write_text(seeds_toml(given_seeds), encoding="utf-8")
    if given_seeds:
        assert load_seeds(path) == given_seeds


def test_a_seed_that_nobody_signed_is_written_as_ever():
    text = '[[seeds]]\nmarker = "a"\nframe = 3\nx_px = 1.0\ny_px = 2.5\nr_px = 3.0\n'
    assert seeds_toml([Seed("a", 3, Circle(1.0, 2.5, 3.0))]) == text


def test_two_circles_of_a_marker_on_one_frame_are_refused_and_other_answers_are_not(tmp_path):
    path = tmp_path / "seeds.toml"
    path.write_text(seeds_toml([Keep("a", 3, 5), Keep("a", 3, 9), Hidden("a", 3, 3), Seed("a", 4, Circle(1, 2, 3))]))
    assert len(load_seeds(path)) == 4
    path.write_text(seeds_toml([Seed("a", 3, Circle(1, 2, 3)), Keep("a", 3, 5), Seed("a", 3, Circle(2, 2, 3))]))
    with pytest.raises(SettingsError, match="seeds 1 and 3 are both of a on frame 3"):
        load_seeds(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"expected \[\[seeds\]\]"),
        ("seeds = 3", r"expected \[\[seeds\]\]"),
        ("[[seeds]]\nmarker = 'a'", "seed 1 must have marker, frame, x_px, y_px and r_px"),
        ("[[seeds]]\nmarker='a'\nframe=0\nx_px=1\ny_px=2\nr_px=3\nextra=4", "seed 1 must have"),
        ("[[seeds]]\nmarker='a'\nframe=0\nx_px='left'\ny_px=2\nr_px=3", "seed 1: "),
        (
            "[[seeds]]\nmarker='a'\nframe=0\nkind='hidden'\nx_px=1\ny_px=2\nr_px=3",
            "must have marker, frame and to_frame,",
        ),
        ("[[seeds]]\nmarker='a'\nframe=0\nto_frame=9\nkind='gone'", "kind is 'gone'; expected one of circle"),
        ("[[seeds]]\nmarker='a'\nframe=0\nx_px=1\ny_px=2\nr_px=3\nkind='dot'", "kind is 'dot'; expected one of"),
        ("[[seeds]]\nmarker='a'\nframe=9\nto_frame=8\nkind='keep'", "to_frame 8 is before frame 9"),
        ("[[seeds]]\nmarker='a'\nframe=9\nto_frame=9\nkind='keep'\ntime='noon'", "time: "),
        ("[[seeds]]\nmarker='a'\nframe=9\nto_frame=9\nkind='keep'\nauthor=7", "author: "),
    ],
)
def test_a_wrong_seeds_file_names_the_seed_and_what_it_lacks(tmp_path, text, message):
    path = tmp_path / "seeds.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=message) as caught:
        load_seeds(path)
    assert str(path) in str(caught.value)


# -- clicks on a chair -----------------------------------------------------------------------------


def clicks_on(width_px, height_px):
    one = st.builds(
        ChairClick,
        st.sampled_from(CLICKED),
        st.integers(0, 10**6),
        st.floats(-0.5, width_px - 0.5),
        st.floats(-0.5, height_px - 0.5),
    )
    return st.lists(one, max_size=6, unique_by=lambda click: click.on if click.on not in RIMS else click)


@given(clicks_on(1280, 720))
def test_clicks_on_a_chair_are_read_back_as_written(tmp_path_factory, clicks):
    path = tmp_path_factory.getbasetemp() / "session.chair.toml"
    path.write_text(chair_toml(clicks, 1280, 720), encoding="utf-8")
    assert load_chair(path) == (tuple(clicks), (1280, 720))


def test_a_file_of_clicks_on_a_chair_is_what_the_docs_say():
    text = 'width_px = 640\nheight_px = 480\n\n[[clicks]]\non = "left_rim"\nframe = 3\nx_px = 1.0\ny_px = 2.5\n'
    assert chair_toml([ChairClick("left_rim", 3, 1.0, 2.5)], 640, 480) == text


SIZE = "width_px = 640\nheight_px = 480\n"
CLICK = "[[clicks]]\non = '{}'\nframe = 0\nx_px = {}\ny_px = {}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected width_px and height_px"),
        ("width_px = 640\n", "expected width_px and height_px"),
        (SIZE + "depth_px = 3\n", "expected width_px and height_px"),
        (SIZE + "clicks = 3\n", "expected width_px and height_px"),
        ("width_px = 0\nheight_px = 480\n", "width_px: "),
        ("width_px = '640'\nheight_px = 480\n", "width_px: a number has no quotes"),
        (SIZE + "[[clicks]]\non = 'front'\nframe = 0\nx_px = 1\n", "click 1 must have on, frame, x_px and y_px"),
        (SIZE + CLICK.format("front", 1, 2) + "r_px = 3\n", "click 1 must have on, frame, x_px and y_px"),
        (SIZE + CLICK.format("front", "'left'", 2), "click 1: x_px: "),
        (SIZE + CLICK.format("front", 1, "nan"), "click 1: y_px: "),
        (SIZE + "[[clicks]]\non = 'front'\nframe = -1\nx_px = 1\ny_px = 2\n", "click 1: frame: "),
        (SIZE + CLICK.format("hub", 1, 2), "click 1: on is 'hub'; expected one of left_axle, right_axle, left_rim"),
        (SIZE + CLICK.format("front", 639.6, 2), "click 1: front at 639.6, 2 is outside the 640x480 picture"),
        (SIZE + CLICK.format("front", -0.6, 2), "is outside the 640x480 picture"),
        (SIZE + CLICK.format("front", 1, 479.6), "is outside the 640x480 picture"),
        (SIZE + CLICK.format("front", 1, -0.6), "is outside the 640x480 picture"),
        (SIZE + "".join(CLICK.format(on, 1, 2) for on in ("front", "left_rim", "left_rim", "front")),
         "clicks 1 and 4 are both of front, of which there is one"),
    ],
)  # fmt: skip
def test_a_wrong_file_of_clicks_on_a_chair_says_what_is_expected(tmp_path, text, message):
    path = tmp_path / "session.chair.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=message) as caught:
        load_chair(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("text", "colour"), [('"green"', "green"), ('"black"', "black"), ("[170, 10]", (170.0, 10.0))])
def test_a_marker_s_colour_is_a_name_or_two_hues_and_comes_back(settings_file, text, colour):
    settings = load_settings(settings_file(f'[[markers]]\nname = "a"\ncolour = {text}\n[[markers]]\nname = "b"'))
    assert [marker.colour for marker in settings.markers] == [colour, None]
    assert Settings.model_validate(tomllib.loads(settings.to_toml())) == settings


@pytest.mark.parametrize(
    ("text", "word"),
    [('"greenish"', "red, orange, yellow"), ("[10]", ""), ("[-1, 10]", "between 0 and 180"),
     ("[10, 181]", "steps of 2 degrees"), ("[1, 2, 3]", ""), ("true", ""), ("60", ""), ("[nan, 10]", "")],
)  # fmt: skip
def test_a_colour_that_is_none_is_refused(settings_file, text, word):
    with pytest.raises(SettingsError) as error:
        load_settings(settings_file(f'[[markers]]\nname = "a"\ncolour = {text}'))
    assert "markers.0.colour" in str(error.value)
    assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("seconds", ["0", "-1", "61", '"3"'])
def test_auto_s_seconds_have_bounds(settings_file, seconds):
    with pytest.raises(SettingsError, match=r"auto\.seconds"):
        load_settings(settings_file(f"[auto]\nseconds = {seconds}"))

"""Two hundred settings, seeds, cameras, times and lengths that nobody means: each is one line that names it, exit 2."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mutants import FAULT, run

from clips import write_clip

SEED = "orange@0=100,90,18"
NUMBERS_OF_NOBODY = ("inf", "-inf", "nan", "1e300", "-1e300", '"5"', "true", "[]", "{}", "1979-05-27", "-1")
NUMBERS = (
    "camera.fx_px", "camera.width_px", "camera.focal_sd", "camera.exposure_s", "output.debug_rate_hz",
    "session.smoother_lag_frames", "chain.kcf.sigma", "chain.jury.th1", "chain.edge.rays", "chain.policy.lost_after",
)  # fmt: skip
SETTINGS = {
    "th1 below th2": "[chain.jury]\nth1 = 2\nth2 = 3",
    "odd grid": "[chain.kcf]\ngrid_cells = 15",
    "marker in mm": "[[markers]]\nname = 'orange'\ndiameter_m = 40",
    "marker of a micrometre": "[[markers]]\nname = 'orange'\ndiameter_m = 1e-6",
    "marker of nan": "[[markers]]\nname = 'orange'\ndiameter_m = nan",
    "marker without a unit": "[[markers]]\nname = 'orange'\ndiameter = '40'",
    "marker of 40 m": "[[markers]]\nname = 'orange'\ndiameter = '40 m'",
    "marker as a number": "[[markers]]\nname = 'orange'\ndiameter = 40",
    "two sizes": "[[markers]]\nname = 'orange'\ndiameter = '4 cm'\ndiameter_m = 0.04",
    "marker twice": "[[markers]]\nname = 'orange'\n[[markers]]\nname = 'orange'",
    "marker without a name": "[[markers]]\ndiameter_m = 0.04",
    "empty name": "[[markers]]\nname = ''",
    "a name with a slash": "[[markers]]\nname = 'a/b'",
    "a name with a newline": '[[markers]]\nname = "a\\nb"',
    "a name of 1000 letters": f"[[markers]]\nname = '{'a' * 1000}'",
    "a name that is none of letters": "[[markers]]\nname = '../../etc/passwd'",
    "markers as a table": "[markers]\nname = 'orange'",
    "markers as a number": "markers = 3",
    "decimal comma": "[camera]\nfx_px = 1187,5",
    "unknown key": "[camera]\nfocal = 3",
    "unknown table": "[cameras]\nfx_px = 3",
    "key at the top": "fx_px = 3",
    "key twice": "[camera]\nfx_px = 3\nfx_px = 4",
    "table twice": "[camera]\n[camera]",
    "no TOML": "this is not TOML",
    "JSON": '{"camera": {"fx_px": 3}}',
    "deep list": "a = " + "[" * 3000 + "]" * 3000,
    "deep keys": ".".join(["a"] * 3000) + " = 1",
    "number of 5000 digits": "[camera]\nwidth_px = " + "9" * 5000,
    "not UTF-8": b"[camera]\npreset = '\xff\xfe'",
    "binary": bytes(range(256)) * 4,
    "zero bytes": b"\0" * 100,
    "half a camera": "[camera]\nfx_px = 100",
    "two cameras": "[camera]\npreset = 'thesis'\nfile = 'a.yaml'",
    "unknown preset": "[camera]\npreset = 'hero99'",
    "camera file that is not there": "[camera]\nfile = 'nowhere.yaml'",
    "camera file that is a folder": "[camera]\nfile = '.'",
    "another shape": "[camera]\nwidth_px = 1000\nheight_px = 200\nfx_px = 1\nfy_px = 1\ncx_px = 1\ncy_px = 1",
    "principal point far away": "[camera]\nwidth_px=320\nheight_px=240\nfx_px=550\nfy_px=550\ncx_px=99999\ncy_px=1",
    "three coefficients": "[camera]\nwidth_px=320\nheight_px=240\nfx_px=550\nfy_px=550\ncx_px=160\ncy_px=120\n"
    "model='plumb_bob'\ndistortion=[0.1,0.2,0.3]",
    "coefficients of nan": "[camera]\nwidth_px=320\nheight_px=240\nfx_px=550\nfy_px=550\ncx_px=160\ncy_px=120\n"
    "model='fisheye'\ndistortion=[0.1,0.2,nan,0]",
    "huge coefficients": "[camera]\nwidth_px=320\nheight_px=240\nfx_px=550\nfy_px=550\ncx_px=160\ncy_px=120\n"
    "model='fisheye'\ndistortion=[0.1,0.2,1e30,0]",
    "lens model": "[camera]\nmodel = 'omni'",
    "switch as a number": "[chain.kcf]\nenabled = 1",
    "switch as a text": "[chain.kcf]\nenabled = 'yes'",
    "video kind": "[output]\nvideo = 'gif'",
    "compression": "[output]\ncompression = 'brotli'",
    "a table for a number": "[chain.kcf.sigma]\nvalue = 3",
    "a number for a table": "chain = 3",
    "a list for a table": "[[camera]]\nfx_px = 3",
}
SEEDS = {
    "empty": "",
    "no tables": "seeds = 3",
    "another table": "[[seed]]\nmarker = 'orange'",
    "a table too many": "[[seeds]]\nmarker='orange'\nframe=0\nx_px=1\ny_px=2\nr_px=3\n[more]",
    "numbers in the list": "seeds = [1, 2]",
    "key missing": "[[seeds]]\nmarker='orange'\nframe=0\nx_px=1\ny_px=2",
    "key too many": "[[seeds]]\nmarker='orange'\nframe=0\nx_px=1\ny_px=2\nr_px=3\nz_px=3",
    "same frame": "[[seeds]]\nmarker='orange'\nframe=0\nx_px=1\ny_px=2\nr_px=3\n" * 2,
    "decimal comma": "[[seeds]]\nmarker='orange'\nframe=0\nx_px=1,5\ny_px=2\nr_px=3",
    "marker as a number": "[[seeds]]\nmarker=5\nframe=0\nx_px=1\ny_px=2\nr_px=3",
    "marker with spaces": "[[seeds]]\nmarker='left wrist'\nframe=0\nx_px=99\ny_px=90\nr_px=18",
    "empty marker": "[[seeds]]\nmarker=''\nframe=0\nx_px=99\ny_px=90\nr_px=18",
    **{
        f"frame {value}": f"[[seeds]]\nmarker='orange'\nframe={value}\nx_px=99\ny_px=90\nr_px=18"
        for value in (*NUMBERS_OF_NOBODY, "0.7", "-5", "99999999999999999999", "10000000000", "1000000")
    },
    **{
        f"{key} {value}": "[[seeds]]\nmarker='orange'\nframe=0\n"
        + "\n".join(f"{name}={value if name == key else 50}" for name in ("x_px", "y_px", "r_px"))
        for key in ("x_px", "r_px")
        for value in (*NUMBERS_OF_NOBODY, "-3", "5000")
    },
}
FLAGS = {
    **{
        f"seed {text}": ["--seed", text]
        for text in (
            "",
            "orange",
            "orange@0",
            "orange@0=",
            "orange@0=1,2",
            "orange@0=1,2,3,4",
            "orange@0.7=100,90,18",
            "orange@-1=100,90,18",
            "orange@=100,90,18",
            "orange@1e3=100,90,18",
            "orange@0=inf,90,18",
            "orange@0=nan,90,18",
            "orange@0=1e300,90,18",
            "orange@0=100,90,0",
            "orange@0=100,90,-18",
            "orange@0=100,90,1e-300",
            "orange@0=a,b,c",
            "orange@0=100;90;18",
            "orange@0=100 90 18",
            "o range@0=100,90,18",
            "@0=100,90,18",
            "orange@0=100,90,18px",
            "orange@0=0x10,90,18",
            "orange@0=1_0,90,18",
            "orange@٣=100,90,18",
            "orange@0=١,90,18",
            "a/b/c@0=100,90,18",
            "orange@99999999999999999999=100,90,18",
            "orange@0=100,90,5000",
            "orange@0=-50,90,18",
            "o" * 5000,
        )
    },
    "two seeds of a frame": ["--seed", SEED, "--seed", "orange@0=101,90,18"],
    "no seed": [],
    **{
        f"start time {text}": ["--seed", SEED, "--start-time", text]
        for text in (
            "",
            "noon",
            "inf",
            "nan",
            "1e300",
            "1e99",
            "-1",
            "-1e9",
            "9" * 30,
            "9" * 5000,
            "2025-13-01",
            "2025-02-30T10:00:00Z",
            "9999-12-31T23:59:59Z",
            "1/3",
            "2025-06-01T25:00:00Z",
            "1e12",
            "0x10",
        )
    },
    **{
        f"diameter {text}": ["--seed", SEED, "--diameter", text]
        for text in ("4", "", "nan cm", "40 m", "-4 cm", "1e9 cm", "0 cm")
    },
    "unknown camera": ["--seed", SEED, "--camera", "hero99"],
    "camera that is not there": ["--seed", SEED, "--camera", "nowhere.yaml"],
    "camera of no name": ["--seed", SEED, "--camera", ""],
    "settings that are not there": ["--seed", SEED, "-s", "nowhere.toml"],
    "settings that are a folder": ["--seed", SEED, "-s", "."],
    "seeds that are not there": ["--seeds", "nowhere.toml"],
    "a name too long": ["--seed", SEED, "-s", "a" * 300 + ".toml"],
    "flags of recordings": ["--seed", SEED, "--start", "3"],
    "rate of a file": ["--seed", SEED, "--rate", "30"],
}
LENS = "image_width: 320\nimage_height: 240\ncamera_matrix:\n  data: [{k}]\ndistortion_model: {model}\n" \
    "distortion_coefficients:\n  data: [{d}]\n"  # fmt: skip
K = "550, 0, 160, 0, 550, 120, 0, 0, 1"
CAMERAS = {
    "empty": "",
    "a text": "hello",
    "a list": "- 1\n- 2",
    "no matrix": "image_width: 320\nimage_height: 240",
    "eight numbers": LENS.format(k="1, 2, 3, 4, 5, 6, 7, 8", model="plumb_bob", d=""),
    "focal length nan": LENS.format(k=K.replace("550", ".nan"), model="plumb_bob", d=""),
    "focal length inf": LENS.format(k=K.replace("550", ".inf"), model="plumb_bob", d=""),
    "focal length 0": LENS.format(k=K.replace("550", "0"), model="plumb_bob", d=""),
    "focal length below 0": LENS.format(k=K.replace("550", "-550"), model="plumb_bob", d=""),
    "words": LENS.format(k=K.replace("550", "wide"), model="plumb_bob", d=""),
    "lists": LENS.format(k=K.replace("550", "[1]"), model="plumb_bob", d=""),
    "unknown model": LENS.format(k=K, model="omni", d="0.1, 0.2"),
    "too many coefficients": LENS.format(k=K, model="plumb_bob", d="1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14"),
    "five for a fisheye": LENS.format(k=K, model="equidistant", d="1, 2, 3, 4, 5"),
    "coefficients nan": LENS.format(k=K, model="plumb_bob", d=".nan, 0, 0, 0"),
    "no size": LENS.format(k=K, model="plumb_bob", d="").replace("320", "0"),
    "size below 0": LENS.format(k=K, model="plumb_bob", d="").replace("320", "-320"),
    "size of 1e300": LENS.format(k=K, model="plumb_bob", d="").replace("320", "1.0e+300"),
    "size of inf": LENS.format(k=K, model="plumb_bob", d="").replace("320", ".inf"),
    "another shape": LENS.format(k=K, model="plumb_bob", d="").replace("320", "700"),
    "uncertainty of 3000 %": LENS.format(k=K, model="plumb_bob", d="") + "focal_sd: 30\n",
    "uncertainty in words": LENS.format(k=K, model="plumb_bob", d="") + "focal_sd: small\n",
    "deep list": "[" * 20_000,
    "deep map": "{a: " * 3000,
    "deep blocks": "\n".join(" " * i + "a:" for i in range(400)) + "\n",
    "aliases of aliases": "a: &a [1,1,1,1,1,1,1,1,1]\n"
    + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)),
    "Python object": "!!python/object/apply:os.system ['true']",
    "OpenCV's tag": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n",
    "a date that is none": "image_width: 2025-99-99",
    "tabs": "image_width:\t320\n\timage_height: 240",
    "not UTF-8": b"image_width: \xff\xfe",
    "binary": bytes(range(256)) * 10,
    "huge": "a: " + "x" * 400_000,
}  # fmt: skip


def rows() -> Iterator[tuple[str, str, str | bytes]]:
    """(where it goes, what it is, its content)."""
    for key in NUMBERS:
        table, _, name = key.rpartition(".")
        for value in NUMBERS_OF_NOBODY:
            yield "settings", f"{key} {value}", f"[{table}]\n{name} = {value}"
    for where, content in (("settings", SETTINGS), ("seeds", SEEDS), ("camera", CAMERAS)):
        for name, text in content.items():
            yield where, name, text
    for name in FLAGS:
        yield "flags", name, ""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("hostile") / "clip.mp4")


def test_there_are_two_hundred_of_them() -> None:
    assert len(list(rows())) >= 200


@pytest.mark.parametrize(
    ("where", "name", "content"), list(rows()), ids=lambda value: None if isinstance(value, bytes) else ""
)
def test_what_nobody_means_is_one_line_and_leaves_nothing(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, name: str, content: str | bytes
) -> None:
    monkeypatch.chdir(tmp_path)
    given = tmp_path / {"camera": "camera.yaml"}.get(where, f"{where}.toml")
    (tmp_path / "orange.toml").write_text("[[markers]]\nname = 'orange'")
    if where != "flags":
        given.write_bytes(content if isinstance(content, bytes) else content.encode())
    flags = {
        "settings": ["--seed", SEED, "-s", given],
        "seeds": ["--seeds", given],
        "camera": ["--seed", SEED, "--camera", given],
        "flags": FLAGS.get(name, []),
    }[where]
    outcome = run("track", clip, "-o", tmp_path / "out.mcap", *flags)
    assert outcome.code == 2, (name, outcome)
    assert (outcome.out, outcome.err.count("\n")) == ("", 1), (name, outcome)
    assert outcome.err.startswith("spheremcap: "), (name, outcome)
    assert FAULT not in outcome.err, (name, outcome)
    assert len(outcome.err) < 700, (name, outcome)
    names = (given.name, "seed of orange", "camera", "nowhere.yaml", "folder", "'left wrist'")
    assert where == "flags" or any(word in outcome.err for word in names), (name, outcome)
    assert not list(tmp_path.glob("out.mcap*")), name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[markers]]\nname = 'orange'\ndiameter_m = 40", ["40 m", "0.04", "millimetres"]),
        ("[chain.jury]\nth1 = 2\nth2 = 3", ["th2 = 3", "th1 = 2"]),
        ("[camera]\nfx_px = 1187,5", ["line 2", "decimals have a point"]),
        ("[camera]\nfx_px = nan", ["camera.fx_px", "nan"]),
        ("[chain.kcf]\nenabled = 1", ["chain.kcf.enabled", "true or false"]),
    ],
)
def test_the_line_says_what_is_wrong_with_it(clip: Path, tmp_path: Path, text: str, words: list[str]) -> None:
    settings = tmp_path / "s.toml"
    settings.write_text(text)
    outcome = run("track", clip, "-o", tmp_path / "out.mcap", "--seed", SEED, "-s", settings)
    for word in words:
        assert word in outcome.err


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_error(clip: Path, tmp_path: Path, encoding: str) -> None:
    settings = tmp_path / "s.toml"
    settings.write_bytes("[output]\nvideo = 'none'\n".encode(encoding))
    assert run("track", clip, "-o", tmp_path / "out.mcap", "--seed", SEED, "-s", settings).code == 0

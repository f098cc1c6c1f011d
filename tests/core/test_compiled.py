"""Kernels are compiled once, kept where that can be written, and never for a layout that nobody has foreseen."""

import importlib.util
import os
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.dispatcher import Dispatcher

from scenes import CAMERA, COUNTED, GREEN, ORANGE, RADIUS_M, Ball, bgr_frame, picture, truth, yuv_frame
from spheremcap.chain import ChainConfig
from spheremcap.core import compiled
from spheremcap.core.camera import Camera
from spheremcap.core.frame import BgrFrame, YuvFrame
from spheremcap.core.marker import MarkerSpec, Seed
from spheremcap.session import Session


def kernels():
    """All of the package's kernels by name; loops that only kernels call are not among them."""
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("spheremcap."):
            for key, value in vars(module).items():
                if isinstance(value, Dispatcher) and not value._can_compile:
                    found[f"{value.py_func.__module__}.{key}"] = value
    return found


def orange(i):
    return Ball((-0.08 + 0.004 * i, 0.02 - 0.001 * i, 0.9), ORANGE)


def green(i):
    return Ball((0.1 - 0.002 * i, 0.05, 0.8 + 0.01 * i), GREEN)


def turned(frame):
    """The frame a quarter to the left, as a rotated video's planes are: views."""
    if isinstance(frame, BgrFrame):
        return BgrFrame(frame.index, frame.stamp_ns, np.rot90(frame.image))
    (sx, sy), (ox, oy), columns = frame.uv_step_px, frame.uv_origin_px, frame.uv[0].shape[1]
    origin = (oy, frame.width_px - 1 - (ox + (columns - 1) * sx))
    u, v = (np.rot90(plane) for plane in frame.uv)
    return YuvFrame(frame.index, frame.stamp_ns, np.rot90(frame.y), (u, v), (sy, sx), origin, frame.to_bgr)


def turned_circle(circle):
    return type(circle)(circle.y_px, CAMERA.width_px - 1 - circle.x_px, circle.r_px)


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("frame_of", [bgr_frame, yuv_frame])
def test_no_frame_of_any_layout_makes_a_kernel_compile_again(frame_of, rotated):
    """A session with a lost marker, views and smoothing; the pictures are contiguous, or turned views of such."""
    camera = Camera(240, 320, 600.0, 600.0, 119.5, 159.5) if rotated else CAMERA
    seeds = [Seed("one", 0, truth(orange(0))), Seed("two", 0, truth(green(0)))]
    if rotated:
        seeds = [Seed(seed.marker, 0, turned_circle(seed.circle)) for seed in seeds]

    def frames():
        for i in range(20):
            balls = [green(i)] if 5 <= i < 14 else [orange(i), green(i)]
            frame = frame_of(picture(*balls, noise_seed=i), i)
            yield turned(frame) if rotated else frame

    markers = [MarkerSpec("one", 2 * RADIUS_M), MarkerSpec("two", 2 * RADIUS_M)]
    with event.install_recorder("numba:compile") as heard:
        results = list(
            Session(camera, markers, seeds, ChainConfig(policy=COUNTED), keep_view=lambda estimate: True).run(frames())
        )
    assert heard.buffer == []
    statuses = [[e.status.value for e in r.estimates] for r in results]
    assert {"VERIFIED", "LOST"} <= {one for one, _ in statuses}
    assert {two for _, two in statuses[1:]} == {"VERIFIED"}
    assert statuses[-1][0] == "VERIFIED"
    signatures = {name: kernel.signatures for name, kernel in kernels().items()}
    assert len(signatures) > 15
    assert all(len(own) == 1 for own in signatures.values()), signatures


def test_an_array_of_another_kind_is_refused_not_compiled_for():
    name, kernel = next((name, kernel) for name, kernel in kernels().items() if name.endswith(".cut_bgr"))
    planes = bgr_frame(picture()).planes
    wrong = planes.y.astype(np.float32)
    with pytest.raises(TypeError, match="No matching definition"):
        kernel(wrong, planes.u, planes.v, planes.grid, 0.0, 0.0, 1.0, 4, 4)
    assert len(kernels()[name].signatures) == 1


# -- where they are kept ---------------------------------------------------------------------------

INNER = "from spheremcap.core.compiled import inner\n\n\n@inner\ndef twice(x):\n    return {factor} * x\n"
MIDDLE = (
    "from spheremcap.core.compiled import inner\n"
    "from kept_inner import twice\n\n\n@inner\ndef four_times(x):\n    return twice(twice(x))\n"
)
OUTER = (
    "from spheremcap.core.compiled import F8\n"
    "from kept_middle import four_times\n\n\ndef shifted(x):\n    return four_times(x) + 1.0\n\n\n"
    "def plain(x):\n    return x + 1.0\n"
)


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Writes and (again) imports three files: a loop, a loop that calls it, a function that calls that."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv(compiled._HELPS, "1")  # no second process for these
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python knows a changed file by size and second alone
    names = ("kept_inner", "kept_middle", "kept_outer")

    def load(factor=2.0):
        importlib.invalidate_caches()
        for name, text in zip(names, (INNER.format(factor=factor), MIDDLE, OUTER), strict=True):
            path = tmp_path / f"{name}.py"
            if not path.exists() or path.read_text() != text:
                path.write_text(text)
            sys.modules.pop(name, None)
        return importlib.import_module("kept_outer")

    yield load
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    return folder


def folder_of(function):
    with compiled._kept_for(function) as kept:
        assert kept
        return Path(numba.config.CACHE_DIR)


def test_a_kernel_is_kept_in_a_folder_named_after_all_files_that_go_into_it(modules, cache, tmp_path):
    outer = modules()
    first, plain = folder_of(outer.shifted), folder_of(outer.plain)
    assert first.parent == cache
    assert first.is_dir()
    assert folder_of(outer.shifted) == first
    assert folder_of(modules().shifted) == first
    # A loop two calls away, in a file that the kernel's own file does not even import.
    outer = modules(factor=3.0)
    assert folder_of(outer.shifted) != first
    assert folder_of(outer.plain) == plain
    (tmp_path / "kept_other.py").write_text("x = 1\n")
    assert folder_of(outer.plain) == plain
    second = folder_of(outer.shifted)
    os.utime(tmp_path / "kept_outer.py", ns=(1, 1))
    assert folder_of(outer.shifted) not in (first, second)


def test_a_changed_loop_is_compiled_anew_and_an_unchanged_one_is_not(modules, cache):
    def made():
        return compiled.kernel(None, compiled.F8)(modules.current.shifted)

    modules.current = modules()
    first = made()
    assert first(10.0) == 41.0
    assert not first.stats.cache_hits
    modules.current = modules()
    again = made()
    assert again(10.0) == 41.0
    assert again.stats.cache_hits
    modules.current = modules(factor=3.0)
    changed = made()
    assert changed(10.0) == 91.0
    assert not changed.stats.cache_hits


def test_all_loops_of_a_kernel_of_the_package_are_found():
    files = {
        Path(name).name
        for name in compiled._files_of(kernels()["spheremcap.detection.outline._sharpened"].py_func, set())
    }
    assert {"outline.py", "edge.py", "sampling.py", "sphere.py", "lens.py", "linear.py", "colour.py"} <= files


def test_the_place_where_numba_keeps_others_is_left_as_it_was(modules, cache):
    folder_of(modules().shifted)
    assert str(cache) == numba.config.CACHE_DIR
    with pytest.raises(ZeroDivisionError), compiled._kept_for(modules().shifted):
        raise ZeroDivisionError
    assert str(cache) == numba.config.CACHE_DIR


def test_a_folder_that_cannot_be_written_is_passed_over(modules, tmp_path, monkeypatch):
    """Not by the one that is asked for, not beside the package: the user's own caches are left."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(blocked / "cache"))
    monkeypatch.setattr(compiled, "__file__", str(blocked / "spheremcap" / "core" / "compiled.py"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert (tmp_path / "home") in folder_of(modules().shifted).parents


def test_where_nothing_can_be_written_the_kernel_works_without_being_kept(modules, tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(blocked / "cache"))
    monkeypatch.setattr(compiled, "__file__", str(blocked / "spheremcap" / "core" / "compiled.py"))
    monkeypatch.setenv("HOME", str(blocked / "home"))
    with compiled._kept_for(modules().shifted) as kept:
        assert not kept
    kernel = compiled.kernel(None, compiled.F8)(modules().shifted)
    assert kernel(10.0) == 41.0
    assert blocked.read_text() == ""


def test_a_folder_that_may_not_be_written_to_is_passed_over(modules, cache, monkeypatch):
    """It is there, and of another user, as in a container that runs under a changed one."""
    forbidden = folder_of(modules().shifted)
    allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != forbidden and allowed(path, mode))
    with compiled._kept_for(modules().shifted) as kept:
        assert kept
        assert Path(numba.config.CACHE_DIR) != forbidden


def test_the_one_who_waits_is_told_once(capsys):
    notice = compiled._Notice()
    notice.done()
    assert capsys.readouterr().err == ""
    for _ in range(3):
        notice.missed(0.0)
    assert capsys.readouterr().err.count("\n") == 1
    notice.done()
    notice.done()
    said = capsys.readouterr().err
    assert said.startswith("spheremcap: compiled in ")
    assert said.count("\n") == 1


def test_infinity_and_nan_are_not_finite_in_a_kernel():
    """The sums' freedom must not fold the question away."""

    @numba.njit(**compiled._OPTIONS)
    def asked(value):
        return compiled_finite(value)

    for value, expected in ((1.0, True), (-1e200, True), (np.inf, False), (-np.inf, False), (np.nan, False)):
        assert asked(value) == expected


compiled_finite = compiled.finite

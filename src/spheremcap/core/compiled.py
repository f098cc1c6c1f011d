"""The one switch for every compiled loop: numba, off the GIL, kept on disk between runs where that can be written.

A kernel takes plain arrays and floats and says their types, so it is compiled once, when its module is first
imported, and never again for another layout. Whoever only prints (help, info, export) must not import this.
"""

import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any

import numba

PLANE = numba.types.Array(numba.types.uint8, 2, "A", readonly=True)
"""A plane of a frame: (rows, columns) uint8, any strides, not to be written to."""
BGR = numba.types.Array(numba.types.uint8, 3, "A", readonly=True)
F8 = numba.types.float64
F4 = numba.types.float32
I8 = numba.types.int64
BOOL = numba.types.boolean


def array(scalar: Any, dims: int) -> Any:
    """The type of a contiguous array that is only read."""
    return numba.types.Array(scalar, dims, "C", readonly=True)


_ROOMS_LAST = "spheremcap.tracking.follower, spheremcap.verification.matching, spheremcap.positioning.kalman"
_HELPS = "SPHEREMCAP_COMPILES_BESIDE"  # set for the second process, which neither says so nor starts a third

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
# Sums may be taken in any order, which lets them run in vector registers; NaN and infinity keep their meaning.

inner = numba.njit(forceinline=True, **_OPTIONS)
"""For a loop that only kernels call: it is compiled into them. Inlined whatever its size: a function that two kernels
share is linked by its name, and which of its two versions runs would depend on what was loaded first."""


@inner
def finite(value):
    """Whether a number is neither NaN nor infinite. math.isfinite is x - x == 0, which sums in any order fold away."""
    return abs(value) < 1e300


class _Notice:
    """One line for the person who waits, when it turns out that the kernels have to be compiled; and a second process
    that compiles the rooms which this one comes to last, since a process compiles one kernel at a time."""

    def __init__(self) -> None:
        self._since: float | None = None
        self._helper: subprocess.Popen[bytes] | None = None

    def missed(self, started: float, kept: bool) -> None:
        """A kernel had to be compiled; `kept` says whether what another process compiles can be loaded by this one."""
        if self._since is not None or _HELPS in os.environ:
            return
        self._since = started
        print("spheremcap: compiling for this machine, once; this takes about a minute", file=sys.stderr, flush=True)
        if kept:
            with suppress(OSError):
                self._helper = subprocess.Popen(
                    [sys.executable, "-c", f"import {_ROOMS_LAST}"], env={**os.environ, _HELPS: "1"},
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip

    def done(self) -> None:
        """All kernels are there; say how long it took, if it took anything."""
        if self._since is not None:
            if self._helper is not None:
                self._helper.wait()
            spent = time.monotonic() - self._since
            print(f"spheremcap: compiled in {spent:.0f} s", file=sys.stderr, flush=True)
            self._since = None


notice = _Notice()


def kernel(result: Any, *parameters: Any, at_import: bool = True) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function for these types. `result` is None where numba finds the type of what comes back itself.

    One that no tracking needs is compiled not `at_import` but when it is first called.
    """
    signature = tuple(parameters) if result is None else result(*parameters)

    def compiled(function: Callable[..., Any]) -> Any:
        if at_import:
            return compile_now(function)
        of_function: list[Any] = []

        @wraps(function)
        def when_called(*values: Any) -> Any:
            if not of_function:
                of_function.append(compile_now(function))
            return of_function[0](*values)

        return when_called

    def compile_now(function: Callable[..., Any]) -> Any:
        started = time.monotonic()
        with _kept_for(function) as kept:
            dispatcher = numba.njit(signature, cache=kept, **_OPTIONS)(function)
        if not numba.config.DISABLE_JIT and not dispatcher.stats.cache_hits:
            notice.missed(started, kept)
        return dispatcher

    return compiled


@contextmanager
def _kept_for(function: Callable[..., Any]) -> Iterator[bool]:
    """Where numba keeps this kernel: in a folder named after the files whose loops go into it, since numba itself looks
    only at the kernel's own file. Beside the package, else with the user's caches; False where neither can be written.
    """
    stamp = hashlib.sha256()
    for name in sorted(_files_of(finite.py_func, set()) | _files_of(function, set())):
        facts = Path(name).stat()
        stamp.update(f"{Path(name).name} {facts.st_size} {facts.st_mtime_ns}\n".encode())
    before = numba.config.CACHE_DIR
    for place in (before, Path(__file__).parents[1] / "__pycache__", Path.home() / ".cache" / "spheremcap"):
        if not place:
            continue
        folder = Path(place) / f"kernels-{stamp.hexdigest()[:12]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            numba.config.CACHE_DIR = str(folder)
            try:
                yield True
            finally:
                numba.config.CACHE_DIR = before
            return
    yield False


def _files_of(function: Callable[..., Any], seen: set[Any]) -> set[str]:
    """The source files of a function and of all inner loops that it can call."""
    seen.add(function)
    files = {function.__code__.co_filename}
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", None)
        if called is not None and called not in seen:
            files |= _files_of(called, seen)
    return files

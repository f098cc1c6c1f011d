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


_ROOMS = (
    "spheremcap.session",
    "spheremcap.tracking.follower, spheremcap.verification.matching, spheremcap.positioning.kalman",
)
"""What two processes compile side by side: all, and those to which the first comes last."""
_HELPS = "SPHEREMCAP_COMPILES_BESIDE"  # set for these processes, which neither say so nor start others

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
    """One line for the person who waits, when it turns out that the kernels have to be compiled.

    Compiling takes twice the memory of tracking, and a process compiles one kernel at a time: so two processes of their
    own do it, and leave the kernels where this one loads them from.
    """

    def __init__(self) -> None:
        self._since: float | None = None

    def compile_beside(self) -> None:
        """Have all kernels compiled, once, and wait for it. What cannot be had so is compiled by this process."""
        if self._since is not None or _HELPS in os.environ:
            return
        self.missed(time.monotonic())
        silent = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        environment = {**os.environ, _HELPS: "1"}
        with suppress(OSError):
            words = ([sys.executable, "-c", f"import {rooms}"] for rooms in _ROOMS)
            for helper in [subprocess.Popen(some, env=environment, **silent) for some in words]:
                helper.wait()

    def missed(self, started: float) -> None:
        """A kernel had, or has, to be compiled."""
        if self._since is not None or _HELPS in os.environ:
            return
        self._since = started
        print("spheremcap: compiling for this machine, once; this takes about a minute", file=sys.stderr, flush=True)

    def done(self) -> None:
        """All kernels are there; say how long it took, if it took anything."""
        if self._since is not None:
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
            if kept is not None and at_import and not numba.config.DISABLE_JIT and not _is_kept(function, kept):
                notice.compile_beside()
            dispatcher = numba.njit(signature, cache=kept is not None, **_OPTIONS)(function)
        if not numba.config.DISABLE_JIT and not dispatcher.stats.cache_hits:
            if at_import:
                notice.missed(started)
            else:
                spent = time.monotonic() - started
                print(f"spheremcap: compiled {function.__name__} in {spent:.0f} s, once", file=sys.stderr, flush=True)
        return dispatcher

    return compiled


@contextmanager
def _kept_for(function: Callable[..., Any]) -> Iterator[Path | None]:
    """Where numba keeps this kernel: in a folder named after the files whose loops go into it, since numba itself looks
    only at the kernel's own file. Beside the package, else with the user's caches; None where neither can be written.
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
                yield folder
            finally:
                numba.config.CACHE_DIR = before
            return
    yield None


def _is_kept(function: Callable[..., Any], folder: Path) -> bool:
    """Whether a compiled version of it is there, for whatever machine."""
    line = function.__code__.co_firstlineno
    return any(folder.glob(f"*/*.{function.__name__}-{line}.py*.nbi"))


def _files_of(function: Callable[..., Any], seen: set[Any]) -> set[str]:
    """The source files of a function and of all inner loops that it can call."""
    seen.add(function)
    files = {function.__code__.co_filename}
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", None)
        if called is not None and called not in seen:
            files |= _files_of(called, seen)
    return files

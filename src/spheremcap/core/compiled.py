"""The one switch for every compiled loop: numba, off the GIL, kept on disk between runs where that can be written.

A kernel takes plain arrays and floats and says their types, so it is compiled once, when its module is first
imported, and never again for another layout. Whoever only prints (help, info, export) must not import this.
"""

import sys
import time
from collections.abc import Callable
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


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
# Sums may be taken in any order, which lets them run in vector registers; NaN and infinity keep their meaning.

inner = numba.njit(**_OPTIONS)
"""For a loop that only kernels call: it is compiled into them."""


class _Notice:
    """One line for the person who waits, when it turns out that the kernels have to be compiled."""

    def __init__(self) -> None:
        self._since: float | None = None
        self.compiled = 0

    def missed(self, started: float) -> None:
        self.compiled += 1
        if self._since is None:
            self._since = started
            print(
                "spheremcap: compiling for this machine, once; this takes up to a minute", file=sys.stderr, flush=True
            )

    def done(self) -> None:
        """All kernels are there; say how long it took, if it took anything."""
        if self._since is not None:
            spent = time.monotonic() - self._since
            print(f"spheremcap: compiled {self.compiled} kernels in {spent:.0f} s", file=sys.stderr, flush=True)
            self._since = None


notice = _Notice()


def kernel(result: Any, *parameters: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function for these types. `result` is None where numba finds the type of what comes back itself."""
    signature = tuple(parameters) if result is None else result(*parameters)

    def compiled(function: Callable[..., Any]) -> Any:
        started = time.monotonic()
        try:
            dispatcher = numba.njit(signature, cache=True, **_OPTIONS)(function)
        except RuntimeError:  # no place to keep it
            dispatcher = numba.njit(signature, **_OPTIONS)(function)
        if not dispatcher.stats.cache_hits:
            notice.missed(started)
        return dispatcher

    return compiled

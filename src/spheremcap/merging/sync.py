"""Offset and drift of a sensor's clock from the motion that sensor and camera both saw.

A marker's track gives its acceleration a in the camera's frame; an accelerometer beside it gives the specific
force in its own turning frame, of which only the size is known: |f| = |a + u|, with u minus gravity in the
camera's frame. u's direction is found on the way, so nothing about the orientation of sensor or camera has to
be known. Against a wheel's rate the marker's speed is used.

1. The whole recording: |f|^2 is linear in |a|^2 and a; R^2 of that regression as a function of lag, by FFT,
   in segments whose curves are added along lines of constant drift. An answer has to stand out against every
   other lag, which strictly periodic motion does not.
2. u and the lag together by least squares on |f| = |a + u| (Gauss-Newton in u at each lag).
3. |a + u| against |f| in short windows: the peak of each correlation to a fraction of a sample (parabola;
   Cespedes et al., Ultrasonic Imaging 17, 1995), and a robust line through the windows' lags (iteratively
   reweighted least squares, Tukey's weights).

Measured on simulated ten-minute recordings (tests/merging/test_sync.py). The camera's own acceleration is not
seen: a chair that surges by 3 m/s^2 with every push moves the answer by about half a millisecond. A constant
delay inside sensor or camera (filters, half the exposure) is part of the result.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from spheremcap.core.time import NS_PER_S
from spheremcap.errors import SpheremcapError
from spheremcap.merging.clock import Clock
from spheremcap.merging.log import SensorLog
from spheremcap.merging.units import G as STANDARD_GRAVITY

FloatArray = npt.NDArray[np.float64]
StampArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


_LONGEST_S = 86_400.0


class SyncError(SpheremcapError):
    """The signals do not say what the clock's offset and drift are."""


@dataclass(frozen=True)
class SyncConfig:
    """Units in the names; the defaults suit arm and wheel motion of 0.5 to 5 Hz."""

    max_offset_s: float = 15.0
    """How far the clocks may be apart, beyond the guess."""
    max_drift_ppm: float = 300.0
    derivative_s: float = 0.1
    """Length of the local fourth-order polynomials that give a track's derivatives (Savitzky and Golay): flat
    to about 12 Hz, and half at 18 Hz, at 0.105 s.
    """
    rate_hz: float = 200.0
    """Of the grid that both signals are brought to."""
    longest_gap_s: float = 0.05
    """Longer gaps in a track are left out, shorter ones bridged by a spline."""
    segment_s: float = 20.0
    window_s: float = 16.0
    """In a short recording a fifth of it, at least 3 s."""
    search_s: float = 0.12
    """How far a window's lag is looked for around the first estimate; below half a movement's period."""
    least_distinction: float = 3.0
    """How clearly the best lag has to stand out: log of the ratio of unexplained variances, times the square
    root of the number of independent samples (2 a second).
    """
    least_correlation: float = 0.4
    least_agreeing: float = 0.5
    """Fraction of the windows that have to lie on the line."""
    largest_error_s: float = 0.005
    """Standard error of the line at the recording's ends above which there is no answer."""


@dataclass(frozen=True)
class Signal:
    """A quantity over time on one clock, NaN where it was not measured.

    `values` is (N, 3) for a track's acceleration, of which `gravity` says that an accelerometer sees it with
    a constant vector added, and (N, 1) for a speed, a rate or the size of a sensor's vectors.
    """

    stamp_ns: StampArray
    values: FloatArray
    gravity: bool = False


@dataclass(frozen=True)
class Sync:
    """The answer. `clock` maps the sensor's stamps to the reference's.

    `window_stamp_ns` (W,) and `window_residual_s` (W,) are the windows' middles on the reference's clock and
    how far each window's own lag is from the line; `agreed` (W,) those that lie on it. `error_s` is the
    line's standard error at the worse end, `residual_s` the agreeing windows' standard deviation,
    `distinction` how clear the first estimate was, `correlation` the agreeing windows' median.
    """

    clock: Clock
    window_stamp_ns: StampArray
    window_residual_s: FloatArray
    agreed: BoolArray
    error_s: float
    residual_s: float
    correlation: float
    distinction: float
    guess_ns: int = 0

    @property
    def offset_s(self) -> float:
        """The offset at the sensor's first sample, beyond the guess."""
        return (self.clock.offset_ns - self.guess_ns) / NS_PER_S

    @property
    def drift_ppm(self) -> float:
        """Positive when the sensor's clock is too slow."""
        return float(self.clock.drift) * 1e6

    def facts(self) -> dict[str, str]:
        """How good it is, for a metadata record beside the clock."""
        return {
            "sync_residual_ms": f"{self.residual_s * 1e3:.3f}",
            "sync_error_ms": f"{self.error_s * 1e3:.3f}",
            "sync_windows": f"{int(self.agreed.sum())} of {len(self.agreed)}",
        }

    def line(self) -> str:
        """The result in one line, for a person."""
        return (
            f"offset {self.offset_s * 1e3:+.3f} ms at the first sample, drift {self.drift_ppm:+.2f} ppm, "
            f"residual {self.residual_s * 1e3:.2f} ms, "
            f"{int(self.agreed.sum())} of {len(self.agreed)} windows agree, "
            f"error at the ends {self.error_s * 1e3:.2f} ms"
        )


# --- signals ---

_BEYOND_MEASURE = 1e9


def track_acceleration(stamp_ns: StampArray, xyz_m: FloatArray, config: SyncConfig | None = None) -> Signal:
    """Of a marker's track, stamps (N,) and positions (N, 3) with NaN where it was not measured."""
    return Signal(*_derived(stamp_ns, xyz_m, 2, config or SyncConfig()), gravity=True)


def track_speed(stamp_ns: StampArray, xyz_m: FloatArray, config: SyncConfig | None = None) -> Signal:
    """Of a marker on a wheel, whose speed goes with the wheel's rate."""
    stamps, v = _derived(stamp_ns, xyz_m, 1, config or SyncConfig())
    return Signal(stamps, np.linalg.norm(v, axis=1)[:, None])


def magnitude(stamp_ns: StampArray, vectors: FloatArray, left_out: BoolArray | None = None) -> Signal:
    """The size (N,) of a sensor's vectors (N, 3), or of a rate (N,); `left_out` where it was saturated.

    A number beyond all that can be measured, as a damaged message has it, is none.
    """
    vectors = np.where(np.abs(vectors) < _BEYOND_MEASURE, vectors, np.nan)
    size = np.abs(vectors) if vectors.ndim == 1 else np.linalg.norm(vectors, axis=1)
    if left_out is not None:
        size = np.where(left_out, np.nan, size)
    return Signal(np.asarray(stamp_ns, np.int64), size[:, None].astype(np.float64))


def _derived(stamp_ns: StampArray, xyz_m: FloatArray, order: int, config: SyncConfig) -> tuple[StampArray, FloatArray]:
    """The smoothed derivative of a track on an even grid of rate_hz; NaN in gaps and near their ends."""
    from scipy.interpolate import CubicSpline  # 50 MB, for which only this room has use
    from scipy.signal import savgol_filter

    good = (np.abs(xyz_m) < _BEYOND_MEASURE).all(axis=1)
    stamps, xyz = np.asarray(stamp_ns, np.int64)[good], xyz_m[good]
    keep = np.concatenate([[True], np.diff(stamps) > 0]) if len(stamps) else np.zeros(0, bool)
    stamps, xyz = stamps[keep], xyz[keep]
    if len(stamps) < 10:
        raise SyncError(f"the track has only {len(stamps)} measured positions")
    t = (stamps - stamps[0]) / NS_PER_S
    step = 1 / config.rate_hz
    _check_span(float(t[-1]), "the track")
    count = int(t[-1] / step) + 1
    grid = np.arange(count) * step
    out = np.full((count, xyz.shape[1]), np.nan)
    breaks = np.flatnonzero(np.diff(t) > config.longest_gap_s) + 1
    width = 2 * round(config.derivative_s / step / 2) + 1
    for part in np.split(np.arange(len(t)), breaks):
        i0, i1 = int(np.ceil(t[part[0]] / step)), int(np.floor(t[part[-1]] / step)) + 1
        if len(part) < 5 or i1 - i0 < 2 * width:
            continue
        even = CubicSpline(t[part], xyz[part])(grid[i0:i1])
        smooth = savgol_filter(even, width, 4, deriv=order, delta=step, axis=0, mode="nearest")
        out[i0 + width // 2 : i1 - width // 2] = smooth[width // 2 : len(smooth) - width // 2]
    return stamps[0] + np.rint(grid * NS_PER_S).astype(np.int64), out


def _check_span(span_s: float, what: str) -> None:
    """Raises SyncError for a signal that is longer than any is: one of its stamps is damaged."""
    if span_s > _LONGEST_S:
        raise SyncError(f"{what} spans {span_s:.0f} s, more than a day: one of its stamps must be damaged")


def _on_grid(signal: Signal, origin_ns: int, config: SyncConfig) -> tuple[float, FloatArray]:
    """A sensor's value on an even grid: its start in s after the origin, values (M,) with NaN in gaps."""
    t, first = np.unique((signal.stamp_ns - origin_ns) / NS_PER_S, return_index=True)
    value = signal.values[first, 0]
    good = np.isfinite(value)
    if good.sum() < 10:
        raise SyncError(f"the sensor has only {int(good.sum())} usable samples")
    step, typical = 1 / config.rate_hz, float(np.median(np.diff(t)))
    value = np.interp(t, t[good], value[good])
    taps = max(1, round(step / typical))
    if taps > 1:  # a faster sensor: the mean over a grid step
        value = np.convolve(np.pad(value, (taps // 2, (taps - 1) // 2), mode="edge"), np.full(taps, 1 / taps), "valid")
        t = t - (0.0 if taps % 2 else typical / 2)
    _check_span(float(t[-1] - t[0]), "the sensor")
    grid = t[0] + np.arange(int((t[-1] - t[0]) / step) + 1) * step
    after = np.searchsorted(t, grid).clip(1, len(t) - 1)
    bridged = t[after] - t[after - 1] <= max(3 * typical, config.longest_gap_s)
    sound = bridged & (np.interp(grid, t, good.astype(np.float64)) > 0.999)
    return float(t[0]), np.where(sound, np.interp(grid, t, value), np.nan)


def sync_marker(
    stamp_ns: StampArray,
    xyz_m: FloatArray,
    sensor_stamp_ns: StampArray,
    sensor_values: Mapping[str, FloatArray],
    *,
    saturated: BoolArray | None = None,
    guess_ns: int = 0,
    config: SyncConfig | None = None,
) -> Sync:
    """Synchronise a sensor with a marker's track: an accelerometer's size, or a wheel's rate with a marker on
    it.

    The track is (N,) and (N, 3), NaN where it was not measured; the sensor's values are named as in SensorLog
    and in a Recording's Sensor. Raises SyncError when there is nothing to compare, or no clear answer.
    """
    axes = [sensor_values.get(f"linear_acceleration.{axis}") for axis in "xyz"]
    if all(a is not None for a in axes):
        force = np.stack([a for a in axes if a is not None], axis=1)
        clipped = sensor_values.get("saturated")
        if saturated is None and clipped is not None:
            saturated = clipped > 0
        reference = track_acceleration(stamp_ns, xyz_m, config)
        return synchronise(reference, magnitude(sensor_stamp_ns, force, saturated), guess_ns=guess_ns, config=config)
    rate = sensor_values.get("rate_rad_s")
    if rate is None and "angle_rad" in sensor_values:
        rate = np.gradient(sensor_values["angle_rad"], sensor_stamp_ns / NS_PER_S)
    if rate is None:
        there = ", ".join(sensor_values)
        raise SyncError(f"the sensor has neither acceleration, rate nor angle, only {there}")
    reference = track_speed(stamp_ns, xyz_m, config)
    return synchronise(reference, magnitude(sensor_stamp_ns, rate), guess_ns=guess_ns, config=config)


def residual_log(sync: Sync, name: str) -> SensorLog:
    """The windows' residuals as a record (residual_ms, agreed 0 or 1) on the reference's clock, to merge."""
    values = {"residual_ms": sync.window_residual_s * 1e3, "agreed": sync.agreed.astype(np.float64)}
    return SensorLog(f"{name}_sync", "record", sync.window_stamp_ns, values, name, "")


# --- the estimate ---


def synchronise(reference: Signal, sensor: Signal, *, guess_ns: int = 0, config: SyncConfig | None = None) -> Sync:
    """The clock that maps the sensor's stamps to the reference's; `guess_ns` is added to them before the
    search.

    Raises SyncError, with what is missing, when the signals do not support an answer.
    """
    config = config or SyncConfig()
    origin = int(reference.stamp_ns[0]) if len(reference.stamp_ns) else 0
    if not np.isfinite(reference.values).all(axis=1).any():
        raise SyncError("the track is nowhere measured for long enough")
    start, value = _on_grid(sensor, origin - guess_ns, config)
    pair = _Pair(reference.values, value, start, config, reference.gravity)
    lag, drift, distinction = pair.coarse()
    if distinction < config.least_distinction:
        raise SyncError(
            f"no lag stands out (distinction {distinction:.1f}, {config.least_distinction:g} is needed): "
            "the motion is too regular, too short, or not the sensor's"
        )
    for _ in range(3):
        lag, predicted = pair.refine(lag, drift)
        fit = pair.line(predicted, lag, drift)
        lag, drift = fit.lag, fit.drift
    agreeing = int(fit.agreed.sum())
    if agreeing < max(4, config.least_agreeing * len(fit.lags)):
        raise SyncError(
            f"only {agreeing} of {len(fit.lags)} windows agree on a line (at least "
            f"{max(4, round(config.least_agreeing * len(fit.lags)))} are needed)"
        )
    if fit.error > config.largest_error_s:
        raise SyncError(
            f"the lag is known to {fit.error * 1e3:.1f} ms only at the recording's ends (at most "
            f"{config.largest_error_s * 1e3:g} ms is allowed): the recording is too short or too calm"
        )
    # The line is over the reference's time, the clock over the sensor's: t_ref = t + lag(t_ref).
    first_ns = int(sensor.stamp_ns.min())
    anchor_s = (first_ns + guess_ns - origin) / NS_PER_S
    at_first = (fit.lag + fit.drift * (anchor_s - pair.middle)) / (1 - fit.drift)
    own_drift = fit.drift / (1 - fit.drift)
    clock = Clock(guess_ns + round(at_first * NS_PER_S), Fraction(round(own_drift * 10**12), 10**12), first_ns)
    return Sync(
        clock,
        origin + np.rint(fit.times * NS_PER_S).astype(np.int64),
        fit.residuals,
        fit.agreed,
        fit.error,
        float(np.std(fit.residuals[fit.agreed])),
        float(np.median(fit.correlations[fit.agreed])),
        distinction,
        guess_ns,
    )


@dataclass(frozen=True)
class _Line:
    """lag(t) = lag + drift * (t - middle), and the windows behind it; seconds on the reference's clock."""

    lag: float
    drift: float
    error: float
    times: FloatArray
    lags: FloatArray
    residuals: FloatArray
    correlations: FloatArray
    agreed: BoolArray


class _Pair:
    """Reference (N, k) and sensor values (M,) on even grids; the sensor's starts `start` s after the
    reference's.

    A lag is what to add to a sensor's time to get the reference's.
    """

    def __init__(self, values: FloatArray, sensor: FloatArray, start: float, config: SyncConfig, gravity: bool) -> None:
        self.values = values
        self.sensor = sensor
        self.start = start
        self.config = config
        self.gravity = gravity
        self.step = 1 / config.rate_hz
        good = np.flatnonzero(np.isfinite(values).all(axis=1))
        self.first, self.last = int(good[0]), int(good[-1]) + 1
        self.middle = (self.first + self.last) / 2 * self.step

    def coarse(self) -> tuple[float, float, float]:
        """Lag at the middle, drift, and how clearly they stand out."""
        config = self.config
        every = max(1, round(0.02 * config.rate_hz))  # 50 Hz is enough here
        step = every * self.step
        good = np.isfinite(self.sensor)  # clipped peaks are bridged here: their height matters little for R^2
        filled = np.interp(np.arange(len(self.sensor)), np.flatnonzero(good), self.sensor[good])
        target, features = filled[::every], self.values[::every]
        if self.gravity:
            target = target**2
            features = np.column_stack([np.sum(features**2, axis=1), features])
        reach = int(config.max_offset_s / step) + 1
        size = max(16, int(config.segment_s / step))
        curves, middles, weights = [], [], []
        for begin in range(self.first // every, max(self.first // every + 1, self.last // every - size // 2), size):
            curve, weight = self._explained(features[begin : begin + size], target, begin, step, reach)
            if weight > 0:
                curves.append(curve)
                middles.append((begin + size / 2) * step - self.middle)
                weights.append(weight)
        if not curves or not np.any(curves):
            raise SyncError("track and sensor do not overlap in time within the largest offset")
        table, share = np.array(curves), np.array(weights) / np.sum(weights)
        span = max(1.0, (self.last - self.first) * self.step)
        limit = config.max_drift_ppm * 1e-6
        tries = np.linspace(-limit, limit, 2 * int(np.ceil(limit * span / 2 / (step / 2))) + 1)
        lags = np.arange(-reach, reach + 1)
        scores = np.zeros((len(tries), len(lags)))
        for k, drift in enumerate(tries):
            for curve, middle, part in zip(table, middles, share, strict=True):
                shift = round(drift * middle / step)
                moved = np.full(len(lags), 0.0)
                moved[max(0, -shift) : len(lags) - max(0, shift)] = curve[max(0, shift) : len(lags) + min(0, shift)]
                scores[k] += part * moved
        best_drift, best_lag = np.unravel_index(int(np.argmax(scores)), scores.shape)
        best = float(scores[best_drift, best_lag])
        elsewhere = np.abs(lags - lags[best_lag]) * step > config.search_s + limit * span / 2
        second = float(scores[:, elsewhere].max()) if elsewhere.any() else 0.0
        independent = 2.0 * span
        distinction = float(np.log(max(1 - second, 1e-6) / max(1 - best, 1e-6)) * np.sqrt(independent))
        return float(lags[best_lag] * step), float(tries[best_drift]), distinction

    def _explained(
        self, features: FloatArray, target: FloatArray, begin: int, step: float, reach: int
    ) -> tuple[FloatArray, float]:
        """R^2 of the target on a segment's features for every lag -reach..reach, and the segment's good
        samples.
        """
        from scipy.signal import fftconvolve

        used: BoolArray = np.asarray(np.isfinite(features).all(axis=1))
        count = int(used.sum())
        if count < len(features) // 4 or count < 16:
            return np.zeros(2 * reach + 1), 0.0
        mask = used.astype(np.float64)
        centred = np.where(used[:, None], features - features[used].mean(axis=0), 0.0)
        centred /= np.maximum(centred.std(axis=0), 1e-12)
        # Sample i of the segment meets the target's sample i + begin - (start + lag) / step.
        zero = begin - self.start / step
        offset = round(zero)
        rows = np.arange(offset - reach, offset + reach + len(features))
        inside = (rows >= 0) & (rows < len(target))
        y = np.zeros(len(rows))
        y[inside] = target[rows[inside]]
        there: BoolArray = np.asarray(inside & np.isfinite(y))
        y[there] -= np.mean(y[there]) if there.any() else 0.0
        y[~there] = 0.0
        valid = there.astype(np.float64)

        def slide(weight: FloatArray, over: FloatArray) -> FloatArray:
            out: FloatArray = fftconvolve(over, weight[::-1], mode="valid")
            return out

        n = slide(mask, valid)
        total, squares = slide(mask, y), slide(mask, y * y)
        energy = squares - total**2 / np.maximum(n, 1)
        cross = np.stack([slide(centred[:, k], y) for k in range(centred.shape[1])], axis=1)
        gram = centred.T @ centred + 1e-9 * count * np.eye(centred.shape[1])
        explained = np.einsum("lk,lk->l", cross, np.linalg.solve(gram, cross.T).T)
        floor = 1e-6 * max(float(energy.max()), 1e-12)
        r2 = np.where((n >= 0.7 * count) & (energy > floor), explained / np.maximum(energy, floor), 0.0)
        # Index j of r2 has the target start at offset - reach + j: a larger j is a smaller lag.
        return np.clip(r2[::-1], 0.0, 1.0), float(count)

    def refine(self, lag: float, drift: float) -> tuple[float, FloatArray]:
        """The lag at the middle and the sensor's value as the reference says it should be, (N,), found
        together.
        """
        if not self.gravity:
            return lag, self.values[:, 0]
        usable = np.flatnonzero(np.isfinite(self.values).all(axis=1))
        for step, most in ((0.005, 5_000), (0.001, 15_000)):
            rows = usable[:: max(1, len(usable) // most)]
            tries = lag + np.arange(-12, 13) * step
            costs = [self._constant_part(rows, more, drift)[1] for more in tries]
            k = int(np.clip(np.argmin(costs), 1, len(tries) - 2))
            lag = float(tries[k]) + step * _vertex(*costs[k - 1 : k + 2])
        u, _ = self._constant_part(rows, lag, drift)
        return lag, np.linalg.norm(self.values + u, axis=1)

    def _constant_part(self, rows: npt.NDArray[np.intp], lag: float, drift: float) -> tuple[FloatArray, float]:
        """u (3,) of least squares |f| = |a + u| with |u| = g at this lag, and the mean square left over.

        Gauss-Newton from the linear solution of the squares. Left free, u's size would trade against the lag.
        """
        t = rows * self.step
        f = self._sensor_at(t - (lag + drift * (t - self.middle)))
        good = np.isfinite(f)
        if good.sum() < max(100, len(rows) // 4):
            raise SyncError("track and sensor hardly overlap in time")
        a, f = self.values[rows][good], f[good]
        design = np.column_stack([2 * a, np.ones(len(a))])
        u: FloatArray = np.linalg.lstsq(design, f**2 - np.sum(a * a, axis=1), rcond=None)[0][:3]
        for _ in range(6):
            u *= STANDARD_GRAVITY / max(float(np.linalg.norm(u)), 1e-9)
            total = a + u
            size = np.maximum(np.linalg.norm(total, axis=1), 1e-6)
            slope = total / size[:, None]
            u = u + np.linalg.solve(slope.T @ slope + 1e-9 * np.eye(3), slope.T @ (f - size))
        u *= STANDARD_GRAVITY / max(float(np.linalg.norm(u)), 1e-9)
        return u, float(np.mean((f - np.linalg.norm(a + u, axis=1)) ** 2))

    def _sensor_at(self, t: FloatArray) -> FloatArray:
        index = (t - self.start) / self.step
        out: FloatArray = np.interp(index, np.arange(len(self.sensor)), self.sensor, left=np.nan, right=np.nan)
        return out

    def line(self, predicted: FloatArray, lag: float, drift: float) -> _Line:
        """The windows' lags around a first estimate, and the robust line through them."""
        config = self.config
        span = (self.last - self.first) * self.step
        size = max(16, int(min(config.window_s, max(3.0, span / 5)) * config.rate_hz))
        reach = int(np.ceil(config.search_s * config.rate_hz))
        times, lags, correlations = [], [], []
        for begin in range(self.first, max(self.first + 1, self.last - size // 2), size // 2):
            part = predicted[begin : begin + size]
            used: BoolArray = np.asarray(np.isfinite(part))
            if used.sum() < size // 4:
                continue
            time = begin * self.step + float(np.mean(np.flatnonzero(used))) * self.step
            found = self._peak(part, used, begin, lag + drift * (time - self.middle), reach)
            if found is not None:
                times.append(time)
                lags.append(found[0])
                correlations.append(found[1])
        if len(lags) < 4:
            raise SyncError(f"only {len(lags)} windows of {size * self.step:g} s have a clear lag, 4 are needed")
        return self._fit(np.array(times), np.array(lags), np.array(correlations))

    def _peak(
        self, part: FloatArray, used: BoolArray, begin: int, lag: float, reach: int
    ) -> tuple[float, float] | None:
        """A window's lag to a fraction of a sample and its correlation; None when there is no clear peak."""
        exact = begin - (self.start + lag) / self.step
        offset = round(exact)
        rows = np.flatnonzero(used)
        p = part[rows]
        scores = np.zeros(2 * reach + 1)
        for j in range(-reach, reach + 1):
            at = rows + offset + j
            inside = (at >= 0) & (at < len(self.sensor))
            y = self.sensor[at[inside]]
            good = np.isfinite(y)
            if good.sum() < 0.7 * len(rows):
                return None
            a, b = p[inside][good], y[good]
            a, b = a - a.mean(), b - b.mean()
            norm = float(np.sqrt((a @ a) * (b @ b)))
            scores[j + reach] = float(a @ b) / norm if norm > 0 else 0.0
        k = int(np.argmax(scores))
        if k in (0, 2 * reach) or scores[k] < self.config.least_correlation:
            return None
        shift = offset + k - reach + _vertex(*scores[k - 1 : k + 2]) - exact
        return lag - shift * self.step, float(scores[k])

    def _fit(self, times: FloatArray, lags: FloatArray, correlations: FloatArray) -> _Line:
        """Tukey's weights on top of each window's own; the error is that of the line at the worse end."""
        own = correlations**2 / np.maximum(1 - correlations**2, 1e-3)
        x = times - self.middle
        design = np.column_stack([np.ones(len(x)), x])
        weights = own.copy()
        solution = np.array([float(np.median(lags)), 0.0])
        scale = 0.02
        for _ in range(50):
            root = np.sqrt(weights)
            solution = np.linalg.lstsq(design * root[:, None], lags * root, rcond=None)[0]
            residuals = lags - design @ solution
            scale = max(1.4826 * float(np.median(np.abs(residuals))), 1e-5)
            inside = np.clip(1 - (residuals / (4.685 * scale)) ** 2, 0, None) ** 2
            if np.allclose(weights, own * inside, rtol=1e-6):
                break
            weights = own * inside
        residuals = lags - design @ solution
        agreed = np.abs(residuals) <= max(4 * scale, 0.001)
        w = weights / max(float(weights.sum()), 1e-12)
        spread = float(np.sum(w * residuals**2))
        effective = 1 / max(float(np.sum(w**2)), 1e-12) / 1.5  # windows overlap by half
        covariance = np.linalg.pinv((design * w[:, None]).T @ design) * spread / max(effective - 2, 1)
        ends = (np.array([self.first, self.last]) * self.step) - self.middle
        error = max(float(np.sqrt(max(np.array([1, e]) @ covariance @ np.array([1, e]), 0))) for e in ends)
        return _Line(float(solution[0]), float(solution[1]), error, times, lags, residuals, correlations, agreed)


def _vertex(left: float, middle: float, right: float) -> float:
    """Where the parabola through three even samples has its vertex, in samples from the middle one."""
    bend = left - 2 * middle + right
    return float(0.5 * (left - right) / bend) if bend else 0.0

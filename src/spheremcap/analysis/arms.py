"""Angles of arms and trunk, and the lengths of segments, from smoothed markers, with standard deviations.

Every value is there on the frames on which all its markers are. An angle's standard deviation is that of the markers'
smoothed positions, to the first order; neighbouring frames err alike.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.analysis.smoother import Motion

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Joint:
    """A marker's motion on N frames, in the chair's frame (or the camera's, where there is no chair): `there` (N,) is
    where it may be used, `measured` (N,) where it was measured."""

    marker: str
    motion: Motion
    there: BoolArray
    measured: BoolArray


@dataclass(frozen=True)
class Values:
    """N values and their standard deviations, NaN where there is none."""

    value: FloatArray
    sd: FloatArray

    @staticmethod
    def of(value: FloatArray, variance: FloatArray, there: BoolArray) -> "Values":
        """Of those that are there."""
        sd = np.sqrt(np.maximum(variance, 0.0))
        return Values(np.where(there, value, np.nan), np.where(there, sd, np.nan))


def distance(a: Joint, b: Joint) -> Values:
    """Between two markers, m."""
    d = a.motion.xyz_m - b.motion.xyz_m
    length = np.linalg.norm(d, axis=1)
    way = d / length[:, None]
    return Values.of(length, _spread(way, a.motion.xyz_m2 + b.motion.xyz_m2), a.there & b.there)


def elevation(low: Joint, high: Joint) -> Values:
    """Of the line from one marker to another above the horizontal, degrees, in the chair's frame."""
    d = high.motion.xyz_m - low.motion.xyz_m
    flat, length = np.hypot(d[:, 0], d[:, 1]), np.linalg.norm(d, axis=1)
    angle = np.arctan2(d[:, 2], flat)
    way = np.stack([-np.sin(angle) * d[:, 0] / flat, -np.sin(angle) * d[:, 1] / flat, np.cos(angle)], axis=1)
    way /= length[:, None]
    variance = _spread(way, low.motion.xyz_m2 + high.motion.xyz_m2)
    return Values.of(np.degrees(angle), np.degrees(1.0) ** 2 * variance, low.there & high.there)


def joint_angle(first: Joint, middle: Joint, last: Joint) -> Values:
    """At the middle marker, between the lines to the other two, degrees: 180 when straight."""
    a, b = first.motion.xyz_m - middle.motion.xyz_m, last.motion.xyz_m - middle.motion.xyz_m
    la, lb = np.linalg.norm(a, axis=1)[:, None], np.linalg.norm(b, axis=1)[:, None]
    ua, ub = a / la, b / lb
    cos = np.clip((ua * ub).sum(axis=1), -1, 1)[:, None]
    angle = np.arctan2(np.linalg.norm(np.cross(ua, ub), axis=1), cos[:, 0])
    sin = np.maximum(np.sin(angle), 1e-3)[:, None]
    by_first, by_last = -(ub - cos * ua) / (la * sin), -(ua - cos * ub) / (lb * sin)
    variance = (
        _spread(by_first, first.motion.xyz_m2)
        + _spread(by_last, last.motion.xyz_m2)
        + _spread(-by_first - by_last, middle.motion.xyz_m2)
    )
    return Values.of(np.degrees(angle), np.degrees(1.0) ** 2 * variance, first.there & middle.there & last.there)


def lean(hips: tuple[Joint, Joint], shoulders: tuple[Joint, Joint]) -> Values:
    """Of the line from mid-hip to mid-shoulder, forward from upright in the chair's x-z plane, degrees."""
    d = _middle(shoulders) - _middle(hips)
    square = d[:, 0] ** 2 + d[:, 2] ** 2
    way = np.stack([d[:, 2] / square, np.zeros(len(d)), -d[:, 0] / square], axis=1)
    spread = sum(_spread(way, joint.motion.xyz_m2) / 4 for joint in (*hips, *shoulders))
    there = np.logical_and.reduce([joint.there for joint in (*hips, *shoulders)])
    return Values.of(np.degrees(np.arctan2(d[:, 0], d[:, 2])), np.degrees(1.0) ** 2 * np.asarray(spread), there)


def tilt(left: Joint, right: Joint) -> Values:
    """Of the line of two markers above the horizontal, degrees: positive where the left one is higher."""
    return elevation(right, left)


def size_of(vectors: FloatArray, covariance: FloatArray, there: BoolArray) -> Values:
    """Of vectors (N, 3) with covariances (N, 3, 3)."""
    size = np.linalg.norm(vectors, axis=1)
    return Values.of(size, _spread(vectors / np.maximum(size, 1e-12)[:, None], covariance), there)


def _middle(pair: tuple[Joint, Joint]) -> FloatArray:
    out: FloatArray = (pair[0].motion.xyz_m + pair[1].motion.xyz_m) / 2
    return out


def _spread(way: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (N,) along directions (N, 3)."""
    out: FloatArray = np.einsum("ni,nij,nj->n", way, covariance, way)
    return out

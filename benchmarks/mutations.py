"""Plants faults in a copy of the code, one at a time, and says which of them the tests notice.

usage: python benchmarks/mutations.py [--only 17 18 gate ...] [--list]

A fault is an exact replacement of text in one file, with the tests that should notice it. The working tree is only
read: src and tests are copied to a temporary folder, always the same one, so that kernels are compiled once and found
again (`spheremcap.core.compiled` keeps them by the files that go into them). The tests are first run without any fault;
what fails then is left out. Ends with 1 when a fault's text is not found any more: it is stale and has to be renewed.

Faults up to 34 have the numbers of a reader's review of an early version, which 20 of its 35 faults escaped: these are
they, in their present form. From 101 on they are of chain, status, checks, session, optics, whereabouts, verifier and
follower, from 181 on of what edges, outline and filter make of what they know beforehand, from 211 on of shading,
softness, exposure and returns, from 231 on of size, what is hidden, what is elsewhere and pixels, from 301 on of merge,
from 401 on of output files and of how runs end, from 501 on of what comes from outside, from 601 on of what a person's
answers change, from 701 on of snap and of markers that nobody seeded, from 764 on of analysis, from 779 on of
seasons.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Fault:
    """`old` occurs just once in `file` (below src/spheremcap) and becomes `new`; `harmless` says why no test needs to
    notice it."""

    number: int
    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    harmless: str = ""


CHECKS, DECISIONS = "tests/verification/test_checks.py", "tests/test_decisions.py"
LEARNER, OUTLINE = "tests/detection/test_optics_learner.py", "tests/detection/test_outline.py"
STATUS, VERIFIER = "tests/core/test_status.py", "tests/verification/test_verifier.py"
FOLLOWER, WHEREABOUTS = "tests/tracking/test_follower.py", "tests/positioning/test_whereabouts.py"
EDGE, COLOUR = "tests/detection/test_edge.py", "tests/detection/test_colour.py"
APPEARANCE = "tests/detection/test_appearance.py"
SHADING, REACQUIRED = "tests/detection/test_shading.py", "tests/verification/test_reacquired.py"
OUTPUT, OUTPUTS = "tests/io/test_output.py", "tests/cli/test_outputs.py"
INTERRUPT, RECOVER = "tests/test_interrupt.py", "tests/io/test_recover.py"
KILLS = "tests/abuse/test_kills.py"
SIZE, MATCHING = "tests/positioning/test_size.py", "tests/verification/test_matching.py"
ASPECT = "tests/detection/test_aspect.py"
SEASON, SEASON_RUN = "tests/season/test_season_faults.py", "tests/season/test_season_run.py"
FINDING, MANIFEST = "tests/season/test_finding.py", "tests/season/test_manifest.py"
SPOTS, HUES = "tests/detection/test_spots.py", "tests/detection/test_hues.py"
PROPOSALS, FOUND = "tests/test_proposals.py", "tests/test_found.py"
SNAP, AUTO = "tests/test_snap.py", "tests/cli/test_auto.py"
SPHERE, KALMAN = "tests/positioning/test_sphere.py", "tests/positioning/test_kalman.py"
COURSE, INDEX = "tests/io/test_course.py", "tests/io/test_message_index.py"
STRETCH, RETRACK = "tests/test_stretch.py", "tests/corrections/test_retrack.py"
ATTENDED = "tests/corrections/test_attended.py"
SMOOTHER, CHAIR = "tests/analysis/test_smoother.py", "tests/analysis/test_chair_frame.py"
EVENTS, STROKES = "tests/analysis/test_events.py", "tests/analysis/test_hand_strokes.py"
ANALYSIS = "tests/analysis/test_job.py"

PLACEMENT = "tests/merging/test_placement.py"
TIMES = "tests/merging/test_times.py"
TABLES = "tests/merging/test_tables.py"
GPMF = "tests/merging/test_gpmf.py"
MERGE_CLI = "tests/cli/test_merge.py"
INPUTS, VERBS_INPUTS = "tests/abuse/test_hostile_files.py", "tests/cli/test_inputs.py"
HOSTILE, RECORDS = "tests/abuse/test_settings.py", "tests/io/test_mcap_records.py"
PICTURE, CALIBRATION, FOLDER = "tests/io/test_picture.py", "tests/io/test_calibration.py", "tests/io/test_folder.py"

FAULTS = (
    Fault(
        1, "points: no forward-backward check", "tracking/points.py",
        "if math.hypot(back_x - from_x, back_y - from_y) < max_round_trip:", "if not math.isnan(back_x):",
        ("tests/tracking/test_points.py",),
    ),
    Fault(
        2, "edge: curvature of blur dropped", "detection/edge.py",
        "inwards = sigma * sigma / (2.0 * r_px)", "inwards = 0.0", (EDGE,),
    ),
    Fault(
        4, "edge: sign of the streak's curvature", "detection/edge.py",
        "centre = np.float32(k + 0.5) + inwards[n]", "centre = np.float32(k + 0.5) - inwards[n]", (EDGE,),
    ),
    Fault(
        6, "colour: a clipped marker may not go pale", "detection/colour.py",
        "v1, s0 = 255.0, s0 * 0.7", "v1 = 255.0", ("tests/detection/test_colour.py",),
    ),
    Fault(
        8, "sphere: covariance not widened by residuals", "positioning/sphere.py",
        "wider = max(1.0, spread / max(1.0, effective - 3.0))", "wider = 1.0",
        ("tests/positioning/test_fit_covariance.py",),
    ),
    Fault(
        9, "sphere: hold kept to the end", "positioning/sphere.py",
        "if not math.isnan(hold) and number < rounds - 2:", "if not math.isnan(hold):", (SPHERE,),
    ),
    Fault(
        10, "kalman: smoother forgets widening", "positioning/kalman.py",
        "* widened[k + 1]", "", (KALMAN,),
    ),
    Fault(17, "checks: no gate", "verification/checks.py", '    "gate": _gate,\n', "", (CHECKS,)),
    Fault(18, "checks: the seed has no veto", "verification/checks.py", '    "seed": _seed,\n', "", (CHECKS,)),
    Fault(19, "checks: no colour", "verification/checks.py", '    "colour": _colour,\n', "", (CHECKS,)),
    Fault(
        20, "verifier: the seed's template not asked of one that was missed", "verification/verifier.py",
        "(self._template, self._seeded) if prior.missed else (self._template,)", "(self._template,)", (VERIFIER,),
    ),
    Fault(
        22, "follower: size from points ignored", "tracking/follower.py",
        "r_px += share * (grown - r_px)", "pass", (FOLLOWER,),
    ),
    Fault(
        23, "outline: a hidden part adds no uncertainty", "detection/outline.py",
        "hidden = _PART_HIDDEN * max(0.0, 0.8 - visible)", "hidden = 0.0", (OUTLINE,),
    ),
    Fault(
        24, "outline: rays counted as independent", "detection/outline.py",
        "return max(1.0, length_px * rays / (2.0 * math.pi * r_px))", "return 1.0", (OUTLINE,),
    ),
    Fault(
        25, "appearance: gain never follows", "detection/appearance.py",
        "self.gain += 0.5 * (self._gain_of(value) - self.gain)", "pass", (APPEARANCE,),
    ),
    Fault(
        26, "join: messages at the limit are left", "io/join.py",
        "message.log_time <= limit", "message.log_time < limit", ("tests/io/test_equal_times.py",),
    ),
    Fault(
        30, "video: a repeated stamp is put where the last one was", "io/video.py",
        "ns = last + max(1, length_ns // 2)", "ns = last", ("tests/io/test_equal_times.py",),
    ),
    Fault(
        31, "sync: drift of the reference taken for the sensor's", "merging/sync.py",
        "own_drift = fit.drift / (1 - fit.drift)", "own_drift = fit.drift", ("tests/merging/test_starts.py",),
    ),
    Fault(
        33, "dataset: a relative sensor does not start with the recording", "merging/placement.py",
        "return start_ns, (f\"{_time(start_ns)}", "return 0, (f\"{_time(start_ns)}", ("tests/merging/test_starts.py",),
    ),
    Fault(
        34, "outline: order of the covariance's sandwich", "detection/outline.py",
        "sd[i] += back[i, a] * covariance[a, b] * back[i, b]", "sd[i] += back[a, i] * covariance[a, b] * back[b, i]",
        (OUTLINE,),
    ),
    # -- chain
    Fault(
        101, "chain: velocity given when unknown", "chain.py",
        "where.track.now.velocity_cam_mps if where.track.moving_known else None", "where.track.now.velocity_cam_mps",
        (DECISIONS,),
    ),
    Fault(
        102, "look: the first candidate for the foremost", "core/look.py",
        "return min(looks, key=lambda look: (look.elsewhere, -look.vote_sum), default=None)",
        "return next(iter(looks), None)", (DECISIONS,),
    ),
    Fault(
        103, "chain: doubts do not count", "chain.py",
        "if look.claim is not None and not look.doubts:", "if look.claim is not None:", (DECISIONS,),
    ),
    Fault(
        104, "chain: the filter goes on with a marker found again", "chain.py",
        "claim, look.elsewhere, leapt)", "claim, False, leapt)", (DECISIONS,),
    ),
    Fault(
        105, "chain: the estimated circle as under a global shutter", "chain.py",
        "circle = self._expected.motion.seen_circle(circle)", "pass", (DECISIONS,),
    ),
    Fault(
        106, "chain: what was expected of an earlier frame stays", "chain.py",
        "        self._stamp_ns, self._expected = frame.stamp_ns, None\n        if self.status.tracked",
        "        self._stamp_ns = frame.stamp_ns\n        if self.status.tracked", (DECISIONS, LEARNER),
        harmless="what is found elsewhere neither teaches nor steers",
    ),
    Fault(
        107, "chain: misses never end", "chain.py",
        "stages, circle, self.misses = self._stages, claim.circle, 0", "stages, circle = self._stages, claim.circle",
        (DECISIONS,),
    ),
    Fault(
        108, "chain: a marker found again teaches as before it was lost", "chain.py",
        "if self._expected is not None and not look.elsewhere:", "if self._expected is not None:", (DECISIONS, LEARNER),
    ),
    # -- status
    Fault(
        111, "status: lost one miss later", "core/status.py",
        "sight.misses >= policy.lost_after", "sight.misses > policy.lost_after", (STATUS,),
    ),
    Fault(
        112, "status: lost at the bound of its time out of view", "core/status.py",
        "sight.away_s > policy.out_of_view_s", "sight.away_s >= policy.out_of_view_s", (STATUS,),
    ),
    Fault(
        113, "status: immediate at a doubtful one too", "core/status.py",
        "(policy.immediate and sight.rejected)", "policy.immediate", (STATUS,),
    ),
    # -- checks
    Fault(
        121, "checks: a lost marker's colours as any's", "verification/checks.py",
        "jury.lost_colour if case.lost else jury.seed_colour", "jury.seed_colour", (CHECKS,),
    ),
    Fault(
        122, "checks: a part only where almost nothing is seen", "verification/checks.py",
        "_LITTLE, _LEAST_IN_PICTURE = 0.6, 0.3", "_LITTLE, _LEAST_IN_PICTURE = 0.3, 0.3", (CHECKS,),
    ),
    Fault(
        124, "checks: what the border cuts off counts as hidden", "verification/checks.py",
        "_LITTLE * max(self.in_picture, _LEAST_IN_PICTURE)", "_LITTLE", (CHECKS,),
    ),
    Fault(
        123, "checks: a lost marker may leap", "verification/checks.py", "return not case.lost and case.visible",
        "return case.visible", (CHECKS,),
    ),
    # -- session
    Fault(
        131, "session: an estimated marker covers others", "session.py",
        "if e.circle is not None and e.status.measured", "if e.circle is not None", (DECISIONS,),
    ),
    Fault(
        132, "session: farthest first", "session.py",
        "lanes.sort(key=lambda item: item[1].chain.range_m)", "lanes.sort(key=lambda item: -item[1].chain.range_m)",
        (CHECKS,),
    ),
    Fault(
        133, "session: reasons of earlier gaps stay", "session.py",
        "                lane.against.clear()\n", "", (DECISIONS,),
    ),
    Fault(
        134, "session: a seed that never came is passed over", "session.py",
        "requests += [_unseen(frame, one) for one in missing]", "pass", (DECISIONS,),
    ),
    Fault(
        135, "session: each marker learns its own optics", "session.py",
        "metric=metric, optics=optics)", "metric=metric, exposure_s=exposure_s, readout_s=readout_s)", (LEARNER,),
    ),
    # -- optics
    Fault(
        141, "optics: the lean allowed for is forgotten", "detection/optics.py",
        "(stretch if k == 0 else shear) + lean[1 - k]", "(stretch if k == 0 else shear)", (LEARNER,),
    ),
    Fault(
        142, "optics: any gain is evidence of an exposure", "detection/optics.py",
        "and gain.mean() > 2 * gain.std() / len(looks) ** 0.5", "", (LEARNER,),
    ),
    Fault(
        143, "optics: any readout is believed", "detection/optics.py",
        "abs(found) > _BEYOND_DOUBT * sd and", "abs(found) > 0 and", (LEARNER,),
    ),
    Fault(
        144, "optics: part-hidden claims teach", "detection/optics.py",
        "        if claim.visible < _CLEAR:\n            return\n", "", (LEARNER,),
    ),
    Fault(
        145, "optics: a soft lens is as likely as a sharp one", "detection/optics.py",
        "looks = looks + _SOFT * np.log(self._softnesses)[:, None] ** 2", "pass", (LEARNER,),
    ),
    # -- whereabouts
    Fault(
        151, "whereabouts: looks outside the picture too", "positioning/whereabouts.py",
        "        if outside_px(frame, circle) > circle.r_px + 3 * spread_px:\n            return None\n", "",
        (WHEREABOUTS, DECISIONS),
    ),
    Fault(
        152, "whereabouts: a wild depth makes a wild circle", "positioning/whereabouts.py",
        "min(max(circle.r_px, self.circle.r_px / 2), self.circle.r_px * 2)", "circle.r_px", (WHEREABOUTS,),
    ),
    Fault(
        153, "whereabouts: one that left is sought where it would be", "positioning/whereabouts.py",
        "if left or centre is None or outside_px(frame, centre) > centre.r_px:", "if centre is None:", (WHEREABOUTS,),
    ),
    Fault(
        154, "whereabouts: the reach has no bound", "positioning/whereabouts.py",
        ", 3 * circle.r_px)\n        range_m", ", 300 * circle.r_px)\n        range_m",
        (WHEREABOUTS, DECISIONS),
    ),
    Fault(
        155, "whereabouts: the expected circle as under a global shutter", "positioning/whereabouts.py",
        "        circle = motion.seen_circle(circle)\n", "", (WHEREABOUTS,),
    ),
    # -- verifier and jury
    Fault(
        161, "verifier: votes too few are no reason", "verification/verifier.py",
        "if claim is not None and verdict is not Verdict.VERIFIED:", "if False:", (VERIFIER,),
    ),
    Fault(
        162, "verifier: the seed's template follows", "verification/verifier.py",
        "        self._template = make_template(patch, circle, self._matching)",
        "        self._seeded = self._template = make_template(patch, circle, self._matching)", (VERIFIER,),
    ),
    Fault(
        163, "verifier: the seed's template never asked", "verification/verifier.py",
        "claim.visible < 0.7 and not prior.lost", "claim.visible < 0.0", (VERIFIER,),
    ),
    # -- follower
    Fault(
        171, "follower: points start from a frame that was not verified", "tracking/follower.py",
        "        self._before = None\n", "        pass\n", (FOLLOWER,),
    ),
    Fault(
        172, "follower: the patch does not grow with the reach", "tracking/follower.py",
        "max(0.0, reach_px - 0.5 * circle.r_px)", "0.0", (FOLLOWER,),
    ),
    Fault(
        173, "follower: size from points unbounded", "tracking/follower.py",
        "min(max(self._before[1].r_px * ratio, 0.9 * r_px), 1.1 * r_px)", "self._before[1].r_px * ratio", (FOLLOWER,),
    ),
    # -- a distance known beforehand
    Fault(
        181, "sphere: the known distance left out of the last rounds", "positioning/sphere.py",
        "        deviation = known_sd_m\n", "        deviation = known_sd_m if number < rounds - 2 else math.inf\n",
        (SPHERE, OUTLINE),
    ),
    Fault(
        182, "sphere: what the rays say alone has the distance in it", "positioning/sphere.py",
        "alone[i] = centre[i] - covariance[i, 0] * gx - covariance[i, 1] * gy - covariance[i, 2] * gz",
        "alone[i] = centre[i] - step[i]", (OUTLINE,),
    ),
    Fault(
        183, "outline: the likeliest place no surer than the outline", "detection/outline.py",
        "    if finite(known_sd):\n        _condition(both, centre / length, known_sd * known_m)\n", "", (OUTLINE,),
    ),
    Fault(
        184, "whereabouts: the filter takes its own distance in", "positioning/whereabouts.py",
        "self.track.update(place, covariance)", "self.track.update(claim.xyz_cam_m, claim.covariance_m2)",
        (WHEREABOUTS,),
    ),
    Fault(
        185, "whereabouts: the filter starts with the likeliest place", "positioning/whereabouts.py",
        "self.track.start(stamp_ns, place, covariance, leap_mps)",
        "self.track.start(stamp_ns, claim.xyz_cam_m, claim.covariance_m2, leap_mps)", (WHEREABOUTS,),
    ),
    Fault(
        186, "whereabouts: the likeliest place at the gate", "positioning/whereabouts.py",
        "self.track.surprise(*claim.outline_alone)", "self.track.surprise(claim.xyz_cam_m, claim.covariance_m2)",
        (WHEREABOUTS,),
    ),
    # -- edges
    Fault(
        191, "edge: what neighbouring chroma shares counts the more", "detection/edge.py",
        "shared = _SHARED if grid[0] > 1.0 else 1.0", "shared = 1.0 / _SHARED if grid[0] > 1.0 else 1.0", (EDGE,),
    ),
    Fault(
        192, "edge: a step of any height", "detection/edge.py",
        "(sse[k, n] + expected[k, n] * held / both * off * off)", "sse[k, n]", (EDGE,),
    ),
    Fault(
        193, "edge: chroma says nothing", "detection/edge.py",
        "shapes[1], varies[1], params[1], shared, cost,", "shapes[1], varies[1], params[1], 1e9, cost,", (EDGE,),
    ),
    Fault(
        194, "edge: brightness says nothing", "detection/edge.py",
        "shapes[0], varies[0], params[1], 1.0, cost,", "shapes[0], varies[0], params[1], 1e9, cost,", (EDGE,),
    ),
    Fault(
        195, "edge: shading is carried on without a doubt", "detection/edge.py",
        "carried = _CARRIED * (2.0 * depth[n] / r_px) ** 2", "carried = 0.0", (EDGE,),
    ),
    Fault(
        196, "outline: limits not loosened for edges", "detection/outline.py",
        "_NO_LIMITS if limits is None else loosened(limits)", "_NO_LIMITS if limits is None else limits", (OUTLINE,),
    ),
    Fault(
        197, "colour: hue loosened twofold", "detection/colour.py", "1.5 * hue_half", "2.0 * hue_half", (COLOUR,),
    ),
    # -- filter
    Fault(
        201, "kalman: a push moves place and velocity apart", "positioning/kalman.py",
        "[[abs(dt_s) ** 3 / 3, dt_s * abs(dt_s) / 2], [dt_s * abs(dt_s) / 2, abs(dt_s)]]",
        "[[abs(dt_s) ** 3 / 3, -dt_s * abs(dt_s) / 2], [-dt_s * abs(dt_s) / 2, abs(dt_s)]]", (KALMAN,),
    ),
    Fault(
        202, "kalman: so it does in the smoother", "positioning/kalman.py",
        "noise[i, 3 + i] = noise[3 + i, i] = power * dt * dt / 2.0",
        "noise[i, 3 + i] = noise[3 + i, i] = -power * dt * dt / 2.0", (KALMAN,),
    ),
    Fault(
        203, "kalman: one acceleration over each step", "positioning/kalman.py",
        "[[abs(dt_s) ** 3 / 3, dt_s * abs(dt_s) / 2]", "[[abs(dt_s) ** 3 / 4, dt_s * abs(dt_s) / 2]", (KALMAN,),
    ),
    Fault(
        204, "kalman: an acceleration that does not forget itself", "positioning/kalman.py",
        "if ratio < 1e-3:", "if ratio < 1e9:", (KALMAN,),
    ),
    Fault(
        205, "kalman: as forgetful over short steps as over long ones", "positioning/kalman.py",
        "(ratio - 1.0 + math.exp(-ratio))", "ratio", (KALMAN,),
    ),
    # -- shading, softness and exposure, returns
    Fault(
        211, "shading: the fall towards the limb is not carried on", "detection/shading.py",
        "slope *= _CARRIED_ON / max(squares, 1e-9)", "slope = 0.0", (SHADING,),
    ),
    Fault(
        212, "shading: hidden rays teach it too", "detection/shading.py",
        "        if shown[n]:\n            looks[n]", "        if True:\n            looks[n]", (SHADING,),
    ),
    Fault(
        213, "shading: in the light's own units", "detection/shading.py",
        "(light[k, n] / level - mean[k, n])", "(light[k, n] - mean[k, n])", (SHADING,),
    ),
    Fault(
        214, "shading: read up to the edge itself", "detection/outline.py",
        "return rings, shown, 1 - (blur_px", "return rings, shown, 1 - 0 * (blur_px", (SHADING,),
    ),
    Fault(
        215, "edge: learnt shading counts alone", "detection/edge.py",
        "math.sqrt(limb[k, n] * min(max(value, np.float32(0.1)), np.float32(4.0)))",
        "min(max(value, np.float32(0.1)), np.float32(4.0))", (EDGE,),
    ),
    Fault(
        216, "misfits: each exposure has its own samples' margin", "detection/edge.py",
        "direction, share * across, share * along, r_px,", "direction, across, along, r_px,", (EDGE, LEARNER),
    ),
    Fault(
        217, "misfits: brightness alone", "detection/edge.py",
        "math.log(luma[n] + chroma[n] + 1e-7)", "math.log(luma[n] + 1e-7)", (EDGE,),
    ),
    Fault(
        218, "outline: half an outline is as good to the filter as a whole one", "detection/outline.py",
        "more = (_ALIKE - 1.0) * (found_r * hidden) ** 2", "more = 0.0", (OUTLINE,),
    ),
    Fault(
        219, "optics: a blur that no softness needs is believed", "detection/optics.py",
        "if not sure or plain[i, j] >= plain[:, 0].min():", "if not sure:", (LEARNER,),
    ),
    Fault(
        220, "optics: streaks beyond bounds teach an exposure", "detection/optics.py",
        "if due and math.hypot(*bounded_blur(way_px, claim.circle)) >= math.hypot(*way_px):", "if due:", (LEARNER,),
    ),
    Fault(
        221, "reacquired: believed at once whatever its size", "verification/reacquired.py",
        "enough = _SURE_VOTES if _alike(circle, last) else _CLEAR_VOTES", "enough = _SURE_VOTES", (REACQUIRED,),
    ),
    Fault(
        222, "reacquired: frames need not follow one another", "verification/reacquired.py",
        "        if found is None or found.claim is None:\n            self._circle, self._frames = None, 0\n",
        "        if found is None or found.claim is None:\n", (REACQUIRED,),
    ),
    Fault(
        223, "chain: a lost marker is never asked to be confirmed", "chain.py",
        "found = self._stages.reacquired.confirmed(elsewhere)", "found = elsewhere",
        (DECISIONS,),
    ),
    Fault(
        224, "status: lost by the count alone", "core/status.py",
        " and sight.unsure_radii >= policy.lost_radii", "", (STATUS,),
    ),
    Fault(
        225, "whereabouts: one that left is sought everywhere", "positioning/whereabouts.py",
        "region = _near_half(frame, self.circle, region)", "pass", (WHEREABOUTS,),
    ),
    Fault(
        226, "colour: hues of black pixels count", "detection/colour.py",
        "hue_off[chroma < _NO_HUE * np.median(chroma)] = 0", "pass", (COLOUR,),
    ),
    # -- size, what is hidden, what is elsewhere, pixels that are not square
    Fault(
        231, "size: rates do not forget themselves", "positioning/size.py",
        "kept = math.exp(-lapse)", "kept = 1.0 - 1e-9 * lapse", (SIZE,),
    ),
    Fault(
        232, "size: all models weigh the same", "positioning/size.py",
        "weight = math.exp(scores[k] - best)", "weight = 1.0 + 0.0 * best", (SIZE,),
    ),
    Fault(
        233, "size: evidence does not fade", "positioning/size.py",
        "        scores[k] *= 1.0 - 1.0 / _MEMORY\n", "", (SIZE,),
    ),
    Fault(
        234, "size: a start forgets which model holds", "positioning/size.py",
        "        self._models[:, 4] = _RATES**2\n",
        "        self._models[:, 4] = _RATES**2\n        self._scores[:] = 0\n",
        (SIZE,),
    ),
    Fault(
        235, "whereabouts: size is not asked", "positioning/whereabouts.py",
        "if sized_sd < range_sd:", "if False:", (WHEREABOUTS,),
    ),
    Fault(
        236, "whereabouts: size moves the distance and not the circle", "positioning/whereabouts.py",
        "            circle = circle.resized(circle.r_px * range_m / sized_m)\n", "", (WHEREABOUTS,),
    ),
    Fault(
        237, "whereabouts: away for long it is sought as it would be", "positioning/whereabouts.py",
        "/ range_m if range_sd < _SIZE_OPEN else 1.0", "/ range_m", (WHEREABOUTS,),
    ),
    Fault(
        238, "whereabouts: a distance that is not known excuses what is far aside", "positioning/whereabouts.py",
        "3 * math.sqrt(max(spread, 0.0))", "3 * math.sqrt(deep)", (WHEREABOUTS,),
    ),
    Fault(
        239, "whereabouts: steering moves the distance", "positioning/whereabouts.py",
        "self.track.update(ray * range_m, spread", "self.track.update(place, spread", (WHEREABOUTS,),
    ),
    Fault(
        240, "whereabouts: steering passes for being seen", "positioning/whereabouts.py",
        "        range_m = float(np.linalg.norm(self.track.now.xyz_cam_m))\n        place = sphere_of_circle(followed",
        "        self.circle = followed\n        range_m = float(np.linalg.norm(self.track.now.xyz_cam_m))\n"
        "        place = sphere_of_circle(followed", (WHEREABOUTS,),
    ),
    Fault(
        241, "matching: the gap is on the other side", "verification/matching.py",
        "return Gap(float(angles[widest]) + half, half)", "return Gap(float(angles[widest]) - half, half)", (MATCHING,),
    ),
    Fault(
        242, "matching: a small gap hides too", "verification/matching.py",
        "    if gap.half <= _QUARTER:\n        return template\n", "", (MATCHING,),
    ),
    Fault(
        243, "matching: what lies beyond the chord is kept instead", "verification/matching.py",
        "left = template.r_px * math.cos(gap.half) - down", "left = -template.r_px * math.cos(gap.half) - down",
        (MATCHING,),
    ),
    Fault(
        244, "verifier: what hides a part votes", "verification/verifier.py",
        "match(less_hidden(template, gap), patch", "match(template, patch", (VERIFIER,),
    ),
    Fault(
        245, "verifier: any size may be part-hidden", "verification/verifier.py",
        " or abs(math.log(claim.circle.r_px / prior.expected.r_px)) > _AS_LARGE", "", (VERIFIER,),
    ),
    Fault(246, "checks: no likeness", "verification/checks.py", '    "likeness": _likeness,\n', "", (CHECKS,)),
    Fault(
        247, "checks: what has the marker's colours may be hidden", "verification/checks.py",
        "if not case.as_expected and case.colour[0] > case.shown + _NOT_HIDDEN:", "if False:", (CHECKS,),
    ),
    Fault(
        248, "checks: a quarter of an outline anywhere", "verification/checks.py",
        "    if on_its_way or case.as_expected:\n", "    if True:\n", (CHECKS,),
    ),
    Fault(
        249, "checks: a seed without an outline asks for none", "verification/checks.py",
        "if case.seeded_visible == 0:", "if False:", (CHECKS,),
    ),
    Fault(
        250, "chain: a doubted marker is not looked for elsewhere", "chain.py",
        "return (look, *(far for far in self._search(frame) if _news(far.claim, expected)))", "return (look,)",
        (DECISIONS, CHECKS),
    ),
    Fault(
        251, "chain: another reading of what hides it is news", "chain.py",
        "return claim.visible > _CLEAR or claim.circle.distance(expected.circle) > expected.circle.r_px", "return True",
        (DECISIONS, CHECKS),
    ),
    Fault(
        252, "chain: KCF does not steer", "chain.py",
        "                self.whereabouts.steer(self._expected.motion.still_circle(followed))\n",
        "                pass\n",
        (CHECKS,),
    ),
    Fault(
        253, "acquire: a blob is always the whole", "detection/acquire.py",
        "            if dx + dy > _SHIFTED * r_px:\n", "            if False:\n", ("tests/detection/test_acquire.py",),
    ),
    Fault(
        254, "aspect: any better outline is an ellipse", "detection/aspect.py",
        "    if square is not None and square.visible > _HARDLY:\n        return 1.0\n", "", (ASPECT,),
    ),
    Fault(
        255, "aspect: half an ellipse is enough", "detection/aspect.py",
        "    if found is None or found.visible < _NEARLY:\n        return 1.0\n", "", (ASPECT,),
    ),
    Fault(
        256, "aspect: no closer look", "detection/aspect.py",
        "return float(min(best * _CLOSE, key=lambda aspect: _residual_px(_seen(frame, circle, aspect))))",
        "return float(best)", (ASPECT,),
    ),
    Fault(
        257, "api: the stream's word is doubted", "api.py",
        "source.pixel_aspect != 1 or not a_video", "not a_video", ("tests/test_api.py",),
    ),
    Fault(
        258, "chain: a seed on nothing is a seed", "chain.py",
        "if measured.visible < _CLEARLY_SEEDED:", "if False:", (DECISIONS,),
    ),
    Fault(
        259, "whereabouts: a leap has no speed", "positioning/whereabouts.py",
        "if leapt and since_s > 0 else None", "if False else None", (DECISIONS, WHEREABOUTS),
    ),
    Fault(
        260, "shading: every frame is looked at", "detection/shading.py",
        "abs(stamp_ns - self._looked_ns) >= _EVERY_NS", "True", (SHADING,),
    ),
    Fault(
        261, "shading: backwards nothing is looked at", "detection/shading.py",
        "abs(stamp_ns - self._looked_ns) >= _EVERY_NS", "stamp_ns - self._looked_ns >= _EVERY_NS", (SHADING,),
    ),
    Fault(
        262, "detector: no other exposure is tried", "detection/detector.py",
        "if claim is None or claim.visible <= 0.5:", "if False:", (DECISIONS,),
    ),
    Fault(
        264, "edge: every lens is the first one", "detection/edge.py",
        "_through_lens(v_first, fine, limb, r_px, sigma * softnesses[i], light, cover)",
        "_through_lens(v_first, fine, limb, r_px, sigma * softnesses[0], light, cover)", (EDGE, LEARNER),
    ),
    Fault(
        265, "edge: the lens does not draw in what a marker covers", "detection/edge.py",
        "step[k, 0] = min(max(0.5 - (v_first + k * fine + inwards) / fine, 0.0), 1.0)",
        "step[k, 0] = min(max(0.5 - (v_first + k * fine) / fine, 0.0), 1.0)", (EDGE,),
    ),
    Fault(
        266, "sampling: a row of places ends a column early", "core/sampling.py",
        "h, n = min(j + 1, columns - 1), min(i + 1, rows - 1)\n        top_left",
        "h, n = min(j + 1, columns - 2), min(i + 1, rows - 1)\n        top_left", (EDGE, "tests/core/test_sampling.py"),
    ),
    # -- merge: tables, times, placements
    Fault(
        301, "dataset: a track is not read through its recording's clock", "merging/dataset.py",
        "stamp_ns = own.clock.all(track.stamp_ns.tolist())", "stamp_ns = track.stamp_ns", (PLACEMENT,),
    ),
    Fault(
        302, "dataset: the start is the recording's raw one", "merging/dataset.py",
        "starts = [(own.clock(own.first_ns), own.source.label)", "starts = [(own.first_ns, own.source.label)",
        (PLACEMENT,),
    ),
    Fault(
        303, "dataset: each file of a device has its own anchor", "merging/dataset.py",
        "place = Placement(\n", "clock = replace(clock, anchor_ns=first_ns)\n                place = Placement(\n",
        (PLACEMENT,),
    ),
    Fault(
        304, "placement: the first sample starts with the recording", "merging/placement.py",
        "return start_ns, (f\"{_time(start_ns)}", "return start_ns - first_ns, (f\"{_time(start_ns)}", (PLACEMENT,),
    ),
    Fault(
        305, "placement: a time of day is of the recording's own day", "merging/placement.py",
        "days = range(start_ns // DAY_NS - 1, start_ns // DAY_NS + 2)", "days = [start_ns // DAY_NS]", (PLACEMENT,),
    ),
    Fault(
        306, "placement: inputs that only follow each other overlap", "merging/placement.py",
        "start > until", "start > until + 60 * NS_PER_S", (PLACEMENT,),
    ),
    Fault(
        307, "placement: the end of a group is that of its last input", "merging/placement.py",
        "until = max(until, end)", "until = end", (PLACEMENT,),
    ),
    Fault(
        308, "placement: the remedy forgets the offset that was given", "merging/placement.py",
        "inside[0] - start + place.given_ns", "inside[0] - start", (PLACEMENT,),
    ),
    Fault(
        309, "log: a restart passes for late samples", "merging/log.py",
        "if again or switches > _SWITCHES * len(falls) + 2 * _SWITCHES:", "if again:", (PLACEMENT,),
    ),
    Fault(
        310, "log: every fall is a restart", "merging/log.py",
        "if again or switches > _SWITCHES * len(falls) + 2 * _SWITCHES:", "if True:", (PLACEMENT,),
    ),
    Fault(
        311, "log: repeated times are not counted", "merging/log.py",
        "repeated = int(np.count_nonzero(steps == 0))", "repeated = 0", (PLACEMENT,),
    ),
    Fault(
        312, "log: gaps are not said", "merging/log.py", "steps > least", "steps > 100 * least", (PLACEMENT,),
    ),
    Fault(
        313, "times: the month always first", "merging/times.py",
        "        if month_first:\n", "        if True:\n", (TIMES,),
    ),
    Fault(
        314, "times: a zone is added instead of taken off", "merging/times.py",
        "_clock_ns(match, 5) - _zone_ns(match[11])", "_clock_ns(match, 5) + _zone_ns(match[11])", (TIMES,),
    ),
    Fault(
        315, "times: no day after midnight", "merging/times.py",
        "return out + midnights * DAY_NS, Timing(how, \"midnight\"", "return out, Timing(how, \"midnight\"", (TIMES,),
    ),
    Fault(
        316, "times: twelve at night is noon", "merging/times.py",
        "hour = hour % 12 + (12 if", "hour = hour + (12 if hour < 12 and", (TIMES,),
    ),
    Fault(
        317, "times: a number without end is computed", "merging/times.py", " or number.adjusted() > 20", "", (TIMES,),
    ),
    Fault(
        318, "tables: UTF-16 without a mark is UTF-8", "merging/tables.py",
        "return \"utf-16-be\" if zeros[0] else \"utf-16-le\"", "return \"utf-8-sig\"", (TABLES,),
    ),
    Fault(
        319, "tables: bytes that are not UTF-8 are lost", "merging/tables.py",
        ".decode(\"cp1252\", \"replace\"), error.end", ".decode(\"ascii\", \"replace\"), error.end", (TABLES,),
    ),
    Fault(
        320, "tables: a short last line is read as far as it goes", "merging/tables.py",
        " or (not ended and len(row) < table.width)", "", (TABLES,),
    ),
    Fault(
        321, "tables: a fault in a whole last line passes for a cut", "merging/tables.py",
        "if not values or (cut.ended and len(cut.cells) > last):", "if not values:", (TABLES,),
    ),
    Fault(
        322, "tables: lines without a time are not counted", "merging/tables.py",
        "                untimed.append(at)\n", "", (TABLES,),
    ),
    Fault(
        323, "tables: a gap in the first row makes it a header", "merging/tables.py",
        "        first -= 1\n", "        break\n", (TABLES,),
    ),
    Fault(
        324, "tables: infinity is a value", "merging/columns.py",
        "np.where(np.isinf(scaled), np.nan, scaled)", "scaled", (TABLES,),
    ),
    Fault(
        325, "columns: names that fold to one replace each other", "merging/columns.py",
        "own = _free(wanted, columns)", "own = wanted", (TABLES,),
    ),
    Fault(
        326, "columns: speeds stay in their own unit", "merging/columns.py",
        "return factor(\"speed\", unit, where) if axis.endswith(\"_mps\") and unit else 1.0", "return 1.0", (TABLES,),
    ),
    Fault(
        327, "mapping: the time's column is not guessed", "merging/mapping.py",
        "        time = _first_rising(table)\n", "        pass\n", (MERGE_CLI,),
    ),
    Fault(
        328, "gopro: a scale of zero divides", "merging/makers/gopro.py", " and bool(np.all(scale != 0))", "", (GPMF,),
    ),
    Fault(
        329, "gopro: nesting without end", "merging/makers/gopro.py",
        "elif kind == \"\\0\" and depth < _DEEPEST:", "elif kind == \"\\0\":", (GPMF,),
    ),
    Fault(
        330, "records: fewer messages than stated is no loss", "io/mcap_records.py",
        "        self._compare(given, [i for i, c in", "        self._compare({}, [] and [i for i, c in",
        (MERGE_CLI, "tests/merging/test_mutants.py"),
    ),
    Fault(
        331, "sync: damage is not said by the exit code", "cli/sync.py", "raise typer.Exit(3)", "pass", (MERGE_CLI,),
    ),
    Fault(
        332, "merge: what sensor files lost is no exit code", "merging/dataset.py",
        "return self.sensors_lost + self.merged.lost", "return self.merged.lost", (MERGE_CLI,),
    ),
    Fault(
        333, "dataset: doubts are not asked about", "merging/dataset.py",
        "if doubts and not force and not stop():", "if False:", (MERGE_CLI,),
    ),
    Fault(
        334, "samples: placements are not written", "merging/samples.py",
        "facts = dict(self.facts) or {", "facts = {", (PLACEMENT,),
    ),
    Fault(
        335, "sync: a sensor that has run for long has no guess", "merging/dataset.py",
        "if start_ns is not None and zero == \"start\" and (clock(first) > max(ends) or clock(last) < start_ns):",
        "if False:", (PLACEMENT,),
    ),
    Fault(
        336, "dataset: a sensor may share a recording's topic", "merging/dataset.py",
        "if (there := topics.get(f\"/sensors/{name}\")) is not None:", "if (there := topics.get(name)) is not None:",
        (PLACEMENT,),
    ),
    Fault(
        337, "dataset: what is out of range is found while writing", "merging/dataset.py",
        "                in_range(stamp_ns, place.input)\n", "                pass\n", (PLACEMENT,),
    ),
    Fault(
        338, "dataset: a drift that sync replaces is said", "merging/dataset.py",
        "Fraction(0) if synced else source.drift)", "source.drift)", (PLACEMENT,),
    ),
    Fault(
        339, "dataset: any sensor of a device may synchronise it", "merging/dataset.py",
        "            except SyncError as error:\n", "            except ZeroDivisionError as error:\n", (PLACEMENT,),
    ),
    Fault(
        340, "mapping: a unit that the header gives is not taken over", "merging/mapping.py",
        "\"unit\": unit if plain(unit) in UNITS[quantity] else \"\"", "\"unit\": \"\"",
        ("tests/merging/test_mapping.py",),
    ),
    Fault(
        341, "columns: what a maker's layout leaves out is not said", "merging/columns.py",
        "return replace(log, notes=(*log.notes, *_left_out(table, used)))", "return log",
        ("tests/merging/test_sensors.py",),
    ),
    Fault(
        342, "columns: a date without its time of day", "merging/columns.py",
        "return [found[0]] if clock is None else [found[0], clock]", "return [found[0]]", (TABLES,),
    ),
    Fault(
        343, "columns: decimal commas in dates become points", "merging/columns.py",
        "comma = table.decimal_comma and unit != \"date\"", "comma = table.decimal_comma", (TABLES,),
    ),
    Fault(
        344, "tables: two times are a row of data", "merging/tables.py", " and numeric + absent > 0", "", (TABLES,),
    ),
    Fault(
        345, "clock: an offset of ages", "merging/clock.py", "if abs(value) >= 1 << 63:", "if False:",
        ("tests/merging/test_clock.py",),
    ),
    # -- output files, and how runs end
    Fault(
        401, "outputs: an input is known by its name", "io/output.py",
        "if found is not None and os.path.samestat(found, known):",
        "if target == given:", (OUTPUT,),
    ),
    Fault(
        402, "outputs: an input folder is known by its name", "io/output.py",
        "if any(os.path.samestat(place, known) for place in places):",
        "if given in target.parents:", (OUTPUT,),
    ),
    Fault(
        403, "outputs: links in an input folder are not followed", "io/output.py",
        "for file in given.rglob(\"*\"):  # a link",
        "for file in ():  # a link", (OUTPUT,),
    ),
    Fault(
        404, "outputs: the link is written, not what it points to", "io/output.py",
        "target = Path(os.path.realpath(path))\n        found",
        "target = path.absolute()\n        found", (OUTPUT,),
    ),
    Fault(
        405, "outputs: a device is replaced", "io/output.py",
        "if found is not None and not stat.S_ISREG(found.st_mode):",
        "if False:", (OUTPUT,),
    ),
    Fault(
        406, "outputs: no lock", "io/output.py",
        "fcntl.flock(lock, fcntl.LOCK_EX)",
        "pass", (OUTPUT,),
    ),
    Fault(
        407, "outputs: the lock is let go before the file has its name", "io/output.py",
        "            part.keep = True\n            _publish(",
        "            part.keep = True\n            fcntl.flock(lock, 8)\n            _publish(", (OUTPUT,),
    ),
    Fault(
        408, "outputs: of runs that start together one takes the other's name", "io/output.py",
        "_rename_to_new(hidden, place)", "os.rename(hidden, place)", (OUTPUT,),
    ),
    Fault(
        409, "outputs: only the first part is looked at for its lock", "io/output.py",
        "(\\.\\d+)?\\.part\"",
        "\\.part\"", (OUTPUT,),
    ),
    Fault(
        410, "outputs: a part that was left is written over", "io/output.py",
        "                _refuse_in_use(place, target)\n                number += 1\n                continue",
        "                _refuse_in_use(place, target)\n                place.unlink()", (OUTPUT,),
    ),
    Fault(
        411, "outputs: a part that was left is not named", "io/output.py",
        "    return tuple(notes)",
        "    return ()", (OUTPUT,),
    ),
    Fault(
        412, "outputs: what appears meanwhile is replaced", "io/output.py",
        "        if overwrite:\n            part.path.replace",
        "        if True:\n            part.path.replace", (OUTPUT,),
    ),
    Fault(
        413, "outputs: ... also where files have one name only", "io/output.py",
        "        if os.path.lexists(new):\n            raise FileExistsError",
        "        if False:\n            raise FileExistsError", (OUTPUT,),
    ),
    Fault(
        414, "outputs: the file gets its name although something was raised", "io/output.py",
        "        part.complete = False\n        raise\n    else:",
        "        _publish(part, overwrite)\n        raise\n    else:", (OUTPUT,),
    ),
    Fault(
        415, "outputs: a part without messages stays", "io/output.py",
        "        if not part.keep:\n            with",
        "        if False:\n            with", (OUTPUT,),
    ),
    Fault(
        416, "outputs: a usage error leaves a part", "io/output.py",
        "if not isinstance(error, UsageError):",
        "if True:", (OUTPUT,),
    ),
    Fault(
        417, "outputs: an error does not say where the rest is", "io/output.py",
        "if part.keep and isinstance(error, SpheremcapError | Interrupted):",
        "if False:", (OUTPUT,),
    ),
    Fault(
        418, "outputs: no chunk ends at a half second", "io/output.py",
        "            self.flush()  # type: ignore[no-untyped-call]\n",
        "", (OUTPUT,),
    ),
    Fault(
        419, "outputs: a chunk ends with each step back", "io/output.py",
        "if halves > self._flushed_halves:",
        "if halves != self._flushed_halves:", (OUTPUT,),
    ),
    Fault(
        420, "outputs: a write that failed leaves its first bytes", "io/output.py",
        "            self._file.truncate()\n",
        "", (OUTPUT,),
    ),
    Fault(
        421, "outputs: after a write that failed others go on", "io/output.py",
        "            self.takes_more = False\n            self._file",
        "            self._file", (OUTPUT,),
    ),
    Fault(
        422, "outputs: the end of the data is written twice", "io/output.py",
        "if file.takes_more and not file.data_ended:",
        "if file.takes_more:", (OUTPUT,),
    ),
    Fault(
        423, "outputs: a file that is full is not sealed", "io/output.py",
        "    with suppress(OutputError):\n        file.seal()",
        "    pass", (OUTPUT,),
    ),
    Fault(
        424, "outputs: a signal during the seal takes the part away", "io/output.py",
        "                part.keep = file.has_messages\n                _end",
        "                _end", (OUTPUT,),
    ),
    Fault(
        425, "outputs: SIGHUP is forgotten", "interrupt.py",
        "(\"SIGINT\", \"SIGTERM\", \"SIGHUP\")",
        "(\"SIGINT\", \"SIGTERM\")", (INTERRUPT,),
    ),
    Fault(
        426, "outputs: nohup does not help", "interrupt.py",
        "if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:",
        "if True:", (INTERRUPT,),
    ),
    Fault(
        427, "outputs: an import may swallow Ctrl-C", "__main__.py",
        "    leave_at_once()\n",
        "", (OUTPUTS,),
    ),
    Fault(
        428, "outputs: a table is left half written when a signal comes", "cli/export.py",
        "    loaded()\n",
        "", (KILLS,),
    ),
    Fault(
        429, "outputs: settings and seeds are no inputs", "cli/track.py",
        "inputs=[*inputs, *([asked.path] if asked else [])],",
        "inputs=[],", (OUTPUTS,),
    ),
    Fault(
        430, "outputs: a calibration is no input", "api.py",
        "[folder / settings.camera.file] if settings.camera.file is not None else []",
        "[]", (OUTPUTS,),
    ),
    Fault(
        431, "outputs: a mapping is no input", "cli/merge.py",
        "inputs=[Path(text.partition(\"=\")[2] or text) for text in mapping or []],",
        "inputs=[],", (OUTPUTS,),
    ),
    Fault(
        432, "outputs: merge checks only recordings", "merging/dataset.py",
        "given_files = [*(source.path for source in sources), *inputs]",
        "given_files = [*inputs]", (OUTPUTS,),
    ),
    Fault(
        433, "outputs: truth is no input", "evaluation/hough_tuning.py",
        "inputs = [path for path in (video, truth, settings) if path is not None]",
        "inputs = [video]", (OUTPUTS,),
    ),
    Fault(
        434, "outputs: synth replaces its tables", "synth/session.py",
        "files.enter_context(whole_file(path, overwrite=overwrite))",
        "files.enter_context(whole_file(path, overwrite=overwrite or path is not video))", (OUTPUTS,),
    ),
    Fault(
        435, "outputs: recover reads what is being written", "io/recover.py",
        "    if in_use(path):",
        "    if False:", (RECOVER,),
    ),
    Fault(
        436, "outputs: recover does not say that the run was cut off", "io/recover.py",
        "if any(\"no footer\" in loss.what for loss in records.lost):",
        "if False:", (RECOVER,),
    ),
    # -- what comes from outside
    Fault(
        501, "chunk: a zstd frame is believed about its size", "io/mcap_records.py",
        "elif size == limit and zstandard.frame_content_size(stored) in (-1, size):", "elif size == limit:", (INPUTS,),
    ),
    Fault(
        502, "chunk: lz4 is not held to the stated size", "io/mcap_records.py",
        "data = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1)",
        "data = lz4.frame.LZ4FrameDecompressor().decompress(stored)", (INPUTS,),
    ),
    Fault(
        503, "chunk: the largest there may be is not looked at", "io/mcap_records.py",
        "limit = min(size, LARGEST_CHUNK_BYTES)", "limit = size", (INPUTS,),
    ),
    Fault(
        504, "statistics: fewer messages pass", "io/mcap_records.py",
        "if stated != given and id_ not in self._compared:", "if stated < given and id_ not in self._compared:",
        (VERBS_INPUTS,),
    ),
    Fault(
        505, "statistics: metadata records are not counted", "io/mcap_records.py",
        '("metadata records", stated.metadata_count, Opcode.METADATA),', "", (RECORDS,),
    ),
    Fault(
        506, "data section: its checksum is not compared", "io/mcap_records.py",
        "for at in range(0, end if stated else 0, 1 << 20):", "for at in range(0, 0, 1 << 20):", (RECORDS,),
    ),
    Fault(
        507, "chunks: each reading opens its own", "io/mcap_records.py",
        "data = self._opened.pop(piece.offset, None)", "data = None", (RECORDS,),
    ),
    Fault(
        508, "still: the size is not looked at", "io/picture.py",
        "    check_size(*size)\n    try:", "    try:", (INPUTS,),
    ),
    Fault(
        509, "jpeg: a look-alike inside a comment is its size", "io/picture.py",
        'at += (1 if kind == 0xFF else 2) if alone else 2 + int.from_bytes(data[at + 2 : at + 4], "big")', "at += 2",
        (PICTURE,),
    ),
    Fault(
        510, "jpeg: one that is cut is whole", "io/picture.py",
        'return is_jpeg(data) and data.find(b"\\xff\\xd9", start) < 0', "return False", (PICTURE,),
    ),
    Fault(
        511, "picture: untagged is BT.601 at every size", "io/picture.py",
        '"bt709" if max(first.height, self.height_px) >= 720 else "bt601"', '"bt601"', (PICTURE,),
    ),
    Fault(
        512, "picture: recordings say full range for all", "io/mcap_images.py",
        "self._of_video = self._of_video or DecodedPictures(picture)",
        "picture.color_range = 2; self._of_video = self._of_video or DecodedPictures(picture)", (PICTURE,),
    ),
    Fault(
        513, "Annex B: an empty unit is one", "io/annex_b.py",
        "        if unit:\n", "        if end > start:\n", ("tests/io/test_annex_b.py",),
    ),
    Fault(
        514, "Annex B: what comes before a slice does not matter", "io/annex_b.py",
        "if kind == 1 if format_ == \"h264\" else kind < 16:", "if kind == 1 if format_ == \"h264\" else kind < 1:",
        ("tests/io/test_annex_b.py",),
    ),
    Fault(
        515, "calibration: an unknown model is plumb_bob", "io/calibration.py",
        "    if name not in _MODELS:", "    if name not in _MODELS and not d:", (CALIBRATION,),
    ),
    Fault(
        516, "calibration: the uncertainty is lost on the way back", "io/recording.py",
        'camera_of(fields, "the recording", focal_sd=focal_sd_of(channel.metadata))',
        'camera_of(fields, "the recording")',
        (CALIBRATION,),
    ),
    Fault(
        517, "calibration: coefficients are cut instead of filled up", "io/calibration.py",
        "length = next((n for n in _LENGTHS[model] if n >= len(d)), None)",
        "length = next((n for n in _LENGTHS[model] if n >= len(d)), max(_LENGTHS[model]))", (CALIBRATION,),
    ),
    Fault(
        518, "settings: nan is a number", "core/stage.py",
        "if not math.isfinite(value) or (abs(value) > _FARTHEST and not bounded):",
        "if abs(value) > _FARTHEST and not bounded:", (HOSTILE,), "pydantic's allow_inf_nan refuses it as well",
    ),
    Fault(
        519, "settings: no number is too large", "core/stage.py",
        "if not math.isfinite(value) or (abs(value) > _FARTHEST and not bounded):", "if not math.isfinite(value):",
        (HOSTILE,),
    ),
    Fault(
        520, "settings: true is 1", "core/stage.py", "            if numeric:\n", "            if not numeric:\n",
        (HOSTILE,),
    ),
    Fault(
        521, "markers: 40 m across is fine", "config.py", "if not 0.001 <= diameter_m <= 1:",
        "if not 0.001 <= diameter_m:",
        (HOSTILE,),
    ),
    Fault(
        522, "seeds: two of a marker on one frame of a file", "config.py", "        if same != number:",
        "        if same > number:",
        (HOSTILE,),
        "the session refuses them as well, only later and without the file's name",
    ),
    Fault(
        523, "toml: a byte order mark is text", "io/toml_file.py", '"utf-16" if utf16 else "utf-8-sig"', '"utf-8"',
        (HOSTILE,),
    ),
    Fault(
        525, "folder: a missing number takes no time", "io/folder.py",
        "return [((number - first) // step, numbers[number]) for number in sorted(numbers)]",
        "return [(index, numbers[number]) for index, number in enumerate(sorted(numbers))]", (FOLDER,),
    ),
    Fault(
        526, "folder: steps are gaps", "io/folder.py",
        "step = math.gcd(*(number - first for number in numbers)) or 1", "step = 1", (FOLDER,),
    ),
    Fault(
        527, "info: damaged messages are passed over", "io/mcap_records.py",
        "self._undecodable[topic] = (count + 1, first)", "self._undecodable = {}", (VERBS_INPUTS,),
    ),
    Fault(
        528, "info --check: only our own topics", "io/summary.py",
        "for raw in records.messages(None if check else ours):", "for raw in records.messages(ours):", (VERBS_INPUTS,),
    ),
    Fault(
        529, "main: a fault of our own goes through", "cli/__init__.py",
        "    except Exception as error:\n",
        "    except ArithmeticError as error:\n        raise\n    except Exception as error:\n",
        (INPUTS,),
    ),
    Fault(
        530, "clock: a stamp after the end of time counts", "io/video.py",
        "> self._latest_ns:", "> self._latest_ns << 99:", ("tests/io/test_equal_times.py", "tests/io/test_video.py"),
    ),
    Fault(
        531, "seeds: those before the first picture are found late", "api.py",
        "if seed.frame_index < source.first_index:", "if seed.frame_index < 0:", (INPUTS,),
    ),
    Fault(
        601, "stretch: any two circles are a meeting", "stretch.py",
        "return one.circle.dice(other.circle) >= _MEETS_DICE", "return True", (STRETCH,),
    ),
    Fault(602, "stretch: meets a track much aside", "stretch.py", "_MEETS_DICE = 0.8", "_MEETS_DICE = 0.5", (STRETCH,)),
    Fault(603, "stretch: four frames are enough", "stretch.py", "_MEETS_FRAMES = 5", "_MEETS_FRAMES = 4", (STRETCH,)),
    Fault(
        604, "stretch: what is only estimated is met", "stretch.py",
        "if one.circle is None or other.circle is None or not (one.status.measured and other.status.measured):",
        "if one.circle is None or other.circle is None:", (STRETCH,),
    ),
    Fault(
        605, "stretch: one frame of disagreement is forgotten", "stretch.py",
        "            self.frames.clear()\n", "            pass\n", (STRETCH,),
    ),
    Fault(
        606, "stretch: time is not mirrored", "stretch.py",
        "mirrored.stamp_ns = twice_ns - frame.stamp_ns", "mirrored.stamp_ns = frame.stamp_ns", (STRETCH,),
    ),
    Fault(
        607, "stretch: velocities of mirrored time", "stretch.py",
        "velocity_cam_mps=None if velocity is None else -velocity,", "velocity_cam_mps=velocity,", (STRETCH,),
    ),
    Fault(
        608, "stretch: smoothed velocities of mirrored time", "stretch.py",
        "velocity_cam_mps=-pose.velocity_cam_mps)", "velocity_cam_mps=pose.velocity_cam_mps)", (STRETCH,),
    ),
    Fault(
        609, "stretch: the shutter rolls forwards in mirrored time", "stretch.py",
        "None if terms.readout_s is None else -terms.readout_s", "terms.readout_s", (STRETCH,),
    ),
    Fault(
        610, "stretch: stamps of mirrored time are handed out", "stretch.py",
        "    stamp_ns = twice_ns - result.stamp_ns\n", "    stamp_ns = result.stamp_ns\n", (STRETCH,),
    ),
    Fault(
        611, "hidden: the last frame is not", "core/marker.py",
        "return self.frame_index <= frame_index <= self.to_frame_index",
        "return self.frame_index <= frame_index < self.to_frame_index", (STRETCH, "tests/test_session_run.py"),
    ),
    Fault(
        612, "hidden: the first frame is not", "core/marker.py",
        "return self.frame_index <= frame_index <= self.to_frame_index",
        "return self.frame_index < frame_index <= self.to_frame_index", (STRETCH, "tests/test_session_run.py"),
    ),
    Fault(
        613, "stretch: backwards through what is hidden", "stretch.py",
        "if any(index in hidden for hidden in self._corrected.hidden):", "if False:", (STRETCH,),
    ),
    Fault(
        614, "stretch: backwards beyond where it is lost", "stretch.py",
        "if not estimate.status.tracked:", "if False:", (STRETCH, RETRACK),
    ),
    Fault(
        615, "stretch: backwards all is believed that was found elsewhere", "stretch.py",
        "astray = astray or (measured and proposer == _ELSEWHERE)", "astray = False", (STRETCH, RETRACK),
    ),
    Fault(
        616, "stretch: forwards on to the next circle", "stretch.py",
        "last = self._borders[k] - 1 if", "last = self._borders[k] if", (STRETCH,),
    ),
    Fault(
        617, "stretch: backwards on to the circle before", "stretch.py",
        "for index in range(start, last, -1):", "for index in range(start, last - 1, -1):", (STRETCH,),
    ),
    Fault(
        618, "stretch: the frames of a meeting are its own", "stretch.py",
        "            stretch.leave(meeting.frames)\n        elif", "            pass\n        elif", (STRETCH,),
    ),
    Fault(
        619, "stretch: another marker is believed where a person says this one is", "stretch.py",
        "_ASTRAY = 1 / 3", "_ASTRAY = 2", (STRETCH,),
    ),
    Fault(
        620, "stretch: nobody else's places are known", "stretch.py",
        "and e.status.measured and _range_m(e, terms) < range_m]", "and False]", (STRETCH,),
    ),
    Fault(
        621, "stretch: an earlier one goes before a later one", "stretch.py",
        "for stretch in reversed(self.stretches) if", "for stretch in self.stretches if", (STRETCH,),
    ),
    Fault(
        622, "session: a marker is looked for where it is hidden", "session.py",
        "() if item[1].hides(frame) else item[1].chain.look(frame)", "item[1].chain.look(frame)",
        ("tests/test_session_run.py",),
    ),
    Fault(
        623, "session: smoothing through what is hidden", "session.py",
        "if moment is not None and self._metric and not hidden:", "if moment is not None and self._metric:",
        ("tests/test_session_run.py",),
    ),
    Fault(
        624, "corrections: what answers made is not taken back", "corrections/rewriting.py",
        "            if is_answered(raw.channel.metadata):\n                return iter(())\n", "", (RETRACK,),
    ),
    Fault(
        625, "corrections: a chunk with what answers made is copied", "corrections/rewriting.py",
        'if any(role == "late" for role, _ in ours) or', "if", (RETRACK,),
    ),
    Fault(
        626, "corrections: paths end where a stretch does", "corrections/rewriting.py",
        "trail_ns = TRAIL_NS if self.run.metric else 0", "trail_ns = 0", (RETRACK,),
    ),
    Fault(
        627, "corrections: old messages of a marker stay", "corrections/rewriting.py",
        'if role == "marker" and self._corrected[marker].at(index) is not None:', "if False:", (RETRACK,),
    ),
    Fault(
        628, "corrections: no request is answered by a circle", "corrections/told.py",
        "there += [stretch.answer for stretch in stretches if request not in stretch.requests]", "pass", (RETRACK,),
    ),
    Fault(
        629, "corrections: stamps of the input, not of the recording", "corrections/footage.py",
        "            frame.stamp_ns += self._shift_ns\n", "            pass\n", (RETRACK,),
    ),
    Fault(
        630, "corrections: any input of that size will do", "corrections/footage.py",
        'if fingerprint(path)[1] != facts.get("input_sha256"):', "if False:", (RETRACK,),
    ),
    Fault(
        631, "corrections: pictures that were encoded again pass for the input's", "corrections/footage.py",
        'run.facts.get("video", "").startswith("video passed through")', "True", (RETRACK,),
    ),
    Fault(
        632, "corrections: another first circle is taken", "corrections/run.py",
        "if any(one.circle != seed.circle for one in same):", "if False:", (RETRACK,),
    ),
    Fault(
        633, "corrections: LOST at the end stays said", "corrections/job.py",
        'lines = [line for line in lines if not line.startswith(f"{place}{one.marker} is LOST at the end")]', "pass",
        (RETRACK,),
    ),
    Fault(
        634, "rewrite: message indexes are not moved", "io/rewrite.py",
        "{id_: start + place for id_, (place, _) in indexes.items()}",
        "{id_: place for id_, (place, _) in indexes.items()}", (RETRACK,),
    ),
    Fault(
        635, "rewrite: channels of a chunk that is written anew are not defined in it", "io/rewrite.py",
        "ids = dict.fromkeys([*defined, *(message.channel_id for message in messages)])",
        "ids = dict.fromkeys(message.channel_id for message in messages)", (RETRACK,),
    ),
    Fault(
        636, "attended: the answer's own frame is left out", "attended.py",
        "for index in range(seed.frame_index, now.index + 1):",
        "for index in range(seed.frame_index + 1, now.index + 1):", (ATTENDED,),
    ),
    Fault(
        637, "attended: asked for where a person says that it is hidden", "attended.py",
        "if any(h.marker == request.marker and request.raised_at_frame_index in h for h in self._hidden):", "if False:",
        (STRETCH,),
    ),
    Fault(
        638, "attended: the base is asked for although its marker is followed", "attended.py",
        "for request in base.requests if request.marker not in self._live)", "for request in base.requests)",
        (STRETCH,),
    ),
    Fault(
        639, "track: answers beyond the end leave the base", "api.py",
        "        base.unlink(missing_ok=True)\n        raise\n", "        raise\n", (RETRACK,),
    ),
    Fault(
        640, "stretch: the base is believed between what is hidden and a stretch", "stretch.py",
        "elif not reached or astray:", "else:", (STRETCH,),
    ),
    Fault(
        641, "course: what is below stands over what is laid on it", "io/course.py",
        "top.number_at(start) or self.number_at(start)", "self.number_at(start) or top.number_at(start)", (COURSE,),
    ),
    Fault(
        642, "course: frames that never came are as those before", "io/course.py",
        "            self._begin(self._end, 0)\n", "            pass\n", (COURSE,),
    ),
    Fault(
        643, "message index: chunks between each other go one after the other", "io/mcap_records.py",
        "start < spans[-1].end or", "False or", (INDEX,),
    ),
    Fault(
        644, "answers: their messages begin to count anew", "corrections/rewriting.py",
        "behind_others = SEQUENCES_A_FRAME * index + SEQUENCES_A_FRAME // 2", "behind_others = 0", (RETRACK,),
    ),
    Fault(
        645, "pictures: what is known of a video is asked anew for each", "io/mcap_images.py",
        "self._of_video or DecodedPictures(picture)", "DecodedPictures(picture)", ("tests/io/test_mcap_images.py",),
    ),
    Fault(
        646, "page: a circle where the track began is changed", "operator/opened.py",
        "seed.circle) != seed.circle:", "seed.circle) is None:", ("tests/operator/test_page.py",),
    ),
    Fault(
        647, "page: answers to another camera are dropped", "operator/answers.py",
        "seeds_toml([*others, *named])", "seeds_toml(named)", ("tests/operator/test_page.py",),
    ),
    Fault(
        648, "chair: the lens of the camera is forgotten", "operator/chair.py",
        "straight = camera.normalise(points_px) * focal + centre", "straight = points_px.copy()",
        ("tests/operator/test_chair.py",),
    ),
    Fault(
        649, "chair: the farthest point is taken for the wrong one", "operator/chair.py",
        "best = int(np.argmin(rms_px))", "best = int(np.argmax(whole.off_px))", ("tests/operator/test_chair.py",),
    ),
    Fault(
        701, "found: two alike are not asked", "found.py",
        "return [p for p in ranked if p.score >= _RIVAL * ranked[0].score]", "return ranked[:1]", (FOUND,),
    ),
    Fault(
        702, "found: one thing for two markers", "found.py",
        "if len(rivals[m.name]) == 1 and not any(rivals[o.name] == rivals[m.name] for o in turn if o is not m)",
        "if len(rivals[m.name]) == 1", (FOUND,),
    ),
    Fault(
        703, "found: those with a colour do not choose first", "found.py",
        "turn = coloured or [", "turn = [", (FOUND,),
    ),
    Fault(
        704, "found: what is weak is taken beside what is strong", "found.py",
        "good = [p for p in free if p.score >= _OF_THE_BEST * best]", "good = list(free)", (FOUND,),
    ),
    Fault(
        705, "found: what a person has shown is free", "found.py",
        "index == seed.frame_index and circle.dice(seed.circle) > _THE_SAME", "False", (FOUND,),
    ),
    Fault(
        706, "found: a seed is not the one that is told", "found.py",
        "rounded(p.circle), AUTHOR)", "p.circle, AUTHOR)", (FOUND,),
    ),
    Fault(707, "found: nobody is the author", "found.py", "rounded(p.circle), AUTHOR)", "rounded(p.circle))", (FOUND,)),
    Fault(
        708, "found: a marker that is missing stays listed", "found.py",
        "kept = tuple(m for m in settings.markers if m not in lost)", "kept = settings.markers", (FOUND,),
    ),
    Fault(
        709, "found: the asked colour makes no surer", "found.py",
        "(_SURE if marker.colour is None else _SURE_OF_ITS_COLOUR)", "_SURE", (FOUND,),
    ),
    Fault(
        710, "found: a second one of a colour takes the first one's name", "found.py",
        'proposal.colour if nth == 1 else f"{proposal.colour}_{nth}"', "proposal.colour", (FOUND,),
    ),
    Fault(
        711, "hues: ranges do not go over the end", "detection/hues.py",
        "(hsv[0] - first) % HUES <= (last - first) % HUES", "first <= hsv[0] <= last", (HUES,),
    ),
    Fault(
        712, "hues: greys have a hue", "detection/hues.py",
        "return name_of(hsv) not in GREYS and (", "return (", (HUES,),
    ),
    Fault(
        713, "hues: dark means black", "detection/hues.py",
        "saturation * value / 255 < _LEAST_CHROMA", "value < 80.0", (HUES,),
    ),
    Fault(
        714, "spots: glints are spots", "detection/spots.py",
        "> _SAME or _is_part(spot, other) for", "> _SAME for", (SPOTS,),
    ),
    Fault(
        715, "spots: the same thing twice", "detection/spots.py",
        "spot.circle.dice(other.circle) > _SAME or ", "", (SPOTS,),
    ),
    Fault(
        716, "spots: colour around does not count", "detection/spots.py",
        "own = max(0.0, self.inside - self.around)", "own = self.inside", (SPOTS,),
    ),
    Fault(
        717, "spots: only by shape", "detection/spots.py",
        "(*_by_colour(frame), *_by_shape(frame))", "_by_shape(frame)", (SPOTS, PROPOSALS),
    ),
    Fault(
        718, "spots: only by colour", "detection/spots.py",
        "(*_by_colour(frame), *_by_shape(frame))", "_by_colour(frame)", (SPOTS,),
    ),
    Fault(
        719, "spots: a reduced picture lies half a step off", "detection/spots.py",
        "first_px = (step - 1) / 2", "first_px = 2.0 * step", (SPOTS,),
    ),
    Fault(
        720, "proposals: the background's way is added", "proposals.py",
        "last.y_px - circle.y_px]) - carried", "last.y_px - circle.y_px]) + carried", (PROPOSALS,),
    ),
    Fault(
        721, "proposals: the background is taken for at rest", "proposals.py",
        "np.zeros(2) if self._last is None else", "np.zeros(2) if True else", (PROPOSALS,),
    ),
    Fault(
        722, "proposals: one seen once is as good as one seen always", "proposals.py",
        " * math.sqrt(len(sights) / looks)", "", (PROPOSALS,),
    ),
    Fault(
        723, "proposals: size does not tell two of a colour apart", "proposals.py",
        "        size / 0.35\n        +", "", (PROPOSALS,),
    ),
    Fault(
        724, "proposals: a full picture's colour does not count", "proposals.py",
        "            * (0.3 + 0.7 * math.sqrt(self.alone))\n", "", (PROPOSALS,),
    ),
    Fault(
        725, "proposals: worst first", "proposals.py",
        "proposals.sort(key=lambda proposal: -proposal.score)", "proposals.sort(key=lambda proposal: proposal.score)",
        (PROPOSALS,),
    ),
    Fault(
        726, "snap: metres without a camera", "snap.py",
        "exposure_s, metric, readout_s)", "exposure_s, True, readout_s)", (SNAP,),
    ),
    Fault(
        727, "snap: the mask of the whole window's brightness", "snap.py",
        "box_mask(patch.bgr, limits)", "box_mask(patch.bgr, limits)[::-1].copy()", (SNAP,),
    ),
    Fault(
        728, "contrast: of the disc to itself", "detection/appearance.py",
        "np.median(lab[inside], axis=0), lab[ring]", "np.median(lab[inside], axis=0), lab[inside]", (SNAP,),
    ),
    Fault(
        729, "track --auto: what is missing is not said", "api.py",
        "report.lost += self._missing + gone", "report.lost += gone", (AUTO,),
    ),
    Fault(
        730, "track --auto: nothing of it in the recording", "api.py",
        'more["auto"] = "" if found is None else', 'more["auto"] = "" if found is not None else', (AUTO,),
    ),
    Fault(
        731, "track --auto: seconds are not heeded", "api.py",
        "if frame.stamp_ns >= end_ns or stop():", "if stop():", (AUTO,),
    ),
    Fault(
        740, "streak: what is seen deep inside does not count as whole", "detection/edge.py",
        "            swept_dark[k, n] /= there", "            swept_dark[k, n] /= np.float32(1.0)", (EDGE,),
    ),
    Fault(
        741, "streak: the background's light taken for the marker's", "detection/edge.py",
        "            if cover[k, n] < 1.0:", "            if cover[k, n] < 0.0:", (EDGE,),
    ),
    Fault(
        742, "streak: the outline bends half as much", "detection/edge.py",
        "np.float32(2.0) * t * across[n]) + way2", "np.float32(1.0) * t * across[n]) + way2", (EDGE,),
    ),
    Fault(
        743, "the colour box grows without bound", "detection/appearance.py",
        "room, (least, most) = 0.5 * (high - low)", "room, (least, most) = 5.0 * (high - low)", (APPEARANCE,),
    ),
    Fault(
        744, "the colour box learns other hues", "detection/appearance.py",
        "own = pixels[hue_off <= self.box.hue_half]", "own = pixels", (APPEARANCE,),
    ),
    Fault(
        745, "the colour box learns from parts of an outline", "detection/appearance.py",
        "if visible > _WHOLE:", "if True:", (APPEARANCE,),
    ),
    Fault(
        746, "the colour box learns at another exposure", "detection/appearance.py",
        "own[:, channel] / scale", "own[:, channel]", (APPEARANCE,),
    ),
    Fault(
        747, "colour: half will do where nothing is expected", "verification/checks.py",
        "if case.surprise <= 1 and (case.lost or case.off_expected < _NO_LEAP):", "if True:", (CHECKS,),
    ),
    Fault(
        748, "colour: half will do for a part of an outline", "verification/checks.py",
        "        if case.visible > _WHOLE:", "        if True:", (CHECKS,),
    ),
    Fault(
        749, "an index that promised more raises what nobody expects", "io/mcap_records.py",
        "if self._count <= number < self._promised:", "if False:", (INDEX,),
    ),
    Fault(
        750, "a dark marker's hue is asked for", "verification/checks.py",
        "if case.unlike < _ALIKE and not case.lost:", "if False:", (CHECKS,),
    ),
    Fault(
        751, "a lost marker's colour only has to be alike", "verification/checks.py",
        "if case.unlike < _ALIKE and not case.lost:", "if case.unlike < _ALIKE:", (CHECKS,),
    ),
    Fault(
        752, "unlike: the seed as bright as it was", "detection/appearance.py",
        "np.minimum(self._bgr * self.gain / 255, 1)", "np.minimum(self._bgr / 255, 1)", (APPEARANCE,),
    ),
    Fault(
        753, "unlike: no contrast counts", "detection/appearance.py",
        "/ max(_apart(own, ring), 1e-6)", "/ 100", (APPEARANCE,),
    ),
    Fault(
        754, "what hides a marker teaches it a brightness", "detection/appearance.py",
        "if own > 8 and visible > _CLEAR:", "if own > 8:", (APPEARANCE,),
    ),
    Fault(
        755, "a proposal's own size is never tried", "detection/outline.py",
        "if own_size and expected is not None", "if False", (OUTLINE,),
    ),
    Fault(
        756, "of a part another size is believed", "detection/outline.py",
        "free.visible > _WHOLE * free.in_picture", "True", (OUTLINE,),
    ),
    Fault(
        757, "at the picture's border another size is believed", "detection/outline.py",
        "free.in_picture > _INSIDE", "True", (OUTLINE,),
    ),
    Fault(
        758, "of a streak another size is believed", "detection/outline.py",
        " and math.hypot(*motion.blur_px) < usual_r_px:", ":", (OUTLINE,),
    ),
    Fault(
        759, "what stood there is taken for a lost marker", "verification/reacquired.py",
        "return float((now * then).sum()) > _SAME * power", "return False", (REACQUIRED,),
    ),
    Fault(
        760, "stood there: its own pixels are not asked", "verification/reacquired.py",
        "if stayed.sum() < _STAYED * own.sum():", "if False:", (REACQUIRED,),
    ),
    Fault(
        761, "stood there: what is around is not asked", "verification/reacquired.py",
        "return float((now * then).sum()) > _SAME * power", "return True", (REACQUIRED,),
    ),
    Fault(
        762, "stood there: the marker's own place is asked about", "verification/reacquired.py",
        "if circle.distance(last) < circle.r_px + last.r_px:", "if False:", (REACQUIRED,),
    ),
    Fault(
        763, "the frame that a marker was last seen on is its first", "chain.py",
        "stages.reacquired.seen(frame, circle)", "stages.reacquired._seen or stages.reacquired.seen(frame, circle)",
        (DECISIONS,),
    ),
    # -- analysis
    Fault(
        764, "smoother: the jerk does not reach the position", "analysis/smoother.py",
        "        x[k] += dt * x[3 + k] + d2 * x[6 + k] + d3 * x[9 + k]",
        "        x[k] += dt * x[3 + k] + d2 * x[6 + k]",
        (SMOOTHER,),
    ),
    Fault(
        765, "smoother: the motion is that of when the marker was seen", "analysis/smoother.py",
        "        d = moved[n]\n",
        "        d = 0.0\n",
        (SMOOTHER,),
    ),
    Fault(
        766, "smoother: noise that was learnt is not used", "analysis/smoother.py",
        "_smooth(t, xyz, whiten / self.noise, seen",
        "_smooth(t, xyz, whiten, seen",
        (SMOOTHER,),
    ),
    Fault(
        767, "rim: the top leans outward", "analysis/rim.py",
        "[0.0, -sign * sin, cos], [0.0, sign * cos, sin]",
        "[0.0, sign * sin, cos], [0.0, sign * cos, -sin]",
        ("tests/analysis/test_rim.py",),
    ),
    Fault(
        768, "events: a gap beside the rim hides nothing", "analysis/events.py",
        "for beside_s in (seen_s, at_s):", "for beside_s in (at_s,):",
        (EVENTS, STROKES,),
    ),
    Fault(
        769, "events: release lets the velocity jump", "analysis/events.py",
        "            held = tau\n            first, off = [], [(air**2, 0.0)",
        "            held = held\n            first, off = [(free, 0.0)], [(air**2, 0.0)",
        (EVENTS, STROKES,),
    ),
    Fault(
        770, "events: the wheel has no say", "analysis/events.py",
        "turned = path.turned_rad * path.push_radius_m",
        "turned = 0.0 * path.turned_rad",
        (EVENTS, STROKES,),
    ),
    Fault(
        771, "strokes: short stretches tell the rim's rate", "analysis/strokes.py",
        "if way > _TELLS * float(np.median(far))]",
        "if way > 0]",
        (STROKES,),
    ),
    Fault(
        772, "strokes: the rim's rate changes within a push", "analysis/strokes.py",
        "np.array([-_EXTENT_S, _EXTENT_S]) / 4",
        "np.array([1.0, -1.0]) * 1e-3 + np.diff(hand.t_s[np.array(whole)]) * [0.49, -0.49]",
        (STROKES,),
    ),
    Fault(
        773, "strokes: where the axle is unsure no angle is", "analysis/strokes.py",
        " + (self.hub_sd_m / radius_m) ** 2",
        "",
        (STROKES,),
    ),
    Fault(
        774, "chair: positions that err alike count each", "analysis/chair.py",
        "len(found.fun) - alike - len(found.x)",
        "len(found.fun) - len(found.x)",
        (CHAIR, ANALYSIS,),
    ),
    Fault(
        775, "chair: upright whatever", "analysis/chair.py",
        "bool(np.degrees(np.sqrt(covariance[1, 1])) < _UPRIGHT_DEG)",
        "True",
        (CHAIR, ANALYSIS,),
    ),
    Fault(
        776, "focal: noise is not taken out", "analysis/focal.py",
        "return 2 * plain - float(np.mean(noisier))",
        "return plain",
        ("tests/analysis/test_focal.py",),
    ),
    Fault(
        777, "messages: events on the last hand's topic", "analysis/messages.py",
        'f"{ROOT}/{side}/events", event_message',
        'f"{ROOT}/right/events", event_message',
        (ANALYSIS,),
    ),
    Fault(
        778, "findings: the focal length's error counts on each frame", "analysis/findings.py",
        "without_focal(poses, 0.0 if camera is None else camera.focal_sd)",
        "without_focal(poses, 0.0)",
        (ANALYSIS,),
    ),
    # -- seasons
    Fault(
        779, "season's key: what is in the camera's file does not count", "season/key.py",
        "*_named_by(plan.settings, settings.camera.file)", "", (SEASON,),
    ),
    Fault(
        780, "season's key: a file that is as large as it was is the same", "season/key.py",
        "same.state == state", "same.size_bytes == size", (SEASON,),
    ),
    Fault(
        781, "season: what other first circles began is taken up", "season/session.py",
        "set(base_seeds(answers)) != set(base_seeds(found.answers))",
        "len(base_seeds(answers)) != len(base_seeds(found.answers))",
        (SEASON_RUN,),
    ),
    Fault(
        782, "season: run.json stays while other files come into its folder", "season/session.py",
        "        (self.folder / RUN).unlink(missing_ok=True)\n", "", (SEASON,),
    ),
    Fault(
        783, "season: what the tracking lost is forgotten when it is taken up", "season/session.py",
        "self._reported(recorded.lost, (*recorded", "self._reported([], (*recorded", (SEASON,),
    ),
    Fault(
        784, "season: not analysed as was wanted, and done", "season/session.py",
        "asked = self.plan.analysis is not None", "asked = False", (SEASON,),
    ),
    Fault(
        785, "season: a session outlives whoever started it", "season/worker.py",
        "            os.kill(child, signal.SIGKILL)", "            pass", (SEASON,),
    ),
    Fault(
        786, "season: two runs work in one folder", "season/worker.py",
        "                free = False", "                pass", (SEASON,),
    ),
    Fault(
        787, "season: a second run clears away what the first is at", "season/run.py",
        "    elif ended.code == BUSY:\n        raise BusyError\n",
        '    elif ended.code == BUSY:\n        reason = "another run is at work on it"\n',
        (SEASON,),
    ),
    Fault(
        788, "season: a question goes by the marker, whichever camera sees it", "season/requests.py",
        'place = f"{camera}/" if camera is not None else ""', 'place = ""', (SEASON,),
    ),
    Fault(
        789, "season: a job's end is taken for its session's crash", "season/worker.py",
        "        signal.signal(number, signal.SIG_IGN)", "        pass", (SEASON_RUN,),
    ),
    Fault(
        790, "season: once a session has stopped, nobody is asked any more", "season/run.py",
        "if not asked and stop():", "if not stopped and stop():", (SEASON,),
    ),
    Fault(
        791, "season: an address is another one once it was read", "season/addresses.py",
        "if told.get(key) is not None] or filesystem.ukey(place)", "if False] or filesystem.ukey(place)",
        ("tests/season/test_addresses.py",),
    ),
    Fault(
        792, "season: a result that was cut short is whole", "season/outcome.py",
        "(folder / name).stat().st_size == size", "(folder / name).exists()", (SEASON,),
    ),
    Fault(
        793, "season's key: pictures may change places", "season/key.py",
        "(one.name, s.st_size, s.st_mtime_ns, s.st_ctime_ns)", "(s.st_size, s.st_mtime_ns, 0)", (SEASON,),
    ),
    Fault(
        794, "season's key: what takes its original's date with it is the original", "season/key.py",
        "s.st_mtime_ns, s.st_ctime_ns)", "s.st_mtime_ns)", (SEASON,),
    ),
    Fault(
        795, "season: a chapter that is gone is not missed", "season/key.py",
        'if line.startswith("no video")]:', 'if not plan.videos]:', (SEASON,),
    ),
    Fault(
        796, "season: the log tells of a run that made nothing", "season/worker.py",
        "(folder / LOG).write_bytes(before)", "pass", (SEASON_RUN,),
    ),
    Fault(
        797, "season: after an answer the tracking's own notes are gone", "season/session.py",
        "self._reported([], self.before.recorded.notes, False)", "pass", (SEASON,),
    ),
    Fault(
        798, "season: a session may have any memory", "season/worker.py",
        "    os._exit(TOO_LARGE)", "    pass", (SEASON_RUN,),
    ),
    Fault(
        799, "season: a whole result is thrown away for the hour", "season/run.py",
        "if ended.hung and ended.code not in (0, KEPT):", "if ended.hung:", (SEASON,),
    ),
    Fault(
        800, "manifest: a name with brackets is a pattern", "season/manifest.py",
        "[path] if os.path.lexists(path) else sorted(", "sorted(", (FINDING,),
    ),
    Fault(
        801, "manifest: a sensor that is gone and has brackets is not missed", "season/manifest.py",
        '_SEVERAL.search(_ESCAPED.sub("", written))', "_SEVERAL.search(written)", (MANIFEST,),
    ),
    Fault(
        802, "manifest: two sensors may be called alike", "season/manifest.py",
        "free(sensor_name(one, place._stem), names)", "sensor_name(one, place._stem)", (MANIFEST,),
    ),
    Fault(
        803, "manifest: a video is two sessions by two paths", "season/manifest.py",
        "return path if is_address(path) else os.path.realpath(path)", "return path", (MANIFEST,),
    ),
    Fault(
        804, "init --add: what lies in the folder overrules what somebody wrote", "season/proposed.py",
        'or (general is not None and path == root / f"{kind}.toml")', "", (FINDING,),
    ),
    Fault(
        805, "init --add: a log is two sessions'", "season/proposed.py",
        " if real_path(sensor.path) not in others)", ")",
        (FINDING,),
    ),
    Fault(
        806, "init --add: logs that came later are passed over", "season/proposed.py",
        "for s in session.sensors if real_path(s.path) not in merged]", "for s in ()]", (FINDING,),
    ),
    Fault(
        807, "init: an input may be written over", "cli/dataset.py",
        "() if known is not None else found.files", "()", ("tests/season/test_dataset_command.py",),
    ),
    Fault(
        808, "season: a file that was written again and is the same is another one", "season/key.py",
        "(is_address(path) or file.sha256 != _content(Path(path), going_on))", "True", (SEASON,),
    ),
)  # fmt: skip


class Copy:
    """src and tests in a folder of their own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.gettempdir()) / f"spheremcap-mutations-{os.getuid()}"
        tree = self.folder / "tree"
        shutil.rmtree(tree, ignore_errors=True)
        for name in ("src", "tests", "benchmarks"):
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy2(ROOT / "pyproject.toml", tree)
        self.tree = tree
        self.broken: dict[str, list[str]] = {}  # tests that fail without a fault, by file

    def path(self, file: str) -> Path:
        return self.tree / "src" / "spheremcap" / file

    def pytest(self, tests: Sequence[str], *options: str) -> tuple[int, str]:
        """pytest's exit code and what it printed. No bytecode is kept: a fault may leave a file's size as it was."""
        environment = os.environ | {
            "PYTHONPATH": str(self.tree / "src"), "NUMBA_CACHE_DIR": str(self.folder / "kernels"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        out = [f"--deselect={test}" for file in tests for test in self.broken.get(file, ())]
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *out, *tests]
        for _ in range(2):
            done = subprocess.run(command, cwd=self.tree, env=environment, capture_output=True, text=True, check=False)
            if done.returncode >= 0:  # else something else on this machine ended it
                break
        return done.returncode, done.stdout + done.stderr

    def without(self, file: str) -> str:
        """Run a test file as it is; '' when all is well, else what to say of it."""
        code, printed = self.pytest([file], "-rfE")
        if code == 0:
            return ""
        self.broken[file] = re.findall(r"^(?:FAILED|ERROR) (\S+)", printed, re.MULTILINE)
        if code != 1 or not self.broken[file]:
            raise SystemExit(f"{file} cannot be run without a fault:\n{printed[-2000:]}")
        return f"fails without a fault and is left out: {', '.join(self.broken[file])}"

    def planted(self, fault: Fault) -> str:
        """Run the fault's tests with it: noticed, escaped, stale or broken."""
        path = self.path(fault.file)
        before, facts = path.read_text(), path.stat()
        if before.count(fault.old) != 1:
            return "stale"
        path.write_text(before.replace(fault.old, fault.new))
        # The same fault has the same time stamp in every run, so its kernels are compiled once only.
        stamp_ns = facts.st_mtime_ns + 1 + zlib.crc32(f"{fault.old}{fault.new}".encode())
        os.utime(path, ns=(stamp_ns, stamp_ns))
        try:
            code, printed = self.pytest(fault.tests, "-x")
        finally:
            path.write_text(before)
            os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))
        if code not in (0, 1):
            return f"broken: pytest ends with {code}: {printed.strip().splitlines()[-1:]}"
        return "noticed" if code else "escaped"


def chosen(only: Sequence[str]) -> list[Fault]:
    return [f for f in FAULTS if not only or any(o == str(f.number) or (not o.isdigit() and o in f.name) for o in only)]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", default=[], metavar="N", help="numbers, or words of their names")
    parser.add_argument("--list", action="store_true", help="list the faults and stop")
    options = parser.parse_args()
    faults = chosen(options.only)
    if options.list:
        for fault in faults:
            print(f"{fault.number:4d}  {fault.name}  ({fault.file})")
        return 0
    copy = Copy()
    for file in dict.fromkeys(test for fault in faults for test in fault.tests):
        started = time.monotonic()
        said = copy.without(file) or "passes"
        print(f"{file}: {said} ({time.monotonic() - started:.0f} s)", flush=True)
    print("\n| no. | fault | result | s |\n|---|---|---|---|", flush=True)
    results = []
    for fault in faults:
        started = time.monotonic()
        result = copy.planted(fault)
        results.append(result)
        said = f"{result} (harmless: {fault.harmless})" if fault.harmless else result
        print(f"| {fault.number} | {fault.name} | {said} | {time.monotonic() - started:.0f} |", flush=True)
    harmful = [r for r, fault in zip(results, faults, strict=True) if not fault.harmless]
    noticed, stale = harmful.count("noticed"), results.count("stale")
    print(f"\nnoticed: {noticed} of {len(harmful)}" + (f"; stale: {stale}" if stale else ""))
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())

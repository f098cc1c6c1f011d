"""How good a recording is, for its page: tables, and a sentence for each number."""

from html import escape

import numpy as np

from spheremcap.analysis.findings import Findings
from spheremcap.analysis.markup import NONE, explained, heads, listed, number, percent, row, table

_NOISY = 1.5


def quality_part(found: Findings) -> str:
    """How much of each marker was measured."""
    if not found.quality:
        return "<p>There are no markers in the recording.</p>"
    rows = []
    for q in found.quality:
        share = max(0.0, min(1.0, q.measured)) if np.isfinite(q.measured) else 0.0
        bar = f'<span class="bar" aria-hidden="true"><i style="width:{100 * share:.1f}%"></i></span>'
        scatter = f"× {number(q.noise, 1)}" if q.noise is not None else NONE
        if q.noise is not None and q.noise >= _NOISY:
            scatter = f'<span class="bad">{scatter} (!)</span>'
        cells = [
            str(q.frames), bar + percent(q.measured), percent(q.bridged), f"{number(q.longest_gap_ms, 0)} ms",
            str(q.requests), scatter,
        ]  # fmt: skip
        rows.append(row(escape(q.marker), cells))
    head = heads(
        "Marker", "Frames", "Measured", "Bridged", "Longest gap", "Open questions", "Scatter against what is stated"
    )
    return (
        "<h3>Markers</h3>"
        + table("How much of each marker was measured", head, rows)
        + explained(
            {
                "Measured": "the share of its frames on which the marker was found and accepted. All numbers on this "
                "page come from these frames, but for short gaps where <code>--fill</code> was told to stand in.",
                "Bridged": "frames on which the tracker's prediction stood in for a marker it did not see. They are "
                "not measured, and no number here is made of them.",
                "Longest gap": "the longest time from one measured frame to the next. A gap that is longer than a "
                "few frames hides a contact or release; one as long as a push hides the whole push.",
                "Open questions": "places where the tracker asked a person and has no answer yet.",
                "Scatter": "how much the positions scatter about a smooth path, against the uncertainty that is "
                f"stated for them. × 1 is just as stated; below 1 they are better than stated; from × {_NOISY} on "
                "(marked) worse. The uncertainties of strokes below have this factor in them.",
            }
        )
    )


def lengths_part(found: Findings) -> str:
    """Whether segments keep their lengths."""
    title = "<h3>Segment lengths</h3>"
    if not found.lengths:
        return title + "<p>No two markers are on one part of the body: no length can be checked.</p>"
    rows = []
    for length in found.lengths:
        if length.median_m is None:
            verdict = "too few frames"
        else:
            verdict = "constant" if length.constant else '<span class="bad">(!) no constant length</span>'
        median_mm = None if length.median_m is None else length.median_m * 1e3
        cells = [
            str(length.frames), f"{number(median_mm, 1)} mm" if median_mm is not None else NONE,
            percent(length.spread), percent(length.noise), percent(length.drift), verdict,
        ]  # fmt: skip
        rows.append(row(escape(length.segment), cells))
    head = heads("Segment", "Frames", "Median", "Varies by", "Expected from noise", "Drift", "It is")
    return (
        title
        + table("Distances of two markers on one part of the body", head, rows)
        + explained(
            {
                "Why it matters": "a bone does not change its length. Where one does here, by more than its noise "
                "and one percent for skin, the metres are wrong (a marker's size, the calibration) or a marker "
                "slipped. The line between the shoulders is no single bone: it changes as the shoulders move.",
                "Varies by": "its standard deviation over the frames, as a share of the length, far-off frames left "
                "out.",
                "Expected from noise": "what the positions' stated uncertainty would make of it.",
                "Drift": "how far a five seconds' median departs from the median of all. A drift tells of a marker "
                "that slipped.",
            }
        )
    )


def chair_part(found: Findings) -> str:
    """What the chair's frame rests on and how well it is known."""
    title, chair = "<h3>The chair's frame</h3>", found.chair
    if chair is None:
        return (
            title + "<p>There is none: nothing told where the camera is on the chair. So there are no strokes, and "
            "no angles about the axle.</p>"
        )
    sd = np.sqrt(np.maximum(np.diagonal(chair.covariance), 0.0))
    across, _, forward = np.clip(chair.rotation.T, -1.0, 1.0)
    turns = {
        "it looks down by": (-forward[2], sd[1]),
        "it looks to the athlete's left by": (forward[1], sd[2]),
        "its right side is higher by": (across[2], sd[0]),
    }
    rows = [
        row(name, [f"{number(float(np.degrees(np.arcsin(sin))), 1)}°", f"± {number(float(np.degrees(sd_rad)), 2)}°"])
        for name, (sin, sd_rad) in turns.items()
    ]
    places = ("it is forward of the axle by", "it is to the left of the middle by", "it is above the axle by")
    rows += [
        row(
            name,
            [
                f"{number(float(chair.camera_xyz_chair_m[k]) * 1e3, 0)} mm",
                f"± {number(float(sd[k + 3]) * 1e3, 1)} mm",
            ],
        )
        for k, name in enumerate(places)
    ]
    rows.append(
        row(
            "a hub is from the middle of the chair by",
            [f"{number(chair.half_track_m * 1e3, 0)} mm", f"± {number(chair.half_track_sd_m * 1e3, 1)} mm"],
        )
    )
    told = listed([escape(word) for word in chair.told_by]) or "nothing but how chairs usually are"
    fits = "fits together" if chair.misfit < 2 else "does not fit together well"
    tilt = float(np.degrees(chair.tilt_sd_rad))
    up = (
        f"Angles about the axle count from straight up; that is known to {number(tilt, 1)}°, which shifts all contact "
        "and release angles alike."
        if chair.upright
        else "Nothing says how the camera is tilted, so there are no contact and release angles and no elevations."
    )
    return (
        f"{title}<p>It rests on: {told}. What was told {fits}: its residuals are {number(chair.misfit, 2)} times what "
        f"they should be (1 or less is well). {up} The axle is seen to within {number(chair.hub_sd_m() * 1e3, 1)} "
        "mm.</p>"
        + table(
            "Where the camera is on the chair", heads("The camera", "Is", "Known to (one standard deviation)"), rows
        )
    )


def clocks_part(found: Findings) -> str:
    """How the inputs' clocks were put together."""
    title, clocks = "<h3>Clocks</h3>", found.session.clocks
    if not clocks:
        return title + "<p>The recording was not merged with others: there is one clock.</p>"
    rows = []
    for name, facts in clocks.items():
        told = {key: escape(str(value)) for key, value in facts.items()}
        cells = [told.get("samples", NONE)]
        cells += [
            f"{told[key]} {unit}" if key in told else NONE for key, unit in (("rate_hz", "Hz"), ("drift_ppm", "ppm"))
        ]
        cells.insert(2, told.get("added", NONE))
        if "sync_residual_ms" in told:
            agreed = f" ({told['sync_windows']} windows agree)" if "sync_windows" in told else ""
            cells += [f"{told['sync_residual_ms']} ms{agreed}", f"{told.get('sync_error_ms', NONE)} ms"]
        else:
            cells += [NONE, NONE]
        rows.append(row(escape(name), cells))
    synced = any("sync_residual_ms" in facts for facts in clocks.values())
    said = (
        "Residual: how far apart the clocks are in single windows of the recording, as a standard deviation, once "
        "offset and drift are taken away. Error: the uncertainty of the clock that was found, at its worse end: all "
        "times of that input may be off by so much, alike."
        if synced
        else "No clock was found from motion (<code>merge --sync</code>): how well the clocks agree rests on what "
        "each says."
    )
    head = heads("Input", "Samples", "Rate", "Added to its times", "Drift", "Sync residual", "Sync error")
    return f"{title}{table('How the times of each input were put together', head, rows, 'words')}<p>{said}</p>"

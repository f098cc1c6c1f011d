"""Kinetics Toolkit's TimeSeries from an export: `python kinetics_toolkit.py tracks.parquet [events.parquet]`.

The files come from

    spheremcap export session.mcap -o tracks.parquet
    spheremcap export session.mcap -o events.parquet --table events     (after `spheremcap analyse`)

and the toolkit from `pip install kineticstoolkit pyarrow`; spheremcap itself is not needed here. Each marker becomes a
point series (N, 4) in metres as the toolkit has them, NaN where it was not measured, over seconds from the first frame.
"""

import sys

import kineticstoolkit as ktk
import numpy as np
import pandas as pd
import pyarrow.parquet

POSITION = ["x_cam_m", "y_cam_m", "z_cam_m"]


def time_series(tracks: str, events: str | None = None) -> ktk.TimeSeries:
    """Measured positions of all markers, and contacts and releases as events."""
    table = pd.read_parquet(tracks)
    table.loc[~table["status"].isin(["SEEDED", "VERIFIED"]), POSITION] = np.nan  # else the filter's, not the picture's
    stamps = np.sort(table["stamp_ns"].unique())
    series = ktk.TimeSeries(time=(stamps - stamps[0]) / 1e9)
    unit = pyarrow.parquet.read_schema(tracks).field("x_cam_m").metadata[b"unit"].decode()
    for marker, rows in table.drop_duplicates(["marker", "stamp_ns"]).groupby("marker"):
        xyz = rows.set_index("stamp_ns")[POSITION].reindex(stamps).to_numpy(float)
        one = np.where(np.isnan(xyz[:, :1]), np.nan, 1.0)
        series = series.add_data(marker, np.hstack([xyz, one]))
        series = series.add_data_info(marker, "Unit", unit)
    if events is not None:
        for event in pd.read_parquet(events).itertuples():
            series = series.add_event((event.stamp_ns - stamps[0]) / 1e9, f"{event.side} {event.kind}")
    return series


def main(tracks: str, events: str | None = None) -> None:
    series = time_series(tracks, events)
    print(f"{len(series.time)} frames in {series.time[-1]:.2f} s")
    for marker in series.data:
        print(f"{marker}: {np.count_nonzero(~series.isnan(marker))} measured, in {series.data_info[marker]['Unit']}")
    for event in series.events:
        print(f"{event.time:.4f} s {event.name}")
    # A gap of more than 5 frames stays one: the toolkit fills no more than it is told to.
    filled = series.fill_missing_samples(5, method="pchip")
    print("after filling gaps of up to 5 frames:")
    for marker in filled.data:
        print(f"{marker}: {np.count_nonzero(filled.isnan(marker))} without a position")


if __name__ == "__main__":
    main(*sys.argv[1:])

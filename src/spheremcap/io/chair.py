"""Where the chair is in a camera's frame, read back from a recording that `analyse` wrote."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spheremcap.io import _pb
from spheremcap.io.mcap_records import McapRecords
from spheremcap.io.recording import UNREADABLE, schema_names

FloatArray = npt.NDArray[np.float64]

CHAIR = _pb.ChairFrame.DESCRIPTOR.full_name


@dataclass(frozen=True)
class ChairPose:
    """The chair's frame `frame_id` in the camera's optical frame `parent_frame_id`.

    `rotation` (3, 3) turns vectors of the chair's frame into the camera's, `xyz_cam_m` (3,) is the chair's origin.
    Without `upright` nothing says how the camera is tilted, and z is up as far as cameras usually are.
    """

    parent_frame_id: str
    frame_id: str
    rotation: FloatArray
    xyz_cam_m: FloatArray
    upright: bool

    def place(self, xyz_cam_m: FloatArray) -> FloatArray:
        """Positions (..., 3) of the camera's frame, in the chair's."""
        out: FloatArray = (xyz_cam_m - self.xyz_cam_m) @ self.rotation
        return out


def read_chairs(records: McapRecords) -> list[ChairPose]:
    """The first of each topic that has any; `records` counts what does not decode."""
    names = schema_names(records)
    found = []
    for topic in sorted({c.topic for c in records.channels.values() if names[c.id] == CHAIR}):
        from scipy.spatial.transform import Rotation  # here, for exports without a chair are to start at once

        for raw in records.messages([topic]):
            try:
                said = _pb.ChairFrame.FromString(raw.data)
                q, t = said.rotation, said.translation
                turn = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
            except (*UNREADABLE, ValueError) as error:
                records.undecodable(topic, error)
                continue
            place = np.array([t.x, t.y, t.z])
            found.append(ChairPose(said.parent_frame_id, said.child_frame_id, turn, place, said.upright))
            break
    return found

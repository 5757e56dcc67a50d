"""ROS transforms (/tf, /tf_static): the pose of every robot's base in the frame at the root of its tree.

Frames are named as REP 105 has them; a name in front (``robot1/base_link``) is the vehicle's.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fleetlog.core.arrays import Floats
from fleetlog.importers._messages import normal_name, numbers, readers, stamp_of
from fleetlog.importers._rows import Sample

KIND = "tf2_msgs/TFMessage"
BASES = ("base_link", "base_footprint")
ODOMETRY = "odom"  # A frame that drifts; poses in it count where no other frame is above it
WORLD = "world"  # What simulators call the map; frames right below it are robots, but for ``BODIES``
BODIES = (*BASES, ODOMETRY, "map")
FRAMES, DEEPEST = 10_000, 64  # Frames of a recording, and frames above one another, that are believed


class Link(NamedTuple):
    """Where a frame lies in its parent at a stamp [us]: a matrix (4, 4) of turn and shift [m]."""

    parent: str
    child: str
    stamp: int
    pose: Floats


Decode = Callable[[Any], dict[str, Any]]


def decoder(schema: str, encoding: str) -> Decode | None:
    """What reads the messages of a topic of transforms; None for any other."""
    known = normal_name(schema) in (KIND, "tf/tfMessage")
    return readers(KIND).get(encoding) if known else None


def _links(message: dict[str, Any]) -> list[Link]:
    links = []
    for said in message["transforms"]:
        transform, pose = said["transform"], np.eye(4)
        pose[:3, :3] = Rotation.from_quat(numbers(transform["rotation"], *"xyzw")).as_matrix()
        pose[:3, 3] = numbers(transform["translation"], *"xyz")
        parent, child = (str(v).strip("/") for v in (said["header"]["frame_id"], said["child_frame_id"]))
        links.append(Link(parent, child, stamp_of(said), pose))
    return links


class Transforms:
    """The frames of one recording as they are told."""

    def __init__(self) -> None:
        self._links: dict[str, Link] = {}

    def take(self, decode: Decode, data: Any, *, static: bool, named: bool) -> list[Sample]:
        """Take note of a message; the poses of the bases that it moves, ``named`` after their frames."""
        links = _links(decode(data))
        if len(self._links.keys() | {k.child for k in links}) > FRAMES:
            raise ValueError(f"more than {FRAMES:,} frames")
        self._links |= {link.child: link for link in links}
        moved = [] if static else [k for k in links if _last(k.parent) not in BASES]
        bases = [self._pose(k, k.child.rpartition("/")[0]) for k in moved if _last(k.child) in BASES]
        robots = [self._pose(k, k.child) for k in moved if k.parent == WORLD and _last(k.child) not in BODIES]
        return [s if named else s._replace(vehicle="") for s in (*bases, *robots)]

    def _pose(self, link: Link, vehicle: str) -> Sample:
        pose, frame = link.pose, link.parent
        for _ in range(DEEPEST):
            above = self._links.get(frame)
            if above is None:
                values = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
                values |= {"heading": math.atan2(pose[1, 0], pose[0, 0]), "map_id": frame}
                return Sample(link.stamp, values, vehicle=vehicle)
            pose, frame = above.pose @ pose, above.parent
        raise ValueError("the frames form a circle")


def _last(frame: str) -> str:
    return frame.rpartition("/")[2]

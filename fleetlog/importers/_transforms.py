"""ROS transforms (/tf, /tf_static): the pose of every robot's base in the frame at the root of its tree.

Frames are named as REP 105 has them; a name in front (``robot1/base_link``) is the vehicle's.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fleetlog.core.arrays import Floats
from fleetlog.importers._messages import normal_name, numbers, stamp_of
from fleetlog.importers._rows import Sample
from fleetlog.importers._wire import Wire, from_json

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


Decode = Callable[[Any], list[Link]]


def decoder(schema: str, encoding: str) -> Decode | None:
    """What reads the messages of a topic of transforms; None for any other."""
    known = normal_name(schema) in ("tf2_msgs/TFMessage", "tf/tfMessage")
    by_encoding: dict[str, Decode] = {
        "cdr": lambda d: _links(Wire(d)), "ros1": lambda d: _links(Wire(d, ros1=True)), "json": _json,
    }  # fmt: skip
    return by_encoding.get(encoding) if known else None


def _links(w: Wire) -> list[Link]:
    (count,) = w.take("I")
    return [_link(*w.header(), w.text(), w.take("d", 7)) for _ in range(count)]


def _json(data: Any) -> list[Link]:
    links = []
    for said in from_json(data)["transforms"]:
        pose, parent = said["transform"], said["header"]["frame_id"]
        place = numbers(pose["translation"], *"xyz") + numbers(pose["rotation"], *"xyzw")
        links.append(_link(stamp_of(said), str(parent), str(said["child_frame_id"]), place))
    return links


def _link(stamp: int, parent: str, child: str, place: Sequence[float]) -> Link:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(place[3:]).as_matrix(), place[:3]
    return Link(parent.strip("/"), child.strip("/"), stamp, pose)


class Transforms:
    """The frames of one recording as they are told."""

    def __init__(self) -> None:
        self._links: dict[str, Link] = {}

    def take(self, decode: Decode, data: Any, *, static: bool, named: bool) -> list[Sample]:
        """Take note of a message; the poses of the bases that it moves, ``named`` after their frames."""
        links = decode(data)
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

"""ROS transforms (/tf, /tf_static): the pose of every robot's base in the frame at the root of its tree.

Frames are named as REP 105 has them; a name in front (``robot1/base_link``) is the vehicle's.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from fleetlog.importers._messages import json_object, json_part, json_stamp, normal_name
from fleetlog.importers._rows import Sample, finite, heading_of_quaternion
from fleetlog.importers._wire import Wire

BASES = ("base_link", "base_footprint")
ODOMETRY = "odom"
"""A frame that drifts; poses in it count where no other frame is above it."""
WORLD = "world"
"""What simulators call the map; frames right below it are robots, but for ``BODIES``."""
BODIES = (*BASES, ODOMETRY, "map")
FRAMES, DEEPEST = 10_000, 64
"""Frames of a recording, and frames above one another, that are believed."""
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Link(NamedTuple):
    """Where a frame lies in its parent: shift [m] and turn (x, y, z, w), at a stamp [us]."""

    parent: str
    child: str
    stamp: int
    shift: Vector
    turn: Quaternion


Decode = Callable[[Any], Iterator[Link]]


def decoder(schema: str, encoding: str) -> Decode | None:
    """What reads the messages of a topic of transforms; None for any other."""
    known = normal_name(schema) in ("tf2_msgs/TFMessage", "tf/tfMessage")
    return {"cdr": _cdr, "ros1": _ros1, "json": _json}.get(encoding) if known else None


def _cdr(data: Any) -> Iterator[Link]:
    return _links(Wire(data))


def _ros1(data: Any) -> Iterator[Link]:
    return _links(Wire(data, ros1=True))


def _links(w: Wire) -> Iterator[Link]:
    for _ in range(w.take("I")[0]):
        (stamp, parent), child = w.header(), w.text()
        x, y, z, *turn = w.take("d", 7)
        yield Link(
            parent.strip("/"), child.strip("/"), stamp, (x, y, z), (turn[0], turn[1], turn[2], turn[3])
        )


def _json(data: Any) -> Iterator[Link]:
    for m in json_object(data)["transforms"]:
        parent, child = (
            str(v).strip("/") for v in (json_part(m, "header").get("frame_id"), m["child_frame_id"])
        )
        shift, turn = (json_part(m, "transform", name) for name in ("translation", "rotation"))
        x, y, z = (finite(shift.get(k)) for k in "xyz")
        a, b, c, d = (finite(turn.get(k)) for k in "xyzw")
        yield Link(parent, child, json_stamp(m), (x, y, z), (a, b, c, d))


class Transforms:
    """The frames of one recording as they are told."""

    def __init__(self) -> None:
        self._links: dict[str, Link] = {}

    def take(self, decode: Decode, data: Any, *, static: bool, named: bool) -> list[Sample]:
        """Take note of a message; the poses of the bases that it moves, ``named`` after their frames."""
        links = list(decode(data))
        if len(self._links) + len(links) > FRAMES and len({*self._links, *(k.child for k in links)}) > FRAMES:
            raise ValueError(f"more than {FRAMES:,} frames")
        self._links |= {link.child: link for link in links}
        moved = [] if static else [k for k in links if _last(k.parent) not in BASES]
        bases = [self._pose(k, k.child.rpartition("/")[0]) for k in moved if _last(k.child) in BASES]
        robots = [self._pose(k, k.child) for k in moved if k.parent == WORLD and _last(k.child) not in BODIES]
        return [s if named else s._replace(vehicle="") for s in (*bases, *robots)]

    def _pose(self, link: Link, vehicle: str) -> Sample:
        shift, turn, frame = link.shift, link.turn, link.parent
        for _ in range(DEEPEST):
            above = self._links.get(frame)
            if above is None:
                x, y, z = shift
                values = {"x": x, "y": y, "z": z, "heading": heading_of_quaternion(*turn), "map_id": frame}
                return Sample(link.stamp, values, vehicle=vehicle)
            moved = rotated(above.turn, shift)
            shift = (above.shift[0] + moved[0], above.shift[1] + moved[1], above.shift[2] + moved[2])
            turn, frame = product(above.turn, turn), above.parent
        raise ValueError("the frames form a circle")


def _last(frame: str) -> str:
    return frame.rpartition("/")[2]


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The turn ``b`` followed by ``a``."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotated(turn: Quaternion, v: Vector) -> Vector:
    """A vector after a turn by a unit quaternion."""
    x, y, z, w = turn
    back = (-x, -y, -z, w)
    return product(product(turn, (*v, 0.0)), back)[:3]

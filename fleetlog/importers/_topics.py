"""From topics to vehicles: which topic says where which truck is, which adds its battery.

ROS transforms (/tf, /tf_static) give the pose of every robot's base in the frame at the root of its tree.
Frames are named as REP 105 has them; a name in front (``robot1/base_link``) is the vehicle's."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.files import open_regular
from fleetlog.core.words import count
from fleetlog.errors import DataError, FormatError
from fleetlog.importers._messages import KINDS, POSITIONS, Topic, normal_name, numbers, readers, stamp_of
from fleetlog.importers._open import ReadReport, plain_stem, refuse_packed
from fleetlog.importers._rows import BATCH, LOOKED_FOR, Rows, Sample
from fleetlog.importers._walk import Walk
from fleetlog.importers.base import RawBatch, ReadOptions

KIND, OLD_KIND = "tf2_msgs/TFMessage", "tf/tfMessage"  # Of transforms
BASES = ("base_link", "base_footprint")
STATIC = "tf_static"  # The end of the name of a topic of frames that do not move
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


def _links(message: dict[str, Any]) -> list[Link]:
    from scipy.spatial.transform import Rotation

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

    def take(self, read: Callable[[Any], Any], data: Any, *, static: bool, named: bool) -> list[Sample]:
        """Take note of a message; the poses of the bases that it moves, ``named`` after their frames."""
        links = _links(read(data))
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
            if (above := self._links.get(frame)) is None:
                values = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
                values |= {"heading": math.atan2(pose[1, 0], pose[0, 0]), "map_id": frame}
                return Sample(link.stamp, values, vehicle=vehicle)
            pose, frame = above.pose @ pose, above.parent
        raise ValueError("the frames form a circle")


def _last(frame: str) -> str:
    return frame.rpartition("/")[2]


LISTED = 12


class Role(NamedTuple):
    """What a topic is used for."""

    vehicle: str
    decode: Callable[[Any], Sample | list[Sample]]
    is_position: bool


def plan(
    topics: Iterable[Topic], path: Path, default: str, one: str | None, report: ReadReport
) -> dict[str, Role]:
    """The role of every topic that is used. A vehicle is told by the part of the names in which topics of one
    kind differ (``/T00/fix``, ``/T01/fix``), else by a name in front of all of them; ``default`` otherwise
    and ``one`` always, if given. Each vehicle takes its position from one topic, the most absolute one."""
    topics = sorted(set(topics))
    wanted = {t: kind for t in topics if (kind := t.kind)}
    placed = any(kind.is_position for kind in wanted.values())
    moved = [] if placed else [t for t in topics if normal_name(t.schema) in (KIND, OLD_KIND)]
    frames = {t: read for t in moved if (read := readers(KIND).get(t.encoding))}
    if not placed and not frames:
        what = "no topic in it, so no position"
        if topics:
            what = f"none of its {count(len(topics), 'topic')} carries a position: {listed(topics)}"
        raise DataError(what, where=path, do="record " + " or ".join(list(KINDS)[:3]))
    naming = [*wanted, *(t for t in frames if not t.name.endswith(STATIC))]
    names = {t.name: one for t in topics} if one else _vehicles(naming, default)
    # Topics of transforms: those of one namespace make one tree of frames.
    roles, trees = dict[str, Role](), defaultdict[str, Transforms](Transforms)
    for topic, read in frames.items():
        tree = trees[topic.name.rpartition("/")[0]]
        take = partial(tree.take, read, static=topic.name.endswith(STATIC), named=not one)
        roles[topic.name] = Role(names.get(topic.name, default), take, True)
    report.recognised |= dict.fromkeys(roles, "position and heading of base_link, from transforms")
    taken: dict[str, str] = {}
    for topic, kind in sorted(wanted.items(), key=lambda item: (item[1].rank, item[0].name)):
        vehicle = names[topic.name]
        if kind.is_position and vehicle in taken:
            why = f"{vehicle} takes its position from {taken[vehicle]}"
            if kind is not KINDS["nav_msgs/Odometry"]:
                report.note(f"topic {topic.name} left out: {why}")
                continue
            report.note(f"only the speed of topic {topic.name} is used: {why}")
        first = kind.is_position and taken.setdefault(vehicle, topic.name) == topic.name
        roles[topic.name] = Role(vehicle, kind.decode[topic.encoding], first)
        report.recognised[topic.name] = f"{kind.meaning}, of {vehicle}"
    if unused := [t for t in topics if t.name not in roles and t not in wanted]:
        report.note(f"{count(len(unused), 'topic')} without position or battery left out: {listed(unused)}")
    return roles


def _vehicles(topics: list[Topic], default: str) -> dict[str, str]:
    segments = {t.name: t.name.strip("/").split("/") for t in topics}
    same: dict[str, list[list[str]]] = defaultdict(list)
    for t in topics:
        same[normal_name(t.schema)].append(segments[t.name])
    group = max(same.values(), key=len)
    if len(group) > 1 and len({len(s) for s in group}) == 1:
        differing = [i for i, column in enumerate(zip(*group, strict=True)) if len(set(column)) > 1]
        if len(differing) == 1:
            at, known = differing[0], {s[differing[0]] for s in group}
            return {n: s[at] if len(s) > at and s[at] in known else default for n, s in segments.items()}
    fronts = {s[0] for s in segments.values() if len(s) > 1}
    whole = len(fronts) == 1 and all(len(s) > 1 for s in segments.values()) and len(topics) > 1
    return dict.fromkeys(segments, fronts.pop() if whole else default)


def listed(topics: list[Topic]) -> str:
    """Topics with their types, the first dozen."""
    shown = ", ".join(f"{t.name} ({t.schema or 'no schema'}, {t.encoding})" for t in topics[:LISTED])
    return shown + (f" and {len(topics) - LISTED} more" if len(topics) > LISTED else "")


class Decoder:
    """Messages in, batches out: positions and channels apart, what cannot be decoded rejected."""

    def __init__(self, roles: Mapping[str, Role], report: ReadReport, share: Callable[[], float]) -> None:
        self.roles, self.report, self._share = roles, report, share
        self._rows: dict[tuple[str, ...], Rows] = {}
        self._log = Rows(share=share)
        self.no_fix: Counter[str] = Counter()
        self.record = 0

    def batches(self, messages: Iterable[tuple[str, int, Any]]) -> Iterator[RawBatch]:
        """The batches that messages fill: of each its topic, when it was received [us], and its data."""
        for message in messages:
            self._feed(*message)
            if self.record % LOOKED_FOR == 0:
                yield from (rows.take() for rows in (*self._rows.values(), self._log) if rows.full)

    def _feed(self, topic: str, time: int, data: Any) -> None:
        self.record += 1
        if (role := self.roles.get(topic)) is None:
            return
        try:
            decoded = role.decode(data)
        except Exception as error:  # whatever a hostile message does, it is one rejected message
            why = f"{type(error).__name__}: {error}"
            self._log.reject(self.record, f"{topic}: message cannot be decoded", why)
            return
        for sample in decoded if isinstance(decoded, list) else [decoded]:
            values = sample.values
            if not role.is_position:
                values = {k: v for k, v in values.items() if k not in POSITIONS}
            elif not sample.fix:
                self.no_fix[topic] += 1
                continue
            if not values:
                continue
            vehicle, frame = sample.vehicle or role.vehicle, values.get("map_id")
            key = (*values, vehicle, frame) if frame else tuple(values)
            if key not in self._rows:
                self._rows[key] = Rows(*values, share=self._share)
            self._rows[key].add(vehicle, sample.stamp or time, self.record, values)

    @property
    def positions(self) -> int:
        """Rows with positions so far."""
        return sum(r.total for names, r in self._rows.items() if "latitude" in names or "x" in names)

    def finish(self) -> Iterator[RawBatch]:
        """What waits; an error where there was not one usable position."""
        if not self.positions:
            topics = ", ".join(name for name, role in self.roles.items() if role.is_position)
            raise self.report.nothing(f"not one usable position on {topics}", "record it again")
        for topic, blind in self.no_fix.items():
            self.report.note(f"{topic}: {count(blind, 'message')} without a fix left out")
        for key, rows in self._rows.items():
            rivals = (k for k in self._rows if k[:-1] == key[:-1] and k != key)
            if key[-1].endswith(ODOMETRY) and rows.total < BATCH and any(rivals):
                drifted = count(rows.total, "pose")
                self.report.note(f"{drifted} of {key[-2]} before {key[-1]!r} had its place on a map left out")
            else:
                yield from rows.drain()
        yield from self._log.drain()


def read_recording(
    kind: type[Walk], path: Path, options: ReadOptions, name: str | None = None
) -> Generator[RawBatch, None, int]:
    """Positions and batteries of a container, in its order; gives the number of whole messages. ``name`` is
    the vehicle's where the topics name none. Without an index the file is walked once for its channels."""
    refuse_packed(path)
    with open_regular(path) as stream:
        if stream.read(len(kind.magic)) != kind.magic:
            raise FormatError(f"is not {kind.called}: its first bytes are others", where=path, do="check it")
        walk = kind(path, stream, options.report)
        if not walk.index():
            scan = kind(path, stream, ReadReport(path))
            for _ in scan.messages():
                pass
            walk.channels = scan.channels
            if not scan.channels and scan.report.damage:
                raise scan.report.nothing("nothing in it is whole", "record it again")
        roles = plan(walk.channels.values(), path, name or plain_stem(path), options.vehicle, options.report)
        decoder = Decoder(roles, options.report, walk.share)
        yield from decoder.batches(walk.messages())
        yield from decoder.finish()
        return walk.count

"""What CARLA's own OpenDRIVE parser makes of a map, as JSON: run as a program, for it may crash and takes the process along.

Waypoints every 2 m of every driving lane: road, section, lane, x, y (right-handed: minus CARLA's), z, heading.  Successors: pairs of
(road, section, lane).
"""

import json
import math
import sys
from pathlib import Path

import carla

ROWS = carla.Map("map", Path(sys.argv[1]).read_text(encoding="utf-8"))


def key(w):
    return f"{w.road_id}:{w.section_id}:{w.lane_id}"


def place(w):
    p = w.transform.location
    return [p.x, -p.y, p.z, -math.radians(w.transform.rotation.yaw)]


waypoints = [[key(w), *place(w)] for w in ROWS.generate_waypoints(2.0)]
pairs = sorted({(key(a), key(b)) for a, b in ROWS.get_topology()})
print(json.dumps({"waypoints": waypoints, "successors": pairs}))

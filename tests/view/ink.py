"""What the headless viewer has drawn: its views by name, and how much colour is in each."""

from __future__ import annotations

import io
import time
from typing import Any

import numpy as np

from fleetlog.view.headless import Viewer

INK = 5e-4
"""Share of coloured points from which a view counts as drawn: frames, grids and axis texts are grey."""


def views(viewer: Viewer) -> dict[str, Any]:
    """Views by name."""
    return {v.name: v for v in viewer.state.views}


def is_drawn(viewer: Viewer, name: str) -> bool:
    """Whether a view gets ink within a while, as data arrive late."""
    viewer.picture()
    view = views(viewer)[name].view_id
    deadline = time.monotonic() + 15.0
    while colour_ink(bytes(viewer.client.take_screenshot(view))) <= INK:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.2)
    return True


def colour_ink(png: bytes) -> float:
    """Share of the points of a PNG that are coloured, not grey."""
    from PIL import Image

    rgb = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
    return float(((rgb.max(axis=2) - rgb.min(axis=2)) > 60).mean())

"""The dynamics of a box, as a recipe writes them (Odobez, Ba & Gatica-Perez 2003, section 3.2)."""

from __future__ import annotations

import numpy as np

from facetrack_cli.engine.motion import FirstOrder
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions import settings as regions


def first_order(settings: regions.FirstOrder, context: Context) -> FirstOrder:
    noise = [[length.pixels(context.placed.unit) for length in row] for row in settings.position.B]
    scale = np.array(settings.scale.A), np.array(settings.scale.B)
    return FirstOrder((np.array(settings.position.A), np.array(noise)), scale, *context.placed.scale)

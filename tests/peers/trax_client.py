"""A session of vot-toolkit's own client, as JSON: `PYTHON trax_client.py COMMAND`; the Python has vot-toolkit.

The sequence is the one of the toolkit's own `vot test`: a cow that goes round. Imports nothing of ours.
"""

import json
import sys
import typing

# see read_exports.py
_transform = typing.__dict__.pop("dataclass_transform", None)
import attributee  # noqa: E402, F401

if _transform is not None:
    typing.dataclass_transform = _transform

from vot.dataset.dummy import generate_dummy  # noqa: E402
from vot.region import Rectangle  # noqa: E402
from vot.tracker.trax import TrackerProcess, TraxException  # noqa: E402


def box(region):
    return [region.x, region.y, region.width, region.height]


def main():
    sequence = generate_dummy(100)
    process = TrackerProcess(sys.argv[1], timeout=120, log=lambda _: None)
    truth = [sequence.groundtruth(i) for i in range(12)]
    states = [process.initialize(sequence.frame(0), truth[0])[0]]
    states += [process.update(sequence.frame(i))[0] for i in range(1, 12)]
    again = process.initialize(sequence.frame(3), truth[3])[0]
    found = {
        "boxes": [box(one[0].region) for one in states],
        "truth": [box(one) for one in truth],
        "confidence": [float(one[0].properties["confidence"]) for one in states],
        "again": box(again[0].region),
        "name": process._client.tracker_name,
    }
    try:
        process.initialize(sequence.frame(0), Rectangle(1, 1, 0, 0))
    except TraxException as e:
        found["refused"] = str(e)
    process.terminate()
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()

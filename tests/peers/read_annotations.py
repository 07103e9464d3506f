"""What annotation tools read in exported files, as JSON: `PYTHON read_annotations.py FOLDER`

Run by the Python that has them (annotation.txt); imports nothing of ours. The folder holds cvat/annotations.xml,
mot/gt/gt.txt and track.labelstudio.json.
"""

import json
import sys
from pathlib import Path

from datumaro import Dataset
from label_studio_sdk._extensions.label_studio_tools.postprocessing.video import extract_key_frames


def cvat(folder):
    """Of each frame its shapes: label, kind, points, attributes."""
    dataset = Dataset.import_from(str(folder), "cvat")
    (labels,) = dataset.categories().values()
    shapes = {
        item.attributes["frame"]: [
            {"label": labels[one.label].name, "kind": one.type.name, "points": list(one.points), **one.attributes}
            for one in item.annotations
        ]
        for item in dataset
    }
    return {"labels": [one.name for one in labels], "frames": shapes}


def mot(folder):
    """Of each frame its boxes: left and top from 0, width, height, and attributes."""
    dataset = Dataset.import_from(str(folder), "mot_seq")
    return {item.id: [{"box": list(one.get_bbox()), **one.attributes} for one in item.annotations] for item in dataset}


def label_studio(path):
    """The regions, with what the SDK adds between keyframes."""
    (task,) = json.loads(path.read_text(encoding="utf-8"))
    (annotation,) = task["annotations"]
    return extract_key_frames(annotation["result"])


def main():
    folder = Path(sys.argv[1])
    found = {
        "cvat": cvat(folder / "cvat"),
        "mot": mot(folder / "mot"),
        "label_studio": label_studio(folder / "track.labelstudio.json"),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()

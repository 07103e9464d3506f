#!/usr/bin/env bash
# Two faces are annotated, one comes out, and its points are on whole pixels.
#
# Found: the converter of label-studio-sdk 2.1.2 makes COCO keypoints of Label Studio's annotations (a KeyPointLabels tag
# with model_index). All points of a picture become ONE annotation: of two faces with the same labels the points that
# come later in the file replace the earlier ones, so that the first face is gone, or a face is made of the nose of one
# and the chin of the other. There is no message. Every place is rounded to whole pixels, half a pixel off at most, and
# the visibility is always 2.
# Packages: label-studio-sdk 2.1.2 with pillow 12.3.0.
# Data: a black picture and made-up points, written here.
# Output seen:
#   two whole faces: 1 annotation, keypoints [400, 60, 2, 402, 121, 2]
#   a face, and the nose of another: 1 annotation, keypoints [400, 60, 2, 101, 90, 2]
# Exit code: 0 the behaviour is as described, 1 it is another.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet --disable-pip-version-check label-studio-sdk==2.1.2 pillow==12.3.0
env/bin/python - <<'PYTHON'
import json
import sys
from pathlib import Path

from label_studio_sdk.converter import Converter
from PIL import Image

CONFIG = """<View><Image name="image" value="$image"/><KeyPointLabels name="kp" toName="image">
<Label value="nose" model_index="0"/><Label value="chin" model_index="1"/></KeyPointLabels></View>"""
Path("pictures").mkdir()
Image.new("RGB", (640, 480)).save("pictures/a.png")


def converted(name, *points):
    result = [
        {
            "id": f"p{k}", "type": "keypointlabels", "from_name": "kp", "to_name": "image",
            "original_width": 640, "original_height": 480,
            "value": {"x": x / 6.4, "y": y / 4.8, "width": 0.5, "keypointlabels": [label]},
        }
        for k, (label, x, y) in enumerate(points)
    ]
    task = {"id": 1, "data": {"image": "pictures/a.png"}, "annotations": [{"id": 1, "completed_by": 1, "result": result}]}
    Path(f"{name}.json").write_text(json.dumps([task]))
    Converter(CONFIG, project_dir=None, download_resources=False).convert_to_coco(f"{name}.json", name, is_dir=False)
    return [one["keypoints"] for one in json.loads(Path(name, "result.json").read_text())["annotations"]]


first = [("nose", 100.4, 50.6), ("chin", 101.2, 90.0)]
both = converted("both", *first, ("nose", 400.25, 60.0), ("chin", 402.0, 120.75))
mixed = converted("mixed", *first, ("nose", 400.25, 60.0))
for what, found in (("two whole faces", both), ("a face, and the nose of another", mixed)):
    print(f"{what}: {len(found)} annotation, keypoints {found[0]}")
sys.exit(both != [[400, 60, 2, 402, 121, 2]] or mixed != [[400, 60, 2, 101, 90, 2]])
PYTHON

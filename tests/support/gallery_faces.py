"""Small images of the two portraits that installed packages carry, in other light from image to image."""

from functools import cache

import cv2
import numpy as np
import pytest

NAMES = ("collins", "hopper")


@cache
def _portrait(name):
    """(H, W, 3) BGR, some 160 pixels wide, the face in its middle."""
    if name == "collins":
        data = pytest.importorskip("skimage.data", reason="needs the extra: pip install -e '.[samples]'")
        picture, (left, top, right, bottom) = data.astronaut()[:, :, ::-1], (130, 0, 320, 230)
    else:
        cbook = pytest.importorskip("matplotlib.cbook")
        picture = cv2.imread(str(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)))
        left, top, right, bottom = 90, 10, 420, 420
    part = picture[top:bottom, left:right]
    zoom = 160 / part.shape[1]
    return cv2.resize(np.ascontiguousarray(part), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)


def face_of(name, number):
    """An image of the portrait: the light comes from another side in each, and it tilts a little."""
    picture = _portrait(name).astype(np.float32)
    height, width = picture.shape[:2]
    light = 1 + 0.35 * np.sin(1.7 * number) * np.linspace(-1, 1, width)[:, None]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 4 * np.sin(number), 1.0)
    lit = cv2.warpAffine(picture, turn, (width, height), borderMode=cv2.BORDER_REPLICATE) * light
    return np.clip(lit, 0, 255).astype(np.uint8)


def people_folder(folder, pictures):
    """A folder of both persons, with so many images each."""
    for name in NAMES:
        (folder / name).mkdir(parents=True)
        for number in range(pictures):
            cv2.imwrite(str(folder / name / f"{number + 1}.png"), face_of(name, number))
    return folder

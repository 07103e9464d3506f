"""Slow, plain twins of the box measures, written from the definitions and from nothing of ours."""


def iou(a, b):
    """Intersection over union of two boxes [left, top, w, h]."""
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if across <= 0 or down <= 0:
        return 0.0
    return across * down / (a[2] * a[3] + b[2] * b[3] - across * down)


def clip(box, width, height):
    """GOT-10k's: the corner is moved into the image, then the size is cut at its border."""
    left, top = min(max(box[0], 0), width), min(max(box[1], 0), height)
    return [left, top, min(max(box[2], 0), width - left), min(max(box[3], 0), height - top)]

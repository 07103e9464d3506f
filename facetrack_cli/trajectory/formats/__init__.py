"""Trajectories and ground truth as other tools write and read them."""

TRUTH_FORMATS = ("auto", "facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts", "cvat")
# of exports: those of a single target, of boxes, and those that name the clip or its size
ONE_TARGET = ("otb", "got10k", "vot")
OF_BOXES = ("mot", *ONE_TARGET, "coco")
OF_MEDIA = ("openface", "coco", "eaf", "cvat", "labelstudio")

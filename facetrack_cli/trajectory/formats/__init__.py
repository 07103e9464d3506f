"""Trajectories and ground truth as other tools write and read them."""

TRUTH_FORMATS = ("auto", "facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts", "cvat")

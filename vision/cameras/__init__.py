"""Cameras: intrinsics, lens models, calibration files. Begin reading at `vision.cameras.camera`."""

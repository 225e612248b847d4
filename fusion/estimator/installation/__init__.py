"""Checks of the installation in flight: whether camera, gyroscope and attitude are mounted and scaled as configured.

`checks` is the part of the state that the engine updates; it reports the faults. It uses `camera_yaw` (the camera
points to one side), `focal_length` and `frame_timing` (frames stamped early or late). `running_slope` fits the
straight line, with its sigma, of the first two.
"""

"""Cameras: intrinsics, lens models, mounting, and the files they are read from.

Imports nothing else of `vision` but its types, errors and rotations. Begin reading at `vision.cameras.camera`: the
`Camera` that everything else is given. Lens models are in `vision.cameras.lens`; `vision.cameras.calibration` chooses
the reader of a file, `vision.cameras.matrix_files` reads ROS's and OpenCV's, `vision.cameras.fields` checks single
fields; `vision.cameras.imu_noise` reads the IMU's calibration that comes in the same kind of file.
"""

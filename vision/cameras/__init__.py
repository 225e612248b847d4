"""Cameras: intrinsics, lens models, mounting, and the files they are read from.

Imports only basic modules of `vision`, such as types, errors and limits. Begin reading at `vision.cameras.camera`,
which defines `Camera`; `vision.cameras.lens` contains the lens models. `vision.cameras.calibration` selects the
reader of a file: `vision.cameras.matrix_files` for ROS's and OpenCV's, `vision.cameras.slam_files` for those of SLAM
systems. `vision.cameras.fields` checks single fields. `vision.cameras.imu_noise` reads IMU calibrations.
"""

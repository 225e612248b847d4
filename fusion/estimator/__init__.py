"""The streaming estimator: an extended Kalman filter over gyroscope, IMU yaw, frames and ranges.

Knows nothing of logs, reports, plots or the command line: it imports `vision`, `fusion.settings` and `fusion.flight`
only. Begin reading at `fusion.estimator.estimator`, then `fusion.estimator.frame_update`.
"""

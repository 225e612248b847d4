"""The streaming estimator: an extended Kalman filter over gyroscope, IMU yaw, frames, velocities and ranges.

It is independent of logs, reports, plots and the command line: it only imports `vision`, `fusion.settings` and
`fusion.flight`. Begin reading at `fusion.estimator.estimator`, the public class, then `fusion.estimator.engine`,
which calls the parts:

- heading: `propagation` (dead reckoning), `tilt`, `sensing` and `gyro_run` (many samples in one call), `imu_yaw`,
  `corridor_axis`, `axis_acquisition`, `junctions` and `votes`;
- frames: `frame_update` (a frame's measurement and outcome), `frame_fusion` (its effect on all parts);
- lateral offset: the package `lateral`; `velocity`, `range_width`;
- camera: `camera_delay`, `camera_elevation`, `camera_repeats`;
- fault detection: the package `installation` (mounts, scales and time stamps), `gyro_checks`, `imu_yaw_check`,
  `frame_drift` (slopes of frames minus gyroscope and minus IMU yaw), `attitude_drift` (the same without a gyroscope),
  `hypotheses` (fault isolation), `axis_drift` (correction of the filter), `faults`;
- the filter: `ekf`, `models`, `kernels`, `noise_adaptation`, `frame_noise`, `filterpy_ekf` (for inspection);
- samples and time: `input_checks`, `arrivals` (clocks), `timeline` (late samples), `sample_times`, `seed`,
  `records`, `state`;
- results: `estimate`, `notices` (status and faults), `diagnostics` (covariance and innovations), `resets`, `events`,
  `tables`, `filter_table`, `smoother`, `smoothed_table`, `fixed_lag`;
- settings: `config`.

Each part takes a sample and returns its own immutable field of `state.State`; some also update the filter that the
engine passes to them.
"""

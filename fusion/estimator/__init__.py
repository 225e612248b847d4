"""The streaming estimator: an extended Kalman filter over gyroscope, IMU yaw, frames, velocities and ranges.

Knows nothing of logs, reports, plots or the command line: it imports `vision`, `fusion.settings` and `fusion.flight`
only. Begin reading at `fusion.estimator.estimator`, what a program calls, then `fusion.estimator.engine`, which
orders the parts:

- heading: `propagation` and `gyro_run` (dead reckoning), `tilt`, `imu_yaw`, `corridor_axis`, `junctions` and `votes`,
  `frame_update` (a frame's measurement and outcome);
- lateral offset: `lateral`, `lateral_status`, `lateral_offset` with `lateral_kernels` and `lateral_mixture_kernels`,
  `lateral_parallax`, `lateral_smoother`, `velocity`, `range_width`;
- camera: `camera_delay`, `camera_elevation`, `camera_repeats`, `camera_yaw` and `focal_length` (both by
  `running_slope`);
- fault detection: `gyro_checks`, `imu_yaw_check`, `installation_checks`, `frame_timing` (early or late stamps),
  `frame_drift` (slopes of frames minus gyroscope and minus IMU yaw), `hypotheses` (which sensor is wrong),
  `axis_drift` (what follows from it), `faults`;
- the filter: `ekf`, `models`, `kernels`, `noise_adaptation`, `frame_noise`, `filterpy_ekf` (for inspection);
- samples and time: `input_checks`, `arrivals` (clocks), `timeline` (samples in any order), `sample_times`, `seed`,
  `records`, `state`;
- results: `estimate`, `diagnostics` (covariance and innovations), `resets`, `events`, `tables`, `filter_table`,
  `smoother`, `smoothed_table`, `fixed_lag`;
- settings: `config`.

Parts take samples and return their own immutable part of `state.State`; some update the filter that the engine
passes.
"""

"""The streaming estimator: an extended Kalman filter over gyroscope, IMU yaw, frames, velocities and ranges.

Knows nothing of logs, reports, plots or the command line: it imports `vision`, `fusion.settings` and `fusion.flight`
only. Begin reading at `fusion.estimator.estimator`, what a program calls, then `fusion.estimator.engine`, which
orders the parts:

- one per thing that is estimated: `propagation` and `tilt` (what carries the heading), `imu_yaw`, `corridor_axis`
  and `junctions`, `lateral`, `range_width`, `velocity`, `camera_delay`, `camera_elevation`; each takes samples and
  returns its own immutable share of `state.State`; some correct the filter that the engine hands them;
- what they share: the filter (`ekf`, `models`, `kernels`), who is wrong where sources part (`hypotheses`),
  `noise_adaptation`, `votes`, `sample_times`;
- around the engine: `timeline` (samples in any order), `estimate` (what is reported), `smoother`, `fixed_lag`,
  `smoothed_table` and `tables`.
"""

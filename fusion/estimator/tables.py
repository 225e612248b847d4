"""The three tables a fused flight consists of: their columns, and how they are written.

A table is a numpy structured array whose field names are the CSV's columns, so ``table["heading_rad"]`` works
and ``pandas.DataFrame(table)`` takes it as it is. Unknown numbers are NaN in memory and empty in the file.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Table = npt.NDArray[np.void]

ESTIMATE_DTYPE = np.dtype(
    [
        ("timestamp_ns", "i8"),
        ("heading_rad", "f8"),
        ("heading_std_rad", "f8"),
        ("lateral_offset_m", "f8"),
        ("lateral_offset_std_m", "f8"),
        ("lateral_offset_norm", "f8"),
        ("lateral_offset_norm_std", "f8"),
        ("position", "U6"),
        ("yaw_rate_rad_s", "f8"),
        ("gyro_bias_rad_s", "f8"),
        ("imu_yaw_offset_rad", "f8"),
        ("corridor_index", "i4"),
        ("corridor_turn_rad", "f8"),
        ("status", "U12"),
        ("vision_age_s", "f8"),
    ]
)

FRAME_DTYPE = np.dtype(
    [
        ("timestamp_ns", "i8"),
        ("accepted", "?"),
        ("reason", "U16"),
        ("n_lines", "i4"),
        ("n_inliers", "i4"),
        ("vp_x_px", "f8"),
        ("vp_y_px", "f8"),
        ("heading_rad", "f8"),
        ("heading_std_rad", "f8"),
        ("lateral_offset_norm", "f8"),
        ("lateral_offset_norm_std", "f8"),
        ("position", "U6"),
        ("paper_yaw_rad", "f8"),
        ("innovation_rad", "f8"),
        ("test_ratio", "f8"),
        ("vision_ms", "f8"),
    ]
)

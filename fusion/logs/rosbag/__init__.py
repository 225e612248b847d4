"""ROS 1 and ROS 2 bags and MCAP files.

Begin reading at `fusion.logs.rosbag.bag`, the log format. `fusion.logs.rosbag.file` opens bags with rosbags,
`fusion.logs.rosbag.recovery` truncated ones; `fusion.logs.rosbag.topics` reads one in a single pass and decodes the
types in `fusion.logs.rosbag.messages`.
"""

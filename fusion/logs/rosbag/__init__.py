"""ROS 1 and ROS 2 bags and MCAP files.

Begin reading at `fusion.logs.rosbag.bag`, the log format. `fusion.logs.rosbag.file` opens bags with rosbags,
`fusion.logs.rosbag.recovery` those that were cut; `fusion.logs.rosbag.topics` goes through one once, unpacking what
`fusion.logs.rosbag.messages` knows.
"""

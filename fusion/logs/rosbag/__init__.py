"""ROS 1 and ROS 2 bags and MCAP files. Begin reading at `fusion.logs.rosbag.bag`."""

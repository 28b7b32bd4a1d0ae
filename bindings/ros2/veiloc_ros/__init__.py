"""The ROS 2 node of veiloc: `ros2 launch veiloc_ros localizer.launch.py`, or `python -m veiloc_ros.localizer`."""

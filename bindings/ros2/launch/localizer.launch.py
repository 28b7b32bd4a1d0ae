"""Starts the localizer: `ros2 launch veiloc_ros localizer.launch.py map_file:=/maps/hall.vmap`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory("veiloc_ros"))
    arguments = {
        "map_file": ("", "map file to localize in; or server and map_name"),
        "server": ("", "address of a service"),
        "map_name": ("", "name of the map at the service"),
        "parameters": (str(share / "config/localizer.yaml"), "file of parameters"),
        "pose_topic": ("~/pose", "topic of the poses; /amcl_pose for Nav2"),
        "use_sim_time": ("false", "take the time of /clock, as with a bag"),
        "rviz": ("false", "show the pose in rviz"),
    }
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in arguments.items()]
    own = [{name: LaunchConfiguration(name)} for name in ("map_file", "server", "map_name", "use_sim_time")]
    localizer = Node(
        package="veiloc_ros",
        executable="localizer",
        name="localizer",
        output="screen",
        parameters=[LaunchConfiguration("parameters"), *own],
        remappings=[("~/pose", LaunchConfiguration("pose_topic"))],
    )
    rviz = Node(
        package="rviz2", executable="rviz2", arguments=["-d", str(share / "config/localizer.rviz")], condition=IfCondition(LaunchConfiguration("rviz"))
    )
    return LaunchDescription([*declared, localizer, rviz])

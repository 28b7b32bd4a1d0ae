"""The ROS 2 package veiloc_ros, for colcon (ament_python)."""

from setuptools import setup

NAME = "veiloc_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/localizer.launch.py"]),
        (f"share/{NAME}/config", ["config/localizer.yaml", "config/localizer.rviz"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="Localizes a robot in a veiloc map: sealed queries leave the robot, and no image.",
    license="MIT OR Apache-2.0",
    entry_points={"console_scripts": [f"localizer = {NAME}.localizer:main"]},
)

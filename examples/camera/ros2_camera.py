#!/usr/bin/env python3
"""An image topic of ROS 2 as a camera for vservo: `camera.source = "external"`. See docs/cameras.md.

    ros2_camera.py /camera/image_raw

Needs numpy and iceoryx2 in the Python that has rclpy and sensor_msgs (`source /opt/ros/DISTRO/setup.bash`).

This sample was not run with ROS 2, which was not there; what turns messages into images was tried with messages that were made
by hand.
"""
import argparse
import os
import sys
import time

import numpy as np

from external_camera import Images

# Encodings of sensor_msgs/Image: bytes of a pixel, and the four letters of vservo's formats.
FORMATS = {
    "mono8": (1, "GREY"), "8UC1": (1, "GREY"), "bgr8": (3, "BGR3"), "rgb8": (3, "RGB3"), "mono16": (2, "Y16"), "16UC1": (2, "Y16"),
    "yuv422_yuy2": (2, "YUYV"), "yuv422": (2, "UYVY"), "uyvy": (2, "UYVY"),
}


def image_of(message):
    """Pixels, rows x columns or rows x columns x bytes, and their format."""
    if message.encoding not in FORMATS:
        raise ValueError(f"encoding {message.encoding} is none of {', '.join(FORMATS)}")
    size, letters = FORMATS[message.encoding]
    if letters == "Y16" and message.is_bigendian:
        raise ValueError("mono16 with the high byte first is not taken")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    pixels = rows[:, :message.width * size]
    return (pixels if size == 1 else pixels.reshape(message.height, message.width, size)), letters


def exposed(stamp):
    """The stamp of a header, which counts from 1970, by CLOCK_MONOTONIC, ns. Drivers stamp the exposure or the arrival: `vservo
    calibrate latency` finds the constant part of the difference."""
    since_1970_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
    return since_1970_ns - (time.time_ns() - time.monotonic_ns()) if since_1970_ns else 0


def main():
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Image

    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("topic", help="of sensor_msgs/msg/Image")
    p.add_argument("--no-stamps", action="store_true", help="the stamps are of another clock, as those of simulators are")
    p.add_argument("--instance", default=os.environ.get("VSERVO_INSTANCE", "default"))
    p.add_argument("--camera", type=int, default=int(os.environ.get("VSERVO_CAMERA", "0")))
    a = p.parse_args()
    images = Images(a.instance, a.camera)

    def send(message):
        try:
            pixels, letters = image_of(message)
        except ValueError as e:
            sys.exit(f"ros2 camera: {a.topic}: {e}")
        # Messages have no number of their own: what ROS drops on the way cannot be counted.
        images.send(pixels, stamp_ns=0 if a.no_stamps else exposed(message.header.stamp), format=letters)

    rclpy.init()
    node = rclpy.create_node("vservo_camera")
    # Best effort, as drivers of cameras publish; a reliable publisher is received by it too.
    node.create_subscription(Image, a.topic, send, qos_profile_sensor_data)
    rclpy.spin(node)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""The left infrared imager of a RealSense camera for vservo: `camera.source = "external"`. See docs/cameras.md.

    realsense_camera.py [--size 640x480] [--rate 60] [--serial NUMBER]

It is the imager with a global shutter; its projector is switched off, whose dots no finder needs. What the camera tells of its
lens is printed as it goes into the run file. Needs numpy, iceoryx2 and pyrealsense2.

This sample was not run with a camera: none was there. Its calls were held against pyrealsense2 2.x.
"""
import argparse
import os
import sys
import time

import numpy as np
import pyrealsense2 as rs

from external_camera import Images

META = rs.frame_metadata_value


def metadata(frame, what):
    """A value of the frame's metadata, us; None where camera or kernel give none."""
    return frame.get_frame_metadata(what) if frame.supports_frame_metadata(what) else None


def exposed(frame):
    """Middle of the exposure by CLOCK_MONOTONIC, ns; 0 where the camera's clock was not mapped to that of this machine."""
    if frame.get_frame_timestamp_domain() == rs.timestamp_domain.hardware_clock:
        return 0
    # Milliseconds since 1970, of the moment at which the readout began.
    stamp_ns = round(frame.get_timestamp() * 1e6) - (time.time_ns() - time.monotonic_ns())
    middle_us, readout_us = metadata(frame, META.sensor_timestamp), metadata(frame, META.frame_timestamp)
    if middle_us is not None and readout_us is not None:
        stamp_ns -= 1000 * (readout_us - middle_us)
    return stamp_ns


def print_lens(profile):
    i = profile.get_stream(rs.stream.infrared, 1).as_video_stream_profile().get_intrinsics()
    print("# [camera.lens] as the camera tells it; `vservo calibrate camera` finds it more exactly", file=sys.stderr)
    print(f"# fx_px = {i.fx:.2f}\n# fy_px = {i.fy:.2f}\n# cx_px = {i.ppx:.2f}\n# cy_px = {i.ppy:.2f}", file=sys.stderr)
    if any(i.coeffs):
        print(f"# distortion {i.model}: {i.coeffs}", file=sys.stderr)


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--size", default="640x480", help="columns and rows")
    p.add_argument("--rate", type=int, default=60, help="images a second: 6, 15, 30, 60 or 90")
    p.add_argument("--serial", help="of which camera; left out: the first one")
    p.add_argument("--instance", default=os.environ.get("VSERVO_INSTANCE", "default"))
    p.add_argument("--camera", type=int, default=int(os.environ.get("VSERVO_CAMERA", "0")))
    a = p.parse_args()
    width, height = (int(side) for side in a.size.split("x"))
    config = rs.config()
    if a.serial:
        config.enable_device(a.serial)
    config.enable_stream(rs.stream.infrared, 1, width, height, rs.format.y8, a.rate)
    images = Images(a.instance, a.camera)
    pipeline = rs.pipeline()
    profile = pipeline.start(config)
    try:
        depth = profile.get_device().first_depth_sensor()
        if depth.supports(rs.option.emitter_enabled):
            depth.set_option(rs.option.emitter_enabled, 0)
        if depth.supports(rs.option.global_time_enabled):
            depth.set_option(rs.option.global_time_enabled, 1)
        print_lens(profile)
        while True:
            # Raises an exception when none comes for 5 s: the end of this program is then told by vservo.
            frame = pipeline.wait_for_frames(5000).get_infrared_frame(1)
            exposure_us = metadata(frame, META.actual_exposure) or 0
            images.send(np.asanyarray(frame.get_data()), stamp_ns=exposed(frame), exposure_ns=1000 * exposure_us,
                        sequence=frame.get_frame_number())
    finally:
        pipeline.stop()


if __name__ == "__main__":
    main()

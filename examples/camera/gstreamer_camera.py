#!/usr/bin/env python3
"""Everything that GStreamer reads as a camera for vservo: `camera.source = "external"`. See docs/cameras.md.

    gstreamer_camera.py "videotestsrc is-live=true pattern=ball ! video/x-raw,width=640,height=480,framerate=60/1"
    gstreamer_camera.py "v4l2src device=/dev/video0"
    gstreamer_camera.py "rtspsrc location=rtsp://camera/stream latency=0 ! decodebin"

What is given is the begin of a pipeline; its images are turned into grey and handed to an `appsink`. Needs numpy, iceoryx2,
and of Debian or Ubuntu: python3-gi gir1.2-gst-plugins-base-1.0 gstreamer1.0-plugins-base (a virtual environment sees python3-gi
with --system-site-packages).
"""
import argparse
import os
import sys

import gi
import numpy as np

from external_camera import Images

gi.require_version("Gst", "1.0")
from gi.repository import Gst  # noqa: E402

# Images that may wait in the appsink: a program that is held up for longer loses the older ones, which their numbers tell.
WAITING = 2
# Longest wait for an image between two looks at the pipeline's messages, ns.
LOOK_NS = 200_000_000


def grey(sample):
    """The image of a sample, without what its rows are padded with."""
    form = sample.get_caps().get_structure(0)
    width, height = form.get_value("width"), form.get_value("height")
    buffer = sample.get_buffer()
    pixels = np.frombuffer(buffer.extract_dup(0, buffer.get_size()), np.uint8)
    return pixels.reshape(height, -1)[:, :width]


def exposed(sample, base_time):
    """When it was taken, by CLOCK_MONOTONIC, in which the pipeline's clock counts; 0 where the source does not say. Sources stamp
    the capture or the arrival: `vservo calibrate latency` finds the constant part of the difference."""
    time = sample.get_segment().to_running_time(Gst.Format.TIME, sample.get_buffer().pts)
    return 0 if time == Gst.CLOCK_TIME_NONE else base_time + time


def number(sample):
    """The source's own number of it, where it counts: what is dropped on the way is then counted as lost."""
    offset = sample.get_buffer().offset
    return None if offset == Gst.BUFFER_OFFSET_NONE else offset


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("pipeline", help="the begin of a pipeline, as gst-launch-1.0 takes it, up to raw images")
    p.add_argument("--instance", default=os.environ.get("VSERVO_INSTANCE", "default"))
    p.add_argument("--camera", type=int, default=int(os.environ.get("VSERVO_CAMERA", "0")))
    a = p.parse_args()
    Gst.init(None)
    end = f"videoconvert ! video/x-raw,format=GRAY8 ! appsink name=end sync=false drop=true max-buffers={WAITING}"
    pipeline = Gst.parse_launch(f"{a.pipeline} ! {end}")
    clock = Gst.SystemClock.obtain()  # which is that of the machine since its start
    pipeline.use_clock(clock)
    sink, bus = pipeline.get_by_name("end"), pipeline.get_bus()
    images = Images(a.instance, a.camera)
    pipeline.set_state(Gst.State.PLAYING)
    try:
        while True:
            sample = sink.emit("try-pull-sample", LOOK_NS)
            if sample is not None:
                images.send(grey(sample), stamp_ns=exposed(sample, pipeline.get_base_time()), sequence=number(sample))
                continue
            message = bus.pop_filtered(Gst.MessageType.ERROR | Gst.MessageType.EOS)
            if message is not None and message.type == Gst.MessageType.ERROR:
                sys.exit(f"gstreamer camera: {message.parse_error()[0].message}")
            if message is not None:
                sys.exit("gstreamer camera: the pipeline gives no more images")
    finally:
        pipeline.set_state(Gst.State.NULL)


if __name__ == "__main__":
    main()

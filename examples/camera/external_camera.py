#!/usr/bin/env python3
"""A camera for vservo in another program: `camera.source = "external"`. See docs/cameras.md.

    external_camera.py synthetic [--size 640x480] [--rate 60]     a moving pattern, made with numpy
    external_camera.py opencv DEVICE_OR_FILE_OR_URL               cv2.VideoCapture

`Images` is all that a program of your own needs: make one, and call `send` with each image.
"""
import argparse
import ctypes
import os
import sys
import time

import iceoryx2 as iox2
import numpy as np


class ImageHeader(ctypes.Structure):
    _fields_ = [("sequence", ctypes.c_uint64), ("stamp", ctypes.c_int64), ("exposure_span_ns", ctypes.c_uint64),
                ("format", ctypes.c_uint32), ("width_px", ctypes.c_uint32), ("height_px", ctypes.c_uint32),
                ("stride_bytes", ctypes.c_uint32), ("flags", ctypes.c_uint32), ("reserved", ctypes.c_uint32)]

    @staticmethod
    def type_name():
        return "vservo.ImageHeader.v1"


def four_letters(text):
    return int.from_bytes(text.ljust(4).encode(), "little")


class Images:
    """`camera/N/image`. vservo makes the service; this end waits for it."""

    def __init__(self, instance, camera=0, most_bytes=640 * 480 * 3):
        root, prefix = f"/dev/shm/vservo-{instance}", f"vservo.{instance}."
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(os.environ.get("VSERVO_PREFIX", prefix))
        config.global_cfg.root_path = iox2.Path.new(os.environ.get("VSERVO_ROOT", root))
        iox2.set_log_level(iox2.LogLevel.Fatal)
        builder = iox2.NodeBuilder.new().config(config)
        self.node = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)
        name = iox2.ServiceName.new(f"camera/{camera}/image")
        bytes_ = iox2.Slice[ctypes.c_uint8]
        images = patiently(lambda: self.node.service_builder(name).publish_subscribe(bytes_).user_header(ImageHeader).open())
        bell = patiently(lambda: self.node.service_builder(name).event().open())
        self.notifier = patiently(lambda: bell.notifier_builder().create())
        publisher = images.publisher_builder().initial_max_slice_len(most_bytes)
        self.publisher = publisher.allocation_strategy(iox2.AllocationStrategy.PowerOfTwo).create()
        self.sequence = 0

    def send(self, image, stamp_ns=0, exposure_ns=0, sequence=None, format=None):
        """image: uint8, rows x columns (grey) or rows x columns x 3 (BGR, as OpenCV has it). stamp_ns: middle of its
        exposure by CLOCK_MONOTONIC (time.monotonic_ns()); 0 where it is not known. sequence: the camera's own number, so
        that a gap is counted as lost; left out, images are counted here."""
        if image.dtype != np.uint8:
            raise TypeError(f"uint8 is needed, not {image.dtype}")
        image = np.ascontiguousarray(image)
        sample = self.publisher.loan_slice_uninit(image.nbytes)
        ctypes.memmove(sample.payload().as_ptr(), image.ctypes.data, image.nbytes)
        sequence = self.sequence if sequence is None else sequence
        self.sequence = sequence + 1
        h = sample.user_header().contents
        h.sequence, h.stamp, h.exposure_span_ns = sequence, stamp_ns, exposure_ns
        h.format = four_letters(format or ("GREY" if image.ndim == 2 else "BGR3"))
        h.height_px, h.width_px = image.shape[:2]
        h.stride_bytes = h.flags = h.reserved = 0
        sample.assume_init().send()
        self.notifier.notify()


def patiently(open_):
    """Opens a service as soon as it is there; says why it cannot, now and then."""
    said = time.monotonic()
    while True:
        try:
            return open_()
        except Exception as e:
            if time.monotonic() - said > 4.0:
                said = time.monotonic()
                print(f"external camera: not yet: {e}", file=sys.stderr)
            time.sleep(0.01)


def synthetic(images, size, rate):
    """A bright bar that moves by a column an image. A period that was missed is a number that is left out."""
    width, height = size
    begin, k = time.monotonic_ns(), 0
    while True:
        due = begin + round(k * 1e9 / rate)
        now = time.monotonic_ns()
        if now < due:
            time.sleep((due - now) * 1e-9)
        image = np.full((height, width), 40, np.uint8)
        image[:, k % width] = 220
        images.send(image, stamp_ns=due, exposure_ns=1_000_000, sequence=k)
        k += 1 + max(0, int((time.monotonic_ns() - due) * 1e-9 * rate) - 1)


def opencv(images, what):
    """Everything that OpenCV reads. It does not say when an image was exposed: its arrival is told, and
    `vservo calibrate latency` finds the constant part of the delay. What OpenCV itself drops nobody can count."""
    import cv2

    capture = cv2.VideoCapture(int(what) if what.isdigit() else what)
    if not capture.isOpened():
        sys.exit(f"external camera: cannot open {what}")
    while True:
        good, image = capture.read()
        if not good:
            sys.exit(f"external camera: {what} gives no more images")
        images.send(image, stamp_ns=time.monotonic_ns())


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("source", choices=["synthetic", "opencv"])
    p.add_argument("what", nargs="?", default="0", help="opencv: number of a device, file or URL")
    p.add_argument("--size", default="640x480", help="synthetic: columns and rows")
    p.add_argument("--rate", type=float, default=60.0, help="synthetic: images a second")
    p.add_argument("--instance", default=os.environ.get("VSERVO_INSTANCE", "default"))
    p.add_argument("--camera", type=int, default=int(os.environ.get("VSERVO_CAMERA", "0")))
    a = p.parse_args()
    images = Images(a.instance, a.camera)
    if a.source == "synthetic":
        synthetic(images, tuple(int(side) for side in a.size.split("x")), a.rate)
    else:
        opencv(images, a.what)


if __name__ == "__main__":
    main()

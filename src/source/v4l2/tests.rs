//! A camera against a scripted device.

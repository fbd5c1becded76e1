//! The guest: its drivers and its shell.

use crate::common::wait_until;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Fails outside of the virtual machine: nothing that needs it is ever reported as passed without it.
pub fn require() {
    assert!(
        std::env::var_os("VSERVO_VM").is_some(),
        "runs in the virtual machine only: set CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER=\"python3 tests/vm/run.py exec --\""
    );
}

/// Runs a line of shell; what it prints.
pub fn sh(line: &str) -> String {
    require();
    let output = Command::new("sh").args(["-c", line]).output().unwrap();
    let text = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
    assert!(output.status.success(), "{line}: {text}");
    text
}

/// Loads what an emulated USB camera needs.
pub fn load_usb() {
    sh("mods vhci-hcd && mods uvcvideo");
}

/// vivid with one device of its own parameters, until it is dropped.
pub struct Vivid(());

impl Vivid {
    /// `node_types=0x1` is a capture device alone, `input_types=0` a webcam, `3` HDMI.
    pub fn load(parameters: &str) -> Self {
        // One that is there already would keep its own parameters.
        let rid = "if [ -d /sys/module/vivid ]; then rmmod vivid; fi";
        sh(&format!("{rid} && mods vivid n_devs=1 no_error_inj=0 {parameters}"));
        let vivid = Self(());
        wait_until("vivid's device", || node_called("vivid-000-vid-cap").is_some());
        vivid
    }

    /// One webcam.
    pub fn webcam() -> Self {
        Self::load("node_types=0x1 num_inputs=1 input_types=0")
    }

    pub fn capture(&self) -> PathBuf {
        node_called("vivid-000-vid-cap").expect("vivid captures")
    }

    pub fn output(&self) -> PathBuf {
        node_called("vivid-000-vid-out").expect("vivid has an output")
    }

    /// Sets controls, as `name=value,name=value`.
    pub fn set(&self, controls: &str) {
        set(&self.capture(), controls);
    }
}

impl Drop for Vivid {
    fn drop(&mut self) {
        let _ = Command::new("rmmod").arg("vivid").output();
    }
}

/// Sets controls of a device, as `name=value,name=value`.
pub fn set(device: &Path, controls: &str) {
    sh(&format!("v4l2-ctl -d {} -c {controls}", device.display()));
}

/// The video device with this name.
pub fn node_called(name: &str) -> Option<PathBuf> {
    fs::read_dir("/sys/class/video4linux").ok()?.flatten().find_map(|entry| {
        let found = fs::read_to_string(entry.path().join("name")).ok()?;
        let node = PathBuf::from("/dev").join(entry.file_name());
        (found.trim() == name && node.exists()).then_some(node)
    })
}

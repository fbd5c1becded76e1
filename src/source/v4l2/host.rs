//! This machine: its video nodes, what the kernel says about their files, and its clock.

use super::V4l2Error;
use super::device::Device;
use super::node::{CameraHost, NodeFile, VideoNode};
use crate::rt;
use crate::time::{MonoNs, SpanNs};
use rustix::fs::{FileType, major, minor, stat};
use rustix::io::Errno;
use std::fs;
use std::path::{Path, PathBuf};

/// The kernel's number of video devices.
const VIDEO_MAJOR: u32 = 81;
const DEVICES: &str = "/dev";
/// Most nodes that are examined: the number of minors that the kernel's V4L2 core has (VIDEO_NUM_DEVICES).
const MAX_NODES: usize = 256;

/// This machine.
#[derive(Debug, Clone, Copy)]
pub(super) struct ThisMachine;

impl CameraHost for ThisMachine {
    fn nodes(&self) -> Vec<NodeFile> {
        let Ok(entries) = fs::read_dir(DEVICES) else { return Vec::new() };
        let numbered = entries.flatten().filter_map(|entry| {
            let number = entry.file_name().to_str()?.strip_prefix("video")?.parse::<u32>().ok()?;
            Some((number, entry.path()))
        });
        let mut found: Vec<_> = numbered.take(MAX_NODES).collect();
        found.sort();
        found.into_iter().filter_map(|(_, path)| self.file(&path).ok()).collect()
    }

    fn file(&self, path: &Path) -> Result<NodeFile, V4l2Error> {
        let not_video = |kind: &str| V4l2Error::NotVideo { path: path.into(), kind: kind.into() };
        let found = match stat(path) {
            Ok(found) => found,
            Err(Errno::ACCESS) => {
                return Err(V4l2Error::Permission { path: path.into(), group: String::new() });
            }
            Err(_) => return Err(V4l2Error::Gone { path: path.into() }),
        };
        match FileType::from_raw_mode(found.st_mode) {
            FileType::CharacterDevice if major(found.st_rdev) == VIDEO_MAJOR => {}
            FileType::CharacterDevice | FileType::BlockDevice => {
                return Err(not_video("a device of another kind"));
            }
            FileType::Directory => return Err(not_video("a folder")),
            FileType::Fifo => return Err(not_video("a pipe")),
            FileType::RegularFile => return Err(not_video("a file")),
            _ => return Err(not_video("something else")),
        }
        let about = format!("/sys/dev/char/{}:{}", major(found.st_rdev), minor(found.st_rdev));
        let about = Path::new(&about);
        Ok(NodeFile { path: path.into(), serial: serial(about), index: number_in(&about.join("index")) })
    }

    fn open(&self, path: &Path) -> Result<Box<dyn VideoNode>, Errno> {
        Ok(Box::new(Device::open(path)?))
    }

    fn now(&self) -> MonoNs {
        rt::now()
    }

    fn pause(&self, span: SpanNs) {
        rt::sleep_until(rt::now() + span);
    }
}

/// The serial number of the USB device that a node's interface is a part of.
fn serial(about: &Path) -> Option<String> {
    let interface = fs::canonicalize(about.join("device")).ok()?;
    let serial = fs::read_to_string(interface.parent()?.join("serial")).ok()?;
    Some(serial.trim().to_string()).filter(|serial| !serial.is_empty())
}

fn number_in(file: &Path) -> Option<u32> {
    fs::read_to_string(file).ok()?.trim().parse().ok()
}

/// What to do where a node may not be opened: whose it is, by the machine's list of groups.
pub(super) fn about_permission(path: &Path) -> String {
    let of = |path: &Path| -> Option<String> {
        let gid = stat(path).ok()?.st_gid;
        let groups = fs::read_to_string("/etc/group").ok()?;
        groups.lines().find_map(|line| {
            let mut fields = line.split(':');
            let (name, _, number) = (fields.next()?, fields.next()?, fields.next()?);
            (number.parse() == Ok(gid)).then(|| name.to_string())
        })
    };
    match of(path) {
        Some(group) if group != "root" => format!(
            ": it belongs to group `{group}`; join it with `sudo usermod -aG {group} $USER`, and log in again"
        ),
        _ => ": it belongs to root alone; a udev rule gives it to a group, mostly `video`, which you then join with \
              `sudo usermod -aG video $USER`"
            .into(),
    }
}

/// Names by which the device manager knows a node: links to it that say what it is and where it is connected.
pub(super) fn links_to(path: &Path) -> Vec<PathBuf> {
    let mut links = Vec::new();
    for folder in ["/dev/v4l/by-id", "/dev/v4l/by-path"] {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten().take(MAX_NODES);
        let leads_there = |link: &PathBuf| fs::canonicalize(link).is_ok_and(|target| target == path);
        links.extend(entries.map(|entry| entry.path()).filter(leads_there));
    }
    links.sort();
    links
}

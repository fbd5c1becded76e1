//! Which device is meant: by path, by the camera's name, by where it is connected; and whether one is the same as before.

use super::V4l2Error;
use super::fault::{is_gone, refused};
use super::host::about_permission;
use super::node::{CameraHost, NodeFile, NodeInfo, NodeKind, VideoNode};
use rustix::io::Errno;
use std::path::Path;

/// What makes a camera this one and no other, whatever number its node has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Identity {
    driver: String,
    card: String,
    bus_info: String,
    serial: Option<String>,
    index: Option<u32>,
}

impl Identity {
    pub(super) fn of(file: &NodeFile, info: &NodeInfo) -> Self {
        Self {
            driver: info.driver.clone(),
            card: info.card.clone(),
            bus_info: info.bus_info.clone(),
            serial: file.serial.clone(),
            index: file.index,
        }
    }

    /// Whether `other` is the same camera in the same place.
    fn is_in_place(&self, other: &Self) -> bool {
        self.is_alike(other) && self.bus_info == other.bus_info && self.serial == other.serial
    }

    /// Whether `other` is the same camera in another place: only a serial number can tell.
    fn has_moved(&self, other: &Self) -> bool {
        self.is_alike(other) && self.serial.is_some() && self.serial == other.serial
    }

    fn is_alike(&self, other: &Self) -> bool {
        (&self.driver, &self.card, self.index) == (&other.driver, &other.card, other.index)
    }
}

/// A device that was found and opened.
pub(super) struct OpenedNode {
    pub(super) file: NodeFile,
    pub(super) node: Box<dyn VideoNode>,
}

/// Opens the named device.
pub(super) fn resolve(host: &dyn CameraHost, device: &str) -> Result<OpenedNode, V4l2Error> {
    if device.starts_with('/') {
        return by_path(host, device);
    }
    let (mut nodes, mut closed) = (Vec::new(), None);
    for file in host.nodes() {
        match host.open(&file.path) {
            Ok(node) if node.info().kind == NodeKind::Capture => nodes.push(OpenedNode { file, node }),
            Ok(_) => {}
            Err(e) => closed = closed.or(Some(open_error(&file.path, e))),
        }
    }
    type Rule = fn(&NodeInfo, &str) -> bool;
    let rules: [Rule; 3] = [
        |info, name| info.bus_info == name || info.card == name,
        |info, name| info.card.eq_ignore_ascii_case(name),
        |info, name| info.card.to_lowercase().contains(&name.to_lowercase()),
    ];
    for rule in rules {
        let (mut meant, others): (Vec<_>, Vec<_>) =
            nodes.into_iter().partition(|found| rule(found.node.info(), device));
        match (meant.pop(), meant.is_empty()) {
            (Some(found), true) => return Ok(found),
            (Some(last), false) => {
                meant.push(last);
                let candidates =
                    meant.iter().map(|f| line(&f.file, f.node.info())).collect::<Vec<_>>().join(", ");
                return Err(V4l2Error::SeveralDevices { device: device.into(), candidates });
            }
            (None, _) => nodes = others,
        }
    }
    // Where some node could not even be looked at, that may be the reason.
    if nodes.is_empty()
        && let Some(error) = closed
    {
        return Err(error);
    }
    drop(nodes);
    Err(V4l2Error::NoDevice { device: device.into(), there_is: what_there_is(host) })
}

fn by_path(host: &dyn CameraHost, device: &str) -> Result<OpenedNode, V4l2Error> {
    let path = Path::new(device);
    let absent = || V4l2Error::NoDevice { device: device.into(), there_is: what_there_is(host) };
    let file = host.file(path).map_err(|e| if matches!(e, V4l2Error::Gone { .. }) { absent() } else { e })?;
    let node = host.open(path).map_err(|e| if is_gone(e) { absent() } else { open_error(path, e) })?;
    require_capture(host, path, node.info())?;
    Ok(OpenedNode { file, node })
}

/// Refuses a node that gives no images; where they are, if another node of the same device has them.
fn require_capture(host: &dyn CameraHost, path: &Path, info: &NodeInfo) -> Result<(), V4l2Error> {
    if info.kind == NodeKind::Capture {
        return Ok(());
    }
    let has_images = |file: &NodeFile| {
        host.open(&file.path)
            .is_ok_and(|node| node.info().kind == NodeKind::Capture && node.info().bus_info == info.bus_info)
    };
    let remedy = match host.nodes().iter().find(|file| has_images(file)) {
        Some(file) => format!("the images are at {}", file.path.display()),
        None => "`vservo camera --list` shows the nodes that have images".into(),
    };
    Err(V4l2Error::NotCapture { path: path.into(), kind: info.kind.describe(), remedy })
}

/// Opens the camera that was `identity` before, wherever it is now; `None` while it is not there.
pub(super) fn find_again(host: &dyn CameraHost, identity: &Identity) -> Option<OpenedNode> {
    let mut moved = Vec::new();
    for file in host.nodes() {
        let Ok(node) = host.open(&file.path) else { continue };
        if node.info().kind != NodeKind::Capture {
            continue;
        }
        let other = Identity::of(&file, node.info());
        if identity.is_in_place(&other) {
            return Some(OpenedNode { file, node });
        }
        if identity.has_moved(&other) {
            moved.push(OpenedNode { file, node });
        }
    }
    // Cheap cameras share one serial number: of several none is known to be the one.
    let last = moved.pop()?;
    moved.is_empty().then_some(last)
}

/// Why a node could not be opened.
pub(super) fn open_error(path: &Path, cause: Errno) -> V4l2Error {
    match cause {
        Errno::ACCESS | Errno::PERM => {
            V4l2Error::Permission { path: path.into(), group: about_permission(path) }
        }
        Errno::BUSY => V4l2Error::Busy { path: path.into() },
        e if is_gone(e) => V4l2Error::Gone { path: path.into() },
        Errno::NOTTY => {
            V4l2Error::NotVideo { path: path.into(), kind: "a device that knows no video".into() }
        }
        e => refused(format!("to open {}", path.display()), e),
    }
}

/// `/dev/video0 (HD Webcam, usb-0000:00:14.0-2)`
fn line(file: &NodeFile, info: &NodeInfo) -> String {
    format!("{} ({}, {})", file.path.display(), info.card, info.bus_info)
}

/// The cameras of this machine, behind a semicolon.
fn what_there_is(host: &dyn CameraHost) -> String {
    let nodes = host.nodes();
    let one = |file: &NodeFile| match host.open(&file.path) {
        Ok(node) if node.info().kind == NodeKind::Capture => Some(line(file, node.info())),
        Ok(_) => None,
        Err(e) => Some(format!("{} (cannot be opened: {})", file.path.display(), std::io::Error::from(e))),
    };
    let there: Vec<_> = nodes.iter().filter_map(one).collect();
    if there.is_empty() {
        "this machine has no camera: is it plugged in, and its driver loaded?".into()
    } else {
        format!("there is {}", there.join(", "))
    }
}

//! A video node of the kernel: requests by `ioctl`, and buffers that the driver allocates and this process maps.

#![allow(unsafe_code)]

use super::abi::{self, *};
use super::controls;
use super::mapped::Mapped;
use super::node::{
    BufferFormat, ControlKind, ControlOffer, FilledBuffer, FormatName, FourCc, Interval, NodeInfo, NodeKind,
    RateOffer, SensorArea, SizeOffer, VideoNode, Waited,
};
use crate::source::stamp::StampClock;
use crate::time::MonoNs;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags};
use rustix::io::{Errno, retry_on_intr};
use rustix::ioctl::{Getter, Opcode, Setter, Updater, ioctl};
use std::path::Path;
use std::time::Duration;

/// Entries of a list that a driver is asked for: more than any has, so that there is an end with one whose list has none.
const MAX_ENTRIES: u32 = 256;
const MAX_CONTROLS: usize = 1024;

// V4L2_BUF_FLAG_*, as the kernel's header has them.
const BUFFER_ERROR: u32 = 0x40;
const STAMP_CLOCK: u32 = 0xe000;
const STAMP_MONOTONIC: u32 = 0x2000;
const STAMP_COPIED: u32 = 0x4000;
const STAMP_POINT: u32 = 0x7_0000;
const STAMP_AT_START: u32 = 0x1_0000;

/// A request that the driver reads and writes.
fn update<const REQUEST: Opcode, T>(fd: &OwnedFd, record: &mut T) -> Result<(), Errno> {
    // SAFETY: each request is called with the record whose size is a part of its number, see `abi.rs`; the kernel writes to
    // no other memory, but for those with addresses in them, which are `planes` and `control` below.
    retry_on_intr(|| unsafe { ioctl(fd, Updater::<REQUEST, T>::new(record)) })
}

/// An open node. Dropped, it stops streaming and gives everything back; after an unplugging those requests fail, and that is fine.
#[derive(Debug)]
pub(super) struct Device {
    fd: OwnedFd,
    info: NodeInfo,
    queue: u32,
    planes: u32,
    buffers: Vec<Mapped>,
    streams: bool,
}

impl Device {
    /// Opens a node, whatever its kind.
    pub(super) fn open(path: &Path) -> Result<Self, Errno> {
        let fd = retry_on_intr(|| {
            rustix::fs::open(path, OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())
        })?;
        // SAFETY: the record is of the size that the request's number says.
        let c: AbiCapability =
            retry_on_intr(|| unsafe { ioctl(&fd, Getter::<QUERYCAP, AbiCapability>::new()) })?;
        let caps =
            if c.capabilities & capability::HAS_DEVICE_CAPS != 0 { c.device_caps } else { c.capabilities };
        let planar = caps & capability::CAPTURE_PLANAR != 0 && caps & capability::CAPTURE == 0;
        let info = NodeInfo {
            driver: abi::text(&c.driver),
            card: abi::text(&c.card),
            bus_info: abi::text(&c.bus_info),
            kind: kind(caps),
            planar,
        };
        let queue = if planar { QUEUE_CAPTURE_PLANAR } else { QUEUE_CAPTURE };
        Ok(Self { fd, info, queue, planes: 1, buffers: Vec::new(), streams: false })
    }

    fn request_buffers(&self, count: u32) -> Result<u32, Errno> {
        let mut r = AbiRequestBuffers { count, kind: self.queue, memory: MEMORY_MMAP, ..Default::default() };
        update::<REQBUFS, _>(&self.fd, &mut r)?;
        Ok(r.count)
    }

    /// A request about a buffer, with room for its planes where it has some; the first of these.
    fn about_buffer<const REQUEST: Opcode>(&self, index: u32) -> Result<(AbiBuffer, AbiPlane), Errno> {
        let mut planes = [AbiPlane::default(); MAX_PLANES];
        let mut buffer =
            AbiBuffer { index, kind: self.queue, memory_kind: MEMORY_MMAP, ..Default::default() };
        if self.info.planar {
            buffer.length = self.planes;
            // The kernel writes to `planes` during the request, and does not keep the address.
            buffer.memory = planes.as_mut_ptr() as u64;
        }
        update::<REQUEST, _>(&self.fd, &mut buffer)?;
        let [first, ..] = planes;
        Ok((buffer, first))
    }

    fn map(&self, index: u32) -> Result<Mapped, Errno> {
        let (buffer, plane) = self.about_buffer::<QUERYBUF>(index)?;
        let (length, memory) =
            if self.info.planar { (plane.length, plane.memory) } else { (buffer.length, buffer.memory) };
        // Offsets have 32 bits; the rest of the union says nothing.
        Mapped::new(&self.fd, length as usize, memory & 0xffff_ffff)
    }

    fn menu(&self, query: &AbiQueryControl, kind: ControlKind) -> Vec<(i64, String)> {
        let (Ok(first), Ok(last)) = (u32::try_from(query.minimum), u32::try_from(query.maximum)) else {
            return Vec::new();
        };
        let entry = |index: u32| {
            let mut entry = AbiQueryMenu { id: query.id, index, ..Default::default() };
            update::<QUERYMENU, _>(&self.fd, &mut entry).ok()?;
            let name = entry.name;
            let number = name.first_chunk().map_or(0, |b: &[u8; 8]| i64::from_le_bytes(*b));
            let name = if kind == ControlKind::IntegerMenu { number.to_string() } else { abi::text(&name) };
            Some((i64::from(index), name))
        };
        (first..=last).take(MAX_ENTRIES as usize).filter_map(entry).collect()
    }

    /// Selections are asked for by the single-planar kind, whatever the queue.
    fn selected(&self, target: u32) -> Result<SensorArea, Errno> {
        let mut s = AbiSelection { kind: QUEUE_CAPTURE, target, ..Default::default() };
        update::<G_SELECTION, _>(&self.fd, &mut s)?;
        Ok(SensorArea { left: s.left, top: s.top, width: s.width, height: s.height })
    }

    fn layout_of(&mut self, f: &AbiFormat) -> BufferFormat {
        if self.info.planar {
            // SAFETY: the kind of queue says which member counts, and every bit pattern is a value of it.
            let p = unsafe { f.format.planar };
            self.planes = u32::from(p.num_planes).clamp(1, MAX_PLANES as u32);
            let [first, ..] = p.planes;
            return BufferFormat {
                fourcc: FourCc::from_code(p.fourcc),
                width: p.width,
                height: p.height,
                field: p.field,
                stride: first.bytes_per_line,
                size: first.size_image,
            };
        }
        // SAFETY: as above.
        let p = unsafe { f.format.single };
        BufferFormat {
            fourcc: FourCc::from_code(p.fourcc),
            width: p.width,
            height: p.height,
            field: p.field,
            stride: p.bytes_per_line,
            size: p.size_image,
        }
    }

    fn switch<const REQUEST: Opcode>(&self) -> Result<(), Errno> {
        // SAFETY: the request reads one number, the kind of queue.
        retry_on_intr(|| unsafe { ioctl(&self.fd, Setter::<REQUEST, u32>::new(self.queue)) })
    }

    /// Reads or writes one control of any width.
    fn extended<const REQUEST: Opcode>(&self, id: u32, value: i64) -> Result<i64, Errno> {
        let mut control = AbiExtControl { id, value, ..Default::default() };
        let mut all = AbiExtControls { count: 1, ..Default::default() };
        // The kernel writes to `control` during the request, and does not keep the address.
        all.controls = (&raw mut control) as u64;
        update::<REQUEST, _>(&self.fd, &mut all)?;
        Ok(control.value)
    }
}

fn kind(caps: u32) -> NodeKind {
    let has = |bits: u32| caps & bits != 0;
    match () {
        () if has(capability::MEMORY_TO_MEMORY | capability::MEMORY_TO_MEMORY_PLANAR) => NodeKind::Converter,
        () if has(capability::CAPTURE | capability::CAPTURE_PLANAR) && has(capability::STREAMING) => {
            NodeKind::Capture
        }
        () if has(capability::CAPTURE | capability::CAPTURE_PLANAR) => NodeKind::CaptureWithoutStreaming,
        () if has(capability::METADATA_CAPTURE) => NodeKind::Metadata,
        () => NodeKind::Other,
    }
}

/// What `next(index)` gives, from 0 on, until there is no more.
fn listed<T>(next: impl Fn(u32) -> Option<T>) -> Vec<T> {
    (0..MAX_ENTRIES).map_while(next).collect()
}

impl VideoNode for Device {
    fn info(&self) -> &NodeInfo {
        &self.info
    }

    fn select_input(&mut self, index: u32) -> Result<(), Errno> {
        update::<S_INPUT, _>(&self.fd, &mut { index })
    }

    fn formats(&self) -> Vec<FormatName> {
        listed(|index| {
            let mut d = AbiFormatDescription { index, kind: self.queue, ..Default::default() };
            update::<ENUM_FMT, _>(&self.fd, &mut d).ok()?;
            Some(FormatName { fourcc: FourCc::from_code(d.fourcc), description: abi::text(&d.description) })
        })
    }

    fn sizes(&self, fourcc: FourCc) -> Vec<SizeOffer> {
        listed(|index| {
            let mut s = AbiFrameSize { index, fourcc: fourcc.code(), ..Default::default() };
            update::<ENUM_FRAMESIZES, _>(&self.fd, &mut s).ok()?;
            // The driver says the same range for every further index.
            let [a, b, c, d, e, f] = s.sizes;
            match (s.kind, index) {
                (DISCRETE, _) => Some(SizeOffer::Discrete { width: a, height: b }),
                (_, 0) => Some(SizeOffer::Stepwise { smallest: [a, d], largest: [b, e], step: [c, f] }),
                _ => None,
            }
        })
    }

    fn rates(&self, fourcc: FourCc, width: u32, height: u32) -> Vec<RateOffer> {
        let fraction = |[numerator, denominator]: [u32; 2]| Interval { numerator, denominator };
        listed(|index| {
            let mut i =
                AbiFrameInterval { index, fourcc: fourcc.code(), width, height, ..Default::default() };
            update::<ENUM_FRAMEINTERVALS, _>(&self.fd, &mut i).ok()?;
            let [shortest, longest, _] = i.fractions.map(fraction);
            match (i.kind, index) {
                (DISCRETE, _) => Some(RateOffer::Discrete(shortest)),
                (_, 0) => Some(RateOffer::Between { shortest, longest }),
                _ => None,
            }
        })
    }

    fn set_format(&mut self, fourcc: FourCc, width: u32, height: u32) -> Result<BufferFormat, Errno> {
        let mut f = AbiFormat { kind: self.queue, ..Default::default() };
        update::<G_FMT, _>(&self.fd, &mut f)?;
        // Strides and sizes of the format before would be kept by some drivers: zeroes let them choose anew.
        if self.info.planar {
            // SAFETY: the kind of queue says which member counts, and every bit pattern is a value of it.
            let mut p = unsafe { f.format.planar };
            (p.width, p.height, p.fourcc, p.field) = (width, height, fourcc.code(), super::node::FIELD_NONE);
            p.planes = [AbiPlaneFormat::default(); MAX_PLANES];
            f.format = AbiFormatUnion { planar: p };
        } else {
            // SAFETY: as above.
            let mut p = unsafe { f.format.single };
            (p.width, p.height, p.fourcc, p.field) = (width, height, fourcc.code(), super::node::FIELD_NONE);
            (p.bytes_per_line, p.size_image) = (0, 0);
            f.format = AbiFormatUnion { single: p };
        }
        update::<S_FMT, _>(&self.fd, &mut f)?;
        Ok(self.layout_of(&f))
    }

    fn layout(&mut self) -> Result<BufferFormat, Errno> {
        let mut f = AbiFormat { kind: self.queue, ..Default::default() };
        update::<G_FMT, _>(&self.fd, &mut f)?;
        Ok(self.layout_of(&f))
    }

    fn set_interval(&mut self, interval: Interval) -> Result<Option<Interval>, Errno> {
        let mut p = AbiStreamParameters { kind: self.queue, ..Default::default() };
        match update::<G_PARM, _>(&self.fd, &mut p) {
            Ok(()) if p.capability & HAS_TIME_PER_FRAME != 0 => {}
            Ok(()) | Err(Errno::NOTTY | Errno::INVAL) => return Ok(None),
            Err(e) => return Err(e),
        }
        (p.numerator, p.denominator) = (interval.numerator, interval.denominator);
        update::<S_PARM, _>(&self.fd, &mut p)?;
        Ok(Some(Interval { numerator: p.numerator, denominator: p.denominator }))
    }

    fn controls(&self) -> Vec<ControlOffer> {
        let mut found = Vec::new();
        let mut query = AbiQueryControl { id: NEXT_CONTROL, ..Default::default() };
        while found.len() < MAX_CONTROLS {
            let before = query.id & !NEXT_CONTROL;
            if update::<QUERY_EXT_CTRL, _>(&self.fd, &mut query).is_err() || query.id <= before {
                break; // the end, or a driver that goes in circles
            }
            if let Some((kind, flags)) = controls::usable(query.kind, query.flags) {
                let has_menu = matches!(kind, ControlKind::Menu | ControlKind::IntegerMenu);
                found.push(ControlOffer {
                    id: query.id,
                    name: controls::key_of(&abi::text(&query.name)),
                    kind,
                    minimum: query.minimum,
                    maximum: query.maximum,
                    step: query.step,
                    default: query.default,
                    menu: if has_menu { self.menu(&query, kind) } else { Vec::new() },
                    read_only: flags.read_only,
                    inactive: flags.inactive,
                });
            }
            query = AbiQueryControl { id: query.id | NEXT_CONTROL, ..Default::default() };
        }
        found
    }

    fn control(&self, id: u32, kind: ControlKind) -> Result<i64, Errno> {
        if kind == ControlKind::Integer64 {
            return self.extended::<G_EXT_CTRLS>(id, 0);
        }
        let mut c = AbiControl { id, value: 0 };
        update::<G_CTRL, _>(&self.fd, &mut c)?;
        // Bits use the sign too.
        let is_bits = kind == ControlKind::Bitmask;
        Ok(if is_bits { i64::from(c.value.cast_unsigned()) } else { i64::from(c.value) })
    }

    fn set_control(&mut self, id: u32, kind: ControlKind, value: i64) -> Result<(), Errno> {
        if kind == ControlKind::Integer64 {
            return self.extended::<S_EXT_CTRLS>(id, value).map(drop);
        }
        // Bits use the sign too.
        let value = i32::try_from(value).or_else(|_| u32::try_from(value).map(u32::cast_signed));
        let mut c = AbiControl { id, value: value.map_err(|_| Errno::RANGE)? };
        update::<S_CTRL, _>(&self.fd, &mut c)
    }

    fn whole_area(&self) -> Result<SensorArea, Errno> {
        self.selected(TARGET_CROP_DEFAULT)
    }

    fn area(&self) -> Result<SensorArea, Errno> {
        self.selected(TARGET_CROP)
    }

    fn set_crop(&mut self, area: SensorArea) -> Result<SensorArea, Errno> {
        let SensorArea { left, top, width, height } = area;
        let mut s = AbiSelection {
            kind: QUEUE_CAPTURE,
            target: TARGET_CROP,
            left,
            top,
            width,
            height,
            ..Default::default()
        };
        update::<S_SELECTION, _>(&self.fd, &mut s)?;
        // What was set is what a new question gives, whatever the request answered.
        self.area()
    }

    fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        self.buffers.clear();
        let count = self.request_buffers(count)?;
        self.buffers = (0..count).map(|index| self.map(index)).collect::<Result<_, _>>()?;
        Ok(count)
    }

    fn queue(&mut self, index: u32) -> Result<(), Errno> {
        self.about_buffer::<QBUF>(index).map(drop)
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.switch::<STREAMON>()?;
        self.streams = true;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Errno> {
        self.streams = false;
        self.switch::<STREAMOFF>()
    }

    fn wait(&self, longest: Duration) -> Result<Waited, Errno> {
        let timeout = Timespec {
            tv_sec: i64::try_from(longest.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: longest.subsec_nanos().into(),
        };
        let mut asked = [PollFd::new(&self.fd, PollFlags::IN)];
        match poll(&mut asked, Some(&timeout)) {
            Ok(0) | Err(Errno::INTR) => Ok(Waited::TimeIsUp),
            Ok(_) => {
                let trouble = PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL;
                let is_troubled = asked.iter().any(|fd| fd.revents().intersects(trouble));
                Ok(if is_troubled { Waited::Troubled } else { Waited::Ready })
            }
            Err(e) => Err(e),
        }
    }

    fn dequeue(&mut self) -> Result<FilledBuffer, Errno> {
        let (b, plane) = self.about_buffer::<DQBUF>(0)?;
        let (used, offset) =
            if self.info.planar { (plane.bytes_used, plane.data_offset) } else { (b.bytes_used, 0) };
        let clock = match b.flags & STAMP_CLOCK {
            STAMP_MONOTONIC => StampClock::Monotonic,
            STAMP_COPIED => StampClock::Copied,
            _ => StampClock::Unknown,
        };
        let stamp = b.stamp_s.saturating_mul(1_000_000_000).saturating_add(b.stamp_us.saturating_mul(1000));
        Ok(FilledBuffer {
            index: b.index,
            offset: offset as usize,
            length: used.saturating_sub(offset) as usize,
            stamp: MonoNs(stamp),
            clock,
            at_start: b.flags & STAMP_POINT == STAMP_AT_START,
            sequence: b.sequence,
            field: b.field,
            damaged: b.flags & BUFFER_ERROR != 0,
        })
    }

    fn payload(&self, buffer: &FilledBuffer) -> &[u8] {
        let bytes = self.buffers.get(buffer.index as usize).map_or(&[] as &[u8], Mapped::bytes);
        let end = buffer.offset.saturating_add(buffer.length).min(bytes.len());
        bytes.get(buffer.offset..end).unwrap_or_default()
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if self.streams {
            let _ = self.stop();
        }
        if !self.buffers.is_empty() {
            self.buffers.clear();
            let _ = self.request_buffers(0);
        }
    }
}

//! A bench with scripted cameras: time goes on while somebody waits, frames come every 40 ms, and whatever is in the script happens.
//!
//! It watches what it is told as a driver would: a buffer that is given twice, or taken back without being given, is a failure.

use super::super::StampClock;
use super::super::V4l2Error;
use super::super::node::*;
use crate::time::{MonoNs, SpanNs};
use rustix::io::Errno;
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

pub(super) const WIDTH: u32 = 16;
pub(super) const HEIGHT: u32 = 16;
pub(super) const PERIOD: SpanNs = SpanNs(40_000_000);
pub(super) const MS: i64 = 1_000_000;

/// All of the sensor.
pub(super) const WHOLE: SensorArea = SensorArea { left: 0, top: 0, width: WIDTH, height: HEIGHT };

/// What happens instead of a good frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mishap {
    /// The driver drops it.
    Dropped,
    /// The driver says that it is damaged.
    Damaged,
    /// It is too short.
    Short,
    /// Of two expositions.
    Interlaced,
    /// The stream fails until it is begun anew.
    StreamError,
    /// The camera is unplugged for so many periods.
    Unplugged(u32),
    /// Nothing comes for so many periods.
    Silence(u32),
    /// The stamp lies so many ms from where it should.
    Stamped(i64),
}

/// What there is and what happens.
#[derive(Debug)]
pub(super) struct World {
    pub(super) now: MonoNs,
    pub(super) cameras: Vec<FakeCamera>,
    /// By the count of frames since the beginning of the world.
    pub(super) script: BTreeMap<u64, Mishap>,
    pub(super) exposed: u64,
    pub(super) open_nodes: usize,
    pub(super) clock: StampClock,
    pub(super) at_start: bool,
    /// So many of the next requests of each kind fail.
    pub(super) failing_queue: u32,
    pub(super) failing_start: u32,
    pub(super) failing_allocate: u32,
    pub(super) error: Errno,
    pub(super) first_sequence: u32,
    pub(super) exposure_units: i64,
    pub(super) set_controls: Vec<(u32, i64)>,
    /// What the driver makes of a size.
    pub(super) substitutes: Option<(u32, u32)>,
    /// Whether the device can cut, and in which steps it does.
    pub(super) cuts: Option<u32>,
    pub(super) area: SensorArea,
    /// Pixels that differ: each has its number.
    pub(super) numbered: bool,
}

/// A camera that may be plugged in.
#[derive(Debug, Clone)]
pub(super) struct FakeCamera {
    pub(super) path: PathBuf,
    pub(super) info: NodeInfo,
    pub(super) serial: Option<String>,
    pub(super) present_from: MonoNs,
    pub(super) closed: Option<Errno>,
}

impl FakeCamera {
    pub(super) fn new(number: u32, card: &str, bus: &str) -> Self {
        Self {
            path: format!("/dev/video{number}").into(),
            info: NodeInfo {
                driver: "fake".into(),
                card: card.into(),
                bus_info: bus.into(),
                kind: NodeKind::Capture,
                planar: false,
            },
            serial: None,
            present_from: MonoNs::ZERO,
            closed: None,
        }
    }
}

/// A handle to the world; the host of the camera under test.
#[derive(Debug, Clone)]
pub(super) struct Bench(pub(super) Rc<RefCell<World>>);

impl Bench {
    pub(super) fn new() -> Self {
        Self(Rc::new(RefCell::new(World {
            now: MonoNs(10_000 * MS),
            cameras: vec![FakeCamera::new(0, "Fake Camera", "usb-1")],
            script: BTreeMap::new(),
            exposed: 0,
            open_nodes: 0,
            clock: StampClock::Monotonic,
            at_start: false,
            failing_queue: 0,
            failing_start: 0,
            failing_allocate: 0,
            error: Errno::IO,
            first_sequence: 0,
            exposure_units: 100,
            set_controls: Vec::new(),
            substitutes: None,
            cuts: None,
            area: WHOLE,
            numbered: false,
        })))
    }

    pub(super) fn with(script: &[(u64, Mishap)]) -> Self {
        let bench = Self::new();
        bench.0.borrow_mut().script = script.iter().copied().collect();
        bench
    }

    pub(super) fn pass(&self, ms: i64) {
        let mut world = self.0.borrow_mut();
        world.now = world.now + SpanNs(ms * MS);
    }

    fn camera(&self, path: &Path) -> Option<FakeCamera> {
        let world = self.0.borrow();
        world.cameras.iter().find(|c| c.path == path && c.present_from <= world.now).cloned()
    }
}

impl CameraHost for Bench {
    fn nodes(&self) -> Vec<NodeFile> {
        let paths: Vec<_> = self.0.borrow().cameras.iter().map(|c| c.path.clone()).collect();
        paths.iter().filter_map(|path| self.file(path).ok()).collect()
    }

    fn file(&self, path: &Path) -> Result<NodeFile, V4l2Error> {
        let camera = self.camera(path).ok_or(V4l2Error::Gone { path: path.into() })?;
        Ok(NodeFile { path: path.into(), serial: camera.serial, index: Some(0) })
    }

    fn open(&self, path: &Path) -> Result<Box<dyn VideoNode>, Errno> {
        let camera = self.camera(path).ok_or(Errno::NODEV)?;
        if let Some(cause) = camera.closed {
            return Err(cause);
        }
        self.0.borrow_mut().open_nodes += 1;
        Ok(Box::new(FakeNode {
            bench: self.clone(),
            info: camera.info,
            layout: BufferFormat {
                fourcc: FourCc(*b"GREY"),
                width: WIDTH,
                height: HEIGHT,
                field: FIELD_NONE,
                stride: WIDTH,
                size: WIDTH * HEIGHT,
            },
            pixels: Vec::new(),
            given: VecDeque::new(),
            filled: VecDeque::new(),
            streams: false,
            next: MonoNs::ZERO,
            sequence: 0,
            broken: None,
        }))
    }

    fn now(&self) -> MonoNs {
        self.0.borrow().now
    }

    fn pause(&self, span: SpanNs) {
        let mut world = self.0.borrow_mut();
        world.now = world.now + span;
    }
}

/// An open node of the bench.
#[derive(Debug)]
struct FakeNode {
    bench: Bench,
    info: NodeInfo,
    layout: BufferFormat,
    pixels: Vec<Vec<u8>>,
    /// With the driver, empty.
    given: VecDeque<u32>,
    /// With the driver, filled.
    filled: VecDeque<FilledBuffer>,
    streams: bool,
    next: MonoNs,
    sequence: u32,
    broken: Option<Errno>,
}

impl FakeNode {
    /// Exposes what is due.
    fn expose(&mut self) {
        let bench = self.bench.clone();
        let mut world = bench.0.borrow_mut();
        while self.streams && self.broken.is_none() && self.next <= world.now {
            let (end, exposed) = (self.next, world.exposed);
            self.next = self.next + PERIOD;
            world.exposed += 1;
            let mut buffer = FilledBuffer {
                index: 0,
                offset: 0,
                length: self.layout.size as usize,
                stamp: end,
                clock: world.clock,
                at_start: world.at_start,
                sequence: self.sequence,
                field: FIELD_NONE,
                damaged: false,
            };
            self.sequence = self.sequence.wrapping_add(1);
            match world.script.get(&exposed) {
                None => {}
                Some(Mishap::Dropped) => continue,
                Some(Mishap::Damaged) => buffer.damaged = true,
                Some(Mishap::Short) => buffer.length -= 1,
                Some(Mishap::Interlaced) => buffer.field = 4,
                Some(Mishap::Stamped(ms)) => buffer.stamp = end + SpanNs(ms * MS),
                Some(Mishap::StreamError) => self.broken = Some(Errno::IO),
                Some(Mishap::Silence(periods)) => {
                    self.next = self.next + SpanNs(i64::from(*periods) * PERIOD.0);
                    continue;
                }
                Some(Mishap::Unplugged(periods)) => {
                    self.broken = Some(Errno::NODEV);
                    let back = end + SpanNs(i64::from(*periods) * PERIOD.0);
                    let path = self.info.bus_info.clone();
                    world
                        .cameras
                        .iter_mut()
                        .filter(|c| c.info.bus_info == path)
                        .for_each(|c| c.present_from = back);
                }
            }
            if self.broken.is_some() {
                break;
            }
            // A driver without an empty buffer drops the frame.
            if let Some(index) = self.given.pop_front() {
                buffer.index = index;
                let pixels = &mut self.pixels[index as usize];
                pixels.fill(exposed as u8);
                if world.numbered {
                    pixels.iter_mut().zip(0..=u8::MAX).for_each(|(pixel, n)| *pixel = n);
                }
                self.filled.push_back(buffer);
            }
        }
    }

    fn require_presence(&self) -> Result<(), Errno> {
        match self.broken {
            Some(Errno::NODEV) => Err(Errno::NODEV),
            _ => Ok(()),
        }
    }
}

fn fails(count: &mut u32) -> bool {
    let fails = *count > 0;
    *count = count.saturating_sub(1);
    fails
}

impl VideoNode for FakeNode {
    fn info(&self) -> &NodeInfo {
        &self.info
    }
    fn select_input(&mut self, _index: u32) -> Result<(), Errno> {
        Err(Errno::INVAL)
    }
    fn formats(&self) -> Vec<FormatName> {
        vec![FormatName { fourcc: FourCc(*b"GREY"), description: "8-bit".into() }]
    }
    fn sizes(&self, _fourcc: FourCc) -> Vec<SizeOffer> {
        vec![SizeOffer::Stepwise { smallest: [8, 8], largest: [WIDTH, HEIGHT], step: [2, 2] }]
    }
    fn rates(&self, _fourcc: FourCc, _width: u32, _height: u32) -> Vec<RateOffer> {
        vec![RateOffer::Discrete(Interval { numerator: 1, denominator: 25 })]
    }
    fn set_format(&mut self, fourcc: FourCc, width: u32, height: u32) -> Result<BufferFormat, Errno> {
        self.require_presence()?;
        let (width, height) = self.bench.0.borrow().substitutes.unwrap_or((width, height));
        self.layout =
            BufferFormat { fourcc, width, height, stride: width, size: width * height, ..self.layout };
        Ok(self.layout)
    }
    fn layout(&mut self) -> Result<BufferFormat, Errno> {
        Ok(self.layout)
    }
    fn set_interval(&mut self, _interval: Interval) -> Result<Option<Interval>, Errno> {
        self.require_presence()?;
        Ok(Some(Interval { numerator: 1, denominator: 25 }))
    }
    fn controls(&self) -> Vec<ControlOffer> {
        let control = |id: u32, name: &str, kind, maximum| ControlOffer {
            id,
            name: name.into(),
            kind,
            minimum: 0,
            maximum,
            step: 1,
            default: 0,
            menu: vec![(1, "Manual Mode".into()), (3, "Aperture Priority Mode".into())],
            read_only: false,
            inactive: false,
        };
        vec![
            control(0x0098_0913, "gain", ControlKind::Integer, 255),
            control(0x009a_0901, "auto_exposure", ControlKind::Menu, 3),
            control(0x009a_0902, "exposure_time_absolute", ControlKind::Integer, 5000),
        ]
    }
    fn control(&self, id: u32, _kind: ControlKind) -> Result<i64, Errno> {
        let world = self.bench.0.borrow();
        let set = world.set_controls.iter().rev().find(|(set, _)| *set == id).map(|(_, value)| *value);
        Ok(match id {
            0x009a_0901 => set.unwrap_or(3),
            0x009a_0902 => set.unwrap_or(world.exposure_units),
            _ => set.unwrap_or(0).min(200), // a gain above that is not taken
        })
    }
    fn set_control(&mut self, id: u32, _kind: ControlKind, value: i64) -> Result<(), Errno> {
        self.bench.0.borrow_mut().set_controls.push((id, value));
        Ok(())
    }
    fn whole_area(&self) -> Result<SensorArea, Errno> {
        self.bench.0.borrow().cuts.map(|_| WHOLE).ok_or(Errno::NOTTY)
    }
    fn area(&self) -> Result<SensorArea, Errno> {
        self.whole_area().map(|_| self.bench.0.borrow().area)
    }
    fn set_crop(&mut self, area: SensorArea) -> Result<SensorArea, Errno> {
        let mut world = self.bench.0.borrow_mut();
        let step = world.cuts.ok_or(Errno::NOTTY)?;
        let down = |x: i32| x - x % step.cast_signed();
        world.area = SensorArea { left: down(area.left), top: down(area.top), ..area };
        Ok(world.area)
    }
    fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        self.require_presence()?;
        let mut world = self.bench.0.borrow_mut();
        if fails(&mut world.failing_allocate) {
            return Err(world.error);
        }
        self.pixels = vec![vec![0; (WIDTH * HEIGHT) as usize]; count as usize];
        Ok(count)
    }
    fn queue(&mut self, index: u32) -> Result<(), Errno> {
        self.require_presence()?;
        let mut world = self.bench.0.borrow_mut();
        if fails(&mut world.failing_queue) {
            return Err(world.error);
        }
        assert!((index as usize) < self.pixels.len(), "there is such a buffer");
        let is_there = self.given.contains(&index) || self.filled.iter().any(|b| b.index == index);
        assert!(!is_there, "buffer {index} was given to the driver, which already has it");
        self.given.push_back(index);
        Ok(())
    }
    fn start(&mut self) -> Result<(), Errno> {
        self.require_presence()?;
        let mut world = self.bench.0.borrow_mut();
        if fails(&mut world.failing_start) {
            // As the kernel does: the buffers are with the program again.
            self.given.clear();
            return Err(world.error);
        }
        assert!(
            !self.streams && self.given.len() == self.pixels.len(),
            "all buffers are queued at the start"
        );
        (self.streams, self.broken) = (true, None);
        (self.next, self.sequence) = (world.now + PERIOD, world.first_sequence);
        Ok(())
    }
    fn stop(&mut self) -> Result<(), Errno> {
        self.streams = false;
        self.given.clear();
        self.filled.clear();
        self.require_presence()
    }
    fn wait(&self, longest: Duration) -> Result<Waited, Errno> {
        if self.broken.is_some() {
            return Ok(Waited::Troubled);
        }
        if !self.filled.is_empty() {
            return Ok(Waited::Ready);
        }
        let mut world = self.bench.0.borrow_mut();
        let until = world.now + SpanNs(longest.as_nanos() as i64);
        world.now = if self.next > world.now { self.next.min(until) } else { world.now };
        Ok(if self.next <= world.now { Waited::Ready } else { Waited::TimeIsUp })
    }
    fn dequeue(&mut self) -> Result<FilledBuffer, Errno> {
        self.expose();
        if let Some(cause) = self.broken {
            return Err(cause);
        }
        self.filled.pop_front().ok_or(Errno::AGAIN)
    }
    fn payload(&self, buffer: &FilledBuffer) -> &[u8] {
        assert!(
            !self.given.contains(&buffer.index) && self.filled.iter().all(|b| b.index != buffer.index),
            "what the driver has is not read"
        );
        &self.pixels[buffer.index as usize][..buffer.length]
    }
}

impl Drop for FakeNode {
    fn drop(&mut self) {
        self.bench.0.borrow_mut().open_nodes -= 1;
    }
}

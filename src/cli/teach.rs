//! `vservo teach [CONFIG] --out goal.toml`: what the camera sees now as the goal of later runs; features, pose, and an image of it.
//!
//! The camera is that of the run file, opened here: no run may have it meanwhile (a running one learns by `vservo ctl teach`). A rendered
//! one looks from where the arm starts. Or the images are files.

use super::{TeachArguments, check_writable, lost, shown, write_result};
use crate::config::Task;
use crate::config::{Config, FIRST_TARGET, GoalFeature, GoalFile, assemble};
use crate::imaging::ImageView;
use crate::input::printable;
use crate::messages::{FrameHeader, JointState, Measurement};
use crate::process::{ProcessError, StopFlag};
use crate::rt::{now, write_file};
use crate::scene::Exposure;
use crate::servo::SetPoint;
use crate::source::{AnySource, Exposed, Filled, encode_png, load_image, open};
use crate::time::{MonoNs, SpanNs, TICK};
use crate::vision::{Frame, Prior, Vision, VisionSettings};
use image::ExtendedColorType;
use nalgebra::Vector2;
use std::time::Duration;

/// Longest wait for a frame of a real camera. Chosen by hand: USB cameras take up to a second or two to start.
const FIRST_FRAME: SpanNs = SpanNs(5_000_000_000);
/// Time in which automatic exposure settles. Chosen by hand, as for `vservo camera --probe`.
const WARM_UP: SpanNs = SpanNs(500_000_000);
/// Standard deviation of points that fit no pose because lens and target are not known, px: that of `vservo run --uncalibrated`.
const UNKNOWN_SD_PX: f64 = 10.0;
/// Images that show no target, in a row, after which it is given up.
const MAX_WITHOUT: u32 = 100;

/// # Errors
/// When run file or camera are wrong, the target is not seen, or the file cannot be written.
pub(super) fn teach(arguments: &TeachArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let mut config = Config::load(arguments.config.as_deref(), &arguments.set)?;
    config.task = Task::Servo;
    if arguments.uncalibrated {
        config.vision = VisionSettings { model_sd_px: UNKNOWN_SD_PX, lens_is_known: false, ..config.vision };
    }
    check_writable(&arguments.out)?;
    let image = arguments.out.with_extension("png");
    check_writable(&image)?;
    // The target whose goal it is takes the first one's place for who looks; the scene and the camera stay as they are.
    let name = arguments.target.as_deref().filter(|name| *name != FIRST_TARGET);
    let led = config
        .led_by(name.unwrap_or(FIRST_TARGET))
        .map_err(|why| ProcessError::NoCommand(format!("--target: {why}")))?;
    let mut goal_recorder = GoalRecorder::of(&led, name, arguments.measurements);
    if arguments.images.is_empty() {
        goal_recorder.look_through(open(&config)?, &stop)?;
    } else {
        for path in &arguments.images {
            let image = load_image(path)?;
            goal_recorder.look_at(image.as_raw(), image.dimensions())?;
        }
    }
    let (goal, grey) = goal_recorder.goal()?;
    let size = config.camera.full_size_px();
    let image_name = image.file_name().map(|name| name.to_string_lossy().into_owned());
    let shot = encode_png(&grey, size.0, size.1, ExtendedColorType::L8).map_err(std::io::Error::other);
    let thumbnail = match shot.and_then(|png| write_file(&image, png)) {
        Ok(()) => image_name,
        // the goal counts, not its image
        Err(cause) => return Ok(lost(&image, cause, 0)),
    };
    let goal = GoalFile { thumbnail, ..goal };
    let exit_code = write_result(&arguments.out, goal.to_toml(), 0);
    let worst = goal.features.iter().filter_map(|f| f.spread_px).fold(0.0, f64::max);
    let place = printable(&arguments.out.display().to_string());
    let distance =
        goal.pose.map_or(String::new(), |pose| format!(", {:.3} m before the camera", pose.position_m[2]));
    let of = name.map_or(String::new(), |name| format!(" of `{}`", printable(name)));
    let use_it = match name {
        None => format!("--set servo.set_point.file={place}"),
        Some(_) => format!("[goals.NAME] file = \"{place}\", or `vservo ctl goal {place}`"),
    };
    let line = format!(
        "{place}: {} points{of} from {} images{distance}; they differ by up to {worst:.3} px\n\
         use it with {use_it}\n",
        goal.features.len(),
        goal.measurements.unwrap_or_default(),
    );
    Ok(if exit_code == 0 { shown(&line, 0) } else { exit_code })
}

/// Who learns: vision, and the sums of what it saw.
struct GoalRecorder<'a> {
    /// The cell, led by the target.
    config: &'a Config,
    /// Name of the target, where it is not that of `[target]`.
    name: Option<&'a str>,
    vision: Vision,
    wanted: u32,
    taken: u32,
    without: u32,
    frames: u64,
    sums: Vec<Sum>,
    status: &'static str,
    image: Vec<u8>,
}

/// Of one point: sums of normalized coordinates, of pixels, and of their squares.
#[derive(Clone, Default)]
struct Sum {
    id: u32,
    s: Vector2<f64>,
    px: Vector2<f64>,
    px2: f64,
}

impl<'a> GoalRecorder<'a> {
    fn of(config: &'a Config, name: Option<&'a str>, wanted: u32) -> Self {
        let sums = config.set_point.ids().iter().map(|&id| Sum { id, ..Sum::default() }).collect();
        let vision = assemble::vision(config);
        Self {
            config,
            name,
            vision,
            wanted: wanted.max(1),
            taken: 0,
            without: 0,
            frames: 0,
            sums,
            status: "no image",
            image: Vec::new(),
        }
    }

    fn has_enough(&self) -> bool {
        self.taken >= self.wanted || self.without >= MAX_WITHOUT
    }

    fn look_at(&mut self, grey: &[u8], (width_px, height_px): (u32, u32)) -> Result<(), ProcessError> {
        let image = ImageView::new(grey, width_px as usize, height_px as usize)
            .map_err(assemble::AssembleError::from)?;
        let exposure = MonoNs((self.frames as f64 * 1e9 / self.config.camera.rate_hz) as i64);
        let header =
            FrameHeader { frame_id: self.frames, exposure, width_px, height_px, ..FrameHeader::default() };
        self.frames += 1;
        let seen = self.vision.process(&Frame { header, image }, &Prior::default());
        if self.note(&seen) {
            self.image = grey.to_vec();
        }
        Ok(())
    }

    /// Whether it shows all of the target.
    fn note(&mut self, seen: &Measurement) -> bool {
        let find = |id: u32| seen.features().iter().find(|f| f.id == u64::from(id));
        let whole = seen.found() && self.sums.iter().all(|sum| find(sum.id).is_some());
        if !whole {
            self.status = if seen.found() { "a part of it is hidden" } else { seen.target_status().as_str() };
            self.without += 1;
            return false;
        }
        for sum in &mut self.sums {
            if let Some(f) = find(sum.id) {
                let px = Vector2::new(f.u_px, f.v_px);
                sum.s += Vector2::new(f.x, f.y);
                sum.px += px;
                sum.px2 += px.norm_squared();
            }
        }
        self.without = 0;
        self.taken += 1;
        true
    }

    fn look_through(&mut self, source: AnySource, stop: &StopFlag) -> Result<(), ProcessError> {
        let size = self.config.camera.full_size_px();
        let mut grey = vec![0; size.0 as usize * size.1 as usize];
        match source {
            AnySource::Scheduled(mut source) => {
                let mut state = self.standing_arm();
                while !self.has_enough() && !stop.is_requested() {
                    state.stamp = MonoNs(TICK.0 * state.tick as i64);
                    source.arm(&state);
                    let exposure = Exposure {
                        frame_id: self.frames,
                        mid: state.stamp,
                        span: self.config.camera.exposure,
                    };
                    if source.expose(&exposure, &mut grey)? == Exposed::End {
                        break;
                    }
                    self.look_at(&grey, size)?;
                    state.tick += 40;
                }
            }
            AnySource::FreeRunning(mut source) => {
                let (begin, mut last) = (now(), now());
                while !self.has_enough() && !stop.is_requested() {
                    if now() - last > FIRST_FRAME {
                        let (device, waited_s) = (self.config.camera.id.to_string(), (now() - last).as_s());
                        return Err(ProcessError::NoFrame { device: format!("camera {device}"), waited_s });
                    }
                    if source.wait(Duration::from_millis(100))?.is_none() {
                        continue;
                    }
                    last = now();
                    if source.fill(&mut grey)? == Filled::Image && last - begin > WARM_UP {
                        self.look_at(&grey, size)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// An arm that stands where it starts.
    fn standing_arm(&self) -> JointState {
        let mut state = JointState { joints: self.config.start.q.len() as u32, ..JointState::default() };
        let places = state.q.iter_mut().zip(&mut state.q_true).zip(&mut state.q_r);
        for (((q, q_true), q_r), start) in places.zip(&self.config.start.q) {
            (*q, *q_true, *q_r) = (*start, *start, *start);
        }
        state
    }

    /// The mean of what was seen, and its last image.
    fn goal(self) -> Result<(GoalFile, Vec<u8>), ProcessError> {
        if self.taken == 0 {
            return Err(ProcessError::NothingTaught { images: self.frames, status: self.status });
        }
        let count = f64::from(self.taken);
        let features: Vec<_> = self
            .sums
            .iter()
            .map(|sum| {
                let (s, px) = (sum.s / count, sum.px / count);
                let spread_px = (sum.px2 / count - px.norm_squared()).max(0.0).sqrt();
                GoalFeature { id: sum.id, s: s.into(), px: Some(px.into()), spread_px: Some(spread_px) }
            })
            .collect();
        let s_d: Vec<_> = features.iter().map(|f| Vector2::from(f.s)).collect();
        let depth_m = self.config.effective.servo.constant_depth_m;
        let set_point = SetPoint::from_features(&s_d, self.config.set_point.points(), depth_m);
        let pose = set_point.as_ref().and_then(SetPoint::X_DO).map(GoalFile::pose_of);
        let target = GoalFile::target_word(self.config, self.name);
        let goal = GoalFile {
            target,
            target_name: self.name.map(str::to_owned),
            measurements: Some(self.taken),
            q_rad_or_m: Vec::new(),
            thumbnail: None,
            pose,
            features,
        };
        Ok((goal, self.image))
    }
}

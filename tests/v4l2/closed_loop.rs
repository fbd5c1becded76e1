//! The loop closed over a real driver: what the default cell's camera would see is rendered from the arm's true motion and played into a
//! video output, a cable of vivid leads from there to its capture device, and from there on everything is as in a real cell.
//!
//! ```text
//!        joint states ◄──────────────────────────────── control ◄── vision ◄── camera, source = "v4l2"
//!             │                                                                    ▲
//! the test:   └─► renderer ─► v4l2-ctl ─► /dev/video (HDMI output) ═ vivid ═ /dev/video (HDMI input)
//! ```
//! The output takes a frame at every period of 60 Hz and blocks the player meanwhile: the image that is captured is a constant time old.
//! How old is measured first, with images that say when they were drawn, and given to the run as `camera.stamp_offset_ms`.

use crate::capture::{self, Capture, CaptureRequest};
use crate::common::{Instance, read_summary, vservo, wait_until};
use crate::guest::{self, Vivid, sh};
use crate::usb_camera::test_image::{self, Marks};
use nalgebra::{Isometry3, SVector, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;
use std::io::Write;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;
use vservo::config::{Config, assemble};
use vservo::ipc::{Receiver, Services};
use vservo::messages::{ControlState, JointState, Status, joint_flag};
use vservo::rt::{now, sleep_until};
use vservo::scene::{Exposure, SyntheticCamera};
use vservo::time::SpanNs;

/// Frames that the output takes for one that is rendered.
const REPEATED: usize = 2;
/// HDMI at 640x480 has 59.94 Hz.
const RATE_HZ: f64 = 59.94;

/// vivid with its output led to its input, grey images of 640x480.
fn cable() -> Vivid {
    let vivid = Vivid::load("node_types=0x101 num_inputs=1 input_types=3 num_outputs=1 output_types=1");
    for device in [vivid.output(), vivid.capture()] {
        sh(&format!("v4l2-ctl -d {} --set-dv-bt-timings index=0", device.display()));
    }
    sh(&format!("v4l2-ctl -d {} --set-fmt-video-out=pixelformat=GREY", vivid.output().display()));
    vivid.set("loop_video=1,osd_text_mode=2");
    vivid
}

/// Renders the default cell and plays it.
struct Player {
    camera: SyntheticCamera<4>,
    image: Vec<u8>,
    frames: u64,
    tool: Child,
    screen: ChildStdin,
    heard: Vec<JointState>,
}

impl Player {
    fn new(output: &Path) -> Self {
        let config = Config::load(None, &[]).unwrap();
        let camera = assemble::synthetic_camera(&config).unwrap();
        let mut tool = Command::new("v4l2-ctl")
            .args(["--stream-out-mmap=2", "--stream-from=-", "-d"])
            .arg(output)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let screen = tool.stdin.take().unwrap();
        Self { camera, image: vec![0; 640 * 480], frames: 0, tool, screen, heard: Vec::new() }
    }

    /// Plays images that say when they were drawn, and captures them: the mean of how much later the stamps of the captures are.
    fn age_at_capture(&mut self, device: &Path) -> SpanNs {
        let request = CaptureRequest { rate_hz: RATE_HZ, ..CaptureRequest::VGA };
        let config = capture::config(device, request, "");
        let done = AtomicBool::new(false);
        let ages_us: Vec<i32> = std::thread::scope(|scope| {
            let measure = || {
                let mut capture = Capture::with(&config).unwrap();
                let mut ages = Vec::new();
                while ages.len() < 60 {
                    let captured = capture.next();
                    if let Some(marks) = test_image::read(&capture.grey, capture.width) {
                        ages.push(((captured.mid.0 / 1000) as u32).wrapping_sub(marks.exposed_us) as i32);
                    }
                }
                done.store(true, Ordering::Relaxed);
                ages
            };
            let measuring = Builder::new().name("measure".into()).spawn_scoped(scope, measure).unwrap();
            while !done.load(Ordering::Relaxed) {
                self.image = test_image::draw(Marks::new(self.frames, now()), 640, 480);
                self.show();
            }
            measuring.join().unwrap()
        });
        let mean_us = ages_us.iter().map(|age| i64::from(*age)).sum::<i64>() / ages_us.len() as i64;
        println!("an image is {mean_us} us old: {ages_us:?}");
        assert!((0..150_000).contains(&mean_us), "{ages_us:?}");
        SpanNs(1000 * mean_us)
    }

    /// Plays what is seen now; takes as long as the output takes for it.
    fn play(&mut self, arm: Option<&Receiver<JointState>>) {
        while let Some(state) = arm.and_then(|arm| arm.receive().unwrap()) {
            self.camera.arm(&state);
            self.heard.push(*state);
        }
        let exposure = Exposure { frame_id: self.frames, mid: now(), span: SpanNs::ZERO };
        self.camera.expose(&exposure, &mut self.image);
        self.show();
    }

    fn show(&mut self) {
        self.frames += 1;
        for _ in 0..REPEATED {
            self.screen.write_all(&self.image).unwrap();
        }
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        let _ = self.tool.kill();
        let _ = self.tool.wait();
    }
}

/// Distance and angle of the camera from where it is to be, for an arm that stands at `q`: the cell of the default run.
fn error_at(q: &[f64]) -> (f64, f64) {
    let pose = |position: [f64; 3], yaw: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Isometry3::from_parts(Translation3::from(position), turn)
    };
    let robot = vservo::robot::load("scara").unwrap().build::<4>().unwrap();
    let X_BC = robot.forward(&SVector::from_column_slice(&q[..4]));
    let X_BC = Isometry3::from_parts(X_BC.translation, X_BC.rotation);
    let X_BO = pose([1.0, 1.0, 1.0], std::f64::consts::FRAC_PI_4);
    let X_DO = pose([-0.1, 0.1, 0.6], -std::f64::consts::FRAC_PI_3);
    let X_DC = X_DO * (X_BC.inverse() * X_BO).inverse();
    (X_DC.translation.vector.norm(), X_DC.rotation.angle())
}

/// A finished run.
struct Run {
    summary: Value,
    /// Joint states; where the player had to wait for long, the newest of those that came.
    heard: Vec<JointState>,
    told: String,
}

/// A run of the default cell with vivid's capture device as its camera. `look` is called about 30 times a second.
fn servo(vivid: &Vivid, name: &str, mut look: impl FnMut(&Status)) -> Run {
    let instance = Instance::new(name);
    let folder = tempfile::tempdir().unwrap();
    let summary = folder.path().join("summary.json");
    let mut player = Player::new(&vivid.output());
    let offset_ms = -1e3 * player.age_at_capture(&vivid.capture()).as_s();
    let sets = [
        "camera.source=v4l2".into(),
        format!("camera.v4l2.device={:?}", vivid.capture().to_str().unwrap()),
        format!("camera.rate_hz={RATE_HZ:?}"),
        format!("camera.stamp_offset_ms={offset_ms:?}"),
        "camera.v4l2.format=GREY".into(),
        "goal.feature_error_px=0.2".into(),
    ];
    let mut run = vservo();
    run.args(["run", "--duration-s", "20", "--instance", &instance.name, "--summary"]).arg(&summary);
    for set in &sets {
        run.args(["--set", set]);
    }
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let place = Path::new("/dev/shm").join(format!("vservo-{}/config.toml", instance.name));
    wait_until("the instance", || place.exists());
    {
        let services = Services::join(&instance.name.parse().unwrap()).unwrap();
        let (arm, _bell) = services.joint_state_receiver().unwrap();
        let statuses = services.status_receiver().unwrap();
        while run.try_wait().unwrap().is_none() {
            player.play(Some(&arm));
            if let Some(status) = statuses.receive().unwrap() {
                look(&status);
            }
        }
        player.play(Some(&arm));
    }
    instance.name.parse::<vservo::ipc::Instance>().unwrap().remove_leftovers(None);
    let output = run.wait_with_output().unwrap();
    instance.assert_gone();
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    Run { summary: read_summary(&summary), heard: std::mem::take(&mut player.heard), told }
}

/// Asserts that a run has converged, in truth.
fn assert_there(Run { summary: s, heard, told }: &Run) {
    assert_eq!(s["outcome"], "converged", "{told}{s}");
    let last = heard.last().expect("joint states");
    assert_ne!(last.flags & joint_flag::TRUTH, 0);
    let (start_m, _) = error_at(&[0.0, std::f64::consts::FRAC_PI_2, 0.5, -std::f64::consts::FRAC_PI_4]);
    let (distance_m, angle_rad) = error_at(&last.q_true);
    println!("{told}\ntrue error {:.3} mm, {:.4} deg", distance_m * 1e3, angle_rad.to_degrees());
    assert!(start_m > 0.1 && distance_m < 1e-3 && angle_rad < 2e-3, "{start_m} {distance_m} {angle_rad}");
}

#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_servo_converges_on_images_of_a_driver() {
    let vivid = cable();
    let run = servo(&vivid, "cable", |_| {});
    assert_there(&run);
    // The control loop held its pace on the guest's one slow processor.
    let count = |key: &str| run.summary[key].as_f64().unwrap();
    assert!(count("missed_deadlines") < 0.02 * count("ticks"), "{}", run.told);
}

/// In the middle of the way no frame comes any more: the arm holds, and goes on when they are back.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_arm_holds_while_the_driver_gives_no_frames() {
    let vivid = cable();
    let capture = vivid.capture();
    let dropped =
        move |percent: u32| guest::set(&capture, &format!("percentage_of_dropped_buffers={percent}"));
    let mut cut = None;
    // The output stands still too, and with it the player: somebody else brings both back.
    let mut rescue = None;
    let run = servo(&vivid, "stall", |status| {
        let moves = status.state == ControlState::Servoing as u32 && status.time_s > 0.3;
        if cut.is_none() && moves {
            let (dropped, until) = (dropped.clone(), now() + SpanNs::from_s(2.0));
            dropped(100);
            cut = Some(now());
            let wait = move || {
                sleep_until(until);
                dropped(0);
            };
            rescue = Some(Builder::new().name("rescue".into()).spawn(wait).unwrap());
        }
    });
    rescue.expect("the arm moved").join().unwrap();
    let cut = cut.unwrap();
    let held: Vec<_> = run.heard.iter().filter(|s| (1.2..1.9).contains(&(s.stamp - cut).as_s())).collect();
    assert!(held.len() > 300, "{} joint states", held.len());
    let fastest = held.iter().flat_map(|s| s.qd_true).fold(0.0_f64, |f, v| f.max(v.abs()));
    assert!(fastest < 1e-3, "{fastest} rad/s or m/s");
    let (there_m, _) = error_at(&held[0].q_true);
    assert!(there_m > 1e-3, "it was still on its way: {there_m}");
    assert!(run.summary["safety"]["events"].to_string().contains("camera stalled"), "{}", run.summary);
    assert_there(&run);
}

/// What is played is what is captured, to the last bit and in its order.
#[test]
#[ignore = "runs in the virtual machine: tests/vm/run.py"]
fn the_cable_carries_images() {
    let vivid = cable();
    let mut player = Player::new(&vivid.output());
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut played = Vec::new();
    let mut capture: Option<Child> = None;
    loop {
        player.play(None);
        played.push(player.image.clone());
        if played.len() == 5 {
            sh(&format!("v4l2-ctl -d {} --set-fmt-video=pixelformat=GREY", vivid.capture().display()));
            let child = Command::new("v4l2-ctl")
                .args(["--stream-mmap", "--stream-count=30", "--stream-to"])
                .arg(file.path())
                .arg("-d")
                .arg(vivid.capture())
                .stderr(Stdio::null())
                .spawn();
            capture = Some(child.unwrap());
        }
        if capture.as_mut().is_some_and(|c| c.try_wait().unwrap().is_some()) {
            break;
        }
    }
    let captured = std::fs::read(file.path()).unwrap();
    assert_eq!(captured.len(), 30 * 640 * 480);
    let number = |image: &[u8]| played.iter().position(|p| p == image).expect("an image that was played");
    let numbers: Vec<usize> = captured.chunks(640 * 480).map(number).collect();
    // Each is taken twice by the output; input and output do not keep step with one another.
    assert!(numbers.windows(2).all(|w| w[1] == w[0] || w[1] == w[0] + 1), "{numbers:?}");
    assert!((14..=17).contains(&(numbers[29] - numbers[0])), "{numbers:?}");
}

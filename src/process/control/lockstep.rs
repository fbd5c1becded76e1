//! Lockstep: a simulated clock that waits for nothing but its own measurements.
//!
//! At each tick the arm's state goes out; a camera whose frame is due renders it. The measurement of a frame is used
//! exactly `latency` later, and the loop waits there until it has come. Nothing else decides: not the machine's load, not
//! the order in which processes run.

use super::plant::{self, Answer, PlantPorts};
use super::{Pace, Ports, STOP_REASON};
use crate::calibration::Recording;
use crate::config::Config;
use crate::control_loop::ControlLoop;
use crate::ipc::{FrameShape, Services, Spin};
use crate::messages::{Measurement, frame_flag};
use crate::process::{LONGEST_SPIN, LONGEST_WAIT, ProcessError, StopFlag, WAKE_AHEAD};
use crate::safety::Fault;
use crate::schedule::TICK;
use crate::summary::TickTimes;
use crate::time::MonoNs;
use std::collections::VecDeque;
use std::time::Duration;
use tracing::info;

/// Waits until camera and vision have joined: what is sent before would be lost to them.
pub(super) fn wait_for_peers(
    services: &Services,
    frames: FrameShape,
    stop: &StopFlag,
) -> Result<(), ProcessError> {
    let mut told = false;
    while !stop.is_requested() {
        let peers = services.peers(frames)?;
        if peers.camera && peers.vision {
            return Ok(());
        }
        if !told {
            info!("waiting for the camera and vision processes of this instance");
            told = true;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(())
}

/// Ticks to the end of the run.
pub(super) fn run<const N: usize>(
    config: &Config,
    mut control: ControlLoop<N>,
    ports: &Ports,
    mut plant: Option<PlantPorts<'_>>,
    mut recording: Option<&mut Recording<N>>,
    stop: &StopFlag,
) -> Result<(ControlLoop<N>, Pace), ProcessError> {
    let schedule = &config.camera.schedule;
    let mut inbox = Inbox { waiting: VecDeque::new(), last_frame: None, spin: Spin::new(LONGEST_SPIN) };
    let mut next_exposure = schedule.next_exposure_tick(0);
    let mut next_frame = 0;
    let mut tick = 0;
    loop {
        let now = MonoNs(TICK.0 * tick as i64);
        // The first state came when the plant was connected.
        if let Some(plant) = &mut plant
            && tick > 0
        {
            match plant.wait_for_state(tick, stop)? {
                Answer::Here => {}
                Answer::Stopped => {
                    control.stop(now, STOP_REASON);
                    control.fail(Fault::DriveSilent);
                }
                Answer::Failed(fault) => control.fail(fault),
            }
        }
        let state = control.sense(tick, now);
        if let Some(recording) = &mut recording {
            recording.note_state(&state);
        }
        if schedule.frame_at(tick).is_some() {
            next_exposure = schedule.next_exposure_tick(tick);
            ports.joint_state.send(&state)?;
        } else {
            ports.joint_state.send_quietly(&state)?;
        }
        if stop.is_requested() {
            control.stop(now, STOP_REASON);
        }
        let (mut measurement, before) = (None, next_frame);
        while schedule.usable_tick(next_frame) == tick {
            if !schedule.is_lost(next_frame) {
                measurement = inbox.measurement_of(next_frame, ports, stop)?.or(measurement);
            }
            next_frame += 1;
        }
        // From here to the next frame nothing is waited for: the camera may wake up meanwhile.
        let ahead = next_exposure - tick;
        if ahead == WAKE_AHEAD || (ahead < WAKE_AHEAD && next_frame > before) {
            ports.joint_state.ring()?;
        }
        if let (Some(recording), Some(m)) = (&mut recording, &measurement) {
            recording.note_measurement(m);
        }
        let (status, finish) = control.act(tick, now, measurement.as_ref());
        control.commanded(now);
        if let Some(plant) = &mut plant {
            plant.send()?;
        }
        if let Some(status) = status {
            ports.status.send_quietly(&status)?;
        }
        if let Some(finish) = finish {
            plant::farewell(plant)?;
            let tick_us = TickTimes::default();
            return Ok((
                control,
                Pace { finish, missed_deadlines: 0, skipped_ticks: 0, tick_us, realtime: None },
            ));
        }
        tick += 1;
    }
}

/// Measurements that have come, in the order of their frames.
struct Inbox {
    waiting: VecDeque<Measurement>,
    last_frame: Option<u64>,
    spin: Spin,
}

impl Inbox {
    /// The measurement of frame `id`, as soon as it is there; `None` when a stop is requested meanwhile, or no such frame
    /// will ever come.
    fn measurement_of(
        &mut self,
        id: u64,
        ports: &Ports,
        stop: &StopFlag,
    ) -> Result<Option<Measurement>, ProcessError> {
        loop {
            while let Some(m) = ports.measurements.receive()? {
                if m.flags & frame_flag::LAST != 0 {
                    self.last_frame = Some(m.frame_id);
                }
                self.waiting.push_back(m);
            }
            while self.waiting.front().is_some_and(|m| m.frame_id < id) {
                self.waiting.pop_front();
            }
            match self.waiting.front() {
                Some(m) if m.frame_id == id => return Ok(self.waiting.pop_front()),
                Some(_) => return Ok(None),
                None if stop.is_requested() || self.last_frame.is_some_and(|last| id > last) => {
                    return Ok(None);
                }
                None => {
                    let here = || ports.measurements.is_waiting();
                    ports.waker.wait_spinning(LONGEST_WAIT, &mut self.spin, here)?;
                }
            }
        }
    }
}

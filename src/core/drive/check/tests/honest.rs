//! The log that a drive which keeps to its contract leaves on a busy machine.

use crate::drive::CommandMode;
use crate::drive::check::*;
use crate::linalg::Random;
use crate::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, drive_flag};
use crate::robot::JointLimits;
use crate::time::{MonoNs, SpanNs};

pub(super) const JOINTS: usize = 4;
pub(super) const BEGIN: MonoNs = MonoNs(77_000_000_000_000);
pub(super) const START: [f64; 7] = [0.3, -0.8, 0.12, 1.4, 0.0, 0.0, 0.0];

pub(super) fn ms(ms: f64) -> SpanNs {
    SpanNs::from_s(ms * 1e-3)
}

pub(super) fn arm() -> ArmFacts {
    let joint = |i: usize| JointFacts {
        name: format!("j{i}"),
        limits: if i == 2 {
            JointLimits { lower: 0.0, upper: 0.4, velocity: 1.0, effort: 100.0 }
        } else {
            JointLimits { lower: -3.0, upper: 3.0, velocity: 3.0, effort: 100.0 }
        },
        prismatic: i == 2,
    };
    ArmFacts {
        joints: (0..JOINTS).map(joint).collect(),
        connect_timeout: ms(5000.0),
        drive_timeout: ms(100.0),
        lead: ms(20.0),
        wanted: CommandMode::Position,
        lockstep: false,
    }
}

/// How a good drive is, and how busy the machine.
#[derive(Clone, Copy)]
pub(super) struct Machine {
    pub(super) trial: DriveTrial,
    pub(super) mode: CommandMode,
    pub(super) period_ms: f64,
    pub(super) lag_ms: f64,
    /// A state comes so late at most, and a command too.
    pub(super) late_ms: f64,
    pub(super) lockstep: bool,
    pub(super) seed: u64,
}

pub(super) const USUAL: Machine = Machine {
    trial: DriveTrial::Motion,
    mode: CommandMode::Position,
    period_ms: 1.0,
    lag_ms: 12.0,
    late_ms: 3.0,
    lockstep: false,
    seed: 1,
};

pub(super) fn initial() -> DriveStateMsg {
    let (joints, modes) = (JOINTS as u32, 0b110);
    DriveStateMsg { joints, modes, q: START, flags: drive_flag::INITIAL, ..Default::default() }
}

/// What a good drive and a check leave. `tweak` changes each state before it is sent; it is told the time since the first command, ms.
pub(super) fn log_of(m: Machine, tweak: &dyn Fn(&mut DriveStateMsg, f64)) -> DriveLog {
    let mut arm = arm();
    (arm.lockstep, arm.wanted) = (m.lockstep, m.mode);
    let mut rng = Random::new(m.seed);
    let mut log = DriveLog {
        trial: m.trial,
        mode: m.mode,
        arm,
        sent: Vec::new(),
        received: Vec::new(),
        texts: Vec::new(),
        phases: Vec::new(),
        until: BEGIN,
        given_up: None,
        exit: ProgramExit::Ran,
    };
    let command = |at: MonoNs, flags: u32| DriveCommandMsg {
        stamp: at,
        joints: JOINTS as u32,
        mode: m.mode as u32,
        flags,
        q_r: START,
        ..Default::default()
    };
    for (i, at) in [ms(-90.0), ms(-40.0)].into_iter().enumerate() {
        let at = BEGIN + at;
        log.sent.push(SentCommand { at, command: command(at, drive_flag::START) });
        let mut state = DriveStateMsg { sequence: i as u64, stamp: at + ms(2.0), ..initial() };
        tweak(&mut state, -90.0);
        let names: Vec<_> = log.arm.joints.iter().map(|joint| joint.name.clone()).collect();
        log.texts.push(ReceivedText { at: at + ms(2.4), text: DriveTextMsg::of_joints(&names) });
        log.received.push(ReceivedState { at: at + ms(2.5), of_batch: 1, batch: 1, state });
    }
    for i in 0..2 {
        let text = DriveTextMsg::of_properties(&format!(
            "period_ms {}\nwatchdog_ms 100\nlag_ms {}",
            m.period_ms, m.lag_ms
        ));
        log.texts.push(ReceivedText { text, ..log.texts[i] });
    }
    let plan = TrialPlan::new(m.trial, &log.arm, m.mode, true, &initial());
    log.phases = plan
        .phases
        .iter()
        .map(|p| LoggedPhase { kind: p.kind, from: BEGIN + p.from, to: BEGIN + p.to })
        .collect();
    let whole_ms = plan.phases.last().unwrap().to.as_s() * 1e3;
    // Commands: each millisecond, some late, none during a silence.
    let mut tick = 0;
    while (tick as f64) < whole_ms {
        let late = if rng.uniform() < 0.02 && !m.lockstep { rng.between(0.0, m.late_ms) } else { 0.0 };
        let t = ms(tick as f64 + late);
        if let Some(phase) = plan.phase(t)
            && phase.kind != PhaseKind::Silence
        {
            let mut c = command(BEGIN + t, 0);
            c.tick = tick;
            (c.q_r, c.qd_r) = plan.reference(t);
            log.sent.push(SentCommand { at: BEGIN + t, command: c });
        }
        tick += 1 + late as u64;
    }
    let end = BEGIN + ms(whole_ms);
    log.sent.push(SentCommand { at: end, command: command(end, drive_flag::LAST) });
    // States: what was commanded a lag ago; in a silence the arm stands after 0.1 s, and what is to be refused is not obeyed.
    let odd = log.phases.iter().find(|p| p.kind.is_odd()).map(|p| (p.kind, (p.from - BEGIN).as_s() * 1e3));
    let (mut k, mut waits): (u64, Vec<usize>) = (0, Vec::new());
    loop {
        k += 1;
        let t = k as f64 * m.period_ms;
        if t > whole_ms + 20.0 || (m.lockstep && t > whole_ms) {
            break;
        }
        let of = match odd {
            Some((PhaseKind::Silence, from)) => (t - m.lag_ms).min(from - 0.01),
            Some((_, from)) => (t - m.lag_ms).min(from - 0.01),
            None => t - m.lag_ms,
        };
        let (q, mut qd) = plan.reference(ms(of.max(0.0)));
        if odd.is_some_and(|(_, from)| t - m.lag_ms > from) {
            qd = Default::default();
        }
        let mut state =
            DriveStateMsg { tick: k, sequence: k + 1, stamp: BEGIN + ms(t), flags: 0, q, qd, ..initial() };
        for j in 0..JOINTS {
            state.q[j] += rng.between(-2e-5, 2e-5);
            state.qd[j] += rng.between(-2e-3, 2e-3);
        }
        tweak(&mut state, t);
        // A reader that does not come to its work takes several at once.
        let at = BEGIN + ms(t + 0.1);
        log.received.push(ReceivedState { at, of_batch: 1, batch: 1, state });
        waits.push(log.received.len() - 1);
        if waits.len() > 1 || rng.uniform() >= 0.03 {
            if rng.uniform() < 0.3 {
                let batch = waits.len() as u32;
                let at = at + ms(rng.between(0.0, m.late_ms));
                for (of_batch, i) in (1..).zip(&waits) {
                    let r = &mut log.received[*i];
                    (r.at, r.of_batch, r.batch) = (at, of_batch, batch);
                }
            }
            waits.clear();
        }
    }
    let mut newest = MonoNs(i64::MIN);
    for r in &mut log.received {
        newest = newest.max(r.at);
        r.at = newest;
    }
    log.until = end + ms(150.0);
    log.exit = ProgramExit::Ended { at: end + ms(120.0), code: Some(0), words: None };
    log
}

pub(super) fn untouched(_: &mut DriveStateMsg, _: f64) {}

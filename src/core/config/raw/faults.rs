//! `[[faults]]`: what is put wrong on purpose about the simulated parts of a cell.

use crate::faults::FaultyProcess;
use serde::{Deserialize, Serialize};

word! {
    /// What is wrong.
    FaultKind {
        /// Frames are lost.
        Drop,
        /// Frames are handed over later.
        Delay,
        /// Frames are the one before once more, image and stamp.
        Duplicate,
        /// Frames show what the one before showed, with stamps of their own.
        Freeze,
        /// Frames are black.
        Black,
        /// Frames are white.
        Saturated,
        /// The lower half of frames is that of the one before.
        Torn,
        /// Left and right of frames are exchanged.
        Mirror,
        /// Stamps of frames are off: the camera's clock has leapt.
        ClockJump,
        /// Frames show everything a second time, displaced to the right.
        FalseTarget,
        /// Blocks of frames have levels at random.
        Corrupt,
        /// Measurements are the last good one before once more, with its stamp.
        Stale,
        /// Measurements are the good one before the last once more, with its stamp: they were overtaken.
        Overtaken,
        /// Measurements are displaced in the image.
        Jump,
        /// Two features of measurements have each other's ids.
        Mislabelled,
        /// Points in the image are off by noise, each by its own.
        PointNoise,
        /// A joint's encoder is off, one way or the other by chance, in single states.
        EncoderSpike,
        /// A joint's encoder stays where it was.
        EncoderFreeze,
        /// A joint's encoder is off by a constant.
        EncoderOffset,
        /// A joint's motor lacks a share of its torque.
        TorqueLoss,
        /// States of the arm are the one before once more.
        StaleState,
        /// Commands do not come to the arm, which does what it was told before.
        LostCommand,
        /// The process of camera or vision dies, as by kill -9; in real time.
        ProcessDies,
        /// The process of camera or vision does nothing, and shows no sign of life; in real time.
        ProcessHangs,
        /// The process of camera or vision takes longer for each frame; in real time.
        ProcessSlows,
    }
}

table! {
    /// One fault of the simulated parts of a cell.
    RawFault {
        /// What is wrong; it must be told.
        kind: Option<FaultKind> = None,
        /// From when on, s.
        from_s: f64 = 0.5,
        /// How long, s.
        duration_s: f64 = 0.5,
        /// Of each frame, measurement or state of that time, 0 to 1.
        probability: f64 = 1.0,
        /// `delay`, `process_slows`: by how much frames are later, ms; 100 where it is left out. `clock_jump`: by how much stamps are late, or early where it is negative; 200.
        delay_ms: Option<f64> = None,
        /// `jump`: by how much measurements are displaced, px; 20 where it is left out. `false_target`: by how much what is seen a second time is; 60. `point_noise`: the standard deviation; 1.
        size_px: Option<f64> = None,
        /// `encoder_spike`, `encoder_offset`: by how much the encoder is off, rad or m; 0.02 where it is left out.
        size_rad_or_m: Option<f64> = None,
        /// `corrupt`: share of the blocks, 0.2 where it is left out; `torque_loss`: share of the torque, 0.5.
        share: Option<f64> = None,
        /// `encoder_spike`, `encoder_freeze`, `encoder_offset`, `torque_loss`: which joint, from 0, which it is where it is left out.
        joint: Option<u32> = None,
        /// `process_dies`, `process_hangs`, `process_slows`: which, vision where it is left out.
        process: Option<FaultyProcess> = None,
    }
}

//! The stages of a calibration as spans, for whoever asks where its time goes.

/// Does the `work` of the stage called `name`.
pub(super) fn stage<T>(name: &'static str, work: impl FnOnce() -> T) -> T {
    tracing::debug_span!("stage", name).in_scope(work)
}

//! Summaries in words.

use super::*;
use crate::time::SpanNs;

#[test]
fn durations_are_told_no_finer_than_their_buckets() {
    let told = [0.0, 0.25, 5.42, 47.9, 96.4, 260.0, 1003.2, 6965.7, 20_500.0, 21_393.9].map(counted_us);
    assert_eq!(told, ["0", "0.250", "5.4", "48", "96", "260", "1000", "7000", "20500", "21400"]);
}

#[test]
fn text_leaves_out_what_was_never_measured() {
    let config = crate::config::Config::load(None, &[]).unwrap();
    let mut summary = Summary::without_control(&config, SpanNs(0));
    let text = summary.to_text();
    assert!(text.contains("outcome       fault") && text.contains("position unknown"), "{text}");
    assert!(!text.contains("latency") && !text.contains("tick  ") && !text.contains("hash"), "{text}");
    summary.latency_us.exposure_to_command.max = 20_000.0;
    assert!(summary.to_text().contains("latency       exposure to command"));
    let mut realtime = RealtimeReport { scheduling: "SCHED_FIFO 80".into(), ..RealtimeReport::default() };
    summary.realtime = Some(realtime.clone());
    assert!(summary.to_text().contains("SCHED_FIFO 80, 0 page faults"));
    (realtime.spin_us, realtime.spin_share) = (50.0, 0.0371);
    summary.realtime = Some(realtime);
    let text = summary.to_text();
    assert!(text.contains("SCHED_FIFO 80, spins the last 50 us (3.7 % of a core), 0 page faults"), "{text}");
}

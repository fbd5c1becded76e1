use super::*;
use proptest::prelude::*;

fn measurement(frame_id: u64) -> Measurement {
    let mut m = Measurement { frame_id, feature_count: 1, status: 0, ..Measurement::default() };
    if let Some(f) = m.features.first_mut() {
        (f.id, f.u_px, f.v_px) = (1, frame_id as f64, 0.5);
    }
    m
}

fn column<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    let mut lines = text.lines();
    let at = lines.next().unwrap().split(',').position(|c| c == name).unwrap();
    lines.map(|line| line.split(',').nth(at).unwrap()).collect()
}

proptest! {
    #[test]
    fn what_is_kept_is_even_and_has_both_ends(most in 2usize..40, count in 1u64..400) {
        let mut rows = Thinned::new(most);
        (0..count).for_each(|row| { rows.push(row); });
        let all: Vec<u64> = rows.all().copied().collect();
        prop_assert!(rows.rows.len() <= rows.most);
        prop_assert_eq!((all.first(), all.last()), (Some(&0), Some(&(count - 1))));
        let steps: Vec<u64> = rows.rows.windows(2).map(|w| w[1] - w[0]).collect();
        prop_assert!(steps.iter().all(|step| *step == rows.stride), "{all:?}");
        prop_assert!(count <= rows.most as u64 * rows.stride, "no coarser than it must be, and no finer");
    }
}

#[test]
fn measurements_keep_their_points_when_they_are_thinned() {
    // memory for 2 s at 30 Hz and a little more
    let mut history = RunHistory::new(2, &[&[0, 1]], SpanNs::from_s(2.0), 30.0);
    let before = (history.px.capacity(), history.measurements.rows.capacity());
    (0..1000).for_each(|k| history.note_measurement(&measurement(k)));
    assert_eq!(before, (history.px.capacity(), history.measurements.rows.capacity()), "reserved before");
    let text = history.measurements_csv();
    let (ids, u) = (column(&text, "frame_id"), column(&text, "u_2_px"));
    assert_eq!(ids, u, "each frame has its own point");
    assert_eq!((ids.first(), ids.last()), (Some(&"0"), Some(&"999")));
    assert!(column(&text, "u_1_px").iter().all(|u| u.is_empty()), "a point that was not seen");
    assert!(column(&text, "CO_x_m").iter().all(|x| x.is_empty()), "no pose");
}

#[test]
fn each_measurement_has_the_points_of_its_own_target() {
    let mut history = RunHistory::new(2, &[&[0, 1], &[1, 28, 29]], SpanNs::from_s(2.0), 30.0);
    for (frame_id, target_number) in [(5, 0), (6, 1), (7, 2), (8, 1)] {
        let pose = [frame_id as f64, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let flags = measurement_flag::POSE;
        history.note_measurement(&Measurement { target_number, flags, pose, ..measurement(frame_id) });
    }
    let text = history.measurements_csv();
    // Id 1 is the second point of the first target and the first one of the other; a number that no target has leaves no points.
    assert_eq!(column(&text, "u_2_px"), ["5", "6", "", "8"]);
    assert_eq!(column(&text, "target_number"), ["0", "1", "2", "1"]);
    assert!(["u_1_px", "u_29_px", "v_30_px"].iter().all(|name| column(&text, name) == ["", "", "", ""]));
    let x = |target| history.last_pose(target).map(|X_CO| X_CO.translation.x);
    assert_eq!(
        (x(0), x(1), x(9)),
        (None, Some(8.0), None),
        "the arm has moved on since another target was seen"
    );
}

#[test]
fn memory_is_bounded_whatever_the_run_file_says() {
    let history = RunHistory::new(100, &[&[0]], SpanNs(i64::MAX), f64::MAX);
    assert_eq!((history.joints, history.ticks.most, history.measurements.most), (7, 120_000, 12_000));
    let shortest = RunHistory::new(2, &[], SpanNs(i64::MIN), f64::NAN);
    assert!(shortest.ticks.most < 100 && shortest.measurements.most <= 12_000);
    assert_eq!(shortest.trace_csv(|_| PostureFacts::default()).lines().count(), 1);
}

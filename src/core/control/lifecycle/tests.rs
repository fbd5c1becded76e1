//! The whole table of transitions, written down a second time.

use super::*;
use std::collections::{HashMap, HashSet};

const CUES: [Cue; 23] = [
    Cue::Request(Request::Start),
    Cue::Request(Request::Hold),
    Cue::Request(Request::Teach),
    Cue::Request(Request::Reset),
    Cue::Request(Request::Stop),
    Cue::Request(Request::Shutdown),
    Cue::Request(Request::Goal),
    Cue::Request(Request::Goto),
    Cue::Request(Request::Jog),
    Cue::Request(Request::Set),
    Cue::Request(Request::Velocity),
    Cue::InView,
    Cue::OutOfView,
    Cue::WayBack,
    Cue::Returned,
    Cue::Taught,
    Cue::Arrived,
    Cue::Silent,
    Cue::AtRest,
    Cue::Failed,
    Cue::RobotClears,
    Cue::RobotReady,
    Cue::RobotStays,
];

/// A row for each state and a column for each cue: `.` where nothing happens, the first letters of the next state, or a refusal in capitals.
const TABLE: &str = "
          start     hold      teach     reset     stop      shutdown  goal      goto      jog       set       velocity  in_view   no_view   way_back  returned  taught    arrived   silent    at_rest   failed    clears    ready     stays
Idle      Waiting   NOSTART   Teaching  NOFAULT   .         Stopping  .         Moving    Moving    .         Moving    .         .         .         .         .         .         .         .         Failing   .         .         .
Waiting   STARTED   Held      Teaching  NOFAULT   Stopping  Stopping  .         Moving    Moving    .         Moving    Servoing  .         Returning .         .         .         .         .         Failing   .         .         .
Teaching  TEACHING  Held      .         NOFAULT   Stopping  Stopping  TEACHING  TEACHING  TEACHING  .         TEACHING  .         .         .         .         Held      .         .         .         Failing   .         .         .
Servoing  STARTED   Held      Teaching  NOFAULT   Stopping  Stopping  .         Moving    Moving    .         Moving    .         Holding   .         .         .         .         .         .         Failing   .         .         .
Holding   STARTED   Held      Teaching  NOFAULT   Stopping  Stopping  .         Moving    Moving    .         Moving    Servoing  .         Returning .         .         .         .         .         Failing   .         .         .
Returning STARTED   Held      Teaching  NOFAULT   Stopping  Stopping  .         Moving    Moving    .         Moving    Servoing  .         .         Holding   .         .         .         .         Failing   .         .         .
Moving    MOVING    Held      MOVING    NOFAULT   Stopping  Stopping  .         .         .         .         .         .         .         .         .         .         Held      Held      .         Failing   .         .         .
Held      Waiting   .         Teaching  NOFAULT   Stopping  Stopping  .         Moving    Moving    .         Moving    .         .         .         .         .         .         .         .         Failing   .         .         .
Stopping  MOVING    MOVING    MOVING    NOFAULT   .         .         .         MOVING    MOVING    .         MOVING    .         .         .         .         .         .         .         Idle      Failing   .         .         .
Failing   INFAULT   INFAULT   INFAULT   MOVING    .         .         INFAULT   INFAULT   INFAULT   .         INFAULT   .         .         .         .         .         .         .         Fault     .         .         .         .
Fault     INFAULT   INFAULT   INFAULT   Idle      .         .         INFAULT   INFAULT   INFAULT   .         INFAULT   .         .         .         .         .         .         .         .         .         Clearing  .         .
Clearing  INFAULT   INFAULT   INFAULT   .         Fault     Fault     INFAULT   INFAULT   INFAULT   .         INFAULT   .         .         .         .         .         .         .         .         Fault     .         Idle      Fault
";

fn step_of(word: &str) -> Step {
    let state = State::ALL.into_iter().find(|state| format!("{state:?}") == word);
    match (word, state) {
        (_, Some(state)) => Step::To(state),
        (".", _) => Step::Stay,
        ("NOSTART", _) => Step::Refuse(Refusal::NotStarted),
        ("NOFAULT", _) => Step::Refuse(Refusal::NoFault),
        ("STARTED", _) => Step::Refuse(Refusal::AlreadyStarted),
        ("TEACHING", _) => Step::Refuse(Refusal::Teaching),
        ("MOVING", _) => Step::Refuse(Refusal::StillMoving),
        ("INFAULT", _) => Step::Refuse(Refusal::InFault),
        _ => panic!("{word}"),
    }
}

#[test]
fn the_table_is_this_one() {
    let mut cells = 0;
    for row in TABLE.lines().filter(|row| !row.trim().is_empty()).skip(1) {
        let mut words = row.split_whitespace();
        let name = words.next().unwrap();
        let state = State::ALL.into_iter().find(|state| format!("{state:?}") == name).unwrap();
        for (cue, word) in CUES.into_iter().zip(words) {
            assert_eq!(state.next(cue), step_of(word), "{state:?} {cue:?}");
            cells += 1;
        }
    }
    assert_eq!(cells, State::ALL.len() * CUES.len());
}

#[test]
fn the_arm_servoes_only_after_a_start_and_never_from_a_fault() {
    for state in State::ALL {
        for cue in CUES {
            if state.next(cue) == Step::To(State::Servoing) {
                assert_eq!(cue, Cue::InView);
            }
        }
    }
    // Without a request for it nothing moves, whatever else happens.
    let sends = [Request::Start, Request::Goto, Request::Jog, Request::Velocity].map(Cue::Request);
    for from in [
        State::Idle,
        State::Fault,
        State::Clearing,
        State::Failing,
        State::Stopping,
        State::Held,
        State::Teaching,
    ] {
        let (mut seen, mut open) = (HashSet::from([from]), vec![from]);
        while let Some(state) = open.pop() {
            for cue in CUES.into_iter().filter(|cue| !sends.contains(cue)) {
                if let Step::To(next) = state.next(cue)
                    && seen.insert(next)
                {
                    open.push(next);
                }
            }
        }
        assert!(!seen.iter().any(|state| state.moves()), "{from:?}: {seen:?}");
    }
}

/// A fault is left by a reset, or by a robot that has cleared its error after one; never by anything else.
#[test]
fn nothing_but_a_reset_leads_out_of_a_fault() {
    for state in [State::Failing, State::Fault, State::Clearing] {
        for cue in CUES {
            let Step::To(next) = state.next(cue) else { continue };
            let faults = [State::Fault, State::Clearing];
            let way_out = [(State::Fault, Cue::Request(Request::Reset)), (State::Clearing, Cue::RobotReady)];
            assert!(faults.contains(&next) || way_out.contains(&(state, cue)), "{state:?} {cue:?}");
        }
    }
    for state in State::ALL.into_iter().filter(|state| *state != State::Fault) {
        assert!(!CUES.into_iter().any(|cue| state.next(cue) == Step::To(State::Clearing)), "{state:?}");
    }
}

#[test]
fn every_state_is_reached_and_left() {
    let mut reached: HashMap<State, usize> = HashMap::new();
    for state in State::ALL {
        let leads: Vec<_> = CUES.into_iter().filter(|cue| matches!(state.next(*cue), Step::To(_))).collect();
        assert!(!leads.is_empty(), "{state:?}");
        for cue in leads {
            if let Step::To(next) = state.next(cue) {
                *reached.entry(next).or_default() += 1;
            }
        }
    }
    assert_eq!(reached.len(), State::ALL.len());
}

#[test]
fn codes_come_back() {
    for request in Request::ALL {
        assert_eq!(Request::from_code(request as u32), Some(request));
    }
    for refusal in Refusal::ALL {
        assert_eq!(Refusal::from_code(refusal as u32), Some(refusal));
    }
    assert_eq!((Request::from_code(0), Refusal::from_code(0)), (None, None));
}

/// Programs read these words, and people those of the log: each is the name of what it tells.
#[test]
fn requests_and_states_are_told_by_their_names() {
    for request in Request::ALL {
        assert_eq!(request.as_str(), format!("{request:?}").to_lowercase());
    }
    for state in State::ALL {
        let is_fault = [State::Failing, State::Fault, State::Clearing].contains(&state);
        let name = if is_fault { "Fault".into() } else { format!("{state:?}") };
        assert_eq!(format!("{:?}", state.told()), name);
    }
}

/// Whoever is refused is told why: no reason has the words of another.
#[test]
fn each_refusal_has_words_of_its_own() {
    let words: HashSet<_> = Refusal::ALL.into_iter().map(Refusal::describe).collect();
    assert!(words.len() == Refusal::ALL.len() && words.iter().all(|words| words.contains(' ')));
}

/// Where the arm is sent it counts as moving: its rest, a contact and the limits in space are judged by that.
#[test]
fn what_was_asked_to_move_moves() {
    let ways = [
        (State::Waiting, Cue::InView),
        (State::Holding, Cue::WayBack),
        (State::Idle, Cue::Request(Request::Goto)),
        (State::Held, Cue::Request(Request::Jog)),
        (State::Servoing, Cue::Request(Request::Velocity)),
    ];
    for (from, cue) in ways {
        let Step::To(next) = from.next(cue) else { panic!("{from:?} {cue:?}") };
        assert!(next.moves(), "{next:?}");
    }
}

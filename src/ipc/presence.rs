//! Who is there, and what a service carries: to say what differs where two programs do not find each other.

use super::{Node, PubSub};
use crate::messages::{DriveCommandMsg, DriveStateMsg, FrameHeader, Measurement};
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use iceoryx2::service::static_config::messaging_pattern::MessagingPattern as Settings;

/// Our own programs begin with this.
const OWN_PROGRAMS: &str = "vservo";

/// Which peers have joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Peers {
    /// Every camera publishes frames.
    pub camera: bool,
    /// Vision publishes measurements.
    pub vision: bool,
}

/// The look-out for camera and vision. It holds their services open: a service that is opened and given up in turn can
/// vanish under the process that joins it in between.
#[derive(Debug)]
pub struct PeerPresence {
    frames: Vec<PubSub<[u8], FrameHeader>>,
    measurements: Vec<PubSub<Measurement>>,
}

impl PeerPresence {
    pub(super) fn new(
        frames: Vec<PubSub<[u8], FrameHeader>>,
        measurements: Vec<PubSub<Measurement>>,
    ) -> Self {
        Self { frames, measurements }
    }

    /// Which peers have joined; their ports, once made, miss nothing that is sent afterwards.
    #[must_use]
    pub fn look(&self) -> Peers {
        Peers {
            camera: self.frames.iter().all(|frames| frames.dynamic_config().number_of_publishers() > 0),
            vision: self.measurements.iter().all(|of| of.dynamic_config().number_of_publishers() > 0),
        }
    }
}

/// Looks for the external drive without opening anything anew.
#[derive(Debug)]
pub struct DrivePresence {
    states: PubSub<DriveStateMsg>,
    commands: PubSub<DriveCommandMsg>,
    config: Config,
}

impl DrivePresence {
    pub(super) fn new(
        states: PubSub<DriveStateMsg>,
        commands: PubSub<DriveCommandMsg>,
        config: Config,
    ) -> Self {
        Self { states, commands, config }
    }

    /// Whether an external drive has joined: it hears commands and sends states.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.sends() && self.hears()
    }

    fn sends(&self) -> bool {
        self.states.dynamic_config().number_of_publishers() > 0
    }

    fn hears(&self) -> bool {
        self.commands.dynamic_config().number_of_subscribers() > 0
    }

    /// What there is of it, what is missing, and who else is in the instance.
    #[must_use]
    pub fn describe(&self) -> String {
        let missing = match (self.sends(), self.hears()) {
            (true, true) => return "it is there".into(),
            (true, false) => "it sends states, but does not hear commands",
            // A guardian and a recorder hear commands too, so that this says nothing of a drive.
            (false, _) => "nobody sends states",
        };
        let types = format!(
            "`drive/state` carries {}, `drive/command` {}",
            type_of::<DriveStateMsg>(),
            type_of::<DriveCommandMsg>()
        );
        let strangers = strangers(&self.config);
        if strangers.is_empty() {
            return format!("{missing}, and no other program has joined this instance; {types}");
        }
        format!(
            "{missing}, yet there is {}: has it other types, or another version of iceoryx2 than {TRANSPORT}? {types}",
            strangers.join(", ")
        )
    }
}

/// The version of the transport, as Cargo.lock has it; programs with another one would not see each other.
const TRANSPORT: &str = "0.10.0";

/// Living programs in the instance that are none of ours.
fn strangers(config: &Config) -> Vec<String> {
    let mut found = Vec::new();
    let _ = Node::list(config, |state| {
        if let NodeState::Alive(node) = state
            && let Some(details) = node.details()
        {
            let program = details.executable().to_string();
            if !program.starts_with(OWN_PROGRAMS) {
                found.push(format!("`{program}` (process {})", details.process_id().value()));
            }
        }
        CallbackProgression::Continue
    });
    found
}

/// The type of a record as the transport compares it: name, size, alignment.
#[must_use]
pub fn type_of<T: ZeroCopySend>() -> String {
    text(&TypeDetail::new::<T>(TypeVariant::FixedSize))
}

/// What a publish-subscribe service carries, if there is one of this name.
pub(super) fn type_of_service(service: &ServiceName, config: &Config) -> Option<String> {
    let details = ipc::Service::details(service, config, MessagingPattern::PublishSubscribe).ok()??;
    let Settings::PublishSubscribe(settings) = details.static_details.messaging_pattern() else {
        return None;
    };
    Some(text(&settings.message_type_details().payload))
}

fn text(detail: &TypeDetail) -> String {
    format!("{} of {} bytes, aligned to {}", detail.type_name(), detail.size(), detail.alignment())
}

//! What viewers can subscribe to, and the newest messages of it. The watching loop puts them here, and each viewer's thread takes what it has not sent yet:
//! one that is slow misses some, and holds up nobody.

use super::protocol::ViewerChannel;
use crate::time::MonoNs;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Bytes of messages that are kept for viewers. Chosen by hand: more than two seconds of all that a run sends at 1 kHz with images of VGA at 10 Hz.
const KEPT_BYTES: usize = 16 << 20;
/// Messages that are kept. Chosen by hand, for the same two seconds.
const KEPT_MESSAGES: usize = 4096;

/// A message of a channel.
#[derive(Debug)]
pub(super) struct ChannelMessage {
    pub(super) channel: u32,
    pub(super) stamp_ns: u64,
    pub(super) data: Vec<u8>,
}

#[derive(Debug, Default)]
struct Channels {
    /// Which run of this watcher, from 1; 0 before the first.
    run: u64,
    name: String,
    channels: Vec<Arc<ViewerChannel>>,
    /// Number of the next channel; those of runs before are not used again.
    next_id: u32,
    /// How many subscribe to each channel.
    subscribers: BTreeMap<u32, usize>,
    /// The last message of channels that tell it to who comes later.
    latched: BTreeMap<u32, Arc<ChannelMessage>>,
    kept: VecDeque<Arc<ChannelMessage>>,
    kept_bytes: usize,
    /// How many there were.
    count: u64,
}

/// Everything that live viewers are offered.
#[derive(Debug, Default)]
pub(crate) struct ChannelHub {
    channels: Mutex<Channels>,
    changed: Condvar,
    viewers: AtomicUsize,
}

/// What a viewer has been told.
#[derive(Debug, Default)]
pub(super) struct ViewerProgress {
    run: Option<u64>,
    pub(super) channels: Vec<u32>,
    count: u64,
}

/// What a viewer has not been told yet.
#[derive(Debug, Default)]
pub(super) struct News {
    /// The run, where it is another one.
    pub(super) run: Option<(u64, String)>,
    pub(super) new: Vec<Arc<ViewerChannel>>,
    pub(super) gone: Vec<u32>,
    pub(super) messages: Vec<Arc<ChannelMessage>>,
}

impl ChannelHub {
    fn lock(&self) -> MutexGuard<'_, Channels> {
        self.channels.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Another run begins, whose channels are others.
    pub(super) fn begin(&self, run: u64, name: &str) {
        let mut channels = self.lock();
        let next_id = channels.next_id;
        *channels =
            Channels { run, name: name.to_owned(), next_id, count: channels.count, ..Channels::default() };
        drop(channels);
        self.changed.notify_all();
    }

    /// Offers another channel; its number.
    pub(super) fn offer(&self, topic: &str, (schema_name, schema): (String, String)) -> u32 {
        let mut channels = self.lock();
        let id = channels.next_id;
        channels.next_id += 1;
        let (encoding, schema_encoding) = ("cdr", "ros2msg");
        let channel =
            ViewerChannel { id, topic: topic.to_owned(), encoding, schema_name, schema, schema_encoding };
        channels.channels.push(Arc::new(channel));
        drop(channels);
        self.changed.notify_all();
        id
    }

    /// Whether anybody is there to whom anything could be told.
    pub(super) fn has_viewers(&self) -> bool {
        self.viewers.load(Ordering::Relaxed) > 0
    }

    /// Whether anybody wants the messages of a channel.
    pub(super) fn is_wanted(&self, channel: u32) -> bool {
        self.lock().subscribers.get(&channel).is_some_and(|count| *count > 0)
    }

    /// Publishes a message; the last one of a channel that is `latched` is told to who subscribes later.
    pub(super) fn publish(&self, channel: u32, stamp: MonoNs, data: Vec<u8>, latched: bool) {
        let message =
            Arc::new(ChannelMessage { channel, stamp_ns: u64::try_from(stamp.0).unwrap_or_default(), data });
        let mut channels = self.lock();
        if latched {
            channels.latched.insert(channel, Arc::clone(&message));
        }
        if channels.subscribers.get(&channel).is_none_or(|count| *count == 0) {
            return;
        }
        channels.kept_bytes += message.data.len();
        channels.kept.push_back(message);
        channels.count += 1;
        while channels.kept_bytes > KEPT_BYTES || channels.kept.len() > KEPT_MESSAGES {
            let Some(oldest) = channels.kept.pop_front() else { break };
            channels.kept_bytes -= oldest.data.len();
        }
        drop(channels);
        self.changed.notify_all();
    }

    /// A viewer subscribes to a channel; what is latched there. `Err` with words where there is no such channel: nothing is kept for numbers that viewers make up.
    pub(super) fn subscribe(&self, channel: u32) -> Result<Option<Arc<ChannelMessage>>, &'static str> {
        let mut channels = self.lock();
        if !channels.channels.iter().any(|offered| offered.id == channel) {
            return Err("there is no such channel");
        }
        *channels.subscribers.entry(channel).or_default() += 1;
        Ok(channels.latched.get(&channel).map(Arc::clone))
    }

    /// A viewer does not want a channel any more.
    pub(super) fn unsubscribe(&self, channel: u32) {
        if let Some(count) = self.lock().subscribers.get_mut(&channel) {
            *count = count.saturating_sub(1);
        }
    }

    /// A viewer comes, or leaves.
    pub(super) fn count_viewer(&self, comes: bool) {
        if comes {
            self.viewers.fetch_add(1, Ordering::Relaxed);
        } else {
            self.viewers.fetch_sub(1, Ordering::Relaxed);
        }
    }

    /// What there is beyond what was `told`; waits for it for `longest`.
    pub(super) fn news(&self, told: &mut ViewerProgress, longest: Duration) -> News {
        let is_old = |now: &mut Channels| {
            Some(now.run) == told.run && now.count == told.count && now.channels.len() == told.channels.len()
        };
        let channels = self.changed.wait_timeout_while(self.lock(), longest, is_old);
        let (channels, _) = channels.unwrap_or_else(PoisonError::into_inner);
        let is_other = Some(channels.run) != told.run;
        let gone = if is_other { std::mem::take(&mut told.channels) } else { Vec::new() };
        let new: Vec<_> = channels.channels.iter().skip(told.channels.len()).map(Arc::clone).collect();
        told.channels.extend(new.iter().map(|channel| channel.id));
        let missed = usize::try_from(channels.count - told.count).unwrap_or(usize::MAX);
        let from = channels.kept.len().saturating_sub(missed);
        let messages = channels.kept.iter().skip(from).map(Arc::clone).collect();
        (told.run, told.count) = (Some(channels.run), channels.count);
        let run = is_other.then(|| (channels.run, channels.name.clone()));
        News { run, new, gone, messages }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schema() -> (String, String) {
        ("a/msg/B".into(), "uint8 c\n".into())
    }

    #[test]
    fn each_viewer_is_told_what_is_new_to_it() {
        let hub = ChannelHub::default();
        hub.begin(1, "one");
        let (a, b) = (hub.offer("/a", schema()), hub.offer("/b", schema()));
        hub.publish(a, MonoNs(1), vec![1], true);
        hub.publish(b, MonoNs(1), vec![1], false);
        let (mut told, mut late) = (ViewerProgress::default(), ViewerProgress::default());
        let first = hub.news(&mut told, Duration::ZERO);
        assert_eq!((first.run, first.new.len(), first.messages.len()), (Some((1, "one".into())), 2, 0));
        assert_eq!(hub.subscribe(a).unwrap().map(|m| m.data.clone()), Some(vec![1]), "it is latched");
        assert!(hub.subscribe(b).unwrap().is_none() && hub.is_wanted(b));
        assert!(hub.subscribe(99).is_err() && !hub.is_wanted(99), "nobody offers it");
        hub.publish(b, MonoNs(2), vec![2], false);
        hub.publish(b, MonoNs(3), vec![3], false);
        let news = hub.news(&mut told, Duration::ZERO);
        let data: Vec<_> = news.messages.iter().map(|m| (m.channel, m.stamp_ns, m.data.clone())).collect();
        assert_eq!(data, [(b, 2, vec![2]), (b, 3, vec![3])]);
        assert!(hub.news(&mut told, Duration::ZERO).messages.is_empty());
        hub.unsubscribe(b);
        hub.publish(b, MonoNs(4), vec![4], false);
        assert!(hub.news(&mut told, Duration::ZERO).messages.is_empty() && !hub.is_wanted(b));
        hub.begin(2, "two");
        let c = hub.offer("/c", schema());
        let news = hub.news(&mut told, Duration::ZERO);
        assert_eq!((news.gone, news.new[0].id, news.run), (vec![a, b], c, Some((2, "two".into()))));
        let all = hub.news(&mut late, Duration::ZERO);
        assert_eq!((all.gone.len(), all.new.len()), (0, 1), "who comes late is told of this run alone");
    }

    #[test]
    fn a_slow_viewer_misses_what_is_older_and_memory_is_bounded() {
        let hub = ChannelHub::default();
        hub.begin(1, "one");
        let a = hub.offer("/a", schema());
        let mut told = ViewerProgress::default();
        hub.news(&mut told, Duration::ZERO);
        hub.subscribe(a).unwrap();
        for k in 0..40 {
            hub.publish(a, MonoNs(k), vec![0; 1 << 20], false);
        }
        let stamps: Vec<_> =
            hub.news(&mut told, Duration::ZERO).messages.iter().map(|m| m.stamp_ns).collect();
        assert_eq!(stamps, (24..40).collect::<Vec<u64>>(), "the newest 16 MiB");
    }
}

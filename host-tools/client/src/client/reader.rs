//! Receiving side: turns bytes into replies and frames, and counts lost frames.

use std::io::{ErrorKind, Read};
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering};
use std::sync::mpsc::{Sender, SyncSender, TrySendError};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use taxel::frame::Frame;
use taxel::wire::deframer::Deframer;
use taxel::wire::message::Message;

use super::{Received, lock, tag_of};
use crate::error::Problem;

/// No request starts the stream.
pub(super) const NO_TAG: u16 = u16::MAX;

/// Numbers of frames since the stream was started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames received.
    pub frames: u64,
    /// Frames missing between the sequence numbers received.
    pub lost: u64,
    /// Damaged packets. Bytes before the first whole packet do not count.
    pub bad_packets: u64,
    /// Frames received but dropped because the program was too slow.
    pub overflow: u64,
}

/// State shared by reader and client.
#[derive(Debug)]
pub(super) struct Shared {
    frames: AtomicU64,
    lost: AtomicU64,
    bad_packets: AtomicU64,
    overflow: AtomicU64,
    /// Tag of the request that starts the stream; frames count from its reply on.
    pub(super) start_tag: AtomicU16,
    pub(super) stop: AtomicBool,
    end: Mutex<Option<Problem>>,
}

impl Default for Shared {
    fn default() -> Self {
        Self {
            frames: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            bad_packets: AtomicU64::new(0),
            overflow: AtomicU64::new(0),
            start_tag: AtomicU16::new(NO_TAG),
            stop: AtomicBool::new(false),
            end: Mutex::new(None),
        }
    }
}

impl Shared {
    pub(super) fn counts(&self) -> Counts {
        Counts {
            frames: self.frames.load(Ordering::Relaxed),
            lost: self.lost.load(Ordering::Relaxed),
            bad_packets: self.bad_packets.load(Ordering::Relaxed),
            overflow: self.overflow.load(Ordering::Relaxed),
        }
    }

    /// Cause of the end of the link, if it has ended.
    pub(super) fn ended(&self) -> Option<Problem> {
        lock(&self.end).clone()
    }
}

pub(super) struct Reader {
    bytes: Box<dyn Read + Send>,
    deframer: Deframer,
    replies: Sender<Message>,
    frames: SyncSender<Received>,
    shared: Arc<Shared>,
    sequence: Sequence,
    /// Time of the last frame, or of the stream's start.
    last: Instant,
    started: bool,
    synchronised: bool,
}

impl Reader {
    pub(super) fn new(
        bytes: Box<dyn Read + Send>,
        replies: Sender<Message>,
        frames: SyncSender<Received>,
        shared: Arc<Shared>,
    ) -> Self {
        Self {
            bytes,
            deframer: Deframer::default(),
            replies,
            frames,
            shared,
            sequence: Sequence::default(),
            last: Instant::now(),
            started: false,
            synchronised: false,
        }
    }

    /// Reads until the link ends or the client is dropped. The dropped channels end the client's
    /// waits.
    pub(super) fn run(mut self) {
        let mut buffer = [0; 4096];
        while !self.shared.stop.load(Ordering::Acquire) {
            match self.bytes.read(&mut buffer) {
                Ok(0) => return self.end(Problem::Unplugged("it closed the link".to_owned())),
                Ok(length) => self.bytes(buffer.get(..length).unwrap_or_default()),
                Err(error) => match error.kind() {
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted => {}
                    _ => return self.end(Problem::broken(&error)),
                },
            }
        }
    }

    fn end(&self, problem: Problem) {
        *lock(&self.shared.end) = Some(problem);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        let at = Instant::now();
        for byte in bytes {
            match self.deframer.push::<Message>(*byte) {
                None => {}
                Some(Ok(message)) => {
                    self.synchronised = true;
                    self.message(message, at);
                }
                Some(Err(_)) if self.synchronised => add(&self.shared.bad_packets, 1),
                Some(Err(_)) => {}
            }
        }
    }

    fn message(&mut self, message: Message, at: Instant) {
        if let Message::Frame(frame) = message {
            if self.started {
                self.frame(frame, at);
            }
            return;
        }
        if tag_of(&message).map(u16::from) == Some(self.shared.start_tag.load(Ordering::Acquire)) {
            self.shared.start_tag.store(NO_TAG, Ordering::Release);
            self.started = true;
            (self.sequence, self.last) = (Sequence::default(), at);
        }
        // The client may have been dropped.
        let _ = self.replies.send(message);
    }

    fn frame(&mut self, frame: Frame, at: Instant) {
        add(&self.shared.frames, 1);
        let since = at.duration_since(self.last);
        self.last = at;
        add(&self.shared.lost, self.sequence.lost_before(frame.seq, since).into());
        if let Err(TrySendError::Full(_)) = self.frames.try_send(Received { frame, at }) {
            add(&self.shared.overflow, 1);
        }
    }
}

fn add(count: &AtomicU64, more: u64) {
    count.fetch_add(more, Ordering::Relaxed);
}

/// Finds the gaps in sequence numbers, which wrap.
#[derive(Debug, Default)]
struct Sequence {
    next: Option<u32>,
}

impl Sequence {
    /// Backward steps below this are duplicates; above, the finger has restarted.
    const DUPLICATES: u32 = 256;

    /// Most frames a second of any finger, and the time for which links hold frames back.
    const FASTEST_HZ: f64 = 10_000.0;
    const HELD_BACK_S: f64 = 10.0;

    /// Returns how many frames are missing between the last one and this, which came `since` later.
    ///
    /// A gap of more frames than a finger sends in that time is a restart.
    fn lost_before(&mut self, seq: u32, since: Duration) -> u32 {
        let ahead = seq.wrapping_sub(self.next.unwrap_or(seq));
        if f64::from(ahead) <= Self::FASTEST_HZ * (since.as_secs_f64() + Self::HELD_BACK_S) {
            self.next = Some(seq.wrapping_add(1));
            return ahead;
        }
        if ahead.wrapping_neg() > Self::DUPLICATES {
            self.next = Some(seq.wrapping_add(1));
        }
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost(frames: &[u32]) -> u32 {
        let mut sequence = Sequence::default();
        frames.iter().map(|seq| sequence.lost_before(*seq, Duration::ZERO)).sum()
    }

    #[test]
    fn impossible_jump_is_a_restart_and_counts_no_loss() {
        assert_eq!(lost(&[7, 2_147_483_600, 2_147_483_602]), 1);
        let mut asleep = Sequence::default();
        assert_eq!(asleep.lost_before(7, Duration::ZERO), 0);
        assert_eq!(asleep.lost_before(3_600_008, Duration::from_secs(3600)), 3_600_000);
    }

    #[test]
    fn gaps_are_counted_from_first_frame() {
        assert_eq!(lost(&[7, 8, 9]), 0);
        assert_eq!(lost(&[7, 8, 11, 12, 14]), 3);
    }

    #[test]
    fn sequence_wraps_without_gap() {
        assert_eq!(lost(&[u32::MAX - 1, u32::MAX, 0, 1]), 0);
        assert_eq!(lost(&[u32::MAX - 1, 2]), 3);
    }

    #[test]
    fn duplicates_and_late_frames_count_no_loss() {
        assert_eq!(lost(&[5, 5, 6, 4, 7]), 0);
        assert_eq!(lost(&[0, u32::MAX, 1]), 0);
    }

    #[test]
    fn restarted_sequence_is_followed() {
        assert_eq!(lost(&[100_000, 0, 1, 3]), 1);
    }

    fn frame(seq: u32) -> Vec<u8> {
        let frame = Frame { seq, ..Frame::default() };
        packed(&Message::Frame(frame))
    }

    fn packed(message: &Message) -> Vec<u8> {
        taxel::wire::pack(message, &mut [0; taxel::wire::MAX_PACKET]).unwrap().to_vec()
    }

    /// Reads these packets after a request with tag 9 to start the stream.
    fn read(packets: &[Vec<u8>], queue: usize) -> (Counts, Vec<u32>) {
        let shared = Arc::new(Shared::default());
        shared.start_tag.store(9, Ordering::Release);
        let (replies, _replies) = std::sync::mpsc::channel();
        let (frames, received) = std::sync::mpsc::sync_channel(queue);
        let bytes = Box::new(std::io::Cursor::new(packets.concat()));
        Reader::new(bytes, replies, frames, Arc::clone(&shared)).run();
        (shared.counts(), received.iter().map(|received| received.frame.seq).collect())
    }

    fn started() -> Vec<u8> {
        let result = Ok(taxel::wire::message::Response::Done);
        packed(&Message::Reply { tag: 9, result })
    }

    #[test]
    fn frames_count_from_start_reply() {
        let stale = [frame(3), frame(80)].concat();
        let (counts, seqs) = read(&[stale, started(), frame(90), frame(91)], 10);
        assert_eq!(seqs, [90, 91]);
        assert_eq!(counts, Counts { frames: 2, ..Counts::default() });
    }

    #[test]
    fn bad_packets_count_after_synchronisation() {
        let torn = frame(1).split_off(4);
        let damaged = frame(11).iter().map(|byte| byte ^ u8::from(*byte > 1)).collect();
        let (counts, seqs) = read(&[torn, started(), frame(10), damaged, frame(12)], 10);
        assert_eq!(seqs, [10, 12]);
        assert_eq!(counts, Counts { frames: 2, lost: 1, bad_packets: 1, overflow: 0 });
    }

    #[test]
    fn overflowing_frames_are_dropped_and_counted() {
        let (counts, seqs) = read(&[started(), frame(0), frame(1), frame(2)], 2);
        assert_eq!(seqs, [0, 1]);
        assert_eq!(counts, Counts { frames: 3, overflow: 1, ..Counts::default() });
    }
}

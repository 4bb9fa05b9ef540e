//! The connections of a server: a fixed number of them, a share of it for each client address, and a rule for who gives way
//! when all are taken.

use crate::lock::lock;
use std::net::{IpAddr, Shutdown, TcpStream};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A connection without a request for this long gives way to a new one when all are taken.
const PATIENCE: Duration = Duration::from_millis(100);
/// Longest wait for a connection that was told to give way.
const FAREWELL: Duration = Duration::from_millis(200);

struct Slot {
    id: u64,
    peer: IpAddr,
    /// Since when it has waited for a request; `None` while a request is answered.
    idle_since: Option<Instant>,
    stream: TcpStream,
}

#[derive(Default)]
struct Taken {
    next_id: u64,
    list: Vec<Slot>,
}

/// The connections that are open.
pub struct Slots {
    most: usize,
    taken: Mutex<Taken>,
    freed: Condvar,
}

impl Slots {
    /// Room for `most` connections; one client address may take a third of it.
    #[must_use]
    pub fn new(most: usize) -> Self {
        Self { most, taken: Mutex::default(), freed: Condvar::new() }
    }

    /// Takes a slot for a connection; where none is free, that of the connection that has waited longest without a request.
    pub fn take(&self, stream: &TcpStream, peer: IpAddr) -> Option<u64> {
        let mut taken = lock(&self.taken);
        let share = (self.most / 3).max(2);
        // A client beyond its share takes from itself.
        let crowded = |t: &Taken| t.list.iter().filter(|s| s.peer == peer).count() >= share;
        if taken.list.len() >= self.most || crowded(&taken) {
            let own_only = crowded(&taken);
            let candidates = taken.list.iter().filter(|s| !own_only || s.peer == peer);
            let longest = candidates.filter_map(|s| Some((s.idle_since?, s))).min_by_key(|(since, _)| *since);
            let (_, slot) = longest.filter(|(since, _)| since.elapsed() >= PATIENCE)?;
            let _ = slot.stream.shutdown(Shutdown::Both);
            let gone = slot.id;
            let (back, _) = self
                .freed
                .wait_timeout_while(taken, FAREWELL, |t| t.list.iter().any(|s| s.id == gone))
                .unwrap_or_else(PoisonError::into_inner);
            taken = back;
            if taken.list.len() >= self.most || crowded(&taken) {
                return None;
            }
        }
        let stream = stream.try_clone().ok()?;
        taken.next_id += 1;
        let id = taken.next_id;
        taken.list.push(Slot { id, peer, idle_since: Some(Instant::now()), stream });
        Some(id)
    }

    /// Notes whether a connection waits for a request.
    pub fn set_idle(&self, id: u64, idle: bool) {
        if let Some(slot) = lock(&self.taken).list.iter_mut().find(|s| s.id == id) {
            slot.idle_since = idle.then(Instant::now);
        }
    }

    /// Gives a slot back.
    pub fn release(&self, id: u64) {
        lock(&self.taken).list.retain(|s| s.id != id);
        self.freed.notify_all();
    }

    /// Ends every connection.
    pub fn close(&self) {
        for slot in &lock(&self.taken).list {
            let _ = slot.stream.shutdown(Shutdown::Both);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn a_connection_that_waits_gives_way_and_one_that_works_does_not() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let connect = || TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (slots, a, b) = (Slots::new(6), IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let stream = connect();
        let first = slots.take(&stream, a).unwrap();
        let second = slots.take(&stream, a).unwrap();
        assert_eq!(slots.take(&stream, a), None, "a third of the slots for one client, and nobody has waited for long");
        assert!(slots.take(&stream, b).is_some(), "another client is not concerned");
        slots.set_idle(first, false);
        std::thread::sleep(PATIENCE);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(20));
                slots.release(second);
            });
            assert!(slots.take(&connect(), a).is_some(), "the one that waits gives way");
        });
        slots.set_idle(first, true);
        slots.release(first);
    }
}

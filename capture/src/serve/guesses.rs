//! What a wrong code or token costs: time, in which the clients wait for each other. Few of them may wait: each holds a connection.

use crate::lock::lock;
use std::net::IpAddr;
use std::sync::Mutex;
use std::time::Duration;

/// Time that a wrong guess costs.
pub const COST: Duration = Duration::from_secs(1);
/// Clients that may be waiting for the answer to a guess at a time, one guess each.
const WAITING: usize = 8;

/// Too many guesses wait for their answer, or one of this client does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooMany;

/// The guesses of all clients.
#[derive(Default)]
pub struct Guesses {
    waiting: Mutex<Vec<IpAddr>>,
    turn: Mutex<()>,
}

impl Guesses {
    /// Lets a client guess.
    ///
    /// # Errors
    /// It has to try again later, whatever it guessed.
    pub fn begin(&self, peer: IpAddr) -> Result<Guess<'_>, TooMany> {
        let mut waiting = lock(&self.waiting);
        if waiting.len() >= WAITING || waiting.contains(&peer) {
            return Err(TooMany);
        }
        waiting.push(peer);
        Ok(Guess { all: self, peer })
    }
}

/// A guess that is being looked at.
pub struct Guess<'a> {
    all: &'a Guesses,
    peer: IpAddr,
}

impl Guess<'_> {
    /// It was wrong: waits for all wrong guesses before this one, and then some.
    pub fn punish(self) {
        let _turn = lock(&self.all.turn);
        std::thread::sleep(COST);
    }
}

impl Drop for Guess<'_> {
    fn drop(&mut self) {
        lock(&self.all.waiting).retain(|p| *p != self.peer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(n: usize) -> IpAddr {
        IpAddr::from([10, 0, 0, n as u8])
    }

    #[test]
    fn few_clients_wait_and_one_guess_of_each() {
        let guesses = Guesses::default();
        let mut begun: Vec<_> = (0..WAITING).map(|n| guesses.begin(client(n)).unwrap()).collect();
        assert!(guesses.begin(client(WAITING)).is_err(), "all places are taken");
        drop(begun.pop());
        assert!(guesses.begin(client(0)).is_err(), "a client has one place");
        assert!(guesses.begin(client(WAITING)).is_ok());
    }

    #[test]
    fn wrong_guesses_wait_for_each_other() {
        let guesses = Guesses::default();
        let began = std::time::Instant::now();
        std::thread::scope(|scope| {
            for n in 0..2 {
                let guess = guesses.begin(client(n)).unwrap();
                scope.spawn(move || guess.punish());
            }
        });
        assert!(began.elapsed() >= 2 * COST);
    }
}

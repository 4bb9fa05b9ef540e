//! The box's name in its networks, by multicast DNS (RFC 6762): who asks for `lumiscan-<serial>.local` is told the address of the
//! page. In: queries from neighbours. Out: address records. One thread, one buffer, nothing is remembered of what was heard.

use crate::lock::lock;
use if_addrs::{IfAddr, Ifv4Addr};
use rustix::net::sockopt;
use rustix::net::{AddressFamily, SocketType, bind, socket};
use simple_dns::rdata::{A, RData};
use simple_dns::{CLASS, Name, Packet, PacketFlag, QCLASS, QTYPE, ResourceRecord, TYPE};
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const GROUP: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 0, 0, 251), PORT);
const PORT: u16 = 5353;
/// Longest packet that is read.
const PACKET: usize = 9000;
/// Longest label of a name.
const LABEL: usize = 63;
/// How long others may remember an address; those that ask from another port are told a short time.
const REMEMBER_S: u32 = 120;
const REMEMBER_LEGACY_S: u32 = 10;
/// Time between two looks at the networks of the machine.
const LOOK: Duration = Duration::from_secs(10);
/// Time between two looks at whether the page ends or the name changes.
const POLL: Duration = Duration::from_millis(200);
/// Shortest time between two answers to everybody.
const PAUSE: Duration = Duration::from_secs(1);

/// A name in the networks; it ends when dropped.
pub struct Announcement {
    name: Arc<Mutex<Option<String>>>,
    ended: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Announcement {
    /// Listens for queries in every network in which a page at this address is reached. There is no name yet.
    ///
    /// # Errors
    /// The system does not allow it.
    pub fn start(page: IpAddr) -> std::io::Result<Self> {
        let listening = listen()?;
        let (name, ended): (Arc<Mutex<Option<String>>>, Arc<AtomicBool>) = Default::default();
        let responder = Responder { page, socket: listening, networks: Vec::new(), told: None };
        let (of, over) = (Arc::clone(&name), Arc::clone(&ended));
        let thread = std::thread::Builder::new().name("mdns".into()).spawn(move || responder.run(&of, &over))?;
        Ok(Self { name, ended, thread: Some(thread) })
    }

    /// Announces this host name (without a dot at the end).
    pub fn set(&self, host: &str) {
        *lock(&self.name) = Some(host.to_owned());
    }
}

impl Drop for Announcement {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}

/// The host name of a box with this sensor.
#[must_use]
pub fn host_name(serial: &str) -> String {
    let allowed = serial.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase());
    let label: String = "lumiscan-".chars().chain(allowed).take(LABEL).collect();
    format!("{label}.local")
}

/// The port is shared with other responders of the machine.
fn listen() -> std::io::Result<UdpSocket> {
    let listening = socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    sockopt::set_socket_reuseaddr(&listening, true)?;
    sockopt::set_socket_reuseport(&listening, true)?;
    bind(&listening, &SocketAddr::from((Ipv4Addr::UNSPECIFIED, PORT)))?;
    // Heard in the own network only (RFC 6762, section 11).
    sockopt::set_ip_multicast_ttl(&listening, 255)?;
    let listening = UdpSocket::from(listening);
    listening.set_read_timeout(Some(POLL))?;
    Ok(listening)
}

struct Responder {
    page: IpAddr,
    socket: UdpSocket,
    /// Own addresses, each with its network.
    networks: Vec<Ifv4Addr>,
    /// When everybody was told last.
    told: Option<Instant>,
}

impl Responder {
    fn run(mut self, name: &Mutex<Option<String>>, ended: &AtomicBool) {
        let mut buffer = vec![0; PACKET];
        let (mut looked, mut known): (Option<Instant>, Option<String>) = (None, None);
        while !ended.load(Ordering::Acquire) {
            let current = lock(name).clone();
            let mut news = current != known;
            known = current;
            if looked.is_none_or(|t| t.elapsed() >= LOOK) {
                looked = Some(Instant::now());
                news |= self.look();
            }
            let Some(host) = &known else {
                std::thread::sleep(POLL);
                continue;
            };
            if news {
                self.networks.iter().for_each(|network| self.tell_all(host, network));
            }
            match self.socket.recv_from(&mut buffer) {
                Ok((n, SocketAddr::V4(peer))) => self.hear(host, &buffer[..n], peer),
                Err(e) if !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    tracing::debug!("mDNS: {e}");
                    std::thread::sleep(POLL);
                }
                _ => {}
            }
        }
    }

    /// Finds the networks in which the page is reached; true if they have changed.
    fn look(&mut self) -> bool {
        let all = if_addrs::get_if_addrs().unwrap_or_default();
        let reached = |ip: Ipv4Addr| self.page.is_unspecified() || self.page == IpAddr::V4(ip);
        let networks: Vec<Ifv4Addr> = all
            .into_iter()
            .filter_map(|i| match i.addr {
                IfAddr::V4(a) if reached(a.ip) => Some(a),
                _ => None,
            })
            .collect();
        if networks == self.networks {
            return false;
        }
        for network in &networks {
            // Fails where it was joined before.
            let _ = self.socket.join_multicast_v4(GROUP.ip(), &network.ip);
        }
        self.networks = networks;
        true
    }

    /// Answers a packet, if it asks for the host and comes from a neighbour.
    fn hear(&mut self, host: &str, packet: &[u8], peer: SocketAddrV4) {
        let Some(network) = self.networks.iter().find(|n| is_in(n, *peer.ip())).cloned() else { return };
        let Some(asked) = asked(packet, host, network.ip) else { return };
        if peer.port() != PORT {
            self.send(&answer(host, network.ip, Some(asked.id)), peer, &network);
        } else if asked.unicast {
            self.send(&answer(host, network.ip, None), peer, &network);
        } else if self.told.is_none_or(|t| t.elapsed() >= PAUSE) {
            self.told = Some(Instant::now());
            self.tell_all(host, &network);
        }
    }

    fn tell_all(&self, host: &str, network: &Ifv4Addr) {
        self.send(&answer(host, network.ip, None), GROUP, network);
    }

    fn send(&self, packet: &[u8], to: SocketAddrV4, network: &Ifv4Addr) {
        let sent = sockopt::set_ip_multicast_if(&self.socket, &network.ip)
            .map_err(std::io::Error::from)
            .and_then(|()| self.socket.send_to(packet, to));
        if let Err(e) = sent {
            tracing::debug!("mDNS: {to}: {e}");
        }
    }
}

fn is_in(network: &Ifv4Addr, ip: Ipv4Addr) -> bool {
    let of = |a: Ipv4Addr| u32::from(a) & u32::from(network.netmask);
    of(network.ip) == of(ip)
}

/// A query for the host's address.
#[derive(Debug, PartialEq, Eq)]
pub struct Asked {
    /// Number of the query.
    id: u16,
    /// The answer is for the one who asks alone.
    unicast: bool,
}

/// What a packet asks about the host; `None` if nothing, or if the one who asks knows it.
#[must_use]
pub fn asked(packet: &[u8], host: &str, own: Ipv4Addr) -> Option<Asked> {
    let packet = Some(packet).filter(|p| counts_fit(p))?;
    let packet = Packet::parse(packet).ok().filter(|p| !p.has_flags(PacketFlag::RESPONSE))?;
    let is_host = |name: &Name<'_>| name.to_string().trim_end_matches('.').eq_ignore_ascii_case(host);
    let question = packet.questions.iter().find(|q| {
        is_host(&q.qname)
            && matches!(q.qtype, QTYPE::TYPE(TYPE::A) | QTYPE::ANY)
            && matches!(q.qclass, QCLASS::CLASS(CLASS::IN) | QCLASS::ANY)
    })?;
    let known = packet.answers.iter().any(|a| {
        is_host(&a.name) && a.ttl >= REMEMBER_S / 2 && matches!(&a.rdata, RData::A(a) if a.address == u32::from(own))
    });
    (!known).then(|| Asked { id: packet.id(), unicast: question.unicast_response })
}

/// True if the packet is long enough for the questions and records that its header counts: the parser allocates for the count,
/// which is megabytes for a packet of a few bytes.
fn counts_fit(packet: &[u8]) -> bool {
    const HEADER_BYTES: usize = 12;
    const LEAST_QUESTION_BYTES: usize = 5;
    const LEAST_RECORD_BYTES: usize = 11;
    let Some((header, body)) = packet.split_at_checked(HEADER_BYTES) else { return false };
    let count = |i: usize| usize::from(u16::from_be_bytes([header[i], header[i + 1]]));
    let records = count(6) + count(8) + count(10);
    count(4) * LEAST_QUESTION_BYTES + records * LEAST_RECORD_BYTES <= body.len()
}

/// The packet that tells the host's address; `legacy` is the id of a query by a resolver that knows nothing of multicast, which
/// expects its question back.
fn answer(host: &str, own: Ipv4Addr, legacy: Option<u16>) -> Vec<u8> {
    let mut packet = Packet::new_reply(legacy.unwrap_or(0));
    packet.set_flags(PacketFlag::AUTHORITATIVE_ANSWER);
    let name = Name::new_unchecked(host);
    let (ttl, flush) = if legacy.is_some() { (REMEMBER_LEGACY_S, false) } else { (REMEMBER_S, true) };
    if legacy.is_some() {
        let question = simple_dns::Question::new(name.clone(), QTYPE::TYPE(TYPE::A), QCLASS::CLASS(CLASS::IN), false);
        packet.questions.push(question);
    }
    let record = ResourceRecord::new(name, CLASS::IN, ttl, RData::A(A::from(own))).with_cache_flush(flush);
    packet.answers.push(record);
    packet.build_bytes_vec().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use simple_dns::Question;

    const HOST: &str = "lumiscan-a00366a08793039a.local";
    const OWN: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 2);

    fn query(name: &str, kind: TYPE, unicast: bool) -> Packet<'_> {
        let mut packet = Packet::new_query(7);
        let class = QCLASS::CLASS(CLASS::IN);
        packet.questions.push(Question::new(Name::new_unchecked(name), QTYPE::TYPE(kind), class, unicast));
        packet
    }

    fn heard(packet: &Packet<'_>) -> Option<Asked> {
        asked(&packet.build_bytes_vec().unwrap(), HOST, OWN)
    }

    #[test]
    fn the_serial_number_names_the_box() {
        assert_eq!(host_name("A00366A08793039A"), HOST);
        assert_eq!(host_name("../ü.x"), "lumiscan-x.local");
        assert!(host_name(&"9".repeat(200)).len() <= LABEL + ".local".len());
    }

    #[test]
    fn only_a_query_for_the_own_name_is_answered() {
        assert_eq!(heard(&query(HOST, TYPE::A, false)), Some(Asked { id: 7, unicast: false }));
        assert_eq!(
            heard(&query("LUMISCAN-A00366A08793039A.local", TYPE::A, true)),
            Some(Asked { id: 7, unicast: true })
        );
        assert_eq!(heard(&query("other.local", TYPE::A, false)), None);
        assert_eq!(heard(&query(HOST, TYPE::TXT, false)), None);
        let mut known = query(HOST, TYPE::A, false);
        known.answers.push(ResourceRecord::new(Name::new_unchecked(HOST), CLASS::IN, 100, RData::A(A::from(OWN))));
        assert_eq!(heard(&known), None, "who asks knows it");
        assert_eq!(asked(&answer(HOST, OWN, None), HOST, OWN), None, "an answer is no query");
    }

    #[test]
    fn a_packet_too_short_for_its_counts_is_not_parsed() {
        let mut packet = query(HOST, TYPE::A, false).build_bytes_vec().unwrap();
        assert!(counts_fit(&packet));
        packet[10..12].fill(0xff);
        assert!(!counts_fit(&packet), "65535 additional records");
        assert!(!counts_fit(&packet[..11]));
    }

    #[test]
    fn an_answer_says_where_the_page_is() {
        for (legacy, id, ttl) in [(None, 0, REMEMBER_S), (Some(9), 9, REMEMBER_LEGACY_S)] {
            let bytes = answer(HOST, OWN, legacy);
            let packet = Packet::parse(&bytes).unwrap();
            assert_eq!((packet.id(), packet.questions.len()), (id, usize::from(legacy.is_some())));
            let record = &packet.answers[0];
            assert_eq!(
                (record.name.to_string().as_str(), record.ttl, record.cache_flush),
                (HOST, ttl, legacy.is_none())
            );
            assert!(matches!(&record.rdata, RData::A(a) if a.address == u32::from(OWN)));
        }
    }

    #[test]
    fn neighbours_are_those_of_the_same_network() {
        let network = Ifv4Addr { ip: OWN, netmask: Ipv4Addr::new(255, 255, 255, 0), prefixlen: 24, broadcast: None };
        assert!(is_in(&network, Ipv4Addr::new(10, 0, 0, 77)) && !is_in(&network, Ipv4Addr::new(10, 0, 1, 77)));
    }

    proptest! {
        #[test]
        fn whatever_comes_is_a_query_or_nothing(mut bytes in prop::collection::vec(any::<u8>(), 0..600), cut in any::<prop::sample::Index>()) {
            let _ = asked(&bytes, HOST, OWN);
            let real = query(HOST, TYPE::A, false).build_bytes_vec().unwrap();
            bytes.splice(0..0, real[..cut.index(real.len())].iter().copied());
            let _ = asked(&bytes, HOST, OWN);
        }
    }
}

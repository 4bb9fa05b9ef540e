//! Tests that the shipped files agree with the constants of the program.

use crate::config::Config;
use crate::kinect_models::{Part, part_of};
use crate::serve::APPLIANCE_ADDRESS;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/appliance");

fn shipped(name: &str) -> String {
    std::fs::read_to_string(format!("{FOLDER}/{name}")).unwrap()
}

/// The defaults, but with the web page.
fn appliance() -> Config {
    let mut config = Config::default();
    config.serve.address = APPLIANCE_ADDRESS.into();
    config
}

/// Run with `LUMISCAN_BLESS=1` to rewrite the file after a change of a default.
#[test]
fn default_toml_holds_the_defaults() {
    let text = appliance().to_commented_toml();
    if std::env::var_os("LUMISCAN_BLESS").is_some() {
        std::fs::write(format!("{FOLDER}/default.toml"), &text).unwrap();
    }
    assert_eq!(shipped("default.toml"), text, "LUMISCAN_BLESS=1 cargo test -p firmware-config rewrites it");
    assert_eq!(Config::from_toml(&shipped("default.toml")), Ok(appliance()));
}

#[test]
fn udev_names_every_part_and_nothing_is_open_to_the_world() {
    let rules = shipped("60-lumiscan.rules");
    let listed: Vec<u16> = rules
        .lines()
        .filter_map(|l| l.strip_prefix("ATTR{idProduct}==\"")?.split('"').next())
        .flat_map(|ids| ids.split('|').map(|id| u16::from_str_radix(id, 16).unwrap()))
        .collect();
    let ours = (0..=u16::MAX).filter(|p| matches!(part_of(0x045e, *p), Some(Part::Camera | Part::Motor | Part::Audio)));
    let mut sorted = listed.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, ours.collect::<Vec<_>>());
    assert!(!rules.contains("0666") && !rules.contains("0664") && rules.contains("uaccess"));
}

#[test]
fn the_unit_allows_what_the_memory_plan_says() {
    let unit = shipped("lumiscan.service");
    let max: u64 = unit.lines().find_map(|l| l.strip_prefix("MemoryMax=")?.strip_suffix('M')).unwrap().parse().unwrap();
    let daemon = Config::default().daemon;
    let planned = u64::from(daemon.memory_limit_mb + daemon.estimator_limit_mb);
    assert!(max * 1_048_576 >= planned * 1_000_000 && max < 4000, "{max} MiB for {planned} MB");
    for line in
        ["User=lumiscan", "StateDirectory=lumiscan", "WatchdogSec=60", "OOMPolicy=continue", "DevicePolicy=closed"]
    {
        assert!(unit.lines().any(|l| l == line), "{line}");
    }
    let port = APPLIANCE_ADDRESS.rsplit(':').next().unwrap();
    assert!(unit.contains(&format!("\nSocketBindAllow=tcp:{port}\n")), "no other port can be opened");
    assert!(!unit.contains("DynamicUser"), "results would be locked away");
}

/// systemd's own assessment of the units, where systemd is installed.
#[test]
fn systemd_finds_the_units_tight() {
    for name in ["lumiscan.service", "lumiscan-handoff.service"] {
        let unit = format!("{FOLDER}/{name}");
        let analyzed = std::process::Command::new("systemd-analyze")
            .args(["security", "--offline=true", "--no-pager", &unit])
            .output();
        let text = analyzed.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default();
        let Some(level) = text.lines().find_map(|l| l.split(&format!("Overall exposure level for {name}:")).nth(1))
        else {
            println!("skipped: systemd-analyze security cannot be run here");
            return;
        };
        let level: f64 = level.split_whitespace().next().unwrap().parse().unwrap();
        assert!(level <= 1.5, "{text}");
    }
}

#[test]
fn the_handoff_works_on_the_folder_of_the_daemon() {
    let (daemon, handoff) = (shipped("lumiscan.service"), shipped("lumiscan-handoff.service"));
    for option in ["--device /var/lib/lumiscan", "--config /etc/lumiscan/default.toml", "\nUser=lumiscan\n"] {
        assert!(daemon.contains(option) && handoff.contains(option), "{option}");
    }
    assert!(shipped("lumiscan-handoff.path").contains("PathChanged=/var/lib/lumiscan/scans\n"));
    assert!(shipped("lumiscan-handoff.timer").contains("OnUnitInactiveSec="), "a dead network is tried again");
}

//! What users write: configuration, command lines, plans of the simulator.

use clap::{Command, CommandFactory, FromArgMatches};
use estimator::Reference;
use estimator::render::lighting::lamp_change::LampChange;
use estimator::render::objects::insert::Insert;
use estimator::render::view::ViewChoice;
use firmware_config::Config;
use lumiscan::cli::Cli;
use lumiscan::simulator::plan::SimPlan;
use std::cell::RefCell;

/// A file. What it says can be written, and read again.
pub fn config(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(config) = Config::from_toml(text) {
        Config::from_toml(&config.to_toml()).expect("a configuration that was written");
    }
}

/// `--set`, once a line; a few, since each that is refused is compared with every name.
pub fn setting(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let mut config = Config::default();
    text.lines().take(3).for_each(|line| drop(config.set(line)));
}

/// Arguments, one a line.
pub fn command_line(bytes: &[u8]) {
    thread_local!(static COMMAND: RefCell<Command> = RefCell::new(Cli::command()));
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let arguments = std::iter::once("lumiscan").chain(text.lines());
    COMMAND.with_borrow_mut(|command| {
        if let Ok(matches) = command.try_get_matches_from_mut(arguments) {
            let _ = Cli::from_arg_matches(&matches);
        }
    });
}

pub fn plan(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let _ = SimPlan::parse(text);
}

/// The values of options that have a form of their own.
pub fn values(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let _ = (text.parse::<Insert>(), text.parse::<ViewChoice>(), text.parse::<LampChange>(), text.parse::<Reference>());
    let _ = recordings::parse_seconds(text);
    // A name would be looked up in the network.
    if text.bytes().all(|b| b"0123456789.:[]".contains(&b)) {
        let _ = lumiscan::cli::address(text);
    }
}

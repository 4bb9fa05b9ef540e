//! Settings that may change while the daemon runs: a scan takes them as they are when it begins.

use crate::lock::lock;
use firmware_config::{Config, ConfigError};
use std::sync::Mutex;

/// The settings that may change. Others are bound to what has been started with them: threads, memory, addresses, sensor.
pub const CHANGEABLE: [&str; 9] = [
    "daemon.max_scan_s",
    "daemon.budget_s",
    "daemon.max_folder_mb",
    "daemon.min_free_mb",
    "estimator.quality",
    "estimator.texture",
    "fusion.voxel_size_m",
    "fusion.min_depth_m",
    "fusion.max_depth_m",
];

/// The settings of the next scan.
pub struct LiveConfig(Mutex<Config>);

impl LiveConfig {
    /// As the program was started.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        Self(Mutex::new(config.clone()))
    }

    /// As they are now.
    #[must_use]
    pub fn get(&self) -> Config {
        lock(&self.0).clone()
    }

    /// Changes settings, all of them or none.
    ///
    /// # Errors
    /// One may not change, or its value is out of range.
    pub fn change<'a>(&self, changes: impl Iterator<Item = (&'a str, String)>) -> Result<(), String> {
        let mut config = lock(&self.0);
        let mut changed = config.clone();
        for (key, value) in changes {
            if !CHANGEABLE.contains(&key) {
                return Err(format!("{key} does not change while the box runs; set it in its settings file"));
            }
            // A line of its own would be a setting of its own.
            if value.contains(char::is_control) {
                return Err(format!("{key}: a value is one line"));
            }
            changed.set(&format!("{key}={value}")).map_err(|e: ConfigError| e.to_string())?;
            tracing::info!("{key} is {value} from the next scan on");
        }
        *config = changed;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_changes_hold_or_none() {
        let live = LiveConfig::new(&Config::default());
        let of = |list: &[(&'static str, &str)]| live.change(list.iter().map(|(k, v)| (*k, (*v).to_owned())));
        of(&[("daemon.budget_s", "77"), ("estimator.quality", "draft")]).unwrap();
        assert_eq!(live.get().daemon.budget_s, 77.0);
        for bad in [
            ("daemon.budget_s", "-1"),
            ("fusion.pool_blocks", "512"),
            ("nothing.at_all", "1"),
            ("daemon.budget_s", "1\nx=2"),
        ] {
            assert!(of(&[("daemon.max_scan_s", "9"), bad]).is_err(), "{bad:?}");
        }
        assert_ne!(live.get().daemon.max_scan_s, 9.0);
    }

    #[test]
    fn what_may_change_is_a_setting() {
        let keys: Vec<String> = Config::default().settings().into_iter().map(|s| s.key.to_string()).collect();
        assert!(CHANGEABLE.iter().all(|c| keys.iter().any(|k| k == c)), "{keys:?}");
    }
}

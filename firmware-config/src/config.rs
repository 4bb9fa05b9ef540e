//! All sections as one value: read from TOML and `--set`, written as TOML.

use crate::capture::CaptureConfig;
use crate::daemon::DaemonConfig;
use crate::estimator::EstimatorConfig;
use crate::fusion::FusionConfig;
use crate::handoff::HandoffConfig;
use crate::kinect::{CameraConfig, KinectConfig};
use crate::reality::RealityConfig;
use crate::serve::ServeConfig;
use crate::settings::{ConfigError, SettingInfo};
use crate::tuning::DepthNoiseTuning;
use std::collections::BTreeMap;

/// Every setting.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Config {
    /// Sources, pairing, device folder.
    pub capture: CaptureConfig,
    /// Tracking, TSDF and keyframes.
    pub fusion: FusionConfig,
    /// The estimator.
    pub estimator: EstimatorConfig,
    /// The daemon.
    pub daemon: DaemonConfig,
    /// Where finished scans go.
    pub handoff: HandoffConfig,
    /// A live Kinect.
    pub kinect: KinectConfig,
    /// Its colour camera, where nothing is known of the device's own.
    pub camera: CameraConfig,
    /// Colour cameras by serial number.
    pub cameras: BTreeMap<String, CameraConfig>,
    /// Depth noise by serial number.
    pub depth_noises: BTreeMap<String, DepthNoiseTuning>,
    /// Mixed-reality rendering.
    pub reality: RealityConfig,
    /// The web page.
    pub serve: ServeConfig,
}

impl Config {
    /// Defaults overlaid with the settings of a TOML document (one table a section).
    ///
    /// # Errors
    /// Syntax errors, unknown keys and values out of range.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let mut config = Self::default();
        let table: toml::Table = text.parse().map_err(|e: toml::de::Error| ConfigError::Syntax(e.to_string()))?;
        for (section, value) in &table {
            let toml::Value::Table(fields) = value else {
                return Err(config.unknown(section));
            };
            // The tables of single devices overlay the values of the section.
            let (tables, values): (Vec<_>, Vec<_>) = fields.iter().partition(|(_, v)| v.is_table());
            for (field, value) in values {
                config.set_value(section, field, value)?;
            }
            for (serial, table) in tables {
                let toml::Value::Table(fields) = table else { continue };
                config.set_device(section, serial, fields)?;
            }
        }
        Ok(config)
    }

    /// Sets the values of one device, `[section.serial]`.
    fn set_device(&mut self, section: &str, serial: &str, fields: &toml::Table) -> Result<(), ConfigError> {
        let unknown = |field: &str| self.unknown(&format!("{section}.{field}"));
        match section {
            CameraConfig::SECTION => {
                let mut camera = self.camera.clone();
                for (field, value) in fields {
                    camera.set(field, value).unwrap_or_else(|| Err(unknown(field)))?;
                }
                self.cameras.insert(serial.to_owned(), camera);
            }
            DepthNoiseTuning::SECTION => {
                let mut noise = self.fusion.tuning.depth_noise.clone();
                for (field, value) in fields {
                    noise.set(field, value).unwrap_or_else(|| Err(unknown(field)))?;
                }
                self.depth_noises.insert(serial.to_owned(), noise);
            }
            _ => return Err(unknown(serial)),
        }
        Ok(())
    }

    /// Sets one value from `section.field=value` as given on the command line.
    ///
    /// # Errors
    /// A missing `=`, an unknown key, or a value out of range.
    pub fn set(&mut self, assignment: &str) -> Result<(), ConfigError> {
        let Some((key, text)) = assignment.split_once('=') else {
            return Err(ConfigError::Syntax(format!("`{assignment}` is not of the form section.key=value")));
        };
        let (key, text) = (key.trim(), text.trim());
        let Some((section, field)) = key.split_once('.') else {
            return Err(self.unknown(key));
        };
        // A bare word is a string, everything else is read as TOML.
        let value = format!("v = {text}")
            .parse::<toml::Table>()
            .ok()
            .and_then(|mut t| t.remove("v"))
            .unwrap_or_else(|| toml::Value::String(text.to_owned()));
        self.set_value(section, field, &value)
    }

    fn set_value(&mut self, section: &str, field: &str, value: &toml::Value) -> Result<(), ConfigError> {
        let outcome = match section {
            CaptureConfig::SECTION => self.capture.set(field, value),
            FusionConfig::SECTION => self.fusion.set(field, value),
            EstimatorConfig::SECTION => self.estimator.set(field, value),
            DaemonConfig::SECTION => self.daemon.set(field, value),
            HandoffConfig::SECTION => self.handoff.set(field, value),
            KinectConfig::SECTION => self.kinect.set(field, value),
            CameraConfig::SECTION => self.camera.set(field, value),
            RealityConfig::SECTION => self.reality.set(field, value),
            ServeConfig::SECTION => self.serve.set(field, value),
            _ => (self.fusion.tuning.set(section, field, value))
                .or_else(|| self.estimator.tuning.set(section, field, value))
                .or_else(|| self.capture.tuning.set(section, field, value))
                .or_else(|| self.daemon.tuning.set(section, field, value))
                .or_else(|| self.kinect.tuning.set(section, field, value))
                .or_else(|| self.reality.tuning.set(section, field, value)),
        };
        outcome.unwrap_or_else(|| Err(self.unknown(&format!("{section}.{field}"))))
    }

    /// The colour camera of the device with this serial number, and whether it has settings of its own.
    #[must_use]
    pub fn camera_of(&self, serial: &str) -> (&CameraConfig, bool) {
        self.cameras.get(serial).map_or((&self.camera, false), |c| (c, true))
    }

    /// The settings of fusion for the sensor with this serial number: with its own depth noise, if it has one.
    #[must_use]
    pub fn fusion_of(&self, serial: &str) -> FusionConfig {
        let mut fusion = self.fusion.clone();
        if let Some(noise) = self.depth_noises.get(serial) {
            fusion.tuning.depth_noise.clone_from(noise);
        }
        fusion
    }

    /// Every setting, in order.
    #[must_use]
    pub fn settings(&self) -> Vec<SettingInfo> {
        [
            self.capture.settings(),
            self.capture.tuning.settings(),
            self.fusion.settings(),
            self.fusion.tuning.settings(),
            self.estimator.settings(),
            self.estimator.tuning.settings(),
            self.daemon.settings(),
            self.daemon.tuning.settings(),
            self.handoff.settings(),
            self.kinect.settings(),
            self.kinect.tuning.settings(),
            self.camera.settings(),
            self.reality.settings(),
            self.reality.tuning.settings(),
            self.serve.settings(),
        ]
        .concat()
    }

    /// What a scan stores, as TOML that [`Config::from_toml`] reads back: every setting, but thresholds of single stages only
    /// where they differ from their default, and nothing of the web page and of where scans are sent.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        let mut section = "";
        let settings = self.settings();
        for s in settings.iter().filter(|s| is_stored(s)) {
            let (head, field) = s.key.split_once('.').unwrap_or(("", &s.key));
            if head != section {
                section = head;
                text.push_str(&format!("{}[{head}]\n", if text.is_empty() { "" } else { "\n" }));
            }
            text.push_str(&format!("{field} = {}\n", s.value));
        }
        let cameras = self.cameras.iter().map(|(serial, c)| (CameraConfig::SECTION, serial, c.settings()));
        let noises = self.depth_noises.iter().map(|(serial, n)| (DepthNoiseTuning::SECTION, serial, n.settings()));
        for (section, serial, settings) in cameras.chain(noises) {
            text.push_str(&format!("\n[{section}.{}]\n", toml::Value::String(serial.clone())));
            for s in settings {
                text.push_str(&format!("{} = {}\n", s.key.rsplit('.').next().unwrap_or_default(), s.value));
            }
        }
        text
    }

    /// The same with a comment above each setting: what it does, unit, range, default, symbol in the paper.
    #[must_use]
    pub fn to_commented_toml(&self) -> String {
        let mut text = String::new();
        let mut section = String::new();
        for s in self.settings() {
            let (head, field) = s.key.split_once('.').unwrap_or(("", &s.key));
            if head != section {
                text.push_str(&format!("{}[{head}]\n", if text.is_empty() { "" } else { "\n" }));
                head.clone_into(&mut section);
            }
            let unit = if s.unit.is_empty() { String::new() } else { format!("unit {} · ", s.unit) };
            let symbol = if s.symbol.is_empty() { String::new() } else { format!(" · {}", s.symbol) };
            text.push_str(&format!("# {}\n# {unit}range {} · default {}{symbol}\n", s.doc, s.range, s.default));
            text.push_str(&format!("{field} = {}\n", s.value));
        }
        text
    }

    fn unknown(&self, key: &str) -> ConfigError {
        let field = key.rsplit('.').next().unwrap_or(key);
        let hint = self
            .settings()
            .iter()
            .map(|s| (strsim::levenshtein(field, s.key.rsplit('.').next().unwrap_or("")), s.key.clone()))
            .min()
            .filter(|(d, _)| *d <= 3)
            .map_or(String::new(), |(_, k)| format!(" (did you mean `{k}`?)"));
        ConfigError::UnknownKey { key: key.into(), hint }
    }
}

/// True if a scan stores the setting.
fn is_stored(setting: &SettingInfo) -> bool {
    let section = setting.key.split('.').next().unwrap_or_default();
    let elsewhere = [ServeConfig::SECTION, HandoffConfig::SECTION].contains(&section);
    !elsewhere && (!setting.tuning || setting.value != setting.default)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::ResponseChoice;
    use crate::estimator::TextureChoice;

    #[test]
    fn toml_round_trip() {
        let mut config = Config::default();
        config.set("fusion.voxel_size_m=0.01").unwrap();
        config.set("estimator.transfer=shade").unwrap();
        config.set("distance_check.changed_log=0.1").unwrap();
        assert!(!config.to_toml().contains("handoff"), "a scan tells nobody where it was sent");
        assert!(!config.to_toml().contains("explained_share"), "thresholds are stored where they were changed");
        assert_eq!(Config::from_toml(&config.to_toml()).as_ref(), Ok(&config));
        assert_eq!(Config::from_toml(&config.to_commented_toml()), Ok(config));
    }

    #[test]
    fn textures_are_off_automatic_or_of_a_width() {
        let mut config = Config::default();
        for (text, expected) in
            [("off", TextureChoice::Off), ("1.5", TextureChoice::Texel(1.5)), ("auto", TextureChoice::Auto)]
        {
            config.set(&format!("estimator.texture={text}")).unwrap();
            assert_eq!(config.estimator.texture, expected);
            assert_eq!(Config::from_toml(&config.to_toml()).as_ref(), Ok(&config));
        }
        for bad in ["fine", "0", "-2", "1000", "nan"] {
            let e = config.set(&format!("estimator.texture={bad}")).unwrap_err().to_string();
            assert!(e.contains("off, auto, or 0.05"), "{e}");
        }
    }

    #[test]
    fn a_camera_of_its_own_overlays_the_common_one() {
        let text = "[camera]\nfx = 520.0\nresponse = \"gamma:2.2\"\n[camera.A003]\ncx = 321.0";
        let config = Config::from_toml(text).unwrap();
        let (own, known) = config.camera_of("A003");
        assert_eq!((own.fx, own.cx, own.response, known), (520.0, 321.0, ResponseChoice::Gamma(2.2), true));
        assert_eq!(config.camera_of("B"), (&config.camera, false));
        assert_eq!(Config::from_toml(&config.to_toml()), Ok(config));
        assert!(Config::from_toml("[camera.A003]\nfz = 1").unwrap_err().to_string().contains("camera.fz"));
        assert!(Config::from_toml("[fusion.A003]\nfz = 1").is_err());
    }

    #[test]
    fn depth_noise_is_that_of_the_sensor() {
        let config = Config::from_toml("[depth_noise]\nfloor_m = 0.002\n[depth_noise.A003]\nquadratic = 0.0").unwrap();
        let noise = |serial: &str| config.fusion_of(serial).tuning.depth_noise;
        assert_eq!((noise("A003").floor_m, noise("A003").quadratic), (0.002, 0.0));
        assert_eq!(noise("B"), config.fusion.tuning.depth_noise);
        assert_eq!(Config::from_toml(&config.to_toml()).as_ref(), Ok(&config));
        assert!(Config::from_toml("[depth_noise.A003]\nflor_m = 1").unwrap_err().to_string().contains("floor_m"));
    }

    #[test]
    fn unknown_key_is_named_with_a_hint() {
        let e = Config::default().set("fusion.voxel_sise_m=0.01").unwrap_err();
        assert!(e.to_string().contains("fusion.voxel_size_m"), "{e}");
        assert!(Config::from_toml("[nonsense]\nx = 1").is_err());
        assert!(Config::from_toml("x = 1").is_err());
    }

    #[test]
    fn out_of_range_names_the_range() {
        let e = Config::default().set("fusion.voxel_size_m=7").unwrap_err();
        assert!(e.to_string().contains("0.001"), "{e}");
        assert!(Config::default().set("fusion.voxel_size_m=nan").is_err());
        assert!(Config::default().set("fusion.pool_blocks=-1").is_err());
    }
}

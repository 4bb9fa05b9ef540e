//! Named points of the trade between speed and accuracy.

use firmware_config::{EstimatorConfig, Quality, TextureChoice};

/// The settings with their named point applied to what is left to `auto`.
#[must_use]
pub fn at_quality(config: &EstimatorConfig) -> EstimatorConfig {
    let mut config = config.clone();
    let auto = |value: &mut u32, to: u32| {
        if *value == 0 {
            *value = to;
        }
    };
    match config.quality {
        Quality::Draft => {
            auto(&mut config.rays, 32);
            auto(&mut config.bands, 4);
            auto(&mut config.bounces, 2);
            config.association_rounds = config.association_rounds.min(2);
            if config.texture == TextureChoice::Auto {
                config.texture = TextureChoice::Off;
            }
        }
        Quality::Standard => {}
        Quality::Best => auto(&mut config.rays, 1024),
    }
    config
}

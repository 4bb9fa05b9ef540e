//! Errors of fusion.

/// Why fusion cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum FusionError {
    /// The sensor's description is not usable.
    #[error("{0}")]
    BadSensor(String),
    /// A frame does not have the sensor's image sizes.
    #[error("{0}")]
    BadFrame(String),
}
